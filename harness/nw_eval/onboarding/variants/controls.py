"""The same policy on other motors: pose, gains, rate, latency, meaning of its actions, robot.

What a card forgets there is the robot's own or usual, and not always what a policy was trained on.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from nw_eval.cards import Card, JointControl
from nw_eval.cards.joints import joint_values
from nw_eval.cards.model import CONTROL_RATE
from nw_eval.errors import PolicyError
from nw_eval.onboarding.variants.motors import joint_names, motor_values
from nw_eval.onboarding.variants.written import flow, listed, per_joint
from nw_eval.robots import RobotSpec, get_robot, robot_names

_POSES = {
    "legged_gym": (0.1, 0.8, 1.0, -1.5),
    "MuJoCo Playground": (-0.1, 0.9, 0.9, -1.8),
    "MuJoCo Menagerie": (0.0, 0.9, 0.9, -1.8),
    "Unitree": (0.0, 0.67, 0.67, -1.3),
}
"""Hips outwards, front thighs, rear thighs and calves, rad."""
_FACTORS = (2.0, 0.5, 4.0, 0.25)
_RATES = (CONTROL_RATE, CONTROL_RATE // 2)  # Hz
_DELAYS = (0, 1, 2)


def other_controls(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    """Yield cards with other motors, and what they are in words."""
    yield from _meanings(card)
    yield from _poses(card, robot)
    yield from _gains(card, robot)
    yield from _rates(card)
    for steps in _DELAYS:
        if steps != card.control.delay_steps:
            yield f"actions delayed by {steps}", _with(card, delay_steps=steps)
    yield from _robots(card)


def _meanings(card: Card) -> Iterator[tuple[str, Card]]:
    other = {
        "joint_position": "joint_position_offset",
        "joint_position_offset": "joint_position",
    }.get(card.control.action)
    if other is not None:
        yield f"actions that are {other}", _with(card, action=other)


def _poses(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    names = joint_names(card, robot)
    own = JointControl.from_card(card, robot).default_pose
    for whose, (hip, front, rear, calf) in _POSES.items():
        by_kind = {"hip": hip, "thigh": rear, "F?_thigh": front, "calf": calf}
        right = {"FR_hip": -hip, "RR_hip": -hip}
        pose = joint_values(by_kind | right, names)
        if not np.array_equal(pose, own):
            words = f"{whose}'s default pose"
            yield words, _with(card, default_pose=per_joint(names, pose.tolist()))


def _gains(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    names, order = joint_names(card, robot), JointControl.from_card(card, robot).order
    motors = motor_values(card, robot)
    own = {"kp": robot.kp, "kd": robot.joint_damping}
    if card.control.action == "joint_torque":
        return
    if any((motors[key] != value).any() for key, value in own.items()):
        yield "the robot's own gains", _with(card, **own)
    for which in (("kp", "kd"), ("kp",), ("kd",)):
        for factor in _FACTORS:
            new = {key: per_joint(names, (motors[key][order] * factor).tolist()) for key in which}
            words = [f"{key} {flow(value)}" for key, value in new.items()]
            yield listed(words), _with(card, **new)
    doubled = per_joint(names, (motors["torque_limits"][order] * 2.0).tolist())
    yield "torque limits doubled", _with(card, torque_limits=doubled)


def _rates(card: Card) -> Iterator[tuple[str, Card]]:
    own = card.control.rate
    for rate in _RATES:
        if rate == own:
            continue
        # What was sampled whenever the policy acts still is.
        observations = {
            name: observation.model_copy(update={"rate": rate})
            if observation.rate == own
            else observation
            for name, observation in card.observations.items()
        }
        other = _with(card, rate=rate).model_copy(update={"observations": observations})
        yield f"a rate of {rate} Hz", other


def _robots(card: Card) -> Iterator[tuple[str, Card]]:
    for name in robot_names():
        other = card.model_copy(update={"robot": name})
        try:
            JointControl.from_card(other, get_robot(name))
        except PolicyError:
            continue  # It has other joints.
        if name != card.robot:
            yield f"{name} for a robot", other


def _with(card: Card, **changes: Any) -> Card:
    return card.model_copy(update={"control": card.control.model_copy(update=changes)})
