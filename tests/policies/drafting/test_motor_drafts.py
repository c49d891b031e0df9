"""Motors in drafts, from what Isaac Lab, mjlab and Isaac Gym's trainings write beside."""

import pickle  # noqa: TID251 - a file of a training is made here.

import pytest
import torch
from torch import nn

from nw_policies.cards import load_card
from nw_policies.drafting.beside import read_beside
from nw_policies.drafting.checkpoint import inspect_checkpoint
from nw_policies.drafting.draft import write_card_draft
from nw_policies.drafting.layouts import LEG_BY_LEG as LEGS
from nw_policies.drafting.motors import motor_lines
from nw_scenes.robots import get_robot

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
GO2 = get_robot("go2")
HEAD = """
decimation: 4
sim: {dt: 0.005}
actions: {joint_pos: {class_type: "isaaclab:JointPositionAction", scale: 0.25}}
observations: {policy: {gravity: {func: "m:projected_gravity"}}}
scene:
  robot:
    init_state: {joint_pos: {.*: 0.0}}
    actuators:
"""
DC = (
    "class_type: isaaclab.actuators.actuator_pd:DCMotor, joint_names_expr: [.*], "
    "effort_limit: 23.5, saturation_effort: 33.5, velocity_limit: 30.0, stiffness: 25, damping: 0.5"
)
NETWORK = (
    "class_type: isaaclab.actuators.actuator_net:ActuatorNetMLP, joint_names_expr: [.*], "
    "network_file: 'https://host/Assets/ActuatorNets/Unitree/unitree_go1.pt', pos_scale: -1.0, "
    "vel_scale: 1.0, torque_scale: 1.0, input_order: pos_vel, input_idx: [0, 1, 2], "
    "effort_limit: 23.7, velocity_limit: 30.0, saturation_effort: 23.7"
)


def known(*groups, head=HEAD):
    text = head + "".join(f"      g{n}: {{{group}}}\n" for n, group in enumerate(groups))
    return read_beside({"params/env.yaml": text}, GO2)


def test_dc_motors_have_their_curve_and_no_doubt():
    found = known(DC)
    (group,) = found.motors
    assert dict(group) == {
        "joints": "*",
        "kind": "dc",
        "saturation_torque": 33.5,
        "no_load_speed": 30.0,
    }
    assert found.torque_limits == (23.5,) * 12
    assert not [note for note in found.notes if "motors" in note]


def test_a_group_of_other_curves_by_joint_becomes_one_group_for_each():
    found = known(
        DC.replace("saturation_effort: 33.5", "saturation_effort: {.*_calf: 60.0, .*: 30.0}")
    )
    by_joints = {str(group["joints"]): group["saturation_torque"] for group in found.motors}
    assert by_joints == {"['calf']": 60.0, "['hip', 'thigh']": 30.0}


@pytest.mark.parametrize(
    ("keys", "delay", "said"),
    [
        ("min_delay: 4, max_delay: 4", 4, ""),
        ("min_delay: 0, max_delay: 4", 2, "0 to 4 physics steps late"),
        ("max_delay: 5", 5, ""),
        ("min_delay: 0, max_delay: 0", None, ""),
    ],
)
def test_a_delay_that_is_drawn_becomes_its_middle(keys, delay, said):
    kind = "class_type: isaaclab.actuators.actuator_pd:DelayedPDActuator, joint_names_expr: [.*]"
    found = known(f"{kind}, effort_limit: 40, stiffness: 25, damping: 0.5, {keys}")
    assert [group["delay"] for group in found.motors] == ([] if delay is None else [delay])
    assert all(group["kind"] == "pd" for group in found.motors)
    assert any(said in note for note in found.notes) == bool(said) or not said


def test_a_delay_counts_in_the_physics_steps_of_the_evaluation():
    half = HEAD.replace("dt: 0.005", "dt: 0.0025")
    assert known(f"{DC}, max_delay: 6", head=half).motors[0]["delay"] == 3


@pytest.mark.parametrize(
    "kind", ["RemotizedPDActuator", "UnitreeActuator", "DCMotor", "ActuatorNetLSTM"]
)
def test_a_kind_of_motor_whose_numbers_are_not_known_is_to_be_checked(kind):
    found = known(f"class_type: 'm:{kind}', joint_names_expr: [.*], stiffness: 25, damping: 0.5")
    assert found.motors == ()
    assert f"its motors are of the kind {kind}: the card has servos" in found.notes


