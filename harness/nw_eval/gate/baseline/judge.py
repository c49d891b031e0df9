"""Whether the candidate is worse than the baseline: a run's rows and a bank in, a comparison out.

The candidate's rows become trials in the order of the draw (`met`), these become evidence and a
word (`finding`), and what that may claim depends on what the bank is to the run (`basis`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nw_eval.errors import IncomparableError
from nw_eval.gate.baseline.comparison import Basis, Claim, Comparison, SceneDrop
from nw_eval.gate.baseline.draw import drawn_order
from nw_eval.gate.baseline.finding import Finding, find, margins_of
from nw_eval.gate.baseline.further import foresight
from nw_eval.gate.baseline.holding.basis import basis_of, claim_of
from nw_eval.gate.baseline.holding.known import recheck
from nw_eval.gate.baseline.holding.match import check_match
from nw_eval.gate.baseline.met import Met, budget_of, by_place, scores_of
from nw_eval.gate.baseline.parting import ends, waypoints
from nw_eval.gate.baseline.reasons import in_words
from nw_eval.gate.validity import over_the_cap, that_left
from nw_eval.results.bank import Panel, SavedBank, Stratum, score
from nw_eval.results.bank.against import Against
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.stats.bank import most_false_alarms
from nw_eval.suite.model import Gate
from nw_eval.suite.trials import DrawnStart

_FURTHER = 4
"""How many times its budget of trials a run that is undecided might have, for what more bring."""


@dataclass(frozen=True, kw_only=True)
class ComparisonSetup:
    """A run against a bank that holds for it, before anything of its trials is looked at."""

    run: RunInfo
    against: Against
    gate: Gate
    basis: Basis
    claim: Claim
    panel: Panel
    """Of the baseline, in the scenes of the run."""
    strata: tuple[Stratum, ...]
    judged: tuple[Stratum, ...]
    """Those that count."""
    order: Sequence[DrawnStart]
    left_aside: int
    """Scenes of the bank that the run was not asked for."""

    @property
    def bank(self) -> SavedBank:
        """The bank."""
        return self.against.bank

    def met(self, rows: Sequence[Row], *, further: bool = False) -> Met:
        """Return the trials of the budget, with those rows that there are.

        Args:
            rows: of the candidate.
            further: also trials beyond the budget, as far as `--trials` could go on to.

        Raises:
            StoreError: a row is not of this run, or appears twice.
        """
        order = self.order
        if further and not self.run.is_recheck:
            rounds = budget_of(self.run)
            most = max(rounds, min(_FURTHER * rounds, self.bank.manifest.starts))
            order = drawn_order(self.run, self.strata, most)
        control, left = None, frozenset[str]()
        if self.basis == "control" and self.against.control is not None:
            beside = self.against.control
            control = by_place(beside.rows, beside.run, order, "baseline")
            left = that_left(beside.rows, self.gate)
        elif self.basis == "control":
            control = [None] * len(order)
        return Met(
            order=order,
            rows=by_place(rows, self.run, order),
            control=control,
            left=that_left(rows, self.gate),
            control_left=left,
        )

    def find(self, met: Met, *, alone: bool = False) -> Finding:
        """Return what trials show: `finding.find`."""
        return find(
            met, self.judged, self.panel, self.basis, self.gate, claim=self.claim, alone=alone
        )


def setup_of(run: RunInfo, against: Against, gate: Gate) -> ComparisonSetup:
    """Return a run against a bank.

    Args:
        run: the candidate's. What it says of the bank (`BaselineInfo.checked`) counts.
        against: the bank.
        gate: margins, errors and tiers.

    Raises:
        IncomparableError: the bank does not hold for the run, or has too few starts for its trials;
            or nobody has checked it on this class of machine; or no scene of it counts.
    """
    bank = against.bank
    check_match(run, bank)
    known = run.baseline
    is_begun = known is not None and known.sha256 == against.info.sha256
    basis, panel = basis_of(run, bank, known.checked if known is not None and is_begun else None)
    left_aside = {start.scene for start in panel.starts} - set(run.scenes)
    panel = replace(panel, starts=tuple(x for x in panel.starts if x.scene in run.scenes))
    strata = tuple(panel.by_stratum)
    judged = tuple(stratum for stratum in strata if gate.tier(stratum[0]) != "informational")
    if not judged:
        raise IncomparableError(
            "no scene counts against the baseline: all are informational",
            fix="make one supporting or critical",
        )
    rounds = budget_of(run)
    return ComparisonSetup(
        run=run,
        against=against,
        gate=gate,
        basis=basis,
        claim=claim_of(run, bank, basis, rounds, gate),
        panel=panel,
        strata=strata,
        judged=judged,
        order=drawn_order(run, strata, rounds),
        left_aside=len(left_aside),
    )


def compare(
    rows: Sequence[Row], run: RunInfo, against: Against, gate: Gate, *, foresee: bool = False
) -> Comparison:
    """Compare the trials that a run has so far with a bank.

    Args:
        rows: of the candidate, in any order.
        run: what they are of.
        against: the bank of the baseline, with the control's rows if one ran.
        gate: margins, errors and tiers.
        foresee: also find intervals, and simulate what this gate would show of other policies, and
            of this one after more trials: for a report, and too slow to be asked after each trial.

    Raises:
        IncomparableError: as `setup_of`, or the gate could never convict.
        StoreError: a row is not of this run, or appears twice.
    """
    setup = setup_of(run, against, gate)
    met = setup.met(rows)
    finding = setup.find(met, alone=foresee)
    basis, panel, strata = setup.basis, setup.panel, setup.strata
    used = frozenset(finding.used) | {
        place for place in range(finding.first) if met.order[place][0] not in _scenes(setup)
    }
    parting = waypoints(finding.worst, met, used, panel)
    scenes = [
        _scene(stratum, met, used, panel, gate, finding, parting.get(stratum)) for stratum in strata
    ]
    margins = margins_of(gate)
    meets_starts = basis == "same" and run.panel == "pinned"
    capped = over_the_cap(rows, met.left, gate)
    critical = sum(gate.tier(scene) == "critical" for scene, _ in setup.judged)
    alpha_pass = 1.0 - gate.confidence
    comparison = Comparison(
        word="INCONCLUSIVE" if capped else finding.word,
        bank=setup.bank.manifest.name,
        policy=setup.bank.manifest.policy.name,
        basis=basis,
        claim=setup.claim,
        trials=len(finding.used),
        budget=len(met.places(setup.judged)),
        starts=setup.bank.manifest.starts,
        baseline=_level(finding, panel, setup.judged),
        drop=finding.drop,
        interval=finding.interval,
        mean_convicts=finding.mean_convicts,
        false_alarm=most_false_alarms(
            bar=None if gate.success_rate is None else alpha_pass,
            bar_critical=critical > 0,
            baseline=gate.false_alarm,
            critical=critical,
            scenes=len(setup.judged),
        ),
        max_drop=margins.max_drop,
        tolerate=margins.tolerate,
        scene_drop=margins.scene_drop,
        alpha_pass=alpha_pass,
        alpha_regr=gate.false_alarm,
        scenes=tuple(scenes),
        reasons=(),
        left_aside=setup.left_aside,
        control=0 if met.control is None else sum(row is not None for row in met.control),
        again=recheck(rows, run, setup.bank) if meets_starts else None,
    )
    simulated = None
    if foresee and basis != "same":
        simulated = foresight(comparison, setup.met(rows, further=True), setup.judged, panel, gate)
    more = None if capped else simulated and simulated.more
    reasons = in_words(comparison, finding)
    return replace(
        comparison,
        reasons=(capped, *reasons) if capped else reasons,
        more=more,
        curve=simulated.curve if simulated else None,
    )


def _scenes(setup: ComparisonSetup) -> set[str]:
    return {scene for scene, _ in setup.judged}


def _scene(
    stratum: Stratum,
    met: Met,
    used: Collection[int],
    panel: Panel,
    gate: Gate,
    finding: Finding,
    waypoint: int | None,
) -> SceneDrop:
    scores = met.scores(stratum, used)
    known = scores[~np.isnan(scores)]
    if met.control is None:
        baseline = float(scores_of(panel, stratum).mean())
    else:
        beside = [score(row) or 0.0 for row in met.beside(stratum, used)]
        baseline = float(np.mean(beside)) if beside else None
    return SceneDrop(
        scene=stratum[0],
        perturbation=stratum[1],
        tier=gate.tier(stratum[0]),
        baseline=baseline,
        candidate=float(known.mean()) if known.size else None,
        trials=known.size,
        evidence=finding.evidence.get(stratum, 1.0),
        named=stratum in finding.named,
        interval=finding.alone.get(stratum),
        waypoint=waypoint,
        ends=ends(stratum, met, used, panel),
    )


def _level(finding: Finding, panel: Panel, judged: Sequence[Stratum]) -> float:
    """Return the baseline's mean success: the control's, where one was compared with."""
    if finding.control is not None:
        return finding.control
    return float(np.mean([scores_of(panel, stratum).mean() for stratum in judged]))
