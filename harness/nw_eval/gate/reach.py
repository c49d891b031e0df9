"""Whether a gate can pass at all, asked before anything runs: by a policy that never fails."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from nw_eval.gate.baseline.finding import margins_of
from nw_eval.gate.baseline.rounds import scores_of
from nw_eval.gate.outlook import trials_to_pass
from nw_eval.plural import plural
from nw_eval.results.bank import Panel, Stratum
from nw_eval.stats.bank import Bank, over_rounds
from nw_eval.suite.model import Gate


def rounds_to_pass(
    gate: Gate, panel: Panel, order: Mapping[Stratum, Sequence[int]], *, fresh: bool
) -> int | None:
    """Return after how many rounds a policy that never fails passes against a bank.

    Args:
        gate: its margins, errors and tiers.
        panel: of the bank.
        order: the starts of each scene (and cell) in the order in which they would be met.
        fresh: whether these are others than the bank's.

    Returns:
        None if it does not within all that `order` has.
    """
    judged = [stratum for stratum in order if gate.tier(stratum[0]) != "informational"]
    scores = [scores_of(panel, stratum) for stratum in judged]
    means = np.array([each.mean() for each in scores])
    count = min(len(order[stratum]) for stratum in judged)
    met = [
        np.full(count, each.mean()) if fresh else each[np.array(order[stratum][:count])]
        for stratum, each in zip(judged, scores, strict=True)
    ]
    bank = Bank(means=means) if fresh else Bank(means=means, starts=len(scores[0]))
    known = np.array(met).T
    values = over_rounds(bank, np.ones_like(known), known, margins_of(gate))
    threshold = 1.0 / (1.0 - gate.confidence)
    return next((r for r, found in enumerate(values, 1) if found.passed >= threshold), None)


def bar_obstacles(
    gate: Gate,
    scenes: Sequence[str],
    left_out: Collection[str],
    *,
    trials: int,
    cells: int = 1,
    rounds: bool = False,
) -> list[str]:
    """Return why no policy can reach PASS by the bar of a suite, a sentence for each reason.

    Args:
        gate: of the suite; without a bar the verdict is RAN.
        scenes: that are to be run, by name.
        left_out: scenes of the suite that are not, by name.
        trials: of each scene in each cell.
        cells: of perturbations.
        rounds: whether trials are rounds against a baseline.
    """
    reasons = [
        f"critical scene {scene} is left out, and the suite cannot pass without it"
        for scene in sorted(left_out)
        if gate.tier(scene) == "critical"
    ]
    counted = sum(gate.tier(scene) != "informational" for scene in scenes)
    if not counted:
        return [*reasons, "no scene counts: all are informational; make one supporting or critical"]
    needed = trials_to_pass(gate, counted * cells)
    if needed > trials:
        key = "gate.rounds" if rounds else "trials"
        where = f"of {plural(counted, 'scene')}"
        where += f" at each of {plural(cells, 'perturbation')}" if cells > 1 else ""
        reasons.append(
            f"{plural(trials, 'trial')} {where} cannot reach the bar {gate.success_rate:g} even if "
            f"all are perfect: --trials {needed} (`{key}: {needed}`) is the least that can"
        )
    return reasons
