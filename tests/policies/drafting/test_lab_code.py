"""Environments of Isaac Lab whose observation is code: direct ones, and those of legged_lab."""

import json

import pytest
from tests.policies.drafting.test_beside import BY_TYPE, words

DIRECT = """
from isaaclab.envs import DirectRLEnv
open("RAN", "w").write("the code was run")
class WalkEnv(DirectRLEnv):
    cfg: WalkFlatCfg | WalkStairsCfg
    def __init__(self, cfg):
        if cfg.gait == "trot":
            self._step_freq = 1.6
            self._phase_offset = torch.tensor([0.0, 0.5, 0.5, 0.0], device=self.device).repeat(2, 1)
        elif cfg.gait == "crawl":
            self._step_freq = 0.5
            self._phase_offset = torch.tensor([0.0, 0.5, 0.75, 0.25], device=self.device)
    def _pre_physics_step(self, actions):
        self._actions = torch.clamp(actions, -self.cfg.most, self.cfg.most)
        if self.cfg.filters:
            mixed = 0.8 * self._actions + 0.2 * self._previous_actions
    def _get_observations(self):
        clock = None
        if self.cfg.use_clock:
            clock = torch.vstack([self._phase[:, 0], self._phase[:, 1],
                                  self._phase[:, 2], self._phase[:, 3]]).T
            moves = torch.norm(self._commands[:, :3], dim=1) > 0.02
            clock[:, :] = clock[:, :] * moves.unsqueeze(1) + -1.0 * ~moves.unsqueeze(1)
        speed = self._estimate() if False else self._guess()
        seen = torch.cat([part for part in (
            speed, self._imu.data.ang_vel_b, self._robot.data.projected_gravity_b, self._commands,
            self._robot.data.joint_pos - self._robot.data.default_joint_pos,
            self._robot.data.joint_vel * 0.05, self._actions, clock) if part is not None], dim=-1)
        if self.cfg.use_past:
            self._past = torch.cat((self._past[:, 1:, :], seen.unsqueeze(1)), dim=1)
            seen = torch.flatten(self._past, start_dim=1)
        return {"policy": seen, "critic": torch.cat((seen, self._friction), dim=-1)}
    def _guess(self):
        if self.steps > 100:
            speed = self._network(self._robot.data.joint_vel)
        else:
            speed = self._robot.data.root_lin_vel_b
        return speed
"""
GUESSED = DIRECT.replace("self._estimate() if False else self._guess()", "self._guess()")
SAVED = {
    "sim": {"dt": 0.005},
    "decimation": 4,
    "observation_space": 156,
    "single_observation_space": 52,
    "action_space": 12,
    "action_scale": 0.5,
    "gait": "trot",
    "most": 3.0,
    "use_clock": True,
    "use_past": True,
    "filters": False,
    "robot": {
        "init_state": {"joint_pos": {".*_hip_joint": 0.0, ".*_thigh_joint": 0.9,
                                     ".*_calf_joint": -1.8}},
        "actuators": {"all": {"joint_names_expr": [".*"], "stiffness": 25.0, "damping": 2.0,
                              "effort_limit": 23.7}},
    },
}  # fmt: skip
CHECKPOINT = "repo/tested/run/exported/policy.onnx"
CODE = "../../../source/walks/walks/tasks/walk/walk_env.py"


def direct(code=GUESSED, **changed):
    saved = json.dumps({**SAVED, **changed})
    return {"../../../setup.py": "", CODE: code, "../params/env.yaml": saved}


def test_a_direct_environment_says_terms_clock_and_frames(card_of):
    text, card = card_of(156, direct(), name=CHECKPOINT)
    assert words(card) == [
        "lin_vel", "ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output", "clock"
    ]  # fmt: skip
    terms = card.observations["obs"].frame_terms
    assert (terms[4].relative, terms[5].scale, terms[6].clipped) == (True, 0.05, True)
    clock = terms[7]
    assert (clock.frequency, clock.offsets, clock.values) == (1.6, [0, 0.5, 0.5, 0], ["phase"])
    assert (clock.standing.below, clock.standing.phase) == (0.02, -1.0)
    history = card.observations["obs"].history
    assert (history.steps, history.order, history.by) == (3, "oldest_first", "step")
    assert (card.control.clip, card.control.joints) == ((-3, 3), BY_TYPE)
    assert "the environment computes what the policy sees" not in text, "as it is known"


