"""How the numbers of each proprioceptive term are read from a moment, before scale and clip.

The gait clock paces the feet, as policies see it that were trained to one. With `frequency` f,
`stance` d and the gait's phase, offset and bound in `offsets`, it is `clock_inputs` of
walk-these-ways (Margolis and Agrawal 2022, `_step_contact_targets`); with one offset of 0 the sine
and cosine of unitree_rl_gym, and with a cosine first and a `standing` phase of 0.5 the `phase` of
MuJoCo Playground.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import assert_never

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nw_eval.cards import terms
from nw_eval.cards.card import Command, ConstantCommand
from nw_eval.cards.joint_control import JointControl
from nw_eval.cards.terms import GaitClock
from nw_eval.sensors.sensor import Array, StepContext

Reader = Callable[[StepContext], ArrayLike]

# Of Python, not of NumPy, whose vectorised ones differ in the last bit from processor to processor.
_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "sine": lambda phase: math.sin(2.0 * math.pi * phase),
    "cosine": lambda phase: math.cos(2.0 * math.pi * phase),
    "phase": lambda phase: phase,
}


def fixed_values(term: terms.AnyTerm, command: Command) -> ArrayLike | None:
    """Return the numbers of a term that never changes on the way to waypoints; None for all others.

    A task that commands velocities changes `speed`.
    """
    match term:
        case terms.Constant():
            return term.values
        case terms.Speed():
            return commanded_speed(command)
        case _:
            return None


def reader(  # noqa: C901, PLR0912 - one short case for each term.
    term: terms.AnyTerm, command: Command, control: JointControl, feet: Sequence[str]
) -> Reader:
    """Return the function that reads a term.

    Args:
        term: from the card.
        command: the card's, for commanded speeds.
        control: joint order, default pose and limits of actions.
        feet: the robot's.

    Raises:
        PolicyError: a term names a foot that the robot does not have.
    """
    match term:
        case terms.AngularVelocity():
            return _angular_velocity if term.frame == "trunk" else _angular_velocity_in_world
        case terms.LinearVelocity():
            return _linear_velocity(term)
        case terms.Gravity():
            return lambda moment: -moment.world.imu_rotation[2]
        case terms.RollPitch():
            return lambda moment: moment.roll_pitch_yaw[:2]
        case terms.Imu():
            return lambda moment: (*moment.roll_pitch_yaw[:2], 0.0)
        case terms.Yaw():
            return _yaw(term)
        case terms.Orientation():
            places = [0, 1, 2, 3] if term.order == "wxyz" else [1, 2, 3, 0]
            return lambda moment: moment.world.trunk_quat[places]
        case terms.Acceleration():
            return lambda moment: moment.world.specific_force(term.at)
        case terms.DeltaYaw():
            return lambda moment: moment.delta_yaw
        case terms.Command():
            return lambda moment: velocity_command(command, moment)
        case terms.JointPosition() | terms.JointVelocity():
            return _joints(term, control)
        case terms.AppliedAction():
            return _fed_back(lambda moment: moment.applied_action, term, control)
        case terms.LastOutput():
            return _fed_back(_last_output(term), term, control)
        case terms.FootContacts():
            return _foot_contacts(term, feet)
        case terms.GaitClock():
            return gait_clock(term, command)
        case terms.Speed():
            return lambda moment: speed_command(command, moment)
        case terms.Constant():
            values = np.array(term.values)
            return lambda moment: values  # noqa: ARG005 - as every reader.
        case _:
            assert_never(term)


def _joints(term: terms.JointPosition | terms.JointVelocity, control: JointControl) -> Reader:
    pose, order = control.default_pose, _index(control.order, len(control.order))
    if term.leave_out:
        seen = terms.seen_joints(term, control.names)
        pose, order = pose[seen], control.order[seen]
    if isinstance(term, terms.JointVelocity):
        return lambda moment: moment.world.joint_velocities[order]
    zero = pose if term.relative else np.zeros_like(pose)
    if not term.zero:
        return lambda moment: moment.world.joint_positions[order] - zero
    names = [control.names[index] for index in terms.seen_joints(term, control.names)]
    still = list(terms.named_places(term.zero, names, "joint_pos: zero"))

    def read(moment: StepContext) -> Array:
        values = moment.world.joint_positions[order] - zero
        values[still] = 0.0
        return values

    return read


def _angular_velocity(moment: StepContext) -> Array:
    return moment.world.imu_angular_velocity


def _angular_velocity_in_world(moment: StepContext) -> Array:
    return moment.world.imu_rotation @ moment.world.imu_angular_velocity


def _linear_velocity(term: terms.LinearVelocity) -> Reader:
    px, py, pz = term.at

    def read(moment: StepContext) -> Array:
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
    def read(moment: StepContext) -> ArrayLike:
        yaw = moment.roll_pitch_yaw[2]
        if term.relative_to == "start":
            yaw -= moment.world.start_yaw
        if term.values == "sine_cosine":
            return math.sin(yaw), math.cos(yaw)
        return (yaw + math.pi) % (2.0 * math.pi) - math.pi

    return read


def _last_output(term: terms.LastOutput) -> Callable[[StepContext], Array]:
    def read(moment: StepContext) -> Array:
        outputs = (moment.last_output, *moment.earlier_outputs)
        return outputs[term.ago] if term.ago < len(outputs) else np.zeros_like(outputs[0])

    return read


def _fed_back(
    read: Callable[[StepContext], Array],
    term: terms.AppliedAction | terms.LastOutput,
    control: JointControl,
) -> Reader:
    if not term.clipped:
        return read
    return lambda moment: read(moment).clip(control.low, control.high)


def _foot_contacts(term: terms.FootContacts, feet: Sequence[str]) -> Reader:
    terms.check_feet(term, feet)
    order = _index(np.array([feet.index(foot) for foot in term.feet]), len(feet))
    if term.filter == "none":
        return lambda moment: moment.world.foot_contacts[order]
    return lambda moment: (moment.world.foot_contacts | moment.world.previous_foot_contacts)[order]


def _index(order: NDArray[np.intp], count: int) -> NDArray[np.intp] | slice:
    """Return what indexes `count` numbers in an order; a slice, which is faster, for their own."""
    return slice(None) if np.array_equal(order, np.arange(count)) else order


def velocity_command(command: Command, moment: StepContext) -> tuple[float, float, float]:
    """Return vx, vy (m/s, yaw frame) and yaw rate (rad/s): the task's, or else the card's."""
    asked = moment.task.command
    return velocity_at(command, moment.delta_yaw) if asked is None else asked


def speed_command(command: Command, moment: StepContext) -> float:
    """Return the forward speed, m/s: the task's, or else the card's."""
    asked = moment.task.command
    return commanded_speed(command) if asked is None else asked[0]


def velocity_at(command: Command, error: float) -> tuple[float, float, float]:
    """Return the same for a heading error: the angle to the next waypoint, rad to the left."""
    if command.source == "constant":
        return command.velocity
    if command.source == "waypoint":
        return command.speed, 0.0, 0.0
    forward = max(0.0, math.cos(error)) if command.slow_in_turns else 1.0
    turn, limit = command.yaw_gain * error, command.yaw_limit
    return command.speed * forward, 0.0, min(max(turn, -limit), limit)


def commanded_speed(command: Command) -> float:
    """Return the forward speed that a command asks for on a straight course, m/s."""
    return command.velocity[0] if isinstance(command, ConstantCommand) else command.speed


def gait_clock(term: GaitClock, command: Command) -> Callable[[StepContext], list[float]]:
    """Return the function that reads a clock.

    It follows from the number of control steps alone, so a trial continued from its middle reads
    the same.

    Args:
        term: from the card.
        command: the card's, for clocks that rest while it asks for no step.
    """
    functions = [_FUNCTIONS[name] for name in term.values]
    standing = term.standing

    def read(moment: StepContext) -> list[float]:
        if standing is not None and math.hypot(*velocity_command(command, moment)) < standing.below:
            if standing.phase is None:
                return [0.0] * (len(functions) * len(term.offsets))
            phases = [standing.phase] * len(term.offsets)
        else:
            cycles = term.frequency * moment.step / moment.world.control_rate
            phases = [_warped((cycles + offset) % 1.0, term.stance) for offset in term.offsets]
        return [function(phase) for function in functions for phase in phases]

    return read


def _warped(phase: float, stance: float) -> float:
    """Return a phase with [0, stance) mapped to [0, 0.5) and the rest to [0.5, 1)."""
    if phase < stance:
        return phase * (0.5 / stance)
    return 0.5 + (phase - stance) * (0.5 / (1.0 - stance))
