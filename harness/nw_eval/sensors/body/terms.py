"""How the numbers of each proprioceptive term are read from a moment, before scale and clip."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import assert_never

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nw_eval.cards import terms
from nw_eval.cards.command import Command
from nw_eval.cards.joint_control import JointControl
from nw_eval.sensors.body.command import commanded_speed, velocity_command
from nw_eval.sensors.body.gait_clock import gait_clock
from nw_eval.sensors.sensor import Array, Moment

Reader = Callable[[Moment], ArrayLike]

_FEET = ("FR", "FL", "RR", "RL")


def fixed_values(term: terms.AnyTerm, command: Command) -> ArrayLike | None:
    """Return the numbers of a term that never changes during a trial; None for all others."""
    match term:
        case terms.Constant():
            return term.values
        case terms.Speed():
            return commanded_speed(command)
        case _:
            return None


def reader(  # noqa: C901, PLR0912 - one short case for each term.
    term: terms.AnyTerm, command: Command, control: JointControl
) -> Reader:
    """Return the function that reads a term.

    Args:
        term: from the card.
        command: the card's, for commanded speeds.
        control: joint order, default pose and limits of actions.
    """
    pose, order = control.default_pose, _index(control.order)
    match term:
        case terms.AngularVelocity():
            return _angular_velocity if term.frame == "trunk" else _angular_velocity_in_world
        case terms.LinearVelocity():
            return _linear_velocity(term)
        case terms.Gravity():
            return lambda moment: -moment.rotation[2]
        case terms.RollPitch():
            return lambda moment: moment.roll_pitch_yaw[:2]
        case terms.Imu():
            return lambda moment: (*moment.roll_pitch_yaw[:2], 0.0)
        case terms.Yaw():
            return _yaw(term)
        case terms.Acceleration():
            return lambda moment: moment.world.specific_force(term.at)
        case terms.DeltaYaw():
            return lambda moment: moment.delta_yaw
        case terms.Command():
            return lambda moment: velocity_command(command, moment)
        case terms.JointPosition():
            zero = pose if term.relative else np.zeros_like(pose)
            return lambda moment: moment.world.joint_positions[order] - zero
        case terms.JointVelocity():
            return lambda moment: moment.world.joint_velocities[order]
        case terms.AppliedAction():
            return _fed_back(lambda moment: moment.applied_action, term, control)
        case terms.LastOutput():
            return _fed_back(_last_output(term), term, control)
        case terms.FootContacts():
            return _foot_contacts(term)
        case terms.GaitClock():
            return gait_clock(term, command)
        case terms.Constant() | terms.Speed():
            values = np.array(fixed_values(term, command))
            return lambda moment: values  # noqa: ARG005 - as every reader.
        case _:
            assert_never(term)


def _angular_velocity(moment: Moment) -> Array:
    return moment.world.trunk_angular_velocity


def _angular_velocity_in_world(moment: Moment) -> Array:
    return moment.rotation @ moment.world.trunk_angular_velocity


def _linear_velocity(term: terms.LinearVelocity) -> Reader:
    px, py, pz = term.at

    def read(moment: Moment) -> Array:
        rotation = moment.rotation
        # A cross product in plain numbers: `np.cross` takes longer than all the rest.
        wx, wy, wz = moment.world.trunk_angular_velocity.tolist()
        turning = np.array([wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px])
        in_world = moment.world.trunk_linear_velocity + rotation @ turning
        match term.frame:
            case "world":
                return in_world
            case "trunk":
                return rotation.T @ in_world
            case "yaw":
                yaw = moment.roll_pitch_yaw[2]
                c, s = math.cos(yaw), math.sin(yaw)
                x, y, z = in_world.tolist()
                return np.array([c * x + s * y, c * y - s * x, z])
            case _:
                assert_never(term.frame)

    return read


def _yaw(term: terms.Yaw) -> Reader:
    def read(moment: Moment) -> ArrayLike:
        yaw = moment.roll_pitch_yaw[2]
        if term.relative_to == "start":
            yaw -= moment.world.start_yaw
        if term.values == "sine_cosine":
            return math.sin(yaw), math.cos(yaw)
        return (yaw + math.pi) % (2.0 * math.pi) - math.pi

    return read


def _last_output(term: terms.LastOutput) -> Callable[[Moment], Array]:
    def read(moment: Moment) -> Array:
        outputs = (moment.last_output, *moment.earlier_outputs)
        return outputs[term.ago] if term.ago < len(outputs) else np.zeros_like(outputs[0])

    return read


def _fed_back(
    read: Callable[[Moment], Array],
    term: terms.AppliedAction | terms.LastOutput,
    control: JointControl,
) -> Reader:
    if not term.clipped:
        return read
    return lambda moment: read(moment).clip(control.low, control.high)


def _foot_contacts(term: terms.FootContacts) -> Reader:
    order = _index(np.array([_FEET.index(foot) for foot in term.feet]))
    if term.filter == "none":
        return lambda moment: moment.world.foot_contacts[order]
    return lambda moment: (moment.world.foot_contacts | moment.world.previous_foot_contacts)[order]


def _index(order: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Return what indexes an array in some order; a slice, which is faster, where it is its own."""
    return slice(None) if (np.diff(order) > 0).all() else order
