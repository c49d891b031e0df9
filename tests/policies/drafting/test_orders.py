"""Joints in the order of a simulator, and observations in another than the action's."""

import copy
import json
from dataclasses import replace

import pytest
from tests.policies.drafting.test_beside import (
    BY_TYPE,
    DESCRIPTORS,
    ENVIRONMENT,
    GYM,
    LEFT_FIRST,
)

from nw_policies.drafting.layouts import frames_of, isaac_lab_order
from nw_scenes.robots import get_robot

IN_TYPES = [LEFT_FIRST.index(name) for name in BY_TYPE]
"""Where the joints of BY_TYPE stand in LEFT_FIRST."""


def renamed(prefix):
    """Go1 with joints of other names: it has its legs as FR, FL, RR, RL in its file."""
    go1 = get_robot("go1")
    mjcf = go1.mjcf
    for joint in go1.joints:
        mjcf = mjcf.replace(f'"{joint}"', f'"{prefix}{joint}"')
    return replace(go1, joints=tuple(prefix + joint for joint in go1.joints), mjcf=mjcf)


def test_isaac_lab_counts_the_joints_of_any_robot_level_by_level():
    kinds, legs = ("hip", "thigh", "calf"), ("FR", "FL", "RR", "RL")
    expected = [f"my_{leg}_{kind}" for kind in kinds for leg in legs]
    assert list(isaac_lab_order(renamed("my_"))) == expected
    assert list(isaac_lab_order(get_robot("go1"))) == BY_TYPE, "as its trainings have them"


def test_layouts_of_other_robots_have_three_numbers_for_each_of_their_joints():
    # G1 with 29 joints: 12 + 3 * 29 in Isaac Lab, and the phases of two feet in Playground.
    assert [frame.name for frame, _ in frames_of(99, 29)] == ["legged-gym", "isaac-lab"]
    assert [frame.name for frame, _ in frames_of(103, 29)] == ["playground-biped"]
    assert [(frame.name, n) for frame, n in frames_of(480, 29)][-1] == ("unitree-rl-lab", 5)
    assert frames_of(53, 16) == (), "that of extreme-parkour is of twelve joints"


def seen_by(card, name):
    return card.observations[name]


def test_terms_whose_joints_descriptors_list_in_another_order_are_selected(card_of):
    told = copy.deepcopy(DESCRIPTORS)
    told["observations"]["policy"][2]["joint_names"] = [f"{name}_joint" for name in BY_TYPE]
    text, card = card_of(44, {"IO_descriptors.yaml": json.dumps(told)})
    assert card.control.joints == LEFT_FIRST
    angles = seen_by(card, "obs_joint_pos_rel")
    assert (angles.select, angles.history.steps, angles.history.by) == (IN_TYPES, 2, "step")
    assert "inputs: {obs: [obs, obs_joint_pos_rel]}" in text


def test_a_listed_order_of_the_action_is_not_that_of_what_isaac_lab_observes(card_of):
    listed = json.dumps([f"{name}_joint" for name in LEFT_FIRST])
    exact = ENVIRONMENT.replace("joint_names: [.*]", f"joint_names: {listed}")
    exact = exact.replace("preserve_order: false", "preserve_order: true")
    _, card = card_of(45, {"params/env.yaml": exact})
    assert card.control.joints == LEFT_FIRST
    assert [seen_by(card, f"obs_joint_{what}").select for what in ("pos", "vel")] == [IN_TYPES] * 2
    assert seen_by(card, "obs").select is None
    own = f"params: {{asset_cfg: {{joint_names: {listed}, preserve_order: true}}}}, clip"
    alike = exact.replace(':joint_pos", clip', f':joint_pos", {own}')
    _, card = card_of(45, {"params/env.yaml": alike}, name="other/policy.onnx")
    assert "obs_joint_pos" not in card.observations


def test_joints_that_no_pattern_of_a_pose_means_are_at_zero(card_of):
    # ArticulationCfg.InitialStateCfg of Isaac Lab: joints without a match keep 0.
    text = ENVIRONMENT.replace(".*L_hip_joint: 0.1, .*R_hip_joint: -0.1, ", "")
    _, card = card_of(45, {"params/env.yaml": text})
    assert card.control.default_pose == [0.0] * 4 + [0.8, 0.8, 1, 1] + [-1.5] * 4
    of_others = ENVIRONMENT.replace("_joint: ", "_servo: ").replace('_joint": ', '_servo": ')
    drafted, _ = card_of(45, {"params/env.yaml": of_others}, name="other/policy.onnx")
    assert "# default_pose" in drafted


@pytest.mark.parametrize("size", [270, 45])
def test_a_deploy_config_with_an_estimator_is_of_frames_newest_first(size, card_of):
    config = GYM.replace("num_obs: 45", "num_obs: 64\nnum_obs_current: 45\nnum_obs_encoder: 270")
    text, card = card_of(size, {"configs/go2.yaml": config})
    seen = seen_by(card, "obs")
    assert [term.term for term in seen.frame_terms][:3] == ["command", "ang_vel", "gravity"]
    assert card.control.kp == 21
    if size == 270:
        history = seen.history
        assert (history.steps, history.order, history.by) == (6, "newest_first", "step")
    assert "of another policy by names or sizes" not in text


@pytest.mark.parametrize(
    ("key", "places"),
    [
        ("mapping_joints", [0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11]),
        ("isaac_to_mujoco_map", [0, 4, 8, 1, 5, 9, 2, 6, 10, 3, 7, 11]),
    ],
)
def test_a_scripts_permutation_of_mujocos_joints_is_the_order_in_either_direction(
    key, places, card_of
):
    config = GYM.replace(
        "joint2motor_idx: [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]", f"{key}: {places}"
    )
    config = config.replace("num_obs: 45", "num_obs: 180\nhistory_length: 4\naction_clip: 3")
    _, card = card_of(180, {"configs/go2.yaml": config})
    assert card.control.joints == BY_TYPE
    assert card.control.default_pose[:4] == [0.1, -0.1, 0.1, -0.1]
    assert card.control.clip == (-3, 3)
    # Isaac Lab has the frames of a term in a row; other scripts have them frame by frame.
    assert card.observations["obs"].history.by == ("term" if "isaac" in key else "step")
