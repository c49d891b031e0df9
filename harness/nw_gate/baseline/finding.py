"""What the trials of a run say of its drop, scene by scene and together, before it is worded.

Rows become trials in the order of the draw: what the candidate scored, beside the baseline. The
scenes of `stats.baseline` are strata here: a scene, and what was changed there. Those that are
informational are not in it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import isnan, nan
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import IncomparableError, StoreError
from nw_base.trials import DrawnStart
from nw_base.words import Arm
from nw_gate.results.baseline import Panel, Start, Stratum, score
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.settings import Gate
from nw_gate.stats.baseline.baseline_bets import BaselineBets, make_bets
from nw_gate.stats.baseline.evidence import Margins, Reference
from nw_gate.stats.baseline.interval import drop_interval_after, scene_drop_intervals
from nw_gate.stats.baseline.trials import SUSPECT, DrawnTrials, TrialRules, looks, settle
from nw_gate.stats.interval import Interval
from nw_gate.verdict import Basis, Claim

Floats = NDArray[np.float64]
Places = NDArray[np.intp]
Counted = Callable[[Row | Start], float | None]


@dataclass(frozen=True, kw_only=True)
class Met:
    """All trials of a run's budget in their drawn order, with the rows of those that have ended."""

    order: Sequence[DrawnStart]
    rows: Sequence[Row | None]
    """By index; None has not ended."""
    control: Sequence[Row | None] | None = None
    """Of the baseline's policy from the same starts, where it runs beside the candidate."""
    left: frozenset[str] = frozenset()
    """Trials that left the captured volume (`gate.validity`): nothing is known of their starts."""
    control_left: frozenset[str] = frozenset()
    """Those of the control's. Each arm's trials have the same ids, and only one may have left."""
    counted: Counted = score
    """What of a trial is compared, 0 to 1, None without a result: success, or a scaled score."""

    def places(self, judged: Sequence[Stratum]) -> Places:
        """Return the positions of the trials of some strata, in order, shape (T,)."""
        which = set(judged)
        indices = [
            index for index, (*stratum, _) in enumerate(self.order) if tuple(stratum) in which
        ]
        return np.array(indices, dtype=np.intp)

    def ended(self, places: Iterable[int]) -> list[bool]:
        """Return whether each trial has ended, in both arms where there is a control."""
        return [
            self.rows[place] is not None
            and (self.control is None or self.control[place] is not None)
            for place in places
        ]

    def trials(
        self, judged: Sequence[Stratum], known: Panel | Mapping[Stratum, float]
    ) -> DrawnTrials:
        """Return the trials of some strata as numbers, shape (T,).

        A trial without a result, or that left the captured volume, is NaN; what the other arm did
        from the same start is not: the unknown side of a pair counts as whatever is worst beside
        what is known of the other, and a pair would promise less if both sides were unknown.

        Args:
            judged: the strata.
            known: the baseline's panel; or its mean success in each stratum, where the starts are
                others than the seed set's. A control, if there is one, comes before it.
        """
        places = self.places(judged).tolist()
        number = {stratum: index for index, stratum in enumerate(judged)}
        strata = [(self.order[place][0], self.order[place][1]) for place in places]
        if self.control is not None:
            baseline = [self._score_beside(place) for place in places]
        elif isinstance(known, Panel):
            panels = {stratum: scores_of(known, stratum, self.counted) for stratum in judged}
            baseline = [
                float(panels[stratum][self.order[place][2]])
                for stratum, place in zip(strata, places, strict=True)
            ]
        else:
            baseline = [known[stratum] for stratum in strata]
        return DrawnTrials(
            scenes=np.array([number[stratum] for stratum in strata], dtype=np.intp),
            candidate=np.array([self._score(self.rows[place]) for place in places]),
            baseline=np.array(baseline),
        )

    def scores(self, stratum: Stratum, places: Collection[int]) -> Floats:
        """Return c of the trials of a stratum among some positions, NaN without a result.

        Beside a control means are of whole pairs, as the drop is: if the starts from which the
        candidate left counted for the control alone, means would be of other starts on each side.
        """
        values = [
            self._score(self.rows[place]) if self._is_whole(place) else nan
            for place in sorted(places)
            if self.order[place][:2] == stratum
        ]
        return np.array(values, dtype=np.float64)

    def of(self, stratum: Stratum, places: Collection[int]) -> list[Row]:
        """Return the rows of a stratum among some positions that have a result which counts."""
        return self._whole(self.rows, stratum, places)

    def beside(self, stratum: Stratum, places: Collection[int]) -> list[Row]:
        """Return the control's rows of a stratum among some positions, of pairs that count."""
        return [] if self.control is None else self._whole(self.control, stratum, places)

    def _whole(
        self, rows: Sequence[Row | None], stratum: Stratum, places: Collection[int]
    ) -> list[Row]:
        wanted = (place for place in sorted(places) if self.order[place][:2] == stratum)
        return [row for place in wanted if self._is_whole(place) and (row := rows[place])]

    def _is_whole(self, index: int) -> bool:
        """Return whether a trial has a result that counts, and its control's has one, too."""
        known = not isnan(self._score(self.rows[index]))
        return known and (self.control is None or not isnan(self._score_beside(index)))

    def _score_beside(self, index: int) -> float:
        row = None if self.control is None else self.control[index]
        counted = None if row is None or row.trial_id in self.control_left else self.counted(row)
        return nan if counted is None else counted

    def _score(self, row: Row | None) -> float:
        counted = None if row is None or row.trial_id in self.left else self.counted(row)
        return nan if counted is None else counted


