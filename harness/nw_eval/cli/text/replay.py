"""What a replay came to, in one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.plural import plural

if TYPE_CHECKING:
    from nw_eval.rollout.replaying.report import Difference, ReplayReport

_LONGEST = 2000
"""Characters: most words are the log's."""


def replay_line(replay: ReplayReport) -> str:
    """Return how a replay ended, or what of it is not as it was recorded."""
    start = "" if replay.start_step == 0 else f" from step {replay.start_step}"
    return clean(f"{replay.trial}{start}: {_end(replay)}", at_most=_LONGEST)


def _end(replay: ReplayReport) -> str:
    if replay.is_identical:
        return f"{replay.end} after {plural(replay.steps, 'step')}, identical bit for bit"
    differences = "; ".join(
        f"{each.name} was {_short(each, each.recorded)}, now {_short(each, each.now)}"
        for each in replay.differences
    )
    versions = ", ".join(
        f"{each.name} {each.recorded or 'unknown'}, not {each.now or 'none'}"
        for each in replay.versions
    )
    return f"{differences} (recorded with {versions})" if versions else differences


def _short(difference: Difference, value: str) -> str:
    text = value or "none"
    return text[:12] if difference.name.endswith("_digest") else clean(text, at_most=100)
