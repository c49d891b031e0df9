"""The code of a training is read as text: its settings, and the terms that it joins."""

import pytest
from tests.policies.drafting.test_beside import GYM, LEFT_FIRST, LEFT_FIRST_POSE, words

from nw_policies.drafting.feeders import may_feed

REGISTER = """
from sim.registry import task_registry
from .go2_config import Go2Cfg, Go2CfgPPO, Go2StairsCfg
from .go2_env import Go2Env, BlindEnv
task_registry.register("go2_walk", Go2Env, Go2Cfg(), Go2CfgPPO())
task_registry.register("go2_stairs", BlindEnv, Go2StairsCfg(), Go2CfgPPO())
"""
BASE = """
class BaseCfg:
    class env:
        num_envs = 2 ** 12
    class commands:
        class ranges:
            lin_vel_x = [-0.3, 0.6]
            lin_vel_y = [-0.2, 0.2]
            ang_vel_yaw = [-0.4, 0.4]
    class normalization:
        class obs_scales:
            lin_vel = 2.
            ang_vel = 0.25
            dof_pos = 1.
            dof_vel = 0.05
            quat = 0.5
        clip_observations = 18.
        clip_actions = 9.
    class domain_rand:
        randomize_obs_latency = True
"""
CONFIG = """
from .base import BaseCfg
LEGS = 4
class Go2Cfg(BaseCfg):
    class env(BaseCfg.env):
        frame_stack = 3
        num_single_obs = 47
        num_observations = int(frame_stack * num_single_obs)
        num_actions = 12
    class init_state:
        default_joint_angles = {
            'FL_hip_joint': 0.1, 'RL_hip_joint': 0.1, 'FR_hip_joint': -0.1, 'RR_hip_joint': -0.1,
            'FL_thigh_joint': 0.8, 'RL_thigh_joint': 1.0,
            'FR_thigh_joint': 0.8, 'RR_thigh_joint': 1.0,
            'FL_calf_joint': -1.5, 'RL_calf_joint': -1.5,
            'FR_calf_joint': -1.5, 'RR_calf_joint': -1.5,
        }
    class control:
        stiffness = {'joint': 20.}
        damping = {'joint': 0.5}
        action_scale = 0.25
        decimation = 10  # 100 Hz
    class sim:
        dt = 0.001
    class rewards:
        cycle_time = 0.64
class Go2StairsCfg(Go2Cfg):
    class env(Go2Cfg.env):
        num_one_step_observations = 45
        num_observations = 6 * 45
    class control(Go2Cfg.control):
        decimation = 20
class Go2CfgPPO:
    class runner:
        experiment_name = 'walks'
"""
ENVIRONMENT = """
import os
open("RAN", "w").write("the code was run")
class Robot:
    def _init_buffers(self):
        scales = self.obs_scales
        self.commands_scale = torch.tensor(
            [self.obs_scales.lin_vel, self.obs_scales.lin_vel, self.obs_scales.ang_vel])
    def _get_phase(self):
        cycle_time = self.cfg.rewards.cycle_time
        return self.episode_length_buf * self.dt / cycle_time
class Go2Env(Robot):
    def _init_buffers(self):
        super()._init_buffers()
    def compute_observations(self):
        phase = self._get_phase()
        sine = torch.sin(2 * torch.pi * phase).unsqueeze(1)
        cosine = torch.cos(2 * torch.pi * phase).unsqueeze(1)
        self.asked = torch.cat((sine, cosine, self.commands[:, :3] * self.commands_scale), dim=1)
        q = (self.dof_pos - self.default_dof_pos) * self.obs_scales.dof_pos
        self.critic = torch.cat((self.asked, self.friction), dim=-1)
        if self.cfg.domain_rand.randomize_obs_latency:
            imu = self.late_imu[torch.arange(self.num_envs), :, self.steps.long()]
        else:
            imu = torch.cat((self.base_ang_vel * self.obs_scales.ang_vel,
                             self.base_euler_xyz * self.obs_scales.quat), 1)
        frame = torch.cat((self.asked, q, self.dof_vel * self.obs_scales.dof_vel,
                           self.actions, imu), dim=-1)
        if self.add_noise:
            now = frame.clone() + torch.randn_like(frame) * self.noise_scale_vec
        else:
            now = frame.clone()
        self.frames.append(now)
        every = torch.stack([self.frames[i] for i in range(self.frames.maxlen)], dim=1)
        self.obs_buf = every.reshape(self.num_envs, -1)
class BlindEnv(Robot):
    def compute_observations(self):
        now = torch.cat((self.commands[:, :3] * self.commands_scale,
                         self.base_ang_vel * self.obs_scales.ang_vel, self.projected_gravity,
                         (self.dof_pos - self.default_dof_pos), self.dof_vel, self.actions,
                         self.base_lin_vel), dim=-1)
        if self.add_noise:
            now += (2 * torch.rand_like(now) - 1) * self.noise_scale_vec
        self.obs_buf = torch.cat((now[:, :self.num_one_step_obs],
                                  self.obs_buf[:, :-self.num_one_step_obs]), dim=-1)
"""
FILES = {
    "__init__.py": REGISTER,
    "base.py": BASE,
    "go2_config.py": CONFIG,
    "go2_env.py": ENVIRONMENT,
}
CHECKPOINT = "repo/logs/exported/policy.onnx"


