"""What exporters and trainings write beside a checkpoint becomes the card, and says so."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from nw_base.errors import PolicyError, UsageError
from nw_eval.api.policies import init_policy
from nw_policies.cards.card import Card
from nw_policies.cards.load import load_card

LEFT_FIRST = [
    f"{leg}_{kind}" for leg in ("FL", "FR", "RL", "RR") for kind in ("hip", "thigh", "calf")
]
LEFT_FIRST_POSE = [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1, -1.5, -0.1, 1, -1.5]
BY_TYPE = [f"{leg}_{kind}" for kind in ("hip", "thigh", "calf") for leg in ("FL", "FR", "RL", "RR")]
MAP = [3, 0, 9, 6, 4, 1, 10, 7, 5, 2, 11, 8]
"""The motor of each joint of BY_TYPE: motors are counted FR, FL, RR, RL, leg by leg."""

DEPLOY = """
joint_ids_map: [3, 0, 9, 6, 4, 1, 10, 7, 5, 2, 11, 8]
step_dt: 0.02
stiffness: [20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31]
damping: [.5, .5, .5, .5, .5, .5, .5, .5, .5, .5, .5, .6]
default_joint_pos: [.1, -.1, .1, -.1, .8, .8, 1, 1, -1.5, -1.5, -1.5, -1.5]
commands:
  base_velocity:
    ranges: {lin_vel_x: [-0.4, 0.6], lin_vel_y: [-0.2, 0.2], ang_vel_z: [-0.5, 0.5], heading: null}
actions:
  JointPositionAction:
    clip: null
    joint_names: [.*]
    scale: [.25, .25, .25, .25, .25, .25, .25, .25, .25, .25, .25, .25]
    offset: [.1, -.1, .1, -.1, .8, .8, 1, 1, -1.5, -1.5, -1.5, -1.5]
    joint_ids: !!python/object/apply:builtins.slice [null, null, null]
observations:
  base_ang_vel: {params: {}, clip: [-50, 50], scale: [.2, .2, .2], history_length: 3}
  projected_gravity: {params: {}, clip: null, scale: [1, 1, 1], history_length: 3}
  velocity_commands: {params: {}, clip: null, scale: [2, 2, .25], history_length: 3}
  gait_phase: {params: {period: 0.5}, clip: null, scale: [1, 1], history_length: 3}
  joint_pos_rel: {scale: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1], history_length: 3}
  last_action: {scale: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1], history_length: 3}
"""


def words(card: Card) -> list[str]:
    return [term.term for term in card.observations["obs"].frame_terms]


def test_deploy_yaml_is_the_whole_card(card_of):
    text, card = card_of(3 * 35, {"../params/deploy.yaml": DEPLOY})
    control, seen = card.control, card.observations["obs"]
    assert control.joints == BY_TYPE
    assert control.kp == [20 + motor for motor in MAP], "gains are counted by motor"
    assert control.kd == [0.6 if motor == 11 else 0.5 for motor in MAP]
    assert control.default_pose == [0.1, -0.1] * 2 + [0.8] * 2 + [1] * 2 + [-1.5] * 4
    assert (control.rate, control.scale, control.action) == (50, 0.25, "joint_position_offset")
    assert words(card) == ["ang_vel", "gravity", "command", "clock", "joint_pos", "last_output"]
    ang_vel, _, command, clock, *_ = seen.frame_terms
    assert (ang_vel.scale, ang_vel.clip) == (0.2, (-50, 50))
    assert (command.scale, clock.frequency) == ([2, 2, 0.25], 2.0)
    assert (seen.history.steps, seen.history.order, seen.history.by) == (3, "oldest_first", "term")
    assert (card.command.speed, card.command.yaw_limit) == (0.6, 0.5)
    for line in ("rate: 50", "scale: 0.25", "kp: [23, ", "sensor: proprio"):
        (found,) = [one for one in text.splitlines() if line in one]
        assert "# ../params/deploy.yaml" in found
        assert "CHECK" not in found
    assert "rounds these numbers" not in text


def test_terms_of_a_group_of_deploy_yaml_are_its_terms_and_copies_beside_it_are_not_read(card_of):
    head, terms = DEPLOY.split("observations:\n")
    inner = "".join(f"  {line}\n" for line in terms.splitlines())
    grouped = f"{head}observations:\n  obs:\n    use_gym_history: true\n{inner}"
    files = {
        "../params/deploy copy.yaml": DEPLOY.replace("stiffness: [20,", "stiffness: [99,"),
        "../params/deploy.yaml": grouped,
    }
    text, card = card_of(3 * 35, files)
    assert words(card) == ["ang_vel", "gravity", "command", "clock", "joint_pos", "last_output"]
    assert card.observations["obs"].history.by == "step"
    assert 99 not in card.control.kp
    assert "not read, of another policy by names or sizes: ../params/deploy copy.yaml" in text


@pytest.mark.parametrize(
    ("step", "steps", "rates"),
    [(0.001, 10, (100, 1000)), (0.005, 3, (66.666667, 200)), (0.004, 4, (62.5, 250))],
)
def test_a_rate_that_does_not_divide_50_is_the_cards_with_the_physics_of_the_training(
    step, steps, rates, card_of
):
    times = f"go2: {{dt: {step}, decimation: {steps}}}"
    _, card = card_of(3 * 45, {"config.yaml": SAR, "../base.yaml": times})
    assert (card.control.rate, card.control.physics_rate) == pytest.approx(rates, rel=1e-6)


def test_a_deploy_yaml_beside_env_yaml_is_believed_first(card_of):
    beside = {"../params/deploy.yaml": DEPLOY, "../params/env.yaml": ENVIRONMENT}
    text, card = card_of(3 * 35, beside)
    assert card.control.kp == [20 + motor for motor in MAP]
    assert "torque_limits: 23.5  # ../params/env.yaml" in text, "what only the other one says"


ENVIRONMENT = """
decimation: 4
sim: {dt: 0.005, gravity: !!python/tuple [0.0, 0.0, -9.81]}
scene:
  robot:
    init_state:
      pos: !!python/tuple [0.0, 0.0, 0.4]
      joint_pos: {.*L_hip_joint: 0.1, .*R_hip_joint: -0.1, "F[L,R]_thigh_joint": 0.8,
        "R[L,R]_thigh_joint": 1.0, .*_calf_joint: -1.5}
    actuators:
      legs:
        class_type: isaaclab.actuators.actuator_pd:DCMotor
        joint_names_expr: [.*_hip_joint, .*_thigh_joint, .*_calf_joint]
        effort_limit: 23.5
        stiffness: {.*_hip_joint: 25.0, .*_thigh_joint: 26.0, .*_calf_joint: 27.0}
        damping: 0.5
        armature: null
