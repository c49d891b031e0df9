"""Numbers of the body, scaled and joined as the card says, their past; and the way to go.

Here is how the numbers of each term are read from a moment, before scale and clip. The gait clock
paces the feet, as policies see it that were trained to one. With `frequency` f, `stance` d and the
gait's phase, offset and bound in `offsets`, it is `clock_inputs` of walk-these-ways (Margolis and
Agrawal 2022, `_step_contact_targets`); with one offset of 0 the sine and cosine of unitree_rl_gym,
and with a cosine first and a `standing` phase of 0.5 the `phase` of MuJoCo Playground.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, assert_never

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nw_base import same_bits
from nw_base.errors import PolicyError
from nw_base.memory import Arrays, read_only
from nw_policies.cards import terms
from nw_policies.cards.card import Command, ConstantCommand
from nw_policies.cards.joint_control import JointControl
from nw_policies.cards.joints import short_name
from nw_policies.cards.observations import (
    DirectionObservation,
    History,
    ProprioObservation,
    ReferenceObservation,
    selected_indices,
)
from nw_policies.cards.terms import Constant, GaitClock, ScaledTerm, term_size
from nw_sim.sensors.sensor import Array, Measurement, Plain, Shot, StepContext

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
            return _command(term, command)
        case terms.Moving():
            return lambda moment: _norm(velocity_command(command, moment)) >= term.below
        case terms.Target():
            return _target(term)
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
    pose, order = control.default_pose, joint_index(control.order, len(control.order))
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


def _command(term: terms.Command, command: Command) -> Reader:
    if term.parts is None:
        return lambda moment: velocity_command(command, moment)
    places = [("vx", "vy", "yaw").index(part) for part in term.parts]

    def read(moment: StepContext) -> ArrayLike:
        velocity = velocity_command(command, moment)
        return [velocity[place] for place in places]

    return read


def _norm(velocity: Sequence[float]) -> float:
    return math.hypot(*velocity)


def _target(term: terms.Target) -> Reader:
    own = [(short_name(name), value) for name, value in term.of.items()]

    def read(moment: StepContext) -> ArrayLike:
        asked = moment.task.targets
        return [asked.get(name, value) for name, value in own]

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
                return same_bits.product(in_world, rotation)
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
    low, high = (control.low, control.high) if term.clipped else (-np.inf, np.inf)
    if term.leave_out:
        seen = terms.seen_joints(term, control.names)
        return lambda moment: read(moment)[seen].clip(low, high)
    return (lambda moment: read(moment).clip(low, high)) if term.clipped else read


def _foot_contacts(term: terms.FootContacts, feet: Sequence[str]) -> Reader:
    terms.check_feet(term, feet)
    order = joint_index(np.array([feet.index(foot) for foot in term.feet]), len(feet))
    if term.filter == "none":
        return lambda moment: moment.world.foot_contacts[order]
    return lambda moment: (moment.world.foot_contacts | moment.world.previous_foot_contacts)[order]


def joint_index(order: NDArray[np.intp], count: int) -> NDArray[np.intp] | slice:
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
    ahead = max(command.least_speed or 0.0, command.speed * forward)
    return ahead, 0.0, min(max(turn, -limit), limit)


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
        if standing is not None and _norm(velocity_command(command, moment)) < standing.below:
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


Frame = NDArray[np.float32]
Indices = NDArray[np.intp]

# The published evaluation keeps ten frames, and spoils the first two observations (see below).
_PUBLISHED_FRAMES = 10
_SPOILT_STEPS = 1


class Rows(Measurement):
    """Numbers of this moment in a row: one whole frame, (n,) float32.

    What the card takes of a frame, and its history, are its `form`.
    """

    unit = "mixed"

    def __init__(
        self,
        name: str,
        observation: ProprioObservation | ReferenceObservation,
        terms: Sequence[ScaledTerm],
        sizes: Sequence[int],
        readers: Sequence[Reader],
        *,
        key: str = "",
        spoils_first: bool = False,
    ) -> None:
        """Prepare a frame.

        Args:
            name: of the observation, for errors.
            observation: from the card.
            terms: of a frame.
            sizes: how many numbers each has.
            readers: of each.
            key: what else its numbers depend on.
            spoils_first: whether the first observation is spoilt, as in the published evaluation.

        Raises:
            PolicyError: a list of scales has another length than its term, or `select` or `zero`
                name numbers that the frame does not have.
        """
        self._name = name
        self._observation = observation
        self._sizes = [*sizes]
        bounds = np.cumsum([0, *self._sizes]).tolist()
        # Everything that never changes is written once.
        self._frame = np.zeros(bounds[-1])
        self._readers: list[tuple[slice, Reader]] = []
        for term, read, a, b in zip(terms, readers, bounds[:-1], bounds[1:], strict=True):
            if isinstance(term, Constant):
                self._frame[a:b] = term.values
            else:
                self._readers.append((slice(a, b), read))
        scale = np.concatenate(
            [_scales(name, t, n) for t, n in zip(terms, self._sizes, strict=True)]
        )
        self._scale = scale if (scale != 1.0).any() else None
        offset = np.repeat([term.offset for term in terms], self._sizes)
        self._offset = offset if offset.any() else None
        # Columns low, high; None where nothing is limited, since clipping costs more than reading.
        limits = [term.clip or (-np.inf, np.inf) for term in terms]
        limited = any(t.clip for t in terms)
        self._limits = np.repeat(limits, self._sizes, axis=0) if limited else None
        self._clip = observation.clip
        select = observation.select if isinstance(observation, ProprioObservation) else None
        self._keep = _indices(name, select, bounds[-1])
        self._kept_sizes = self._sizes if self._keep is None else [len(self._keep)]
        self.shape: tuple[int, ...] = (bounds[-1],)
        self.dtype = np.dtype(np.float32)
        self.form = self._form(spoils=spoils_first)
        frame = " + ".join(str(size) for size in self._kept_sizes)
        history = observation.history
        self.sum_of = frame if history is None else f"{history.steps} x ({frame})"
        # Observations of one card that have the same terms read them once.
        texts = [one.model_dump_json() for one in terms]
        self._key = f"{observation.clip}{texts}{key}"

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Return the present frame."""
        known = moment.shared.get(self._key)
        if known is not None:
            return known
        frame = self._frame
        for part, read in self._readers:
            frame[part] = read(moment)
        if self._limits is not None:
            frame = np.clip(frame, self._limits[:, 0], self._limits[:, 1])
        if self._scale is not None:
            frame = frame * self._scale
        if self._offset is not None:
            frame = frame + self._offset
        if self._clip is not None:
            frame = np.clip(frame, *self._clip)
        single = read_only(frame.astype(np.float32))
        moment.shared[self._key] = single
        return single

    def _form(self, *, spoils: bool) -> list[Select | HistoryStack]:
        """Return what a frame passes through to become the observation."""
        observation, keep = self._observation, self._keep
        if observation.history is not None:
            size = len(keep) if keep is not None else self.shape[0]
            zero = _indices(self._name, observation.history.zero, size)
            sizes = self._kept_sizes
            stack = HistoryStack(observation.history, sizes, keep=keep, zero=zero, spoils=spoils)
            return [stack]
        return [Select(keep, spoils=spoils)] if keep is not None or spoils else []


