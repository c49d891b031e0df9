"""What the trials of a run say of its drop, scene by scene and together, before it is worded.

The scenes of `stats.bank` are strata here: a scene, and what was changed there. Those that are
informational are not in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from nw_eval.errors import IncomparableError
from nw_eval.gate.baseline.comparison import Basis, Claim
from nw_eval.gate.baseline.met import Met, scores_of
from nw_eval.results.bank import Panel, Stratum
from nw_eval.stats import Interval
from nw_eval.stats.bank import (
    SUSPECT,
    Bank,
    DrawnTrials,
    Margins,
    TrialRules,
    drop_interval_after,
    looks,
    scene_drop_intervals,
    settle,
)
from nw_eval.suite.model import Gate

_WORST = 3
"""Scenes of which it is said where the candidate fails, though none regressed significantly."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What is settled, and by what. Places are those of the run's drawn order."""

    word: Literal["PASS", "REGRESSED", "INCONCLUSIVE"]
    first: int
    """All places below it bear on the mean: up to the trial that settled it, or those so far."""
    followed: tuple[int, ...] = ()
    """Later places that were judged for their scenes alone."""
    ahead: tuple[int, ...] = ()
    """Places that come next, as `TrialRuling.ahead`; those of strata that count."""
    used: tuple[int, ...] = ()
    """Places of trials of strata that count which were judged, in order."""
    evidence: Mapping[Stratum, float] = field(default_factory=dict)
    """E_s of each that counts."""
    named: tuple[Stratum, ...] = ()
    """Those that regressed significantly."""
    waits_for: tuple[Stratum, ...] = ()
    """Those that alone hold back a PASS."""
    mean_convicts: bool = False
    """Whether the mean itself regressed significantly."""
    drop: float | None = None
    """Estimate of the drop; None without a trial."""
    control: float | None = None
    """Mean success of the control in the pairs that `drop` is of; None without a control."""
    interval: Interval | None = None
    """Drops that are not ruled out; None where nothing was tested."""
    alone: Mapping[Stratum, Interval] = field(default_factory=dict)
    """Drops in each stratum that its own trials do not rule out, if they were asked for."""

    @property
    def worst(self) -> tuple[Stratum, ...]:
        """Those that regressed or may have, and of a policy that was convicted some of the rest."""
        ranked = sorted(self.evidence, key=lambda stratum: (-self.evidence[stratum], stratum))
        least = _WORST if self.word == "REGRESSED" else 0
        return tuple(
            stratum
            for rank, stratum in enumerate(ranked)
            if rank < least or self.evidence[stratum] >= SUSPECT or stratum in self.named
        )


def margins_of(gate: Gate) -> Margins:
    """Return the drops that a gate allows."""
    return Margins(max_drop=gate.most_drop, tolerate=gate.tolerate, scene_drop=gate.scene_drop)


def rules_of(gate: Gate, judged: Sequence[Stratum]) -> TrialRules:
    """Return by what a gate decides about strata that count."""
    return TrialRules(
        tiers=tuple(gate.tier(scene) for scene, _ in judged),
        margins=margins_of(gate),
        alpha_pass=1.0 - gate.confidence,
        alpha_regr=gate.false_alarm,
    )


def bank_of(panel: Panel, judged: Sequence[Stratum], basis: Basis, claim: Claim) -> Bank:
    """Return what is known of the baseline before the first trial."""
    if basis == "control":
        return Bank.control(len(judged))
    bank = Bank.of(np.array([scores_of(panel, stratum) for stratum in judged]))
    return bank if claim == "panel" else bank.fresh()


def numbers_of(
    met: Met, judged: Sequence[Stratum], panel: Panel, basis: Basis, bank: Bank
) -> DrawnTrials:
    """Return the trials of strata that count as numbers, in order, shape (T,)."""
    if basis == "fresh":  # Nothing is known of these starts but the scene.
        return met.trials(judged, dict(zip(judged, bank.means.tolist(), strict=True)))
    return met.trials(judged, panel)


