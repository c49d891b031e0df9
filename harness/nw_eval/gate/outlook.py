"""What other runs would have shown: of a worse policy, and of this one after more trials."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from nw_eval.gate.verdict import SceneScore
from nw_eval.results.row import Row
from nw_eval.stats import Groups, SceneCounts, shares_after, shares_at, trials_to_certify
from nw_eval.suite.model import Gate


def courses(
    groups: Mapping[str, Sequence[Row]],
    scores: Sequence[SceneScore],
    left: Collection[str] = (),
) -> list[SceneCounts]:
    """Return what was seen in each scene that counts, as waypoints reached.

    Args:
        groups: rows of each scene.
        scores: of the scenes.
        left: trials that left the captured volume, of which nothing is known.
    """
    found: list[SceneCounts] = []
    for item in scores:
        rows = [
            row
            for row in groups[item.scene]
            if row.success is not None and row.trial_id not in left
        ]
        if item.tier != "informational" and rows:
            reached = [row.waypoints_reached for row in rows]
            waypoints = [row.waypoints_total for row in rows]
            found.append(SceneCounts.of(reached, waypoints, alone=item.tier == "critical"))
    return found


def chance_to_pass(seen: list[SceneCounts], gate: Gate, success: float) -> float | None:
    """Return how often runs like this one pass a policy of that true success; None if never asked.

    That is so without a bar, without trials, or with a success that no policy has.
    """
    if gate.success_rate is None or not seen or not 0.0 < success < 1.0:
        return None
    return shares_at(seen, success, bar=gate.success_rate, confidence=gate.confidence).passed


def advice(groups: Groups, seen: list[SceneCounts], gate: Gate, bar: float) -> str:
    """Return in words what more trials may bring to a run that was not decided."""
    n = sum(len(values) for values in groups)
    enough = trials_to_certify(bar, gate.confidence)
    if n < enough:
        return f"{n} trials cannot reach this bar even if all are perfect: run at least {enough}"
    longest = max(len(values) for values in groups)
    twice, four_times = (
        percent(shares.passed + shares.regressed)
        for shares in (
            shares_after(seen, times, bar=bar, confidence=gate.confidence) for times in (2, 4)
        )
    )
    return (
        f"chance that {2 * longest} trials in each scene (now {longest}) decide: {twice}, that "
        f"{4 * longest} do: {four_times}; --resume with more --trials adds them"
    )


def percent(share: float) -> str:
    """Return a simulated share as words that claim no more than a simulation can."""
    if share < 0.01:
        return "under 1 %"
    return "over 99 %" if share > 0.99 else f"{100 * share:.0f} %"
