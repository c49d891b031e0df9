"""What is noted of control steps until it is written, hundreds of them at a time.

Ten messages in each control step cost more to make than a step of physics. Here a step costs one
`append` when it happens; the bytes are made later.

Calls of the policy are `nw.PolicyStep` messages that are put together by hand: to fill in a message
number by number costs far more. The fields are those of `messages._MESSAGES`, in their order; what
is zero or empty is left out, as protobuf does. The robot's messages are transforms, joints, the
trunk's pose and twist.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from numpy.typing import NDArray

from nw_sim.rollout.mcap.batch import (
    BLANK_TIME,
    Batch,
    Channels,
    Form,
    Integers,
    Part,
    blank_double,
    filled,
    records,
)
from nw_sim.rollout.mcap.drawn import WORLD, path_cloud
from nw_sim.rollout.mcap.images import SeenRows
from nw_sim.rollout.mcap.messages import (
    Command,
    PolicyStep,
    Twist,
    nanoseconds,
    sized,
    time_field,
    varint,
)

Array = NDArray[np.float64]


Path = Literal["none", "point", "shown"]
"""Whether the walked path has a point there, and is written."""
HEADING = "heading"
"""The frame of commands: the trunk's origin, level, turned by the trunk's yaw only."""
# Fields of a `PolicyStep`.
_STEP, _OBSERVATION, _STATE = b"\x10", b"\x1a", b"\x3a"
_NUMBERS = (b"\x22", b"\x2a", b"\x32")


class StepNote(NamedTuple):
    """What is noted of one control step, all of it the note's own."""

    time: float
    """Simulated, s."""
    data: bytes
    """Float64 numbers: a row for `BodyForms.numbers`; then, where the policy was called, its raw
    output, the applied action and the joint targets, (J) each; then what `SeenRows.note` gave."""
    call: Call | None = None
    path: Path = "none"


class Call(NamedTuple):
    """What else is noted of a call of the policy."""

    step: int
    """Number of the control step."""
    state_digest: bytes
    """Of what it remembers; empty where the log has no state."""
    heading_error: float | None
    """To the next waypoint, rad to the left; None where nothing was observed."""
    digest: bytes
    """Of what it was given: see `SeenRows.note`."""
    new: tuple[bool, ...]
    """Which rows of that are new."""
    command: tuple[float, float, float] | None = None
    """What the task asks for: vx, vy (m/s), yaw rate (rad/s); None leaves it to the card."""


