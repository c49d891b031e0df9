"""What the policy of a recorded trial decided, control step by control step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nw_eval.errors import StoreError
from nw_eval.rollout.episode import Decision

if TYPE_CHECKING:
    from collections.abc import Iterator

    from nw_eval.rollout.mcap.reader import LogReader

_POLICY = "/nw/policy"
_DIGEST = "state_digest"  # A part of every recorded state.


def decisions(log: LogReader, *, joints: int) -> Iterator[Decision]:
    """Yield what was answered and applied in the control steps 0, 1, 2, ... of a log.

    Logs hold it in double precision, so a world that is told the same moves in the same bits.

    Raises:
        StoreError: the log is damaged, or a step is missing.
    """
    for count, (_, _, message) in enumerate(log.messages(_POLICY)):
        numbers = [np.array(each) for each in (message.action, message.applied, message.targets)]
        if message.step != count or any(
            each.shape != (joints,) or not np.isfinite(each).all() for each in numbers
        ):
            raise StoreError(
                f"{log.path} does not say what was applied in control step {count}",
                fix="run the trial again",
            )
        action, applied, targets = numbers
        yield Decision(observation={}, action=action, applied=applied, targets=targets)


def recorded_digests(log: LogReader) -> dict[int, bytes]:
    """Return the digest of all states so far, by the control steps of which the log has a state.

    Raises:
        StoreError: the log is damaged.
    """
    return {
        state.step: part.data
        for state in log.states()
        for part in state.parts
        if part.name == _DIGEST
    }