def beside(**changed):
    """The files of a repository, as they lie from its checkpoint."""
    files = {**FILES, **{f"{name}.py": text for name, text in changed.items()}}
    return {"../../setup.py": "", **{f"../../sim/envs/{n}": text for n, text in files.items()}}


def seen(card):
    return card.observations["obs"]


def test_terms_scales_and_frames_are_those_that_the_method_joins(card_of):
    text, card = card_of(141, beside(), name=CHECKPOINT)
    assert words(card) == [
        "clock", "clock", "command", "joint_pos", "joint_vel", "last_output", "ang_vel",
        "roll_pitch", "yaw",
    ]  # fmt: skip
    sine, cosine, command, _, joint_vel, _, ang_vel, roll_pitch, yaw = seen(card).frame_terms
    assert (sine.values, cosine.values, sine.frequency) == (["sine"], ["cosine"], 1.5625)
    assert command.scale == [2, 2, 0.25]
    assert (joint_vel.scale, ang_vel.scale, roll_pitch.scale, yaw.scale) == (0.05, 0.25, 0.5, 0.5)
    history = seen(card).history
    assert (history.steps, history.order, history.by) == (3, "oldest_first", "step")
    assert (seen(card).clip, card.control.clip) == ((-18, 18), (-9, 9))
    assert "the task go2_walk in ../../sim/envs/go2_env.py" in text


def test_settings_are_the_constants_of_the_class_and_of_those_below_it(card_of):
    _, card = card_of(141, beside(), name=CHECKPOINT)
    control = card.control
    assert (control.rate, control.physics_rate) == (100, 1000), "10 steps of 1 ms"
    assert (control.joints, control.kp, control.kd, control.scale) == (LEFT_FIRST, 20, 0.5, 0.25)
    assert control.default_pose == [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1, -1.5, -0.1, 1, -1.5]
    assert card.trained_speeds["lin_vel_x"] == (-0.3, 0.6)
    assert card.trained_speeds["ang_vel_z"] == (-0.4, 0.4)


def test_loops_over_lists_and_ranges_fill_the_mappings_of_settings(card_of):
    start = CONFIG.index("        default_joint_angles")
    end = CONFIG.index("    class control", start)
    loops = """        default_joint_angles, odd = {}, nothing()
        for side, hip in zip(['L', 'R'], [0.1, -0.1]):
            for number, leg in enumerate('FR'):
                default_joint_angles[f'{leg}{side}_hip_joint'] = hip
                default_joint_angles[f'{leg}{side}_thigh_joint'] = 0.8 + 0.2 * number
                default_joint_angles[f'{leg}{side}_calf_joint'] = -1.5
"""
    _, card = card_of(
        141, beside(go2_config=CONFIG[:start] + loops + CONFIG[end:]), name=CHECKPOINT
    )
    assert card.control.default_pose == LEFT_FIRST_POSE


def test_frames_that_follow_the_present_one_are_newest_first(card_of):
    text, card = card_of(270, beside(), name=CHECKPOINT)
    assert words(card) == ["command", "ang_vel", "gravity", "joint_pos", "joint_vel", "last_output"]
    history = seen(card).history
    assert (history.steps, history.order, history.by) == (6, "newest_first", "step")
    assert (card.control.rate, card.control.physics_rate) == (50, 200)
    assert "names its terms" in text, "it is no guess from the size"