def scores_of(panel: Panel, stratum: Stratum, counted: Counted = score) -> Floats:
    """Return b of all starts of a stratum, shape (M,); `counted` as `Met.counted`."""
    return np.array([counted(start) for start in panel.by_stratum[stratum]], dtype=np.float64)


def budget_of(run: RunInfo) -> int:
    """Return how many trials of each scene in each of its cells a run was to have on average."""
    return int(run.suite["trials"])


def by_place(
    rows: Iterable[Row], run: RunInfo, order: Sequence[DrawnStart], arm: Arm = "candidate"
) -> list[Row | None]:
    """Return the rows of a run by the positions of their trials.

    Args:
        rows: in any order; those of strata that the order has none of, and of starts beyond the
            budget, are left out.
        run: what they are of.
        order: `match.drawn_order`.
        arm: whose rows they are.

    Raises:
        StoreError: a row is not of this run, or appears twice.
    """
    places = {start: place for place, start in enumerate(order)}
    by_index: list[Row | None] = [None] * len(order)
    whose = run.policy.checkpoint_digest
    for row in rows:
        if row.scene not in run.scenes:
            raise _foreign(row, f"the run has no {row.scene}")
        if row.checkpoint_digest != whose:
            raise _foreign(row, f"its checkpoint is {row.checkpoint_digest[:8]}, not {whose[:8]}")
        if row.arm != arm:
            raise _foreign(row, f"it is the {row.arm}'s")
        place = places.get((row.scene, row.perturbation, row.seed_index))
        if place is None:
            continue
        if by_index[place] is not None:
            raise StoreError(
                f"trial {row.trial_id} appears twice among the rows", fix="keep one row of a trial"
            )
        by_index[place] = row
    return by_index


def _foreign(row: Row, why: str) -> StoreError:
    return StoreError(
        f"the row of trial {row.trial_id} is not of this run: {why}", fix="start a new run"
    )


_WORST = 3
"""Scenes of which it is said where the candidate fails, though none regressed significantly."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What is settled, and by what. Places are those of the run's drawn order."""

    word: Literal["PASS", "REGRESSED", "INCONCLUSIVE"]
    first: int
    """All positions below it bear on the mean: up to the trial that settled it, or those so far."""
    followed: tuple[int, ...] = ()
    """Later positions that were judged for their scenes alone."""
    pending: tuple[int, ...] = ()
    """Positions that come next, as `TrialDecision.pending`; those of strata that count."""
    used: tuple[int, ...] = ()
    """Places of trials of strata that count which were judged, in order."""
    evidence: Mapping[Stratum, float] = field(default_factory=dict)
    """E_s of each that counts."""
    named: tuple[Stratum, ...] = ()
    """Those that regressed significantly."""
    waits_for: tuple[Stratum, ...] = ()
    """Those that alone hold back a PASS."""
    mean_regressed: bool = False
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
        """Those that regressed or may have, and of a policy that was flagged some of the rest."""
        ranked = sorted(self.evidence, key=lambda stratum: (-self.evidence[stratum], stratum))
        least = _WORST if self.word == "REGRESSED" else 0
        return tuple(
            stratum
            for rank, stratum in enumerate(ranked)
            if rank < least or self.evidence[stratum] >= SUSPECT or stratum in self.named
        )


def strata_that_count(strata: Iterable[Stratum], gate: Gate) -> tuple[Stratum, ...]:
    """Return those of some strata that a comparison is about, in their order.

    Raises:
        IncomparableError: none is.
    """
    judged = tuple(stratum for stratum in strata if gate.tier(stratum[0]) != "informational")
    if not judged:
        raise IncomparableError(
            "no scene counts against the baseline: all are informational",
            fix="make one supporting or critical",
        )
    return judged


def margins_of(gate: Gate) -> Margins:
    """Return the drops that a gate allows."""
    return Margins(max_drop=gate.most_drop, tolerate=gate.tolerate, scene_drop=gate.scene_drop)


def rules_of(gate: Gate, judged: Sequence[Stratum], *, by_rounds: bool = False) -> TrialRules:
    """Return by what a gate decides about strata that count; `by_rounds` as in `find`."""
    return TrialRules(
        look_every=len(judged) if by_rounds else 1,
        tiers=tuple(gate.tier(scene) for scene, _ in judged),
        margins=margins_of(gate),
        alpha_pass=1.0 - gate.confidence,
        alpha_regr=gate.false_alarm / gate.shared,
    )