observations:
  policy:
    concatenate_terms: true
    history_length: null
    base_ang_vel: {func: isaaclab.envs.mdp.observations:base_ang_vel, clip: null, scale: 0.2,
      history_length: 0}
    gravity: {func: "isaaclab.envs.mdp.observations:projected_gravity", clip: null, scale: null}
    velocity: {func: "isaaclab.envs.mdp.observations:generated_commands", clip: null, scale: null}
    joint_pos: {func: "isaaclab.envs.mdp.observations:joint_pos", clip: null, scale: null}
    joint_vel: {func: "isaaclab.envs.mdp.observations:joint_vel_rel", clip: !!python/tuple [-9, 9]}
    actions: {func: "isaaclab.envs.mdp.observations:last_action", clip: null, scale: null}
actions:
  joint_pos:
    class_type: isaaclab.envs.mdp.actions.joint_actions:JointPositionAction
    joint_names: [.*]
    scale: {.*_hip_joint: 0.125, "^(?!.*_hip_joint).*": 0.25}
    clip: {.*: !!python/tuple [-3.0, 3.0]}
    use_default_offset: true
    preserve_order: false
events:
  feet: {joint_ids: !!python/object/apply:builtins.slice [null, null, null]}
commands:
  base_velocity:
    ranges: {lin_vel_x: !!python/tuple [-1.0, 1.0], lin_vel_y: !!python/tuple [-1.0, 1.0],
      ang_vel_z: !!python/tuple [-1.0, 1.0]}
"""


def test_mjlab_keeps_its_robot_among_entities_and_lists_its_motors(card_of):
    isaac = ENVIRONMENT.partition("    actuators:")
    motors = isaac[2].partition("observations:")
    listed = """    articulation:
      actuators:
      - target_names_expr: [.*_hip_joint, .*_thigh_joint]
        effort_limit: 23.7
        stiffness: 25.0
        damping: 0.5
      - {target_names_expr: [.*_calf_joint], effort_limit: 45.4, stiffness: 40.0, damping: 1.0}
"""
    scene = isaac[0].replace("  robot:\n", "  entities:\n   robot:\n")
    text, card = card_of(45, {"../params/env.yaml": scene + listed + "observations:" + motors[2]})
    assert card.control.kp == [25] * 8 + [40] * 4
    assert card.control.kd == [0.5] * 8 + [1] * 4
    assert card.control.default_pose == [0.1, -0.1] * 2 + [0.8] * 2 + [1] * 2 + [-1.5] * 4
    assert "torque_limits: [23.7" in text


HEIGHTS = """
    height_scan: {func: "isaaclab.envs.mdp.observations:height_scan", scale: null,
      clip: !!python/tuple [-1.0, 1.0], params: {sensor_cfg: {name: height_scanner}}}
"""
SCANNER = """
  height_scanner:
    class_type: isaaclab.sensors.ray_caster.ray_caster:RayCaster
    prim_path: /World/envs/env_.*/Robot/base
    update_period: 0.02
    debug_vis: false
    ray_alignment: yaw
    max_distance: 1000000.0
    drift_range: !!python/tuple [0.0, 0.0]
    ray_cast_drift_range: {x: !!python/tuple [0.0, 0.0]}
    mesh_prim_paths: [/World/ground]
    offset: {pos: !!python/tuple [0.2, 0.0, 20.0], rot: !!python/tuple [1.0, 0.0, 0.0, 0.0]}
    pattern_cfg: {resolution: 0.2, size: [1.2, 0.8], ordering: yx,
      func: "isaaclab.sensors.ray_caster.patterns.patterns:grid_pattern", direction: [0, 0, -1]}
