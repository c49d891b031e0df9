"""What is noted of control steps until it is written, hundreds of them at a time.

Ten messages in each control step cost more to make than a step of physics. Here a step costs one
`append` when it happens; the bytes are made later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_eval.rollout.mcap.batch import Batch, Channels, Integers, filled, merged, records
from nw_eval.rollout.mcap.content.body import BodyForms, command_form, rounded
from nw_eval.rollout.mcap.content.policy_step import policy_steps
from nw_eval.rollout.mcap.content.seen import SeenRows
from nw_eval.rollout.mcap.form import Form
from nw_eval.rollout.mcap.messages import PolicyStep

Array = NDArray[np.float64]


class Call(NamedTuple):
    """What is noted of one call of the policy."""

    step: int
    """Number of the control step."""
    state_digest: bytes
    """Of what it remembers; empty where the log has no state."""
    heading_error: float | None
    """To the next waypoint, rad to the left; None where nothing was observed."""
    digest: bytes
    """Of what it was given, and the bytes of the rows in it: see `SeenRows.note`."""
    data: bytes
    new: tuple[bool, ...]
    """Which of those rows are new; empty where nothing was observed."""


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
        self._actions = 3 * joints
        self._seen = seen
        self._command = command
        self._notes: list[tuple[int, Array, Call | None]] = []

    def note(self, time_ns: int, row: Array, call: Call | None = None) -> None:
        """Keep what the messages of one step need: nothing that changes afterwards.

        Args:
            time_ns: simulated.
            row: for `BodyForms.numbers`; behind it, where the policy was called, its raw output,
                the applied action and the joint targets, (J) each.
            call: of the policy, if it was called.
        """
        self._notes.append((time_ns, row, call))

    def take(self, channels: Channels) -> Batch:
        """Return the messages of all notes so far, a piece for each, and forget them."""
        notes, self._notes = self._notes, []
        parts: list[tuple[Sequence[int], Batch]] = []
        called = [number for number, (_, _, call) in enumerate(notes) if call is not None]
        if called:
            calls = [call for _, _, call in notes if call is not None]
            times = np.array([notes[number][0] for number in called])
            rows = _stacked([notes[number][1] for number in called])
            parts.append((called, self._bodies(times, rows[:, : -self._actions], channels)))
            actions = rows[:, -self._actions :]
            parts.append((called, self._policy(times, calls, actions, channels)))
            for which, batch in self._given(times, calls, channels):
                parts.append(([called[number] for number in which], batch))
        for number, (time_ns, row, call) in enumerate(notes):
            if call is None:
                batch = self._bodies(np.array([time_ns]), row[np.newaxis], channels)
                parts.append(([number], batch))
        return merged(len(notes), parts)

    def _bodies(self, times: Integers, rows: Array, channels: Channels) -> Batch:
        return _filled(channels, self._body.forms, times, self._body.numbers(rows))

    def _policy(
        self, times: Integers, calls: Sequence[Call], actions: Array, channels: Channels
    ) -> Batch:
        missing = [call.data for call in calls if not call.digest]
        digests = iter(self._seen.digests(missing) if missing else ())
        at = times.tolist()
        messages = policy_steps(
            at,
            [call.step for call in calls],
            observations=[call.digest or next(digests) for call in calls],
            states=[call.state_digest for call in calls],
            numbers=actions,
        )
        return records([channels("/nw/policy", PolicyStep)] * len(at), at, messages)

    def _given(
        self, times: Integers, calls: Sequence[Call], channels: Channels
    ) -> Iterator[tuple[list[int], Batch]]:
        """Yield commands and observations, those together that came together: which, and what."""
        groups: dict[tuple[bool, ...], list[int]] = {}
        for number, call in enumerate(calls):
            if call.heading_error is not None:
                groups.setdefault(call.new, []).append(number)
        for new, which in groups.items():
            of_group = [calls[number] for number in which]
            errors = [call.heading_error or 0.0 for call in of_group]
            asked = np.array([(*self._command(error), error) for error in errors])
            forms, numbers = self._seen.numbers(new, [call.data for call in of_group])
            yield (
                which,
                _filled(
                    channels,
                    {"/robot/command": command_form(), **forms},
                    times[which],
                    (rounded(asked), *numbers),
                ),
            )


def _filled(
    channels: Channels, forms: Mapping[str, Form], times: Integers, numbers: Sequence[NDArray[Any]]
) -> Batch:
    numbered = [channels(topic, form.kind) for topic, form in forms.items()]
    return filled(numbered, tuple(forms.values()), times, numbers)


def _stacked(rows: Sequence[Array]) -> Array:
    """Return vectors of one length as rows; faster than `np.array`."""
    return np.concatenate(rows).reshape(len(rows), -1)