def check_level(panel: Panel, judged: Sequence[Stratum], gate: Gate) -> None:
    """Refuse a baseline that scores too little for a drop of max_drop.

    Raises:
        IncomparableError: nobody could drop by it, and all would pass.
    """
    mean = np.mean([scores_of(panel, stratum).mean() for stratum in judged])
    if not mean > gate.most_drop:
        raise IncomparableError(
            f"the baseline's mean success is {mean:.3f}: no policy can be worse by "
            f"max_drop {gate.most_drop:g}, so all would pass",
            fix="lower max_drop, or compare with a better policy",
        )


def find(
    met: Met,
    judged: Sequence[Stratum],
    panel: Panel,
    basis: Basis,
    gate: Gate,
    *,
    claim: Claim,
    alone: bool = False,
) -> Finding:
    """Return what the trials that have ended show.

    Args:
        met: trials of the candidate.
        judged: strata that count.
        panel: of the baseline.
        basis: what the panel is to the trials.
        gate: margins, errors and tiers.
        claim: of which starts it is to hold. Of fresh ones no draw leaves less for the rest.
        alone: whether to ask for intervals: they take longer than all else.

    Raises:
        IncomparableError: as `check_level`.
    """
    places = met.places(judged)
    ended = met.ended(places.tolist())
    if basis == "same":
        return Finding(
            word="PASS",
            first=len(met.order),
            used=tuple(places[ended].tolist()),
            evidence=dict.fromkeys(judged, 1.0),
        )
    check_level(panel, judged, gate)
    bank, rules = bank_of(panel, judged, basis, claim), rules_of(gate, judged)
    trials = numbers_of(met, judged, panel, basis, bank)
    ruling = settle(bank, trials, rules, ended)
    used = [*range(ruling.mean), *ruling.followed]
    seen = trials.at(used)
    evidence = dict.fromkeys(judged, 1.0)
    own = looks(bank, seen, rules.margins).own if used else np.empty(0)
    for which, value in zip(seen.scenes.tolist(), own.tolist(), strict=True):
        evidence[judged[which]] = value
    alphas = {"alpha_pass": rules.alpha_pass, "alpha_regr": rules.alpha_regr}
    mean = trials.at(range(ruling.mean))
    regressed = looks(bank, mean, rules.margins).regressed if ruling.mean else np.empty(0)
    return Finding(
        word="INCONCLUSIVE" if ruling.word == "undecided" else ruling.word,
        first=int(places[ruling.mean - 1]) + 1 if ruling.mean else 0,
        followed=tuple(places[list(ruling.followed)].tolist()) if ruling.followed else (),
        ahead=tuple(places[list(ruling.ahead)].tolist()) if ruling.ahead else (),
        used=tuple(places[used].tolist()) if used else (),
        evidence=evidence,
        named=tuple(judged[index] for index in ruling.named),
        waits_for=tuple(judged[index] for index in ruling.waits_for),
        mean_convicts=bool((regressed >= 1.0 / rules.alpha_regr).any()),
        drop=_drop(bank, mean),
        control=_control(mean) if bank.paired else None,
        interval=drop_interval_after(bank, mean, **alphas) if alone else None,
        alone=dict(zip(judged, scene_drop_intervals(bank, seen, **alphas), strict=True))
        if alone and used
        else {},
    )


def _drop(bank: Bank, trials: DrawnTrials) -> float | None:
    """Return the mean of how much less each trial scored than the baseline does in its scene.

    Beside a control it is of the pairs. The baseline's own result from the same start is left to
    the test: a reader can check this number from the table.
    """
    known = bank.means[trials.scenes] if not bank.paired else trials.baseline
    drops = (known - trials.candidate)[~np.isnan(known - trials.candidate)]
    return float(drops.mean()) if drops.size else None


def _control(trials: DrawnTrials) -> float | None:
    """Return the control's mean success in the pairs of which both trials have a result."""
    known = trials.baseline[~np.isnan(trials.baseline - trials.candidate)]
    return float(known.mean()) if known.size else None