class Steps:
    """Notes of control steps.

    Args:
        body: the robot's own messages.
        joints: how many it has.
        seen: the observations that are rows of numbers.
        command: from a heading error, rad, to what the card asks for where the task asks for
            nothing: vx, vy (m/s), yaw rate (rad/s).
    """

    def __init__(
        self,
        body: BodyForms,
        *,
        joints: int,
        seen: SeenRows,
        command: Callable[[float], tuple[float, float, float]],
        is_summary: bool = False,
    ) -> None:
        self._body = body
        self._is_summary = is_summary
        self._seen = seen
        self._command = command
        # Where the numbers of the body end in a step's bytes, and those of the actions.
        self._ends = 8 * body.width, 8 * (body.width + 3 * joints)
        self._walked = np.empty((0, 3))  # places of the trunk
        self._notes: list[StepNote] = []

    def note(self, step: StepNote) -> None:
        """Keep what the messages of one step need."""
        self._notes.append(step)

    def take(self, channels: Channels) -> list[Part]:
        """Return the messages of all notes so far as parts of a piece for each; forget them."""
        notes, self._notes = self._notes, []
        body, actions = self._ends
        times = np.array([nanoseconds(note.time) for note in notes])
        rows = _numbers([note.data[:body] for note in notes])
        if self._is_summary:
            return [self._path(notes, times.tolist(), rows, channels)]
        messages = _filled(channels, self._body.forms, times, self._body.numbers(rows))
        parts: list[Part] = [(range(len(notes)), messages)]
        parts.append(self._path(notes, times.tolist(), rows, channels))
        called = [number for number, note in enumerate(notes) if note.call is not None]
        if called:
            times = times[called]
            calls = [note.call for note in notes if note.call is not None]
            outputs = _numbers([notes[number].data[body:actions] for number in called])
            observed = [notes[number].data[actions:] for number in called]
            parts.append((called, self._policy(times, calls, outputs, observed, channels)))
            for which, batch in self._observations(times, calls, observed, channels):
                parts.append(([called[number] for number in which], batch))
        return parts

    def _path(
        self, notes: Sequence[StepNote], times: Sequence[int], rows: Array, channels: Channels
    ) -> Part:
        points = [number for number, note in enumerate(notes) if note.path != "none"]
        before = len(self._walked)
        self._walked = np.concatenate((self._walked, self._body.trunk(rows)[points]))
        shown: list[int] = []
        clouds: list[bytes] = []
        for count, number in enumerate(points, before + 1):
            if notes[number].path == "shown":
                shown.append(number)
                clouds.append(path_cloud(times[number], self._walked[:count]))
        numbers = [channels("/robot/path", PointCloud) for _ in shown]
        return shown, records(numbers, [times[number] for number in shown], clouds)

    def _policy(
        self,
        times: Integers,
        calls: Sequence[Call],
        outputs: Array,
        observed: Sequence[bytes],
        channels: Channels,
    ) -> Batch:
        each = zip(calls, observed, strict=True)
        missing = [data for call, data in each if not call.digest]
        digests = iter(self._seen.digests(missing) if missing else ())
        at = times.tolist()
        messages = policy_steps(
            at,
            [call.step for call in calls],
            observations=[call.digest or next(digests) for call in calls],
            states=[call.state_digest for call in calls],
            numbers=outputs,
        )
        return records([channels("/nw/policy", PolicyStep)] * len(at), at, messages)

    def _asked(self, call: Call) -> tuple[float, float, float, float]:
        error = call.heading_error or 0.0
        return (*(call.command or self._command(error)), error)

    def _observations(
        self,
        times: Integers,
        calls: Sequence[Call],
        observed: Sequence[bytes],
        channels: Channels,
    ) -> Iterator[tuple[list[int], Batch]]:
        """Yield commands and observations, those together that came together: which, and what."""
        groups: dict[tuple[bool, ...], list[int]] = {}
        for number, call in enumerate(calls):
            if call.heading_error is not None:
                groups.setdefault(call.new, []).append(number)
        for new, which in groups.items():
            commands = np.array([self._asked(calls[number]) for number in which])
            forms, numbers = self._seen.numbers(new, [observed[number] for number in which])
            yield (
                which,
                _filled(
                    channels,
                    {"/robot/command": _command_form(), **forms},
                    times[which],
                    (rounded(commands), *numbers),
                ),
            )


def _filled(
    channels: Channels, forms: Mapping[str, Form], times: Integers, numbers: Sequence[NDArray[Any]]
) -> Batch:
    numbered = [channels(topic, form.kind) for topic, form in forms.items()]
    return filled(numbered, tuple(forms.values()), times, numbers)


def _numbers(data: Sequence[bytes]) -> Array:
    """Return float64 numbers of N steps as rows."""
    return np.frombuffer(b"".join(data)).reshape(len(data), -1)


@lru_cache(maxsize=8)
def transforms_form(frames: tuple[str, ...]) -> Form:
    """Return the form of `/tf`: for each frame x y z (m) and quaternion w x y z in the world."""
    message = FrameTransforms()
    for number, name in enumerate(frames):
        added = message.transforms.add(
            timestamp=BLANK_TIME, parent_frame_id=WORLD, child_frame_id=name
        )
        _blank(added.translation, "xyz", 7 * number)
        _blank(added.rotation, "wxyz", 7 * number + 3)
    return Form.of_doubles(message, 7 * len(frames))


@lru_cache(maxsize=8)
def joints_form(names: tuple[str, ...]) -> Form:
    """Return the form of `/robot/joints`: for each joint rad, rad/s and N m."""
    message = JointStates(timestamp=BLANK_TIME)
    for number, name in enumerate(names):
        joint = message.joints.add(name=name)
        joint.position = blank_double(3 * number)
        joint.velocity = blank_double(3 * number + 1)
        joint.effort = blank_double(3 * number + 2)
    return Form.of_doubles(message, 3 * len(names))


@lru_cache(maxsize=8)
def odom_form() -> Form:
    """Return the form of `/robot/odom`: x y z (m) and quaternion w x y z in the world."""
    message = PoseInFrame(timestamp=BLANK_TIME, frame_id=WORLD)
    _blank(message.pose.position, "xyz", 0)
    _blank(message.pose.orientation, "wxyz", 3)
    return Form.of_doubles(message, 7)


