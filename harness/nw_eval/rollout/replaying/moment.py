"""A moment of a recorded trial, as its user names it: in seconds from the trial's beginning."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from nw_eval.cards.model import CONTROL_RATE
from nw_eval.errors import UsageError

if TYPE_CHECKING:
    from nw_eval.rollout.replaying.logged import LoggedTrial


def step_at(time: float) -> int:
    """Return the control step that begins at a time (s), or the last one that began before it."""
    # The hair makes 0.58 s the 29th step of 50 in a second, which it is not in floating point.
    return math.floor(time * CONTROL_RATE + 1e-6)


def check_start(start: float, *, option: str = "--start") -> None:
    """Refuse what is no time in a trial.

    Raises:
        UsageError: it is negative or no number.
    """
    if not 0.0 <= start < math.inf:
        raise UsageError(f"{option} {start:g}", fix="give seconds, at least 0")


def check_inside(start: float, logged: LoggedTrial, *, option: str = "--start") -> None:
    """Refuse a time that the trial did not reach: from its end on there is nothing to compare.

    Raises:
        UsageError: it is the trial's end, or later.
    """
    steps = logged.verdict.get("steps", "")  # a stranger's word
    if start > 0.0 and re.fullmatch(r"[0-9]{1,9}", steps):
        length = int(steps) / CONTROL_RATE
        if start >= length:
            raise UsageError(
                f"{option} {start:g}: {logged.path} ends at {length:g} s", fix="give less"
            )