def test_nothing_of_the_code_is_run(card_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    card_of(141, beside(), name=CHECKPOINT)
    assert not list(tmp_path.rglob("RAN"))


def test_what_a_term_is_that_no_card_knows_is_said_with_its_text(card_of):
    wet = ENVIRONMENT.replace("self.actions, imu)", "self.wetness * 2.0, self.actions, imu)")
    larger = CONFIG.replace("num_single_obs = 47", "num_single_obs = 51")
    text, card = card_of(153, beside(go2_env=wet, go2_config=larger), name=CHECKPOINT)
    assert "THESE 4 ZEROS STAND FOR self.wetness" in text
    assert words(card)[5:7] == ["constant", "last_output"]


def test_of_two_tasks_that_fit_the_one_is_taken_whose_name_the_checkpoint_has(card_of):
    twice = REGISTER + 'task_registry.register("go2_rough", BlindEnv, Go2RoughCfg(), Go2CfgPPO())\n'
    rough = CONFIG + "class Go2RoughCfg(Go2StairsCfg):\n    class sim:\n        dt = 0.0005\n"
    files = beside(go2_config=rough)
    files["../../sim/envs/__init__.py"] = twice
    text, card = card_of(270, files, name="repo/logs/go2_rough/policy.onnx")
    assert "the task go2_rough in" in text
    assert card.control.rate == 100
    text, card = card_of(270, files, name="other/logs/exported/policy.onnx")
    assert "the task go2_stairs in" in text
    assert "go2_rough would fit as well" in text


def test_settings_that_were_saved_with_the_checkpoint_count_first(card_of):
    saved = """{"env": {"num_observations": 141, "num_single_obs": 47, "num_actions": 12},
        "init_state": {"default_joint_angles": {ANGLES}}, "sim": {"dt": 0.005},
        "control": {"stiffness": {"joint": 33.0}, "damping": {"joint": 0.7}, "action_scale": 0.5,
        "decimation": 4}}"""
    pose = [0, 0.7, -1.4] * 4
    angles = ", ".join(f'"{n}_joint": {a}' for n, a in zip(LEFT_FIRST, pose, strict=True))
    files = {**beside(), "config.json": saved.replace("ANGLES", angles)}
    text, card = card_of(141, files, name=CHECKPOINT)
    control = card.control
    assert (control.kp, control.rate, control.scale, control.default_pose) == (33, 50, 0.5, pose)
    assert "kp: 33  # config.json" in text
    assert words(card)[0] == "clock", "the terms are those of the code"


def test_terms_of_a_deploy_config_stand_where_the_code_has_one_that_no_card_knows(card_of):
    wet = ENVIRONMENT.replace("self.projected_gravity,", "self.wetness,")
    one = CONFIG.replace("num_observations = 6 * 45", "num_observations = 45")
    files = {
        **beside(go2_env=wet, go2_config=one),
        "configs/go2.yaml": GYM.replace("motion", "policy"),
    }
    _, card = card_of(45, files, name=CHECKPOINT)
    assert words(card) == ["ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output"]


@pytest.mark.parametrize("root", ["../../setup.py", None])
def test_code_outside_of_the_repository_is_not_looked_at(root, card_of):
    files = {name.replace("../../", "../../../"): text for name, text in beside().items()}
    files = {name: text for name, text in files.items() if not name.endswith("setup.py")}
    if root:
        files[root] = ""
    text, _ = card_of(141, files, name="above/repo/logs/policy.onnx")
    assert "go2_env.py" not in text


@pytest.mark.parametrize(
    "odd",
    [
        pytest.param("def broken(:", id="no Python"),
        pytest.param("class Go2Cfg(Go2Cfg):\n    pass\n", id="its own base"),
        pytest.param(f"x = {'(' * 150}1{')' * 150}\n", id="deep"),
        pytest.param(CONFIG.replace("6 * 45", "9 ** 9 ** 9 ** 9"), id="a large number"),
        pytest.param(CONFIG.replace("12\n", "None or 12\n", 1), id="what is computed"),
        pytest.param(CONFIG.replace("= 47", "= None").replace("int(f", "141 or (f"), id="none"),
        pytest.param(
            CONFIG + f"    x = f'{{0x{'f' * 9000}}}'\n", id="more digits than Python says"
        ),
        pytest.param(CONFIG.replace("0.001", f"float(0x{'f' * 900})"), id="no float has it"),
        pytest.param(CONFIG.replace("0.001", "int(1e999)"), id="infinite"),
        pytest.param(
            "".join(f"class B{n}({', '.join([f'B{n + 1}'] * 9)}): pass\n" for n in range(12))
            + CONFIG.replace("(BaseCfg)", "(BaseCfg, B0)"),
            id="many bases",
        ),
        pytest.param(
            "class Go2Cfg:\n"
            + "".join(f"{' ' * (n + 1)}for x{n} in range(10**9):\n" for n in range(9))
            + f"{' ' * 10}y = x0\n",
            id="many turns",
        ),
    ],
)
def test_odd_code_is_no_fault_of_the_draft(odd, card_of):
    text, _ = card_of(141, beside(go2_config=odd), name=CHECKPOINT)
    assert "Traceback" not in text


def test_a_register_that_is_too_large_to_be_one_is_not_read(card_of, tmp_path):
    register = tmp_path / "repo" / "sim" / "envs" / "__init__.py"
    register.parent.mkdir(parents=True)
    with register.open("wb") as file:
        file.truncate(2**40)
    text, _ = card_of(270, {"../../setup.py": ""}, name=CHECKPOINT)
    assert "whose code was read" not in text


def test_a_checkpoint_that_is_too_large_to_be_one_is_not_read_beside_another(tmp_path):
    for name, size in (("policy.onnx", 2**40), ("other.onnx", 9)):
        with (tmp_path / name).open("wb") as file:
            file.truncate(size)
    assert may_feed(tmp_path / "policy.onnx") == []
    assert may_feed(tmp_path / "other.onnx") == []


def test_a_frame_of_nothing_is_no_fault_of_the_draft(card_of):
    empty = ENVIRONMENT.replace("self.projected_gravity,", "torch.cat(())[:, :3],")
    text, _ = card_of(270, beside(go2_env=empty), name=CHECKPOINT)
    assert "ZEROS STAND FOR" in text


def draft_with(card_of, old, new, *, size=270, config=CONFIG):
    assert old in ENVIRONMENT
    files = beside(go2_env=ENVIRONMENT.replace(old, new), go2_config=config)
    return card_of(size, files, name=CHECKPOINT)


def test_limits_of_a_term_are_those_before_its_factor(card_of):
    clipped = "torch.clip(self.dof_vel * 0.5, -2., max=2.),"
    _, card = draft_with(card_of, "self.dof_vel, self.actions,", f"{clipped} self.actions,")
    joint_vel = seen(card).frame_terms[4]
    assert (joint_vel.term, joint_vel.scale, joint_vel.clip) == ("joint_vel", 0.5, (-4, 4))


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param("now[:, 0:3] = 0.", id="in a part"),
        pytest.param("now *= 3.0", id="in place"),
        pytest.param("now[:, 3:6] *= 3.0", id="in a part, in place"),
    ],
)
def test_terms_that_are_changed_after_they_are_joined_are_not_told(changed, card_of):
    before = "        if self.add_noise:\n            now += (2"
    text, _ = draft_with(card_of, before, f"        {changed}\n{before}")
    assert "names its terms" not in text


