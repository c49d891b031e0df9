"""Whether a gate can pass at all, asked before anything runs: by a policy that never fails."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from nw_eval.gate.baseline.finding import bank_of, numbers_of, rules_of
from nw_eval.gate.baseline.met import Met
from nw_eval.gate.outlook import trials_to_pass
from nw_eval.plural import plural
from nw_eval.results.bank import Panel
from nw_eval.stats.bank import settle
from nw_eval.suite.model import Gate
from nw_eval.suite.trials import DrawnStart


def trials_to_pass_baseline(
    gate: Gate, panel: Panel, order: Sequence[DrawnStart], *, fresh: bool
) -> int | None:
    """Return after how many trials a policy that never fails passes against a bank.

    Args:
        gate: its margins, errors and tiers.
        panel: of the bank.
        order: of trials, in which they would be met.
        fresh: whether these are of others than the bank's starts.

    Returns:
        None if it does not within all that `order` has.
    """
    strata = {(scene, cell) for scene, cell, _ in order}
    judged = sorted(place for place in strata if gate.tier(place[0]) != "informational")
    met = Met(order=order, rows=[None] * len(order))
    basis = "fresh" if fresh else "panel"
    bank = bank_of(panel, judged, basis, gate.claim if not fresh else "fresh")
    trials = numbers_of(met, judged, panel, basis, bank)
    perfect = replace(trials, candidate=np.ones(len(trials.scenes)))
    ruling = settle(bank, perfect, rules_of(gate, judged))
    return ruling.trials if ruling.word == "PASS" else None


def bar_obstacles(
    gate: Gate,
    scenes: Sequence[str],
    left_out: Collection[str],
    *,
    trials: int,
    cells: int = 1,
    against: bool = False,
) -> list[str]:
    """Return why no policy can reach PASS by the bar of a suite, a sentence for each reason.

    Args:
        gate: of the suite; without a bar the verdict is RAN.
        scenes: that are to be run, by name.
        left_out: scenes of the suite that are not, by name.
        trials: of each scene in each cell.
        cells: of perturbations.
        against: whether the run is compared with a baseline.
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
        key = "gate.rounds" if against else "trials"
        where = f"of {plural(counted, 'scene')}"
        where += f" at each of {plural(cells, 'perturbation')}" if cells > 1 else ""
        reasons.append(
            f"{plural(trials, 'trial')} {where} cannot reach the bar {gate.success_rate:g} even if "
            f"all are perfect: --trials {needed} (`{key}: {needed}`) is the least that can"
        )
    return reasons
