"""What Booster and LimX deploy their policies with, as a card says it.

The numbers are made up; which of them stands where is as the scripts beside the files have it:
booster_gym/deploy/utils/policy.py, and compute_observation of LimX's controllers.
"""

from dataclasses import replace

import pytest
import yaml

from nw_policies.drafting.beside import read_beside
from nw_policies.drafting.configs import reader_of
from nw_policies.drafting.fields import Fields
from nw_scenes.robots import get_robot

GO1 = get_robot("go1")
BOOSTER = """
common: {dt: 0.002, stiffness: [9, 9, 20, 21], damping: [3, 3, 1, 2],
  default_qpos: [8, 8, 0.5, -0.5], torque_limit: [7, 7, 30, 31]}
policy:
  policy_path: ./models/policy.pt
  num_actions: 2
  num_observations: 17
  gait_frequency: 1.5
  normalization: {gravity: 1.0, lin_vel: 2.0, ang_vel: 0.5, dof_pos: 1.0, dof_vel: 0.1,
    clip_actions: 1.5}
  control: {action_scale: 0.75, decimation: 10}
mech: {parallel_mech_indexes: [15]}
prepare: {stiffness: [5.0]}
"""
LIMX = """
PointfootCfg:
  loop_frequency: 500
  joint_names: [FR_hip_joint, FR_thigh_joint]
  init_state: {default_joint_angle: {FR_hip_joint: 0.25, FR_thigh_joint: -0.5}}
  control: {stiffness: 42.0, damping: 3.5, action_scale_pos: 0.25, decimation: 10,
    user_torque_limit: 80}
  normalization:
    clip_scales: {clip_observations: 90.0, clip_actions: 70.0}
    obs_scales: {lin_vel: 2.0, ang_vel: 0.25, dof_pos: 1.0, dof_vel: 0.05}
  size: {actions_size: 2, encoder_output_size: 3}
  stand_mode: {stand_duration: 1.0}
  imu_orientation_offset: {roll: 0.0, pitch: 0.0, yaw: 0.0}
  user_cmd_scales: {lin_vel_x: 1.5, lin_vel_y: 1.0, ang_vel_yaw: 0.5}
"""


def read(text):
    known = read_beside({"config.yaml": text}, GO1, "policy.pt")
    assert known is not None
    return known


def test_each_file_is_known_by_its_keys():
    kinds = [reader_of(Fields(yaml.safe_load(text)))[0] for text in (BOOSTER, LIMX)]
    assert kinds == ["booster", "limx"]


def test_booster_s_lists_are_of_all_motors_and_the_policy_drives_the_last():
    known = read(BOOSTER)
    assert known.joint_names == ("RL_thigh", "RL_calf")
    assert (known.joint_stiffness, known.joint_damping) == ((20.0, 21.0), (1.0, 2.0))
    assert (known.default_joint_pos, known.torque_limits) == ((0.5, -0.5), (30.0, 31.0))
    assert (known.rate, known.action_scale, known.action_clip) == (50.0, (0.75,), (-1.5, 1.5))


def test_booster_s_terms_are_those_of_its_script():
    terms = {term.name: term for term in read(BOOSTER).observation_terms}
    names = "projected_gravity base_ang_vel commands phase dof_pos dof_vel actions"
    assert list(terms) == names.split()
    assert terms["commands"].scale == (2.0, 2.0, 0.5)
    assert terms["dof_vel"].scale == (0.1,)
    assert terms["phase"].keys == "frequency: 1.5, values: [cosine, sine]"


def test_of_limx_what_is_known_is_kept_and_what_is_not_is_named():
    known = read(LIMX)
    assert known.joint_names == ("FR_hip", "FR_thigh")
    assert (known.default_joint_pos, known.torque_limits) == ((0.25, -0.5), (80.0,))
    assert (known.rate, known.observation_clip) == (50.0, 90.0)
    names = [term.name for term in known.observation_terms]
    assert (names[0], names[-2:]) == ("encoder", ["gait", "commands"])
    assert known.observation_terms[-1].scale == (1.5, 1.0, 0.5)


@pytest.mark.parametrize("text", [BOOSTER, LIMX])
def test_a_field_that_nobody_reads_is_named(text):
    first, more = text.strip().partition("\n")[0], "unheard_of: 3"
    marked = text + ("policy_of_ours: 3\n" if "common" in first else f"  {more}\n")
    left = "policy_of_ours" if "common" in first else "PointfootCfg.unheard_of"
    assert any(left in note for note in read(marked).notes)
    assert not any("has what this card does not" in note for note in read(text).notes)


def test_a_file_of_another_robot_s_size_says_its_number_of_joints():
    known = read(BOOSTER.replace("num_actions: 2", "num_actions: 3"))
    assert replace(known, notes=()).joint_count == 3