def test_a_part_that_does_not_begin_at_the_first_number_is_unknown(card_of):
    config = CONFIG.replace("num_single_obs = 47", "num_single_obs = 49")
    terms = "self.actions, self.commands[:, 1:3], imu)"
    text, card = draft_with(card_of, "self.actions, imu)", terms, size=147, config=config)
    assert "THESE 2 ZEROS STAND FOR self.commands[:, 1:3]" in text
    assert words(card)[5:8] == ["last_output", "constant", "ang_vel"]


@pytest.mark.parametrize(
    ("method", "is_known"),
    [
        pytest.param("return self.dof_vel", True, id="a term"),
        pytest.param("return now", False, id="what has a name of another method"),
        pytest.param(f"return {' + '.join(['self.more()'] * 300)}", False, id="itself, many times"),
    ],
)
def test_a_method_that_is_called_gives_what_it_returns(method, is_known, card_of):
    called = f"class BlindEnv(Robot):\n    def more(self):\n        {method}\n"
    code = ENVIRONMENT.replace("class BlindEnv(Robot):\n", called)
    assert "self.dof_vel, self.actions,\n                         self.base" in code
    code = code.replace("self.dof_vel, self.actions,\n      ", "self.more(), self.actions,\n      ")
    text, _ = card_of(270, beside(go2_env=code), name=CHECKPOINT)
    assert ("names its terms" in text) is is_known


