"""What is noted of control steps until it is written, hundreds of them at a time.

Ten messages in each control step cost more to make than a step of physics. Here a step costs one
`append` when it happens; the bytes are made later.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_eval.rollout.mcap.batch import Batch, Channels, Integers, filled, merged, records
from nw_eval.rollout.mcap.content.body import BodyForms, command_form, rounded
from nw_eval.rollout.mcap.content.policy_step import policy_steps
from nw_eval.rollout.mcap.content.seen import Given, SeenRow, rows_of_bytes
from nw_eval.rollout.mcap.form import Form
from nw_eval.rollout.mcap.messages import PolicyStep

Array = NDArray[np.float64]


class Call(NamedTuple):
    """What is noted of one call of the policy."""

    step: int
    """Number of the control step."""
    state_digest: bytes
    """Of what it remembers; empty where the log has no state."""
    numbers: Array
    """Raw output, applied action and joint targets, (3 J)."""
    command: tuple[float, ...]
    """vx, vy (m/s), yaw rate (rad/s), heading error (rad); empty where nothing was observed."""
    given: Given


class Steps:
    """Notes of control steps.

    Args:
        body: the robot's own messages.
        seen: the observations that are rows of numbers, by name.
    """

    def __init__(self, body: BodyForms, seen: Mapping[str, SeenRow]) -> None:
        self._body = body
        self._seen = seen
        self._times: list[int] = []
        self._rows: list[Array] = []
        self._calls: list[Call | None] = []

    def note(self, time_ns: int, row: Array, call: Call | None = None) -> None:
        """Keep what the messages of one step need: nothing that changes afterwards.

        Args:
            time_ns: simulated.
            row: for `BodyForms.numbers`.
            call: of the policy, if it was called.
        """
        self._times.append(time_ns)
        self._rows.append(row)
        self._calls.append(call)

    def take(self, channels: Channels) -> Batch:
        """Return the messages of all notes so far, a piece for each, and forget them."""
        times, rows, calls = np.array(self._times), self._rows, self._calls
        self._times, self._rows, self._calls = [], [], []
        numbers = self._body.numbers(_stacked(rows))
        parts = [(range(len(rows)), _filled(channels, self._body.forms, times, numbers))]
        made = [(number, call) for number, call in enumerate(calls) if call is not None]
        if made:
            called = np.array([number for number, _ in made])
            of_calls = [call for _, call in made]
            parts.append((called, _called(of_calls, times[called], channels)))
            for which, batch in self._observed(of_calls, times[called], channels):
                parts.append((called[which], batch))
        return merged(len(rows), parts)

    def _observed(
        self, calls: Sequence[Call], times: Integers, channels: Channels
    ) -> Iterator[tuple[list[int], Batch]]:
        """Yield commands and observations, those together that came together: which, and what."""
        groups: dict[tuple[bool, tuple[str, ...]], list[int]] = {}
        for number, call in enumerate(calls):
            groups.setdefault((bool(call.command), call.given.new), []).append(number)
        for (has_command, new), which in groups.items():
            forms: dict[str, Form] = {}
            numbers: list[NDArray[Any]] = []
            if has_command:
                forms["/robot/command"] = command_form()
                numbers.append(rounded(np.array([calls[number].command for number in which])))
            for name in new:
                forms[self._seen[name].topic] = self._seen[name].form
                data = [calls[number].given.data for number in which]
                numbers.append(calls[which[0]].given.layout.values(name, rows_of_bytes(data)))
            if forms:
                yield which, _filled(channels, forms, times[which], numbers)


def _called(calls: Sequence[Call], times: Integers, channels: Channels) -> Batch:
    given = [call.given for call in calls]
    whole = [each for each in given if not each.digest]
    digests = iter(whole[0].layout.digests([each.data for each in whole]) if whole else ())
    messages = policy_steps(
        times.tolist(),
        [call.step for call in calls],
        observations=[each.digest or next(digests) for each in given],
        states=[call.state_digest for call in calls],
        numbers=_stacked([call.numbers for call in calls]),
    )
    channel = channels("/nw/policy", PolicyStep)
    return records([channel] * len(calls), times.tolist(), messages)


def _filled(
    channels: Channels, forms: Mapping[str, Form], times: Integers, numbers: Sequence[NDArray[Any]]
) -> Batch:
    numbered = [channels(topic, form.kind) for topic, form in forms.items()]
    return filled(numbered, tuple(forms.values()), times, numbers)


def _stacked(rows: Sequence[Array]) -> Array:
    """Return vectors of one length as rows; faster than `np.array`."""
    return np.concatenate(rows).reshape(len(rows), -1)