def test_a_torque_limit_that_depends_on_the_angle_is_the_middle_and_to_be_checked():
    # As Isaac Lab's Spot has its knees: angle, ratio of transmission, torque.
    knees = (
        "class_type: 'm:RemotizedPDActuator', joint_names_expr: [.*_calf], effort_limit: null, "
        "stiffness: 60, damping: 1.5, min_delay: 0, max_delay: 4, joint_parameter_lookup: "
        "[[-2.79, -24.78, 37.2], [-1.5, -70.0, 115.0], [-0.25, -20.0, 30.6]]"
    )
    found = known(DC.replace("[.*]", "['.*_hip', '.*_thigh']"), knees)
    limits = dict(zip(found.joint_names, found.torque_limits, strict=True))
    assert (limits["FL_calf"], limits["FL_hip"]) == (72.8, 23.5)
    said = next(note for note in found.notes if "depends on the angle" in note)
    assert "30.6 to 115 N m: the card has the middle, 72.8" in said
    assert {group["delay"] for group in found.motors if group["kind"] == "pd"} == {2}


def test_a_lookup_that_is_none_changes_no_limit():
    odd = "class_type: 'm:RemotizedPDActuator', joint_names_expr: [.*], effort_limit: 30"
    for rows in ("[[1, 2]]", "[[1, 2, -3]]", "[]", "null", "[[1, 2, 3], x]"):
        found = known(f"{odd}, joint_parameter_lookup: {rows}")
        assert found.torque_limits == (30.0,) * 12
        assert not any("depends on the angle" in note for note in found.notes)


def test_a_strength_that_is_drawn_is_said_with_its_range():
    found = known(f"{DC}, motor_strength: [0.8, 1.2]")
    assert "its motors had a strength that was drawn from 0.8 to 1.2: the card has 1" in found.notes


PICKLED = {
    "Cfg": {
        "init_state": {"default_joint_angles": {f"{j}_joint": 0.0 for j in LEGS}},
        "control": {
            "stiffness": {"joint": 20.0}, "damping": {"joint": 0.5}, "action_scale": 0.25,
            "decimation": 4,
        },
        "sim": {"dt": 0.005},
        "domain_rand": {
            "randomize_motor_strength": True, "motor_strength_range": [0.7, 1.1],
            "randomize_Kp_factor": False, "Kp_factor_range": [0.5, 1.5],
            "add_cmd_action_latency": True, "range_cmd_action_latency": [1, 3],
            "gravity": torch.zeros(3),
        },
    }
}  # fmt: skip


def test_the_pickle_of_a_training_is_read_without_running_it():
    letters = pickle.dumps(PICKLED).decode("latin-1")
    found = read_beside({"../parameters.pkl": letters}, GO2)
    assert (found.joint_stiffness, found.rate) == ((20.0,) * 12, 50.0)
    assert [dict(group) for group in found.motors] == [{"joints": "*", "kind": "pd", "delay": 2}]
    notes = " ".join(found.notes)
    assert "the strength of its motors was drawn from 0.7 to 1.1" in notes
    assert "told 1 to 3 physics steps late: the card has the middle" in notes
    assert "kp" not in notes, "which was not drawn"


class Runs:
    def __reduce__(self):
        return eval, ("open('RAN', 'w')",)