def test_a_branch_that_settings_decide_is_taken(card_of):
    sizes = {"observation_space": 48, "single_observation_space": 48}
    _, card = card_of(48, direct(use_clock=False, use_past=False, **sizes), name=CHECKPOINT)
    assert words(card)[-1] == "last_output"
    assert card.observations["obs"].history is None


def test_what_the_settings_do_not_decide_is_said(card_of):
    text, _ = card_of(156, direct(filters=True), name=CHECKPOINT)
    assert "CHECK: speed is another where self.steps > 100" in text
    assert "CHECK: its actions are filtered by those before" in text
    assert "mixed = 0.8 * self._actions" in text


def test_of_a_method_the_first_return_that_is_come_to_counts(card_of):
    early = (
        "    def _guess(self):\n        if self.cfg.use_past:\n            return self._imu.data"
    )
    code = GUESSED.replace("    def _guess(self):\n", f"{early}.projected_gravity_b\n")
    _, card = card_of(156, direct(code), name=CHECKPOINT)
    assert words(card)[0] == "gravity"


@pytest.mark.parametrize(
    ("old", "new", "index", "scale"),
    [
        pytest.param("joint_vel * 0.05", "joint_vel * 0.05", 5, 0.05, id="behind"),
        pytest.param(
            "self._robot.data.joint_vel * 0.05", "0.1 * self._robot.data.joint_vel", 5, 0.1,
            id="before",
        ),
    ],
)  # fmt: skip
def test_a_factor_may_stand_on_either_side_of_a_reading(old, new, index, scale, card_of):
    _, card = card_of(156, direct(GUESSED.replace(old, new)), name=CHECKPOINT)
    term = card.observations["obs"].frame_terms[index]
    assert (term.term, term.scale) == ("joint_vel", scale)


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param("seen[:, 0:3] = 0.0", id="in a part"),
        pytest.param("seen *= 3.0", id="in place"),
        pytest.param("clock[:, 0] = 0.0", id="a clock"),
    ],
)
def test_what_is_changed_before_it_is_seen_is_not_told(changed, card_of):
    past = "        if self.cfg.use_past:\n"
    speed = "        speed = self._guess()\n"
    lines = f"        {changed}\n"
    code = (
        GUESSED.replace(speed, lines + speed)
        if "clock" in changed
        else GUESSED.replace(past, lines + past)
    )
    assert code != GUESSED
    text, card = card_of(156, direct(code), name=CHECKPOINT)
    assert "clock" not in words(card)
    assert "ZEROS STAND FOR" in text or "names its terms" not in text


@pytest.mark.parametrize("file", [CODE, "../../../walk.py"])
def test_code_that_is_too_large_to_be_read_is_not_read(file, card_of, tmp_path):
    place = tmp_path / "repo" / file.removeprefix("../../../")
    place.parent.mkdir(parents=True)
    with place.open("wb") as sparse:
        sparse.truncate(2**40)
    text, _ = card_of(45, {"../../../setup.py": ""}, name=CHECKPOINT)
    assert "was read, not run" not in text