"""


@pytest.mark.parametrize(
    ("changes", "order", "offset"),
    [
        ({}, "y_fastest", -0.5),
        ({"ordering: yx": "ordering: xy"}, "x_fastest", -0.5),
        ({"{sensor_cfg:": "{offset: 0.3, sensor_cfg:"}, "y_fastest", -0.3),
    ],
)
def test_a_scan_of_heights_is_measured_where_env_yaml_has_its_sensor(
    card_of, changes, order, offset
):
    # 7 x 5 points of torch.arange(-size / 2, size / 2 + 1e-9, 0.2), 0.2 m ahead of the base.
    text = ENVIRONMENT.replace("scene:\n", "scene:" + SCANNER).replace(
        "\nactions:\n", HEIGHTS + "actions:\n"
    )
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    drafted, card = card_of(80, {"../params/env.yaml": text})
    scan = card.observations["obs_scan"]
    assert (scan.x, scan.y) == ((-0.4, 0.8, 7), (-0.4, 0.4, 5))
    assert (scan.order, scan.offset, scan.clip) == (order, offset, (-1.0, 1.0))
    assert "CHECK: 35 heights" not in drafted
    assert not [each for each in drafted.splitlines() if "scanner" in each and "CHECK" in each]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("Robot/base", "Robot/torso_link", "the training counts heights from torso_link"),
        ("alignment: yaw", "alignment: base", "height_scan has what a card's scan has not: rays"),
        ("alignment: yaw", "alignment: [yaw]", "height_scan has what a card's scan has not: rays"),
        ("ordering: yx", "ordering: zz", "height_scan has what a card's scan has not: ordering"),
        ("direction: [0, 0, -1]", "direction: [1, 0, -1]", "scan has not: direction [1, 0, -1]"),
        ("[1.0, 0.0, 0.0, 0.0]", "[0.7, 0.0, 0.0, 0.7]", "has not: rot [0.7, 0.0, 0.0, 0.7]"),
        ("[0.2, 0.0, 20.0]", "[1e300, 0.0, 20.0]", "scan has not: pos [1e+300, 0.0, 20.0]"),
    ],
)
def test_what_a_card_has_no_word_for_in_a_scan_is_to_be_checked(card_of, old, new, said):
    scanner = SCANNER.replace(old, new)
    text = ENVIRONMENT.replace("scene:\n", "scene:" + scanner).replace(
        "\nactions:\n", HEIGHTS + "actions:\n"
    )
    drafted, _ = card_of(80, {"../params/env.yaml": text})
    (line,) = [line for line in drafted.splitlines() if said in line]
    assert "CHECK" in line


def test_env_yaml_says_what_its_patterns_say_of_each_joint(card_of):
    text, card = card_of(45, {"../params/env.yaml": ENVIRONMENT})
    control = card.control
    assert control.joints == BY_TYPE
    assert "CHECK: the order of the checkpoint: ../params/env.yaml names no order" in text
    assert control.kp == [25] * 4 + [26] * 4 + [27] * 4
    assert control.default_pose == [0.1, -0.1] * 2 + [0.8, 0.8, 1, 1] + [-1.5] * 4
    assert control.scale == [0.125] * 4 + [0.25] * 8
    assert (control.clip, control.torque_limits, control.rate) == (None, 23.5, 50)
    assert "CHECK: its targets are limited" in text, "which no limit of raw actions says"
    assert "FL_hip -3 to 3" in text
    assert words(card) == ["ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output"]
    seen = card.observations["obs"].frame_terms
    assert (seen[0].scale, seen[3].relative, seen[4].clip) == (0.2, False, (-9, 9))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            ":JointPositionAction",
            ":JointVelocityAction",
            "the card takes it for positions of joints",
        ),
        (
            ":JointPositionAction",
            ":RelativeJointPositionAction",
            "takes it for positions of joints",
        ),
        ("use_default_offset: true", "use_default_offset: false\n    offset: 0.3", "from [0.3]"),
        (
            'joint_pos", clip: ',
            'joint_pos", params: {asset_cfg: {joint_names: [RL_.*], preserve_order: true}}, clip: ',
            "joint_pos lists joints in an order of its own: ['RL_.*']",
        ),
        (
            "    history_length: null",
            "    history_length: 5",
            "says 5 frames of them, the checkpoint",
        ),
        ("actuator_pd:DCMotor", "actuator_net:ActuatorNetLSTM", "of the kind ActuatorNetLSTM"),
        (
            "armature: null",
            "armature: null\n        network_file: m.pt",
            "m.pt is not in",
        ),
        (
            "armature: null",
            "armature: null\n        min_delay: 0\n        max_delay: 4",
            "0 to 4 physics steps late",
        ),
        ("armature: null", "armature: null\n        friction: 0.3", "friction 0.3"),
        (":DCMotor", ":IdealPDActuator", None),
        ("JointPositionAction", "JointPositionAction", None),
    ],
)
def test_what_of_env_yaml_a_card_has_otherwise_is_to_be_checked(card_of, old, new, said):
    assert old in ENVIRONMENT
    text, _ = card_of(45, {"../params/env.yaml": ENVIRONMENT.replace(old, new)})
    marked = [line for line in text.splitlines() if "CHECK: " in line]
    none = ["takes it for", "order of its own", "frames of them", "count from", "steps late"]
    words = [said] if said else none
    assert any(word in line for word in words for line in marked) == bool(said)


def test_the_order_that_a_graph_names_is_that_of_env_yaml_too(card_of):
    order = {"joint_names": ",".join(f"{name}_joint" for name in LEFT_FIRST)}
    text, card = card_of(45, {"params/env.yaml": ENVIRONMENT}, metadata=order)
    assert card.control.joints == LEFT_FIRST
    assert card.control.kp == [25, 26, 27] * 4
    assert "names no order" not in text


def test_names_that_env_yaml_lists_in_order_are_the_order(card_of):
    listed = json.dumps([f"{name}_joint" for name in LEFT_FIRST])
    exact = ENVIRONMENT.replace("joint_names: [.*]", f"joint_names: {listed}")
    exact = exact.replace("preserve_order: false", "preserve_order: true")
    text, card = card_of(45, {"params/env.yaml": exact})
    assert card.control.joints == LEFT_FIRST
    assert "names no order" not in text


DESCRIPTORS = {
    "actions": [
        {
            "full_path": "isaaclab.envs.mdp.actions.joint_actions.JointPositionAction",
            "joint_names": [f"{name}_joint" for name in LEFT_FIRST],
            "scale": 0.5,
            "clip": None,
            "offset": [0.1, 0.8, -1.5] * 4,
        }
    ],
    "articulations": {
        "robot": {
            "joint_names": [f"{name}_joint" for name in BY_TYPE],
            "default_joint_pos": [n / 100 for n in range(8)] + [n / 100 - 1.6 for n in range(4)],
            "default_joint_stiffness": [0.0] * 12,
            "default_joint_damping": [0.0] * 12,
            "default_joint_armature": [0.01] * 8 + [0.02] * 4,
        }
    },
    "observations": {
        "policy": [
            {"name": "base_ang_vel", "full_path": "a.base_ang_vel", "shape": [3],
             "overloads": {"clip": None, "scale": 0.25, "history_length": 2}},
            {"name": "heard", "full_path": "a.heard", "shape": [7],
             "overloads": {"clip": None, "scale": None, "history_length": 2}},
            {"name": "joint_pos_rel", "full_path": "a.joint_pos_rel", "shape": [12],
             "overloads": {"clip": None, "scale": None, "history_length": 2}},
        ]
    },
    "scene": {"decimation": 8, "dt": 0.04, "physics_dt": 0.005},
}  # fmt: skip


@pytest.mark.parametrize(
    ("clip", "offset", "limits", "said"),
    [
        pytest.param([[-1.0, 2.0]] * 12, [0.5] * 12, (-3, 3), "", id="behind scale and offset"),
        pytest.param([[-100.0, 100.0]] * 12, [0.1, 0.8, -1.5] * 4, None, "", id="out of reach"),
        pytest.param(
            [[-1.0, 1.0], [-2.0, 2.0], [-2.5, -1.0]] * 4,
            [0.1, 0.8, -1.5] * 4,
            None,
            "FL_hip -1 to 1, FL_thigh -2 to 2, FL_calf -2.5 to -1",
            id="of each joint",
        ),
        pytest.param([[1.0]] * 12, [0.0] * 12, (-2, 2), "", id="one number for both sides"),
        pytest.param("some", [0.0] * 12, None, "clip cannot be read: some", id="no numbers"),
    ],
)
def test_limits_of_targets_are_brought_to_raw_actions_or_named(clip, offset, limits, said, card_of):
    action = {**DESCRIPTORS["actions"][0], "clip": clip, "offset": offset}
    file = json.dumps({**DESCRIPTORS, "actions": [action]})
    text, card = card_of(44, {"IO_descriptors.yaml": file})
    assert card.control.clip == limits
    lines = [line for line in text.splitlines() if "CHECK" in line and said in line]
    assert bool(said) <= bool(lines)
    assert bool(said) or "targets are limited" not in text


def test_io_descriptors_give_joints_terms_and_rates(card_of):
    text, card = card_of(44, {"../io_descriptors/IO_descriptors.yaml": json.dumps(DESCRIPTORS)})
    control = card.control
    assert (control.joints, control.scale, control.rate) == (LEFT_FIRST, 0.5, 25)
    by_type = [n / 100 for n in range(8)] + [n / 100 - 1.6 for n in range(4)]
    pose = [by_type[BY_TYPE.index(name)] for name in LEFT_FIRST]
    assert control.default_pose == pytest.approx(pose)
    assert control.armature == [0.01, 0.01, 0.02] * 4
    assert "kp: 30  # CHECK" in text, "zeros of explicit motors are no gains"
    assert words(card) == ["ang_vel", "constant", "joint_pos"]
    assert "THESE 7 ZEROS STAND FOR heard" in text
    assert card.observations["obs"].history.steps == 2


SAR = """
go2/mine:
  model_name: "policy.onnx"
  observations: ["commands", "ang_vel", "gravity_vec", "dof_pos", "dof_vel", "actions"]
  observations_history: [0, 1, 2]
  observations_history_priority: "time"
  clip_obs: 100.0
  clip_actions_lower: [-100, -100, -100, -100, -100, -100, -100, -100, -100, -100, -100, -100]
  clip_actions_upper: [100, 100, 100, 100, 100, 100, 100, 100, 100, 100, 100, 100]
  rl_kp: [40, 41, 42, 40, 41, 42, 40, 41, 42, 40, 41, 42]
  rl_kd: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]
  num_of_dofs: 12
  action_scale: [0.125, 0.25, 0.25, 0.125, 0.25, 0.25, 0.125, 0.25, 0.25, 0.125, 0.25, 0.25]
  ang_vel_scale: 0.25
  dof_pos_scale: 1.0
  dof_vel_scale: 0.05
  commands_scale: [2.0, 2.0, 0.25]
  torque_limits: [33.5, 33.5, 33.5, 33.5, 33.5, 33.5, 33.5, 33.5, 33.5, 33.5, 33.5, 33.5]
  default_dof_pos: [.1, .8, -1.5, -.1, .8, -1.5, .1, 1, -1.5, -.1, 1, -1.5]
  joint_mapping: [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
"""
BASE = """
go2:
  dt: 0.005
  decimation: 8
  joint_names: [%s]
"""


def test_the_config_of_rl_sar_and_its_base_are_read(card_of):
    legs = ", ".join(f"{leg}_{k}_joint" for leg in ("FR", "FL", "RR", "RL") for k in ("hip", "thigh", "calf"))  # fmt: skip  # noqa: E501
    text, card = card_of(3 * 45, {"config.yaml": SAR, "../base.yaml": BASE % legs})
    control, seen = card.control, card.observations["obs"]
    assert (control.joints, control.rate, control.clip) == (LEFT_FIRST, 25, (-100, 100))
    assert (control.kp, control.torque_limits) == ([40, 41, 42] * 4, 33.5)
    assert control.scale == [0.125, 0.25, 0.25] * 4
    assert words(card) == ["command", "ang_vel", "gravity", "joint_pos", "joint_vel", "last_output"]
    assert (seen.history.order, seen.history.by, seen.clip) == ("newest_first", "step", (-100, 100))
    assert seen.frame_terms[-1].clipped
    assert "is about" not in text


def test_a_config_of_another_file_is_read_and_said_to_be(card_of):
    text, card = card_of(3 * 45, {"config.yaml": SAR.replace("policy.onnx", "jump.pt")})
    assert card.control.kp == [40, 41, 42] * 4
    assert "# CHECK: config.yaml is about jump.pt: is that this file?" in text


LEGGED = """
ll_dt: 0.002
policy:
  model_path: src/policies/policy.onnx
  policy_dt: 0.02
  joint_ids_map: [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
  stiffness: [20, 21, 22, 20, 21, 22, 20, 21, 22, 20, 21, 22]
  damping: [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]
  commands:
    base_velocity: {process_order: [clip], min: [-1.0, -0.4, -0.3], max: [0.5, 0.4, 0.3]}
  actions:
    JointPositionAction:
      process_order: [clip, scale, offset]
      min: -50.0
      max: 50.0
      scale: 0.25
      offset: [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5]
  observations:
    stack: {length: 2, order: newest_first}
    terms:
      gait_phase_2: {params: {cycle_time: 0.4}}
      velocity_commands:
      base_ang_vel_B: {process_order: [scale, clip], scale: [0.5, 0.5, 0.5], min: -10.0, max: 10.0}
      eulerZYX_rpy:
      joint_pos: {process_order: [offset, clip, scale], min: -9.0, max: 9.0, scale: 1.0}
      last_action:
"""


def test_the_config_of_legged_rl_deploy_is_read(card_of):
    text, card = card_of(2 * 35, {"config.yaml": LEGGED})
    control, seen = card.control, card.observations["obs"]
    assert (control.joints, control.clip, control.rate) == (LEFT_FIRST, (-50, 50), 50)
    assert control.default_pose == [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1, -1.5, -0.1, 1, -1.5]
    assert words(card) == [
        "clock", "command", "ang_vel", "roll_pitch", "yaw", "joint_pos", "last_output",
    ]  # fmt: skip
    clock, _, ang_vel, *_ = seen.frame_terms
    assert (clock.frequency, ang_vel.scale, ang_vel.clip) == (2.5, 0.5, (-20, 20))
    assert (seen.history.steps, seen.history.order, seen.history.by) == (2, "newest_first", "step")
    assert (card.command.speed, card.command.yaw_limit) == (0.5, 0.3)
    assert "physics_rate: 200  config.yaml says 500" in text


def test_the_configs_of_unitree_rl_gym_have_a_clock_where_numbers_are_left(card_of):
    config = """
    simulation_dt: 0.002
    control_decimation: 10
    kps: [100, 101, 102, 100, 101, 102, 100, 101, 102, 100, 101, 102]
    kds: [2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2]
    default_angles: [0, 0.8, -1.5, 0, 0.8, -1.5, 0, 1.0, -1.5, 0, 1.0, -1.5]
    ang_vel_scale: 0.25
    dof_pos_scale: 1.0
    dof_vel_scale: 0.05
    action_scale: 0.25
    cmd_scale: [2.0, 2.0, 0.25]
    num_actions: 12
    num_obs: 47
    """
    _, card = card_of(47, {"configs/go2.yaml": config})
    assert words(card) == [
        "ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output", "clock",
    ]  # fmt: skip
    assert card.observations["obs"].frame_terms[-1].frequency == 1.25
    assert (card.control.kp, card.control.rate) == ([100, 101, 102] * 4, 50)


GYM = """
policy_path: "{LEGGED_GYM_ROOT_DIR}/deploy/pre_train/go2/motion.onnx"
control_dt: 0.02
joint2motor_idx: [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
kps: [21, 21, 21, 21, 21, 21, 21, 21, 21, 21, 21, 21]
kds: [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]
default_angles: [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5]
obs_scales_ang_vel: 0.25
obs_scales_dof_pos: 1.0
obs_scales_dof_vel: 0.05
command_scale: [2.0, 2.0, 0.25]
action_scale: 0.25
num_actions: 12
num_obs: 45
"""
DEPLOYED = "deploy/pre_train/go2/motion.onnx"


def test_the_config_of_a_deploy_script_is_found_from_the_folder_of_its_checkpoints(card_of):
    other = GYM.replace("go2", "g1").replace("[21,", "[99,")
    text, card = card_of(
        45,
        {
            "../../deploy_real/configs/go2.yaml": GYM,
            "../../deploy_real/configs/g1.yaml": other,
            "../../deploy_mujoco/configs/h1.yaml": other,
        },
        name=DEPLOYED,
    )
    assert (card.control.joints, card.control.kp) == (LEFT_FIRST, 21)
    assert words(card) == ["ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output"]
    ang_vel, _, command, _, joint_vel, _ = card.observations["obs"].frame_terms
    assert (ang_vel.scale, command.scale, joint_vel.scale) == (0.25, [2, 2, 0.25], 0.05)
    assert "kp: 21  # ../../deploy_real/configs/go2.yaml" in text
    assert "g1.yaml" not in text


@pytest.mark.parametrize("folder", ["pretrain", "pre_train"])
def test_deploy_configs_are_found_one_folder_further_by_robot_and_size(folder, card_of):
    mapped = GYM.replace("[21,", "[22,").replace("motion", "walk")
    text, card = card_of(
        45,
        {
            "../deploy_mujoco/velocity/configs/go2.yaml": GYM.replace("joint2motor_idx", "mapping"),
            "../deploy_mujoco/go2/config/any.yaml": GYM.replace(
                "num_obs: 45", "num_obs: {low: 45}"
            ),
            "../deploy_real/config/go2_velocity.yaml": mapped,
            "../deploy_real/config/go2_navila.yaml": mapped.replace("num_obs: 45", "num_obs: 909"),
            "../deploy_real/config/g1_velocity.yaml": mapped.replace("[22,", "[99,"),
        },
        name=f"{folder}/walk.onnx",
    )
    assert "kp: [22, 21, 21, 21" in text
    real, sim = (
        "../deploy_real/config/go2_velocity.yaml",
        "../deploy_mujoco/velocity/configs/go2.yaml",
    )
    assert f"# {real}" in text
    assert card.control.joints == LEFT_FIRST
    assert not any(f"# {other}" in text for other in (sim, "../deploy_mujoco/go2"))


def test_of_two_deploy_configs_of_one_size_that_which_names_its_joints_is_taken(card_of):
    unordered = GYM.replace("joint2motor_idx", "mapping").replace("[21,", "[22,")
    text, card = card_of(45, {"configs/a.yaml": unordered, "configs/b.yaml": GYM})
    assert card.control.kp == 21
    assert "CHECK: configs/b.yaml was taken; so many numbers are in configs/a.yaml, too" in text


MUWANX = {
    "onnx": {"path": "walk.onnx"},
    "obs_config": {
        "policy": [
            {"name": "ProjectedGravity", "history_steps": 3},
            {"name": "SimpleVelocityCommand", "scale": [2.0, 2.0, 0.25], "history_steps": 3},
            {"name": "JointPositions", "subtract_default": False, "history_steps": 3},
            {"name": "PreviousActions", "history_steps": 3, "transpose": True},
        ],
        "command_": [{"name": "Oscillators"}],
    },
    "action_scale": 0.5,
    "stiffness": 26.0,
    "damping": 0.7,
}


def test_the_json_of_muwanx_gives_terms_gains_and_order_and_says_what_it_leaves(card_of):
    pose = [0.1] * 4 + [0.8] * 4 + [-1.5] * 4
    asset = {"joint_names_isaac": [f"{n}_joint" for n in BY_TYPE], "default_joint_pos": pose}
    beside = {"walk.json": json.dumps(MUWANX, indent=4), "asset_meta.json": json.dumps(asset)}
    text, card = card_of({"obs": 3 * 30, "command": 7}, beside, name="walk.onnx")
    assert (card.control.joints, card.control.kp, card.control.kd) == (BY_TYPE, 26, 0.7)
    assert (card.control.scale, card.control.default_pose) == (0.5, pose)
    assert words(card) == ["gravity", "command", "joint_pos", "last_output"]
    _, command, joint_pos, _ = card.observations["obs"].frame_terms
    assert (command.scale, joint_pos.relative) == ([2, 2, 0.25], False)
    assert card.observations["obs"].history.steps == 3
    for note in (
        "group command_ was not read: Oscillators",
        "which frame comes first",
        "transpose",
    ):
        assert note in text


@pytest.mark.parametrize("key", [True, False, None])
def test_where_muwanx_says_no_pose_that_joints_count_from_the_card_marks_it_to_be_checked(
    card_of, key
):
    term = {"name": "JointPositions", "history_steps": 3}
    term |= {} if key is None else {"subtract_default": key}
    config = {group: list(terms) for group, terms in MUWANX["obs_config"].items()}
    for terms in config.values():
        terms[:] = [term if each["name"] == "JointPositions" else each for each in terms]
    said = json.dumps({**MUWANX, "obs_config": config})
    text, card = card_of({"obs": 3 * 30, "command": 7}, {"walk.json": said}, name="walk.onnx")
    joint_pos = card.observations["obs"].frame_terms[2]
    assert joint_pos.relative is (key is not False)
    checks = [line for line in text.splitlines() if "CHECK" in line and "subtract_default" in line]
    assert len(checks) == (key is None)


def test_the_card_of_a_policy_that_gives_torques_has_no_kp(card_of):
    said = json.dumps({**MUWANX, "control_type": "torque"})
    text, card = card_of(3 * 30, {"walk.json": said}, name="walk.onnx")
    assert (card.control.action, card.control.kp) == ("joint_torque", None)
    assert "  kp:" not in text


def test_a_json_of_no_known_kind_beside_a_checkpoint_is_said_to_be_unread(card_of):
    beside = {"walk.json": '{"layers": [1], "author": "me"}', "other.json": "{}"}
    text, _ = card_of(45, beside, name="walk.onnx")
    assert "# CHECK: walk.json was not read: its keys are layers, author" in text
    assert "other.json" not in text


@pytest.mark.parametrize("frame", ["obs_size_single: 45\n", ""])
def test_a_config_that_counts_all_frames_of_a_history_gives_its_terms_and_scales(card_of, frame):
    config = GYM.replace("num_obs: 45", f"num_obs: 225\n{frame}history_length: 5")
    text, card = card_of(225, {"configs/go2.yaml": config}, name="motion.onnx")
    assert words(card) == ["ang_vel", "gravity", "command", "joint_pos", "joint_vel", "last_output"]
    history = card.observations["obs"].history
    assert (history.steps, history.order, history.by) == (5, "oldest_first", "step")
    assert "names no terms" not in text
    assert "what this card does not" not in text


def test_a_pose_that_begins_with_a_right_leg_is_put_into_the_order_of_the_policy(card_of):
    config = GYM.replace("joint2motor_idx", "unread").replace(
        "[0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5]",
        "[-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5]",
    )
    config += "hip_scale_reduction: 0.5\nclip_actions: 100.0\nclip_observations: 100\n"
    text, card = card_of(45, {"configs/go2.yaml": config}, name="motion.onnx")
    assert card.control.joints == LEFT_FIRST
    assert card.control.default_pose == LEFT_FIRST_POSE
    assert card.control.scale == [0.125, 0.25, 0.25] * 4
    assert (card.control.clip, card.observations["obs"].clip) == ((-100, 100), (-100, 100))
    assert "CHECK: the order of the checkpoint: configs/go2.yaml names no order" in text


@pytest.mark.parametrize(
    "config",
    [
        GYM.replace("num_obs: 45", "").replace("policy_path", "xml_path").replace("[21,", "[99,"),
    ],
    ids=["no policy"],
)
def test_a_config_that_is_not_of_this_policy_gives_no_gains(config, card_of):
    text, card = card_of(48, {"configs/go2.yaml": config}, name="motion.onnx")
    assert card.control.kp != 99
    assert "# CHECK: configs/go2.yaml was not read: its keys are" in text


GO2_DEPLOY = """
policy_name: "policy.onnx"
dt: 0.02
stand_kp: 60.0
ctrl_kp: 20
ctrl_kd: 0.5
action_scale: 0.25
lin_vel_scale: 1.0
ang_vel_scale: 0.25
dof_pos_scale: 1.0
dof_vel_scale: 0.05
frame_stack: 5
num_single_obs: 45
stand_pos: [0, 0.8, -1.5, 0, 0.8, -1.5, 0, 0.8, -1.5, 0, 0.8, -1.5]
"""


def test_a_frame_and_its_history_are_two_inputs_of_one_config(card_of):
    _, card = card_of({"obs": 45, "history": 225}, {"../configs/ts.yaml": GO2_DEPLOY})
    now, past = card.observations["obs"], card.observations["history"]
    for seen in (now, past):
        assert [term.term for term in seen.frame_terms] == [
            "command", "gravity", "ang_vel", "joint_pos", "joint_vel", "last_output",
        ]  # fmt: skip
    assert now.frame_terms[0].scale == [1, 1, 0.25]
    assert (now.history, past.history.steps, past.history.by) == (None, 5, "step")
    assert card.control.joints[0] == "FR_hip", "motors are counted from the right leg in front"
    assert (card.control.kp, card.control.kd) == (20, 0.5)


def test_of_several_configs_that_which_names_the_checkpoint_is_read(card_of):
    other = GO2_DEPLOY.replace("policy.onnx", "walk.pt").replace("ctrl_kp: 20", "ctrl_kp: 99")
    beside = {"../params/a.yaml": other, "../params/b.yaml": GO2_DEPLOY}
    text, card = card_of(225, beside)
    assert card.control.kp == 20
    assert "is about" not in text


CONTROLLER = """
guide_controller:
  ros__parameters: {update_rate: 500, stand_pos: [0.0]}
rl_quadruped_controller:
  ros__parameters:
    update_rate: 200
    stand_pos: [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 0.8, -1.5]
"""


@pytest.mark.parametrize(("framework", "leg"), [("isaacgym", "FL"), ("isaacsim", "FR")])
def test_a_config_of_quadruped_ros2_control_has_no_name_above_it(framework, leg, card_of):
    flat = "\n".join(
        line.strip()
        for line in SAR.splitlines()
        if line.startswith("  ") and "joint_mapping" not in line and "default_dof" not in line
    )
    flat += f"\ndecimation: 4\nframework: {framework}\n"
    text, card = card_of(3 * 45, {"config.yaml": flat, "../control.yaml": CONTROLLER})
    assert (card.control.joints[0], card.control.rate) == (f"{leg}_hip", 50)
    assert "CHECK: the order of the checkpoint: config.yaml names no order" in text
    assert card.control.kp == [40, 41, 42] * 4
    assert words(card)[:2] == ["command", "ang_vel"]
    assert card.observations["obs"].history.order == "oldest_first", "its newest is the largest"
    assert card.control.default_pose is None, "a stance of the controller is no training's pose"
    assert "CHECK: the go2's own is used" in text


ROS2 = """
rl_controller:
  ros__parameters:
    update_rate: 50
    obs_names: [base_ang_vel, projected_gravity, velocity_commands, joint_pos, joint_vel, actions]
    obs_cfg:
      base_ang_vel: {clip: [0.0], scale: 0.2, history_length: 5}
      projected_gravity: {clip: [0.0], scale: 1.0, history_length: 5}
      velocity_commands: {clip: [0.0], scale: 1.0, history_length: 5}
      joint_pos: {clip: [0.0], scale: 1.0, history_length: 5}
      joint_vel: {clip: [0.0], scale: 0.05, history_length: 5}
      actions: {clip: [0.0], scale: 1.0, history_length: 5}
    joint_names: [%s]
    action_cfg: {%s}
"""


def test_the_controllers_file_of_legged_ros2_is_read(card_of):
    names = ", ".join(f"{joint}_joint" for joint in BY_TYPE)
    pose = [0.1, -0.1, 0.11, -0.11, 0.8, 0.81, 1, 1.01, -1.5, -1.51, -1.52, -1.53]
    actions = ", ".join(
        f"{joint}_joint: {{scale: 0.25, kp: {25 + n}, kd: 0.5, default_pos: {pose[n]}}}"
        for n, joint in enumerate(BY_TYPE)
    )
    text = ROS2 % (names, actions)
    jump = text.replace("history_length: 5", "history_length: 1").replace("kp: ", "kp: 9")
    _, card = card_of(225, {"../jump.yaml": jump, "../walk.yaml": text})
    assert card.control.joints == BY_TYPE
    assert card.control.kp == [25 + n for n in range(12)], "of the file whose terms fit"
    assert card.control.default_pose == pose
    seen = card.observations["obs"]
    assert (seen.history.steps, seen.history.by) == (5, "term")
    assert words(card)[2] == "command"


def test_an_environment_that_makes_its_observations_in_code_gives_the_rest(card_of):
    text, card = card_of(
        260,
        {
            "../params/env.yaml": """
decimation: 4
sim: {dt: 0.005}
observation_space: 260
action_scale: 0.5
robot:
  init_state: {joint_pos: {.*_hip_joint: 0.0, .*_thigh_joint: 0.9, .*_calf_joint: -1.8}}
  actuators:
    legs: {joint_names_expr: [.*], effort_limit: 23.7, stiffness: 25.0, damping: 2.0}
"""
        },
    )
    assert (card.control.kp, card.control.kd, card.control.scale) == (25, 2, 0.5)
    assert card.control.default_pose == [0] * 4 + [0.9] * 4 + [-1.8] * 4
    assert "CHECK: the environment computes what the policy sees in its own code" in text
    assert "THESE 260 ZEROS" in text


def test_a_command_from_a_keyboard_is_a_command(card_of):
    _, card = card_of(
        3 * 35, {"params/deploy.yaml": DEPLOY.replace("velocity_c", "keyboard_velocity_c")}
    )
    assert words(card)[2] == "command"


def test_what_exploy_writes_into_a_graph_is_read(card_of):
    metadata = {
        "exploy_version": "0.1.0",
        "update_rate": "25.0",
        "output.joint_targets.legs": json.dumps(
            {"names": LEFT_FIRST, "stiffness": [20.0] * 12, "damping": [0.5] * 11 + [0.7]}
        ),
        "cmd.se2_velocity.vel": json.dumps({"ranges": {"lin_vel_x": [-0.5, 0.5]}}),
    }
    _, card = card_of(45, {}, metadata=metadata)
    assert (card.control.joints, card.control.rate, card.control.kp) == (LEFT_FIRST, 25, 20)
    assert card.control.kd == [0.5] * 11 + [0.7]
    assert card.command.speed == 0.5


def model(path: Path, joints: int = 12) -> Path:
    layers = {"actor.0": (16, 45), "actor.2": (joints, 16)}
    state = {f"{name}.weight": torch.zeros(shape) for name, shape in layers.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"model_state_dict": state, "iter": 3}, path)
    return path


AGENTS = {
    "rsl_rl": "policy: {class_name: ActorCritic, activation: relu}\nclip_actions: 4.0",
    "rsl_rl 5": "actor: {class_name: MLPModel, activation: relu}\nclip_actions: 4.0",
    "skrl": "models: {policy: {network: [{name: net, activations: relu}]}}\nclip_actions: 4.0",
    "rl_games": "params: {network: {mlp: {units: [8], activation: relu}}}\nclip_actions: 4.0",
}


@pytest.mark.parametrize("trainer", AGENTS)
def test_agent_yaml_says_the_activation_of_a_trainings_checkpoint(trainer, tmp_path):
    checkpoint = model(tmp_path / "run/model_3.pt")
    (tmp_path / "run/params").mkdir()
    (tmp_path / "run/params/agent.yaml").write_text(AGENTS[trainer])
    text = init_policy(checkpoint, robot="go2").text
    card = load_card(tmp_path / "run/policy.yaml")
    assert card.options["activation"] == "relu"
    assert "  activation: relu  # params/agent.yaml" in text
    assert card.control.clip == (-4, 4)


def test_a_folder_of_a_training_gives_its_newest_step(tmp_path):
    for step in (100, 900, 1500, 1000):
        model(tmp_path / f"run/model_{step}.pt")
    (tmp_path / "run/params").mkdir()
    (tmp_path / "run/params/agent.yaml").write_text(AGENTS["rsl_rl"])
    draft = init_policy(tmp_path / "run", robot="go2")
    assert draft.file == tmp_path / "run/policy.yaml"
    assert load_card(draft.file).checkpoint.file == "model_1500.pt"
    first = draft.text.splitlines()[0]
    assert first.startswith("# model_1500.pt is the newest checkpoint here, beside model_100.pt")
    assert "model_900.pt" in first
    with pytest.raises(UsageError, match="exists already"):
        init_policy(tmp_path / "run", robot="go2")


def test_a_folder_without_a_checkpoint_is_said(tmp_path):
    with pytest.raises(PolicyError, match=r"no checkpoint is in it.*pt"):
        init_policy(tmp_path, robot="go2")


def test_a_checkpoint_of_another_robot_is_refused_by_its_joints(card_of):
    legs = [f"{leg}_{kind}" for kind in ("HAA", "HFE", "KFE") for leg in ("LF", "LH", "RF", "RH")]
    anymal = json.loads(json.dumps(DESCRIPTORS))
    anymal["actions"][0]["joint_names"] = legs
    with pytest.raises(PolicyError, match=r"another robot than go2.*LF_HAA.*looks like ANYmal"):
        card_of(45, {"IO_descriptors.yaml": json.dumps(anymal)})


def test_a_checkpoint_with_the_joints_of_a_humanoid_is_refused(card_of):
    humanoid = DEPLOY.replace(str(MAP), str(list(range(29))))
    assert humanoid != DEPLOY
    with pytest.raises(PolicyError, match=r"go2, which has 12 joints: .* about 29 joints"):
        card_of(45, {"params/deploy.yaml": humanoid})
    names = {"joint_names": "left_hip_pitch_joint,waist_yaw_joint"}
    with pytest.raises(
        PolicyError, match=r"names 2 joints.*looks like a humanoid, such as Unitree's G1"
    ):
        card_of(45, {}, metadata=names)
    # A name of one leg alone is no quadruped's.
    for joints, is_one in (
        ("FR_hip_joint,FL_hip_joint", False),
        ("FR_hip_joint,RL_hip_joint", True),
    ):
        with pytest.raises(PolicyError) as caught:
            card_of(45, {}, metadata={"joint_names": joints})
        assert ("a quadruped of Unitree" in str(caught.value)) == is_one


LAUGHS = "a: &a [x, x]\n" + "\n".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]"
    for old, new in zip("abcdefghij", "bcdefghijk", strict=True)
)


def test_no_tag_of_a_file_runs_anything(card_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    evil = DEPLOY + "extra: !!python/object/apply:os.system ['touch ran']\n"
    evil += "more: !!python/object/new:subprocess.Popen [[touch, ran]]\n"
    _, card = card_of(3 * 35, {"params/deploy.yaml": evil})
    assert card.control.kp == [20 + motor for motor in MAP]
    assert not list(tmp_path.rglob("ran"))


@pytest.mark.parametrize(
    "text", ["kps: [", "\x00", LAUGHS, "- 1", "joint_ids_map: 3\nstep_dt: nan", "[" * 5000, ""]
)
def test_a_file_that_says_nothing_changes_nothing_and_is_named(text, card_of, onnx_file):
    plain, _ = card_of(45, {})
    (onnx_file({"obs": [1, 45]}, name="run/exported/policy.onnx").parent / "policy.yaml").unlink()
    with_it, _ = card_of(45, {"params/deploy.yaml": text})
    said = [line for line in with_it.splitlines() if line not in plain.splitlines()]
    assert with_it == plain or len(said) == 1
    assert all(line.startswith("# CHECK: params/deploy.yaml was not read") for line in said)
    assert bool(said) == bool(text)


def test_values_of_other_kinds_are_left_out(card_of):
    odd = DEPLOY.replace("step_dt: 0.02", "step_dt: soon").replace(
        "damping: [.5, .5, .5,", "damping: [.5, {}, .inf,"
    )
    text, card = card_of(3 * 35, {"params/deploy.yaml": odd})
    assert card.control.rate == 50
    assert "rate: 50  # CHECK" in text
    assert "# CHECK: the go2's own" in text
    assert np.all(np.array(card.control.kp) == [20 + motor for motor in MAP])
