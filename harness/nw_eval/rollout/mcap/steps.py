"""What is noted of control steps until it is written, hundreds of them at a time.

Ten messages in each control step cost more to make than a step of physics. Here a step costs one
`append` when it happens; the bytes are made later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from numpy.typing import NDArray

from nw_eval.rollout.mcap.batch import Batch, Channels, Integers, Part, filled, records
from nw_eval.rollout.mcap.content.body import BodyForms, command_form, rounded
from nw_eval.rollout.mcap.content.clouds import path_cloud
from nw_eval.rollout.mcap.content.policy_step import policy_steps
from nw_eval.rollout.mcap.content.seen import SeenRows
from nw_eval.rollout.mcap.form import Form
from nw_eval.rollout.mcap.messages import PolicyStep
from nw_eval.rollout.mcap.stamps import nanoseconds

Array = NDArray[np.float64]


Path = Literal["none", "point", "shown"]
"""Whether the walked path has a point there, and is written."""


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


class Steps:
    """Notes of control steps.

    Args:
        body: the robot's own messages.
        joints: how many it has.
        seen: the observations that are rows of numbers.
        command: from a heading error, rad, to what is asked for: vx, vy (m/s), yaw rate (rad/s).
    """

    def __init__(
        self,
        body: BodyForms,
        *,
        joints: int,
        seen: SeenRows,
        command: Callable[[float], tuple[float, float, float]],
    ) -> None:
        self._body = body
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
            errors = [calls[number].heading_error or 0.0 for number in which]
            commands = np.array([(*self._command(error), error) for error in errors])
            forms, numbers = self._seen.numbers(new, [observed[number] for number in which])
            yield (
                which,
                _filled(
                    channels,
                    {"/robot/command": command_form(), **forms},
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
