"""Whether the candidate is worse than the baseline: a run's rows and a bank in, a comparison out.

The candidate's rows become rounds (`rounds`), these become evidence and a word (`finding`), and
what that may claim depends on what the bank is to the run (`basis`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nw_eval.errors import IncomparableError
from nw_eval.gate.baseline.comparison import Checked, Comparison, SceneDrop
from nw_eval.gate.baseline.finding import Finding, find, margins_of
from nw_eval.gate.baseline.further import foresight
from nw_eval.gate.baseline.holding.basis import basis_of, claim_of
from nw_eval.gate.baseline.holding.known import recheck
from nw_eval.gate.baseline.holding.match import check_match
from nw_eval.gate.baseline.parting import ends, waypoints
from nw_eval.gate.baseline.reasons import in_words
from nw_eval.gate.baseline.rounds import Rounds, budget_of, scores_of, whole_rounds
from nw_eval.gate.validity import over_the_cap, that_left
from nw_eval.results.bank import Panel, SavedBank, Stratum
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.suite.model import Gate


def compare(
    rows: Sequence[Row],
    run: RunInfo,
    bank: SavedBank,
    gate: Gate,
    *,
    checked: Checked | None = None,
    foresee: bool = False,
) -> Comparison:
    """Compare the whole rounds that a run has so far with a bank.

    Args:
        rows: of the candidate, in any order; those beyond the last whole round change nothing.
        run: what they are of.
        bank: of the baseline.
        gate: margins, errors and tiers.
        checked: what trials of the baseline have shown on this class of machine, where the bank
            has no panel of it.
        foresee: also simulate what this gate would show of other policies, and of this one after
            more rounds: for a report, and too slow to be asked after each round.

    Raises:
        IncomparableError: the bank does not hold for the run, has too few starts for its rounds, or
            could never convict; or nobody has checked it on this class of machine.
        StoreError: a row is not of this run, or appears twice.
    """
    check_match(run, bank)
    basis, panel = basis_of(run, bank, checked)
    left_aside = {start.scene for start in panel.starts} - set(run.scenes)
    panel = replace(panel, starts=tuple(x for x in panel.starts if x.scene in run.scenes))
    strata = list(panel.by_stratum)
    judged = [stratum for stratum in strata if gate.tier(stratum[0]) != "informational"]
    if not judged:
        raise IncomparableError(
            "no scene counts against the baseline: all are informational",
            fix="make one supporting or critical",
        )
    budget = budget_of(run)
    claim = claim_of(run, bank, basis, budget)
    left = that_left(rows, gate)
    rounds = whole_rounds(rows, run, strata, left=left)
    finding = find(rounds, judged, panel, basis, gate, claim=claim, alone=foresee)
    used = rounds.first(finding.rounds)
    parting = waypoints(finding.worst, used, panel)
    scenes = [
        _scene(stratum, used, panel, gate, finding, parting.get(stratum)) for stratum in strata
    ]
    margins = margins_of(gate)
    meets_starts = basis == "same" and run.panel == "pinned"
    capped = over_the_cap(rows, left, gate)
    comparison = Comparison(
        word="INCONCLUSIVE" if capped else finding.word,
        bank=bank.manifest.name,
        policy=bank.manifest.policy.name,
        basis=basis,
        claim=claim,
        rounds=used.count,
        budget=budget,
        starts=bank.manifest.starts,
        baseline=_mean([item.baseline for item in scenes if item.counts]),
        drop=_drop(scenes),
        interval=finding.interval,
        max_drop=margins.max_drop,
        tolerate=margins.tolerate,
        scene_drop=margins.scene_drop,
        alpha_pass=1.0 - gate.confidence,
        alpha_regr=gate.false_alarm,
        scenes=tuple(scenes),
        reasons=(),
        left_aside=len(left_aside),
        again=recheck(rows, run, bank, gate) if meets_starts else None,
    )
    simulated = None
    if foresee and basis != "same":
        simulated = foresight(comparison, finding, used, panel, run, gate)
    more = None if capped else simulated and simulated.more
    reasons = in_words(comparison, finding, rounds.left_out, more)
    return replace(
        comparison,
        reasons=(capped, *reasons) if capped else reasons,
        curve=simulated.curve if simulated else None,
    )


def _scene(
    stratum: Stratum,
    rounds: Rounds,
    panel: Panel,
    gate: Gate,
    finding: Finding,
    waypoint: int | None,
) -> SceneDrop:
    scores = rounds.scores([stratum])
    known = scores[~np.isnan(scores)]
    return SceneDrop(
        scene=stratum[0],
        perturbation=stratum[1],
        tier=gate.tier(stratum[0]),
        baseline=float(scores_of(panel, stratum).mean()),
        candidate=float(known.mean()) if known.size else None,
        trials=known.size,
        evidence=finding.evidence.get(stratum, 1.0),
        named=stratum in finding.named,
        interval=finding.alone.get(stratum),
        waypoint=waypoint,
        ends=ends(stratum, rounds, panel),
    )


def _drop(scenes: Sequence[SceneDrop]) -> float | None:
    """Return the mean over scenes of how much less the candidate scored; None before all have."""
    drops = [item.drop for item in scenes if item.counts]
    known = [drop for drop in drops if drop is not None]
    return _mean(known) if len(known) == len(drops) else None


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
