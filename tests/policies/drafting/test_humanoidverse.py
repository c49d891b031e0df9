"""What HumanoidVerse's trainings and FALCON's deployments say of a policy, as a card says it.

The numbers are made up; which of them stands where is as the code beside such files has it:
`parse_observation` and `_get_obs_history_actor` of LeCAR-Lab/HumanoidVerse, and sim2real/rl_policy
of LeCAR-Lab/FALCON.
"""

import pytest
import yaml

from nw_policies.cards import Card
from nw_policies.drafting.beside import read_beside
from nw_policies.drafting.configs import reader_of
from nw_policies.drafting.fields import Fields
from nw_policies.drafting.some_joints import commanded_lines, held_lines
from nw_policies.drafting.tracking import reference_lines
from nw_policies.drafting.vectors import named_parts
from nw_scenes.robots import get_robot

GO1 = get_robot("go1")
NAMES = [name.removesuffix("_joint") for name in GO1.joints]
LEGS, ARMS = NAMES[:9], NAMES[9:]
TRAINING = {
    "robot": {
        "dof_names": [f"{name}_joint" for name in LEGS],
        "upper_dof_names": [],
        "actions_dim": 9,
        "control": {
            "control_type": "P",
            "stiffness": {"hip": 10.0, "FR_hip": 11.0, "thigh": 20.0, "calf": 30.0},
            "damping": {"hip": 1.0, "thigh": 2.0, "calf": 3.0},
            "action_scale": 0.25,
            "action_clip_value": 50.0,
        },
        "init_state": {"default_joint_angles": {f"{name}_joint": 0.5 for name in LEGS}},
        "dof_effort_limit_list": [20.0] * 9,
        "motion": {"motion_file": "motions/kick.pkl"},
        "foot_name": "foot",
    },
    "obs": {
        "obs_dict": {
            "actor_obs": ["dof_pos", "history_actor", "base_ang_vel", "ref_motion_phase"],
            "critic_obs": ["base_lin_vel"],
        },
        "obs_scales": {"base_ang_vel": 0.25, "dof_pos": 1.0, "ref_motion_phase": 1.0},
        "obs_auxiliary": {"history_actor": {"ref_motion_phase": 3, "base_ang_vel": 3}},
    },
    "simulator": {"config": {"sim": {"fps": 200, "control_decimation": 4, "substeps": 1}}},
    "domain_rand": {"randomize_ctrl_delay": True, "ctrl_delay_step_range": [0, 2]},
    "rewards": {"alive": 1.0},
}
DEPLOYMENT = {
    "dof_names": [f"{name}_joint" for name in NAMES],
    "dof_names_lower_body": [f"{name}_joint" for name in LEGS],
    "dof_names_upper_body": [f"{name}_joint" for name in ARMS],
    "JOINT_KP": [float(number) for number in range(12)],
    "JOINT_KD": [1.0] * 12,
    "DEFAULT_DOF_ANGLES": [0.1 * number for number in range(12)],
    "motor_effort_limit_list": [20.0] * 12,
    "GAIT_PERIOD": 0.8,
    "DESIRED_BASE_HEIGHT": 0.3,
    "SIMULATE_DT": 0.005,
    "obs_dict": {
        "actor_obs": [
            *("command_stand", "command_lin_vel", "command_ang_vel", "command_base_height"),
            *("sin_phase", "dof_pos", "ref_upper_dof_pos", "actions"),
        ]
    },
    "history_length_dict": {"actor_obs": 2},
    "obs_dims": {"actions": 9, "dof_pos": 12},
    "obs_scales": {"command_base_height": 2.0, "dof_pos": 1.0},
}


def read(data):
    known = read_beside({"config.yaml": yaml.safe_dump(data)}, GO1, "model.onnx")
    assert known is not None
    return known


def lines_of(known, size):
    parts = named_parts("obs", size, known.observation_terms)
    return [yaml.safe_load("\n".join(part.lines)) for part in parts]


def test_each_file_is_known_by_its_keys():
    kinds = [reader_of(Fields(data))[0] for data in (TRAINING, DEPLOYMENT)]
    assert kinds == ["humanoidverse_train", "humanoidverse_deploy"]