def test_constants_of_a_module_are_those_that_a_file_imports(card_of):
    config = "from .stiff import KP\n" + CONFIG.replace("'joint': 20.", "'joint': KP")
    files = beside(go2_config=config, a_copy="KP = 99.\n", stiff="KP = 21.\n")
    _, card = card_of(141, files, name=CHECKPOINT)
    assert card.control.kp == 21


@pytest.mark.parametrize("angle", ["2 * torch.pi * phase + torch.pi", "phase", "torch.pi * phase"])
def test_a_clock_turns_once_in_a_period_from_0_or_is_unknown(angle, card_of):
    text, card = draft_with(card_of, "sin(2 * torch.pi * phase)", f"sin({angle})", size=141)
    assert f"ZEROS STAND FOR torch.sin({angle})" in text
    assert words(card)[:2] == ["constant", "clock"]


def test_frames_in_an_order_that_is_not_known_are_no_terms(card_of):
    back = "in reversed(range(self.frames.maxlen))"
    text, _ = draft_with(card_of, "in range(self.frames.maxlen)", back, size=141)
    assert "names its terms" not in text


HEIGHTS = "torch.clip(self.root_states[:, 2].unsqueeze(1) - 0.3 - self.measured_heights, -2, 1.)"
GRID = """class Go2StairsCfg(Go2Cfg):
    class terrain:
        measured_points_x = [-0.5, 0.0, 0.5, 1.0]
        measured_points_y = [-0.5, 0, 0.5]
"""


def scanning(card_of, grid):
    """A draft for a policy that sees heights, in 57 numbers."""
    config = CONFIG.replace("class Go2StairsCfg(Go2Cfg):\n", grid).replace("6 * 45", "57")
    terms = f"self.projected_gravity, {HEIGHTS} * 5.0,"
    config = config.replace("45", "57")
    return draft_with(card_of, "self.projected_gravity,", terms, size=57, config=config)


def test_a_scan_has_the_offset_and_the_limits_of_the_code(card_of):
    _, card = scanning(card_of, GRID)
    scan = next(each for each in card.observations.values() if each.sensor == "scandots")
    assert (scan.offset, scan.clip, scan.wrap[0].scale) == (-0.3, (-2, 1), 5)
    assert (scan.x, scan.y) == ((-0.5, 1, 4), (-0.5, 0.5, 3))


def test_a_scan_whose_points_are_not_evenly_apart_is_unknown(card_of):
    text, _ = scanning(card_of, GRID.replace("0.5, 1.0]", "0.2, 1.0]"))
    assert "ZEROS STAND FOR" in text, "a card has no such grid"


def test_of_two_bases_the_first_counts_most(card_of):
    stiff = "class Stiff:\n    class control:\n        stiffness = {'joint': 99.}\n"
    files = beside(go2_config=CONFIG + f"{stiff}class Both(Go2Cfg, Stiff):\n    pass\n")
    files["../../sim/envs/__init__.py"] = REGISTER.replace(
        "Go2Cfg, Go2CfgPPO,", "Both, Go2CfgPPO,"
    ).replace("Go2Cfg()", "Both()")
    _, card = card_of(141, files, name=CHECKPOINT)
    assert card.control.kp == 20


def test_of_classes_that_are_called_alike_the_imported_one_counts(card_of):
    old = CONFIG.replace("'joint': 20.", "'joint': 99.")
    _, card = card_of(141, beside(a_copy=old), name=CHECKPOINT)
    assert card.control.kp == 20


def test_a_file_may_begin_with_a_mark_of_its_encoding(card_of):
    _, card = card_of(141, beside(go2_config="\ufeff" + CONFIG), name=CHECKPOINT)
    assert card.control.kp == 20