def test_a_pickle_that_would_run_something_is_not_read_and_said_to_be(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    letters = pickle.dumps({**PICKLED, "more": Runs()}).decode("latin-1")
    found = read_beside({"../parameters.pkl": letters, "env.yaml": HEAD.replace("    ", " ")}, GO2)
    assert not (tmp_path / "RAN").exists()
    assert any("parameters.pkl was not read" in note for note in found.notes)


@pytest.mark.parametrize(
    ("keys", "loss", "viscous", "noted"),
    [
        ("friction: 0.02", (), (), True),
        ("friction: 0.3, dynamic_friction: 0.3", (0.3,) * 12, (), False),
        ("friction: null, viscous_friction: 0.1", (), (0.1,) * 12, False),
        ("frictionloss: 0.2", (0.2,) * 12, (), False),
        ("friction: 0.3, dynamic_friction: 0.2", (0.3,) * 12, (), True),
        ("friction: 0.0", (), (), False),
    ],
)
def test_friction_is_taken_where_it_is_a_torque(keys, loss, viscous, noted):
    found = known(f"{DC}, {keys}")
    assert (found.friction_loss, found.viscous_friction) == (loss, viscous)
    assert any("friction" in note for note in found.notes) == noted


def test_a_network_is_named_with_what_it_takes():
    (group,) = known(NETWORK).motors
    assert dict(group) == {
        "joints": "*",
        "kind": "network",
        "file": "unitree_go1.pt",
        "history": [0, 1, 2],
        "pos_scale": -1.0,
        "saturation_torque": 23.7,
        "no_load_speed": 30.0,
    }


def test_a_network_that_lies_beside_is_on_the_card_and_else_in_its_comments(tmp_path):
    groups = known(NETWORK, DC.replace("[.*]", "[.*_calf]")).motors[:1]
    absent = motor_lines(groups, tmp_path, "  # params/env.yaml")
    assert all(line.lstrip().startswith("#") for line in absent)
    assert "CHECK: unitree_go1.pt is not in" in absent[0]
    (tmp_path / "unitree_go1.pt").write_bytes(b"x")
    assert motor_lines(groups, tmp_path, "  # params/env.yaml")[0] == (
        "  motors:  # params/env.yaml"
    )


def test_a_name_of_a_network_cannot_write_into_the_card():
    name = "'a/{b: 1}, kind: dc #.pt'"
    (group,) = known(f"class_type: m:X, joint_names_expr: [.*], network_file: {name}").motors
    assert group["file"] == "_b__1___kind__dc__.pt"


GYM = """
Cfg:
  control: {control_type: actuator_net, action_scale: 0.25, hip_scale_reduction: 0.5,
    stiffness: {joint: 20.0}, damping: {joint: 0.5}, decimation: 4}
  domain_rand: {lag_timesteps: 6, randomize_lag_timesteps: true, friction_range: [0, 1]}
  init_state:
    pos: [0, 0, 0.34]
    default_joint_angles: {FL_hip_joint: 0.1, RL_hip_joint: 0.1, FR_hip_joint: -0.1,
      RR_hip_joint: -0.1, FL_thigh_joint: 0.8, RL_thigh_joint: 1.0, FR_thigh_joint: 0.8,
      RR_thigh_joint: 1.0, FL_calf_joint: -1.5, RL_calf_joint: -1.5, FR_calf_joint: -1.5,
      RR_calf_joint: -1.5}
  normalization: {clip_actions: 10.0}
  sim: {dt: 0.005}
  terrain: {mesh_type: plane}
"""


def test_a_training_of_walk_these_ways_says_its_motors(tmp_path):
    module = nn.Sequential(nn.Linear(48, 8), nn.ELU(), nn.Linear(8, 12)).eval()
    torch.jit.script(module).save(str(tmp_path / "body.jit"))
    torch.jit.script(nn.Sequential(nn.Linear(6, 4), nn.Softsign(), nn.Linear(4, 1))).save(
        str(tmp_path / "unitree_go1.pt")
    )
    text = write_card_draft(
        inspect_checkpoint(tmp_path / "body.jit"),
        get_robot("go1"),
        beside={"config.yaml": GYM},
        folder=tmp_path,
    )
    (tmp_path / "policy.yaml").write_text(text)
    control = load_card(tmp_path / "policy.yaml").control
    (motor,) = control.motors
    assert (motor.kind, motor.file, motor.delay) == ("network", "unitree_go1.pt", 6)
    assert (motor.history, motor.pos_scale) == ([0, 1, 2], -1.0)
    assert (control.kp, control.kd, control.rate, control.clip) == (20, 0.5, 50, (-10, 10))
    assert control.scale == [0.125, 0.25, 0.25] * 4
    assert control.joints[:4] == ["FL_hip", "FL_thigh", "FL_calf", "FR_hip"]
    assert control.default_pose[:4] == [0.1, 0.8, -1.5, -0.1]
    assert "terrain" not in text
    assert "friction_range" not in text


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("control_type: actuator_net", "control_type: P", [("pd", 6)]),
        ("randomize_lag_timesteps: true", "randomize_lag_timesteps: false", [("network", None)]),
        (
            "control_type: actuator_net",
            "use_actuator_network: true, actuator_net_file: '{ROOT}/nets/anydrive_v3_lstm.pt'",
            [("network", 6)],
        ),
    ],
)
def test_motors_of_isaac_gyms_trainings_follow_their_switches(old, new, wanted):
    found = read_beside({"config.yaml": GYM.replace(old, new)}, get_robot("go1"))
    assert [(group["kind"], group.get("delay")) for group in found.motors] == wanted
    if "anydrive" in new:
        assert found.motors[0]["file"] == "anydrive_v3_lstm.pt"
        assert "history" not in found.motors[0]
