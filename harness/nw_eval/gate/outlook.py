"""What other runs would have shown: of a worse policy, and of this one after more trials."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from math import ceil

from nw_eval.gate.verdict import SceneScore
from nw_eval.plural import plural
from nw_eval.results.row import Row
from nw_eval.stats import Groups, SceneCounts, shares_after, trials_to_certify
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


def advice(
    groups: Groups, seen: list[SceneCounts], gate: Gate, bar: float, *, cells: int = 1
) -> str:
    """Return in words what more trials may bring to a run that was not decided.

    Args:
        groups: success of the trials of each scene that counts.
        seen: the same as waypoints reached.
        gate: its confidence.
        bar: what the lower bound must reach.
        cells: of perturbations, in each of which a scene has its trials.
    """
    n, strata = sum(len(values) for values in groups), len(seen) * cells
    if n < trials_to_certify(bar, gate.confidence):
        needed = trials_to_pass(gate, strata)
        return (
            f"{plural(n, 'trial')} cannot reach this bar even if all are perfect: run "
            f"{plural(needed, 'trial')} in each scene at least (--trials {needed})"
        )
    twice, four_times = (
        percent(shares.passed + shares.regressed)
        for shares in (
            shares_after(seen, times, bar=bar, confidence=gate.confidence) for times in (2, 4)
        )
    )
    # Trials that were drawn are not as many in each scene.
    each, rest = divmod(n, len(seen))
    now, where = (n, "") if rest else (each, " in each scene")
    return (
        f"{2 * now} trials{where} (now {now}) decide the bar with {twice} probability, "
        f"{4 * now} with {four_times}; --resume with more --trials adds them"
    )


def trials_to_pass(gate: Gate, strata: int) -> int:
    """Return how many trials of each scene a bar needs of a policy that never fails.

    Args:
        gate: of a suite; 0 is returned where it has no bar.
        strata: scenes that count, each as often as it has cells of perturbations; at least 1.
    """
    if gate.success_rate is None:
        return 0
    return ceil(trials_to_certify(gate.success_rate, gate.confidence) / strata)


def percent(share: float) -> str:
    """Return a simulated share as words that claim no more than a simulation can."""
    if share < 0.01:
        return "< 1 %"
    return "> 99 %" if share > 0.99 else f"{100 * share:.0f} %"