@lru_cache(maxsize=8)
def _twist_form(trunk: str) -> Form:
    """Return the form of `/robot/twist`: velocity (m/s), angular velocity (rad/s) in the trunk."""
    message = Twist(timestamp=BLANK_TIME, frame_id=trunk)
    _blank(message.linear, "xyz", 0)
    _blank(message.angular, "xyz", 3)
    return Form.of_doubles(message, 6)


@lru_cache(maxsize=8)
def _command_form() -> Form:
    """Return the form of `/robot/command`: vx, vy (m/s), yaw rate (rad/s), heading error (rad)."""
    message = Command(timestamp=BLANK_TIME, frame_id=HEADING)
    _blank(message, ("forward", "left", "yaw_rate", "heading_error"), 0)
    return Form.of_doubles(message, 4)


_RATES = 6  # numbers of a velocity and an angular velocity


class BodyForms:
    """The robot's own messages of control steps.

    Args:
        names: of the robot's bodies, trunk first.
        bodies: their numbers among the model's.
        in_model: how many bodies the model has.
        joints: names.
        cameras: poses in the body that carries them, (7,), by the name of the frame.
        carriers: places of these bodies in `names`, the trunk's for all if empty.
        props: numbers of bodies that are not the robot's, by the name of the frame.

    Attributes:
        forms: by topic, in the order of `numbers`.
        width: numbers in a row for `numbers`.
    """

    def __init__(
        self,
        *,
        names: tuple[str, ...],
        bodies: Sequence[int],
        in_model: int,
        joints: tuple[str, ...],
        cameras: Mapping[str, Array],
        carriers: Sequence[int] = (),
        props: Mapping[str, int] = MappingProxyType({}),
    ) -> None:
        self.forms: dict[str, Form] = {
            "/tf": transforms_form((*names, *cameras, *props)),
            "/robot/joints": joints_form(joints),
            "/robot/odom": odom_form(),
            "/robot/twist": _twist_form(names[0]),
        }
        self.width = 7 * in_model + 3 * len(joints) + _RATES
        self._bodies = list(bodies)
        self._props = list(props.values())
        self._joints = len(joints)
        self._mounts = tuple(cameras.values())
        self._carriers = tuple(carriers) or (0,) * len(self._mounts)

    def trunk(self, rows: Array) -> Array:
        """Return where the trunk is in the world, (N, 3) m, from rows as for `numbers`."""
        first = 3 * self._bodies[0]
        return rows[:, first : first + 3]

    def numbers(self, rows: Array) -> tuple[Array, ...]:
        """Return what is filled into each form, (N, ...).

        Args:
            rows: (N, 7 A + 3 J + 6) for the A bodies of the model: positions (m) of all, then
                quaternions wxyz; angles (rad), then velocities (rad/s) of the joints; velocity of
                the trunk in the world (m/s), angular in its own frame (rad/s); torques (N m).
        """
        count, joints = len(rows), self._joints
        places, angles, speeds, rates, torques = np.split(
            rows, np.cumsum((-3 * joints - _RATES, joints, joints, _RATES)), axis=1
        )
        everything = _poses(places)
        poses = everything[:, self._bodies]
        trunk = poses[:, 0]
        frames = [poses, self._on_bodies(poses)]
        if self._props:
            frames.append(everything[:, self._props])
        return (
            rounded(np.concatenate(frames, axis=1)),
            rounded(np.stack((angles, speeds, torques), axis=2)).reshape(count, -1),
            rounded(trunk),
            rounded(trunk_rates(trunk, rates)),
        )

    def _on_bodies(self, poses: Array) -> Array:
        """Return poses (N, M, 7) of the cameras, of those of the bodies, (N, B, 7)."""
        mounted = np.empty((len(poses), len(self._mounts), 7))
        for number, (mount, carrier) in enumerate(zip(self._mounts, self._carriers, strict=True)):
            mounted[:, number] = mounted_poses(poses[:, carrier], (mount,))[:, 0]
        return mounted


def rounded(numbers: NDArray[Any]) -> Array:
    """Return numbers of single precision instead of double ones.

    They are for viewing, the exact ones are in `/nw/state`; the zero bits that this leaves compress
    well.
    """
    return numbers.astype(np.float32).astype("<f8")