class Proprio(Rows):
    """Numbers of the body at this moment."""

    def __init__(
        self,
        name: str,
        observation: ProprioObservation,
        command: Command,
        control: JointControl,
        feet: Sequence[str],
        *,
        spoils_first: bool = False,
    ) -> None:
        """Prepare one reader for each term.

        Args:
            name: of the observation, for errors.
            observation: from the card.
            command: the card's.
            control: the card's.
            feet: the robot's.
            spoils_first: whether the protocol spoils the first observation of its own 53 numbers.

        Raises:
            PolicyError: as `Rows`, or a term names a foot that the robot does not have.
        """
        terms = observation.frame_terms
        super().__init__(
            name,
            observation,
            terms,
            [term_size(term, control.names) for term in terms],
            [reader(term, command, control, feet) for term in terms],
            key=command.model_dump_json(),
            spoils_first=spoils_first and observation.layout == "parkour53",
        )


def _scales(name: str, term: ScaledTerm, size: int) -> NDArray[np.float64]:
    if isinstance(term.scale, list) and len(term.scale) != size:
        raise PolicyError(
            f"`{name}`: term {getattr(term, 'term', '')} has {size} numbers but "
            f"{len(term.scale)} scales",
            fix="give one scale, or one for each number",
        )
    return np.broadcast_to(np.asarray(term.scale, dtype=np.float64), size).copy()


def _indices(name: str, select: list[int | str] | None, size: int) -> NDArray[np.intp] | None:
    if select is None:
        return None
    try:
        return np.array(selected_indices(select, size), dtype=np.intp)
    except ValueError as error:
        raise PolicyError(f"`{name}`: {error}") from None