def test_nothing_of_a_direct_environment_is_run(card_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    card_of(156, direct(), name=CHECKPOINT)
    assert not list(tmp_path.rglob("RAN"))


REGISTER = """
from lab.utils import task_registry
task_registry.register("walk", WalkEnv, WalkCfg(), AgentCfg())
task_registry.register("run", WalkEnv, RunCfg(), AgentCfg())
"""
ROBOT = """
DOG_CFG = ArticulationCfg(
    spawn=UsdFileCfg(usd_path=f"{DIR}/dog.usd"),
    init_state=ArticulationCfg.InitialStateCfg(
        pos=(0.0, 0.0, 0.4),
        joint_pos={".*_hip_joint": 0.0, ".*_thigh_joint": 0.9, ".*_calf_joint": -1.8}),
    actuators={"legs": ImplicitActuatorCfg(
        joint_names_expr=[".*"], stiffness=30.0, damping=1.5, effort_limit_sim=25.0)},
)
"""
SETTINGS = """
class GaitCfg:
    gait_cycle: float = PERIOD
    gait_phase_offset_l: float = 0.25
    gait_phase_offset_r: float = 0.75
class NAMECfg:
    scene: SceneCfg = SceneCfg(robot=DOG_CFG, height_scanner=ScannerCfg(enable=False))
    robot: RobotCfg = RobotCfg(actor_obs_history_length=4, action_scale=0.2)
    gait = GaitCfg()
    normalization: NormalizationCfg = NormalizationCfg(
        obs_scales=ObsScalesCfg(ang_vel=0.5, commands=2.0), clip_observations=50.0,
        clip_actions=20.0)
    commands: CommandsCfg = CommandsCfg(ranges=RangesCfg(
        lin_vel_x=(-0.6, 1.0), lin_vel_y=(-0.5, 0.5), ang_vel_z=(-1.5, 1.5)))
    sim: SimCfg = SimCfg(dt=0.005, decimation=4)
"""
REGISTERED = """
class WalkEnv(VecEnv):
    def init_buffers(self):
        self.obs_scales = self.cfg.normalization.obs_scales
        self.gait_cycle = torch.full((9,), self.cfg.gait.gait_cycle)
        self.phase_offset = torch.tensor(
            [self.cfg.gait.gait_phase_offset_l, self.cfg.gait.gait_phase_offset_r]).repeat(9, 1)
        self.ratio = torch.tensor([0.3, 0.4])
    def compute_current_observations(self):
        robot = self.robot
        command = self.command_generator.command
        action = self.action_buffer._circular_buffer.buffer[:, -1, :]
        seen = torch.cat([
            robot.data.root_ang_vel_b * self.obs_scales.ang_vel, command * self.obs_scales.commands,
            robot.data.joint_pos - robot.data.default_joint_pos,
            robot.data.joint_vel - robot.data.default_joint_vel, action,
            torch.sin(2 * torch.pi * self.gait_phase), self.ratio], dim=-1)
        return seen, torch.cat([seen, robot.data.root_lin_vel_b], dim=-1)
    def compute_observations(self):
        seen, of_critic = self.compute_current_observations()
        if self.add_noise:
            seen += torch.rand_like(seen)
        self.kept.append(seen)
        now = self.kept.buffer.reshape(self.num_envs, -1)
        if self.cfg.scene.height_scanner.enable:
            now = torch.cat([now, self.heights], dim=-1)
        return torch.clip(now, -self.clip_obs, self.clip_obs), of_critic
"""


def registered():
    envs = "../lab/envs"
    return {
        "../setup.py": "",
        "../lab/assets/dog.py": ROBOT,
        f"{envs}/__init__.py": REGISTER,
        f"{envs}/env.py": REGISTERED,
        f"{envs}/a_run.py": SETTINGS.replace("NAME", "Run").replace("PERIOD", "0.4"),
        f"{envs}/walk.py": SETTINGS.replace("NAME", "Walk").replace("PERIOD", "0.8"),
    }


def test_a_registered_environment_of_isaac_lab_gives_settings_robot_and_terms(card_of):
    text, card = card_of(184, registered(), name="repo/exported/walk.onnx")
    assert words(card) == [
        "ang_vel", "command", "joint_pos", "joint_vel", "last_output", "clock", "constant"
    ]  # fmt: skip
    terms = card.observations["obs"].frame_terms
    assert (terms[0].scale, terms[1].scale) == (0.5, 2.0)
    assert (terms[5].frequency, terms[5].offsets, terms[5].values) == (1.25, [0.25, 0.75], ["sine"])
    assert terms[6].values == [0.3, 0.4]
    assert card.observations["obs"].history.steps == 4
    control = card.control
    assert (control.kp, control.kd, control.torque_limits, control.scale) == (30, 1.5, 25, 0.2)
    assert (control.joints, control.rate, control.clip) == (BY_TYPE, 50, (-20, 20))
    assert control.default_pose == [0] * 4 + [0.9] * 4 + [-1.8] * 4
    assert card.trained_speeds["lin_vel_x"] == (-0.6, 1.0)
    assert card.observations["obs"].clip == (-50, 50)
    assert "the task walk in" in text


def test_settings_of_one_name_are_those_of_their_own_file(card_of):
    _, card = card_of(184, registered(), name="repo/exported/run.onnx")
    assert card.observations["obs"].frame_terms[5].frequency == 2.5