def mounted_poses(trunk: Array, mounts: Sequence[Array]) -> Array:
    """Return poses (N, M, 7) of what is mounted on the trunk, or on another body.

    Args:
        trunk: its poses, (N, 7): position, quaternion wxyz.
        mounts: poses in it, (7,) each.
    """
    poses = np.empty((len(trunk), len(mounts), 7))
    for number, mount in enumerate(mounts):
        poses[:, number, :3] = trunk[:, :3] + _turned(trunk[:, 3:], mount[:3])
        poses[:, number, 3:] = _product(trunk[:, 3:], mount[3:])
    return poses


def trunk_rates(trunk: Array, rates: Array) -> Array:
    """Return velocity and angular velocity in the trunk (N, 6).

    Args:
        trunk: its poses, (N, 7): position, quaternion wxyz.
        rates: velocity in the world, angular velocity in the trunk, (N, 6).
    """
    backwards = trunk[:, 3:] * (1.0, -1.0, -1.0, -1.0)
    return np.concatenate((_turned(backwards, rates[:, :3]), rates[:, 3:]), axis=1)


def _poses(places: Array) -> Array:
    """Return poses (N, A, 7) from all positions, then all quaternions, (N, 7 A)."""
    count, bodies = len(places), places.shape[1] // 7
    positions, quats = places[:, : 3 * bodies], places[:, 3 * bodies :]
    return np.concatenate(
        (positions.reshape(count, bodies, 3), quats.reshape(count, bodies, 4)), axis=2
    )


def _turned(quats: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors (3,) or (N, 3) turned by unit quaternions (N, 4)."""
    scalar, axis = quats[:, :1], quats[:, 1:]
    across = 2.0 * _cross(axis, vectors)
    return vectors + scalar * across + _cross(axis, across)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross products of (N, 3) with (3,) or (N, 3): `np.cross` takes longer."""
    product = np.empty_like(a)
    for to, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        product[:, to] = a[:, i] * b[..., j] - a[:, j] * b[..., i]
    return product


def _product(quats: NDArray[np.float64], quat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions (N, 4), each times one (4,)."""
    w, x, y, z = quats.T
    a, b, c, d = quat
    return np.stack(
        (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ),
        axis=1,
    )


def _blank(message: Any, fields: Sequence[str], first: int) -> None:
    for number, field in enumerate(fields, start=first):
        setattr(message, field, blank_double(number))


def policy_steps(
    times: Sequence[int],
    steps: Sequence[int],
    *,
    observations: Sequence[bytes],
    states: Sequence[bytes],
    numbers: NDArray[np.float64],
) -> Iterator[bytes]:
    """Yield messages, N.

    Args:
        times: of the calls, ns.
        steps: numbers of their control steps.
        observations: digests of what the policy was given.
        states: digests of what it remembers; empty where the log has no state.
        numbers: raw output, applied action and joint targets, (N, 3 J).
    """
    fields = _number_fields(numbers)
    each = zip(times, steps, observations, states, fields, strict=True)
    for time_ns, step, observation, state, values in each:
        parts = _call_head(time_ns, step), _field(_OBSERVATION, observation), values
        yield b"".join((*parts, _field(_STATE, state)) if state else parts)


@lru_cache(maxsize=4096)  # The steps of every trial have the same times.
def _call_head(time_ns: int, step: int) -> bytes:
    return time_field(time_ns) + (_STEP + varint(step) if step else b"")


def _field(field: bytes, digest: bytes) -> bytes:
    return field + sized(digest) if digest else b""


def _number_fields(rows: NDArray[np.float64]) -> list[bytes]:
    """Return the three fields of numbers, (N, 3 J), of each row."""
    count = len(rows)
    little = rows.astype("<f8", copy=False)
    values = np.frombuffer(little.tobytes(), np.uint8).reshape(count, 3, -1)
    size = values.shape[2]
    if not size:
        return [b""] * count
    heads = [field + varint(size) for field in _NUMBERS]
    fields = np.empty((count, 3, len(heads[0]) + size), np.uint8)
    fields[:, :, :-size] = np.frombuffer(b"".join(heads), np.uint8).reshape(3, -1)
    fields[:, :, -size:] = values
    return [row.tobytes() for row in fields]