def test_gains_of_a_training_go_by_the_longest_part_of_a_joint_s_name():
    known = read(TRAINING)
    assert known.joint_names == tuple(LEGS)
    assert known.joint_stiffness[:4] == (11.0, 20.0, 30.0, 10.0)
    assert known.default_joint_pos == (0.5,) * 9
    assert (known.rate, known.action_clip) == (50.0, (-50.0, 50.0))


def test_a_training_s_terms_stand_by_name_and_its_history_term_by_term_without_the_present():
    past = {"steps": 3, "order": "newest_first", "by": "term", "current": False, "start": "zeros"}
    ang_vel = {"term": "ang_vel", "scale": 0.25}
    assert lines_of(read(TRAINING), 3 + 9 + 9 + 3 + 1) == [
        {"sensor": "proprio", "terms": [ang_vel, "joint_pos"]},
        {"sensor": "proprio", "terms": [ang_vel], "history": past},
        {"sensor": "reference", "terms": ["phase"], "ahead": [1], "history": past},
        {"sensor": "reference", "terms": ["phase"], "ahead": [1]},
    ]


def test_the_motion_of_a_training_has_the_joints_that_it_drives():
    from nw_policies.drafting.checkpoint import CheckpointFacts

    facts = CheckpointFacts(path="m.onnx", sha256="", format="onnx", adapter="onnx")  # type: ignore[arg-type]
    known = read(TRAINING)
    text = "\n".join(reference_lines(facts, known, GO1, ["walk.pkl", "kick.pkl"], "m.onnx"))
    said = yaml.safe_load(text)["reference"]
    assert said["file"] == "kick.pkl"
    assert said["joints"] == LEGS


def test_what_a_training_has_and_a_card_has_not_is_said():
    notes = " ".join(read(TRAINING).notes)
    assert "its targets came 0 to 2 physics steps late" in notes
    assert "rewards" not in notes  # It steers the training.
    odd = {**TRAINING, "robot": {**TRAINING["robot"], "control": {"wobble": 3.0}}}
    assert "robot.control.wobble" in " ".join(read(odd).notes)


def test_a_deployment_s_terms_are_those_of_its_script():
    known = read(DEPLOYMENT)
    (frame,) = lines_of(known, 2 * (9 + 1 + 1 + 2 + 1 + 12 + 3 + 1))
    assert frame["terms"] == [
        {"term": "last_output", "clipped": True},
        {"term": "command", "parts": ["yaw"]},
        {"term": "target", "of": {"height": 0.3}, "scale": 2},
        {"term": "command", "parts": ["vx", "vy"]},
        "moving",
        {"term": "joint_pos", "leave_out": []},
        {
            "term": "target",
            "of": dict(zip(ARMS, (0.9, 1.0, 1.1), strict=True)),
        },
        {
            "term": "clock",
            "frequency": 1.25,
            "standing": {"below": 0.1, "phase": 0},
            "values": ["sine"],
        },
    ]
    assert frame["history"] == {
        "steps": 2,
        "order": "oldest_first",
        "by": "step",
        "start": "zeros",
    }
    Card.model_validate(
        {
            "nw-policy": 1,
            "name": "it",
            "robot": "go1",
            "adapter": "zero",
            "control": {"action": "joint_position_offset", "held": ARMS, "clip": 100.0},
            "command": {"source": "trail_follower", "speed": 0.5},
            "observations": {"obs": frame},
        }
    )


@pytest.mark.parametrize(("residual", "held"), [(False, True), (True, False)])
def test_arms_are_held_or_driven_from_where_a_command_moves_them(residual, held):
    data = {**DEPLOYMENT, "residual_upper_body_action": residual}
    if residual:
        data["obs_dims"] = {"actions": 12}
    known = read(data)
    assert known.joint_count == (9 if held else 12)
    assert commanded_lines(known) == ([] if held else [f"  commanded: [{', '.join(ARMS)}]"])
    driven = GO1.joints[:9] if held else ()
    assert bool(held_lines(driven, GO1, known)) == held


def test_a_file_that_names_joints_in_another_order_than_its_lists_is_read_by_motors():
    turned = [NAMES[1], NAMES[0], *NAMES[2:]]
    known = read({**DEPLOYMENT, "dof_names": turned})
    assert known.joint_names == tuple(NAMES)
    assert "in another order than its lists have" in " ".join(known.notes)
