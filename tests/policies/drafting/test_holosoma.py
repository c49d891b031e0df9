"""Graphs of holosoma: their metadata name joints and gains, and its own code the rest."""

import json

from nw_policies.drafting.exporters import _holosoma

G1 = [
    *(f"{side}_{joint}_joint" for side in ("left", "right") for joint in (
        "hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")),
    *(f"waist_{joint}_joint" for joint in ("yaw", "roll", "pitch")),
    *(f"{side}_{joint}_joint" for side in ("left", "right") for joint in (
        "shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch",
        "wrist_yaw")),
]  # fmt: skip


def read(names, size):
    gains = json.dumps([40.0] * len(names))
    return _holosoma({"dof_names": json.dumps(names), "kp": gains, "kd": gains}, size)


def test_a_g1_that_is_commanded_a_velocity_sees_terms_in_the_order_of_their_names():
    # 3 numbers of each joint, two of the body's, the command, two phases in two functions.
    said = read(G1, 3 * 29 + 3 + 3 + 3 + 4 - 1)
    names = [term.name for term in said.observation_terms]
    assert names == sorted(names)
    assert len(names) == 9
    scales = {term.name: term.scale for term in said.observation_terms}
    assert (scales["base_ang_vel"], scales["dof_vel"]) == ((0.25,), (0.05,))
    assert (said.action_scale, said.rate) == ((0.25,), 50.0)
    pose = dict(zip(said.joint_names, said.default_joint_pos, strict=True))
    assert pose["left_hip_pitch_joint"] == pose["right_hip_pitch_joint"] == -0.312
    assert (pose["left_shoulder_roll_joint"], pose["right_shoulder_roll_joint"]) == (0.2, -0.2)
    assert pose["waist_pitch_joint"] == 0


def test_another_robot_or_size_gets_no_terms_of_it():
    assert not read(G1, 120).observation_terms
    assert not read([f"joint_{n}" for n in range(29)], 99).observation_terms
