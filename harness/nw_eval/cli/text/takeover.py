"""What a take-over came to, in a few lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.cards.model import CONTROL_RATE
from nw_eval.clean import clean

if TYPE_CHECKING:
    from nw_eval.rollout.replaying.takeover.report import Ending, TakeoverReport

_STEP = 1.0 / CONTROL_RATE  # s


def takeover_page(taken: TakeoverReport) -> str:
    """Return how a trial ended under its own policy, and how it does under the other one."""
    was, now = taken.was, taken.now
    head = f"{taken.trial}: {now.policy} takes over from {was.policy} at {taken.step * _STEP:.2f} s"
    lines = [clean(head), f"  was  {_ending(was)}", f"  now  {_ending(now)}"]
    if taken.is_identical:
        lines.append("  the same, bit for bit")
    return "\n".join(lines)


def _ending(ending: Ending) -> str:
    """Return how, when and where."""
    how = clean(f"{ending.end} ({ending.reason})" if ending.reason else ending.end, at_most=300)
    when = f"at {ending.steps * _STEP:.2f} s, {clean(ending.waypoints)} waypoints"
    if ending.position is None:
        return f"{how} {when}"
    x, y, z = ending.position
    return f"{how} {when}, at x {x:.2f}, y {y:.2f}, z {z:.2f} m"