class Select(Plain):
    """Some numbers of each frame.

    Args:
        keep: which; None = all.
        spoils: whether the first observation is that of the published evaluation: each number of
            the frame stands eleven times in a row there, so that the present frame holds only its
            first five numbers.
    """

    def __init__(self, keep: Indices | None, *, spoils: bool) -> None:
        self._keep = keep
        self._spoils = spoils

    def __call__(self, sample: Frame, shot: Shot) -> Frame:
        """Return the numbers that are kept."""
        if self._spoils and shot.step <= _SPOILT_STEPS:
            sample = spoilt_frames(sample)[0]
        return sample if self._keep is None else sample[self._keep]


class HistoryStack:
    """The last frames of an observation, flattened as its checkpoint was trained to read them.

    Args:
        history: how many frames, in which order.
        sizes: how many numbers each term of a whole frame has.
        keep: which numbers of a frame the stack holds; None = all.
        zero: which of those read 0 once they are history.
        spoils: as in `Select`; of histories that are longer than the published one, nothing.
    """

    def __init__(
        self,
        history: History,
        sizes: Sequence[int],
        *,
        keep: Indices | None = None,
        zero: Indices | None = None,
        spoils: bool = False,
    ) -> None:
        self._history = history
        bounds = np.cumsum([0, *sizes]).tolist()
        self._terms = [slice(a, b) for a, b in pairwise(bounds)]
        self._keep = keep
        self._zero = zero
        earlier = history.steps - history.current
        self._spoils = spoils and earlier <= _PUBLISHED_FRAMES
        # Frames before the present one, oldest first, whatever the order of the output.
        self._frames: list[Frame] = []

    def __call__(self, sample: Frame, shot: Shot) -> Frame:
        """Add the present frame and return the stack, (n,) float32."""
        history = self._history
        # In memory of its own: it is kept, and the sample is seen by others.
        frame = sample.copy() if self._keep is None else sample[self._keep]
        past = frame
        if self._zero is not None:
            past = frame.copy()
            past[self._zero] = 0.0
        frames = self._frames
        if not frames:
            filler = past if history.start == "repeat" else np.zeros_like(past)
            frames = [filler] * history.steps
        shown = [*frames[1:], frame] if history.current else frames
        self._frames = [*frames[1:], past]
        if self._spoils and shot.step <= _SPOILT_STEPS:
            shown = self._spoilt(sample)
        if history.order == "newest_first":
            shown = shown[::-1]
        if history.by == "term":
            return np.concatenate([frame[term] for term in self._terms for frame in shown])
        return np.concatenate(shown)

    def reset(self, rng: np.random.Generator) -> None:  # noqa: ARG002 - nothing here is random.
        """Forget all frames."""
        self._frames = []

    def state(self) -> Arrays:
        """Return the earlier frames."""
        return {"frames": np.array(self._frames)} if self._frames else {}

    def restore(self, state: Arrays) -> None:
        """Go back to earlier frames.

        Raises:
            ValueError: they are those of another history.
        """
        frames = state.get("frames")
        if frames is not None and (len(frames), frames.dtype) != (self._history.steps, np.float32):
            raise ValueError(f"a history of {frames.shape} {frames.dtype}")
        self._frames = [] if frames is None else list(frames)

    def _spoilt(self, frame: Frame) -> list[Frame]:
        """Return frames of the published first observation, oldest first."""
        present, *past = spoilt_frames(frame)
        shown = [*past, present] if self._history.current else past
        shown = shown[len(shown) - self._history.steps :]
        return shown if self._keep is None else [frame[self._keep] for frame in shown]


def spoilt_frames(frame: Frame) -> Frame:
    """Return the frames of the published first observation, (11, n): the present, then the past.

    The published wrapper repeats every number eleven times where it means to repeat the frame:
    flat number i is frame[i // 11].
    """
    count = _PUBLISHED_FRAMES + 1
    return np.repeat(frame, count).reshape(count, len(frame))


class Direction(Measurement):
    """The angle from the heading to the next waypoint: (1,) rad, or (2,) sine and cosine."""

    def __init__(self, observation: DirectionObservation) -> None:
        self._as_angle = observation.values == "angle"
        self.unit = "rad" if self._as_angle else "1"
        self.shape: tuple[int, ...] = (1,) if self._as_angle else (2,)
        self.dtype = np.dtype(np.float32)

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Read it."""
        angle = moment.delta_yaw
        values = [angle] if self._as_angle else [math.sin(angle), math.cos(angle)]
        return np.array(values, dtype=np.float32)