def reference_of(
    panel: Panel,
    judged: Sequence[Stratum],
    basis: Basis,
    claim: Claim,
    counted: Counted = score,
    margins: Margins | None = None,
) -> Reference:
    """Return what is known of the baseline before the first trial.

    Args:
        panel: of the baseline.
        judged: strata that count.
        basis: what the baseline is to the trials.
        claim: of which starts it is to hold.
        counted: as `Met.counted`.
        margins: of success: bets are then made from the baseline for these.
    """
    if basis == "control":
        return Reference.control(len(judged))
    scores = np.array([scores_of(panel, stratum, counted) for stratum in judged])
    reference = Reference.of(scores)
    if margins is not None:
        waypoints = tuple(
            max(1, *(start.waypoints_total for start in panel.by_stratum[stratum]))
            for stratum in judged
        )
        bets = _bets(scores.tobytes(), waypoints, margins, by_start=basis != "fresh")
        reference = replace(reference, bets=bets)
    return reference if claim == "panel" else reference.fresh()


@lru_cache(maxsize=8)  # A gate asks after each trial, and they take 50 ms.
def _bets(
    scores: bytes, waypoints: tuple[int, ...], margins: Margins, *, by_start: bool
) -> BaselineBets:
    return make_bets(
        np.frombuffer(scores).reshape(len(waypoints), -1),
        np.array(waypoints),
        max_drop=margins.max_drop,
        tolerate=margins.tolerate,
        by_start=by_start,
    )


def numbers_of(
    met: Met, judged: Sequence[Stratum], panel: Panel, basis: Basis, reference: Reference
) -> DrawnTrials:
    """Return the trials of strata that count as numbers, in order, shape (T,)."""
    if basis == "fresh":  # Nothing is known of these starts but the scene.
        return met.trials(judged, dict(zip(judged, reference.means.tolist(), strict=True)))
    return met.trials(judged, panel)


def check_level(panel: Panel, judged: Sequence[Stratum], gate: Gate) -> None:
    """Refuse a baseline that scores too little for a drop of max_drop.

    Raises:
        IncomparableError: no policy could drop by it, and all would pass.
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
    by_rounds: bool = False,
    alone: bool = False,
) -> Finding:
    """Return what the trials that have ended show.

    Args:
        met: trials of the candidate.
        judged: strata that count.
        panel: of the baseline.
        basis: what the baseline is to the trials.
        gate: margins, errors and tiers.
        claim: of which starts it is to hold. Of fresh ones no draw leaves less for the rest.
        by_rounds: whether trials come round by round, one of each stratum.
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
    rules = rules_of(gate, judged, by_rounds=by_rounds)
    reference = reference_of(panel, judged, basis, claim, margins=rules.margins)
    trials = numbers_of(met, judged, panel, basis, reference)
    decision = settle(reference, trials, rules, ended)
    used = [*range(decision.mean), *decision.followed]
    seen = trials.at(used)
    evidence = dict.fromkeys(judged, 1.0)
    own = looks(reference, seen, rules.margins).own if used else np.empty(0)
    for which, value in zip(seen.scenes.tolist(), own.tolist(), strict=True):
        evidence[judged[which]] = value
    alphas = {"alpha_pass": rules.alpha_pass, "alpha_regr": rules.alpha_regr}
    # A round that has begun says nothing yet.
    mean = trials.at(range(decision.mean - decision.mean % rules.look_every))
    regressed = looks(reference, mean, rules.margins).regressed if len(mean.scenes) else np.empty(0)
    return Finding(
        word="INCONCLUSIVE" if decision.word == "undecided" else decision.word,
        first=int(places[decision.mean - 1]) + 1 if decision.mean else 0,
        followed=tuple(places[list(decision.followed)].tolist()) if decision.followed else (),
        pending=tuple(places[list(decision.pending)].tolist()) if decision.pending else (),
        used=tuple(places[used].tolist()) if used else (),
        evidence=evidence,
        named=tuple(judged[index] for index in decision.named),
        waits_for=tuple(judged[index] for index in decision.waits_for),
        # Within a round the order of scenes is fixed: E is looked at where `settle` looks at it.
        mean_regressed=bool(
            (regressed[rules.look_every - 1 :: rules.look_every] >= 1.0 / rules.alpha_regr).any()
        ),
        drop=_drop(reference, mean),
        control=_control(mean) if reference.paired else None,
        interval=drop_interval_after(
            reference, mean, alpha_pass=rules.alpha_pass, alpha_regr=rules.alpha_regr
        )
        if alone
        else None,
        alone=dict(zip(judged, scene_drop_intervals(reference, seen, **alphas), strict=True))
        if alone and used
        else {},
    )


def _drop(reference: Reference, trials: DrawnTrials) -> float | None:
    """Return the mean of how much less each trial scored than the baseline does in its scene.

    Beside a control it is of the pairs. The baseline's own result from the same start is left to
    the test: a reader can check this number from the table.
    """
    known = reference.means[trials.scenes] if not reference.paired else trials.baseline
    drops = (known - trials.candidate)[~np.isnan(known - trials.candidate)]
    return float(drops.mean()) if drops.size else None


def _control(trials: DrawnTrials) -> float | None:
    """Return the control's mean success in the pairs of which both trials have a result."""
    known = trials.baseline[~np.isnan(trials.baseline - trials.candidate)]
    return float(known.mean()) if known.size else None
