"""Which scenes of a suite tell two policies apart, and a suite that needs fewer trials for it.

A worse policy is taken to have the odds of every next waypoint multiplied by one factor, as in
`stats.power`. So a scene that the baseline always completes says nothing of it, and one that the
baseline completes in half of its trials says most. A trial's information is the Kullback-Leibler
divergence of the worse policy's results from the baseline's: by Wald's bound no test that errs with
`alpha_regr` needs fewer than log(1 / alpha_regr) over it of them.

**A proposal** takes the most informative of the suite's scenes and of rungs of ladders that were
measured, with all critical scenes. Margins, most trials and trials of the baseline stay. Gates of
half a dozen such suites are simulated; the one in which the worse policy and an equal one are
judged in the fewest trials together is proposed, with more scenes where that costs next to nothing.

**What protects from chance.** Scenes are chosen by results, and what was chosen did worse there
by bad luck, too: measured again, the baseline does better. Were its old results compared with new
candidates, a policy that is worse by `max_drop` would pass too often. So a proposed suite has
another seed, for which no result is known, and its baseline is saved anew. The choice then depends
on nothing that is compared. `tests/gate/baseline/test_informative.py` simulates both.

Source: A. Wald, "Sequential tests of statistical hypotheses", Ann. Math. Statist. 16 (1945).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, log

import numpy as np

from nw_gate.baseline.power_forecast import Outset
from nw_gate.results.baseline import Stratum
from nw_gate.stats.baseline.curve import CurvePoint, success_of
from nw_gate.stats.baseline.evidence import Floats
from nw_gate.stats.power import SceneCounts, chances_at, ends

_PARTS = (1.0, 0.875, 0.75, 0.625, 0.5, 0.25)
"""Numbers of scenes that are simulated, as shares of the suite's."""
_FEWEST = 4
"""Scenes: fewer would be a test of one obstacle."""
_CLOSE = 1.05
"""Suites that need so many times the fewest trials are as good; the largest of them is proposed."""
_PASSES = 0.95
"""Share of equally good policies that the gate of a proposal passes, at least."""
_SCALE = 1000
"""Trials that stand for the rate of a rung."""


@dataclass(frozen=True, kw_only=True)
class Item:
    """A scene or a rung, and what a trial of it says."""

    stratum: Stratum
    seen: SceneCounts
    critical: bool
    """Whether it is judged by itself, too: then it stays."""
    rung: bool
    """Whether the suite lacks it."""
    success: float
    """Of the baseline."""
    worse: float
    """Of the policy that is to be detected."""
    information: float
    """Of a trial, in nats."""
    alone: float
    """Trials of this scene alone that tell both apart, at least; infinite if none do."""
    tells: bool
    """Whether the most trials of the whole gate could do so."""

    @property
    def name(self) -> str:
        """Its scene, with what is changed there."""
        scene, cell = self.stratum
        return " ".join([scene, *(f"{axis}={value}" for axis, value in cell)])


@dataclass(frozen=True, kw_only=True)
class Forecasts:
    """What a gate does with three policies; simulated."""

    equal: CurvePoint
    worse: CurvePoint
    """One with the odds of each waypoint multiplied by one factor."""
    evenly: CurvePoint
    """One that loses the same share of success in every scene."""

    @property
    def together(self) -> float:
        """Trials in which an equal and a worse policy are judged."""
        return self.equal.trials + self.worse.trials


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A suite that costs as much and needs fewer trials."""

    items: tuple[Item, ...]
    """What it has, the most informative first."""
    left_out: tuple[Item, ...]
    """Scenes that only the suite has."""
    rounds: int
    """Most trials of each scene, on average."""
    starts: int
    """Initial states of each scene that its baseline is to have."""
    today: Forecasts
    """Of the suite as it is."""
    proposed: Forecasts


def rung_counts(rate: float, waypoints: int) -> SceneCounts:
    """Return trials that stand for a rung at which a share of trials is completed.

    Args:
        rate: between 0 and 1, as the curve of its ladder has it: lucky trials at one rung move it
            less than their own share.
        waypoints: of the course.
    """
    each = ends(np.array(rate ** (1.0 / waypoints)), waypoints)
    return SceneCounts(counts=np.rint(_SCALE * each).astype(np.int64))


def items_of(
    outset: Outset, drop: float, rungs: Sequence[tuple[str, SceneCounts]] = ()
) -> tuple[Item, ...]:
    """Return what a trial of each scene and rung says of a policy, the most informative first.

    Args:
        outset: of the suite's gate.
        drop: of the policy's mean success in the suite, between 0 and the baseline's.
        rungs: scenes that the suite does not have, by name.
    """
    seen = [*outset.seen, *(each for _, each in rungs)]
    strata = [*outset.strata, *((name, ()) for name, _ in rungs)]
    # A rung is measured as such, and moves no scene of the suite.
    parts = [outset.seen, *([each] for _, each in rungs)]
    factor = _log_factor(outset.seen, drop)
    before, after = np.concatenate([_chances(part, factor) for part in parts], axis=1)
    found = [
        _item(outset, number, stratum, counts, before[number], after[number])
        for number, (stratum, counts) in enumerate(zip(strata, seen, strict=True))
    ]
    return tuple(sorted(found, key=_rank))


def propose(outset: Outset, items: Sequence[Item], drop: float) -> Proposal | None:
    """Return a suite that finds a drop in fewer trials; None if none of the simulated ones does.

    Args:
        outset: of the suite's gate.
        items: as `items_of` has them.
        drop: as there.
    """
    today = _forecasts(outset, drop, drop / outset.baseline)
    ranked = sorted(items, key=lambda each: (not each.critical, _rank(each)))
    least = max(min(_FEWEST, outset.scenes), sum(each.critical for each in items))
    sizes = {max(least, round(part * outset.scenes)) for part in _PARTS}
    found = [_proposal(outset, ranked, size, drop, today) for size in sorted(sizes, reverse=True)]
    good = [
        each
        for each in found
        if each.proposed.equal.passed >= min(_PASSES, today.equal.passed)
        and each.proposed.worse.regressed >= min(_PASSES, today.worse.regressed)
        and each.proposed.worse.trials < today.worse.trials
        and each.left_out
    ]
    if not good:
        return None
    fewest = min(each.proposed.together for each in good)
    return next(each for each in good if each.proposed.together <= _CLOSE * fewest)


def _item(
    outset: Outset, number: int, stratum: Stratum, seen: SceneCounts, before: float, after: float
) -> Item:
    waypoints = len(seen.counts) - 1
    one, other = (ends(np.array(chance), waypoints) for chance in (before, after))
    information = max(0.0, float((other * np.log(other / one)).sum()))
    # Less than a rounding error tells nothing apart.
    alone = -log(outset.rules.alpha_regr) / information if information > 1e-12 else inf
    return Item(
        stratum=stratum,
        seen=seen,
        critical=number in outset.rules.critical,
        rung=number >= len(outset.seen),
        success=float(one @ seen.values),
        worse=float(other @ seen.values),
        information=information,
        alone=alone,
        tells=alone <= outset.budget,
    )


def _rank(item: Item) -> tuple[float, Stratum]:
    return -item.information, item.stratum


def _proposal(
    outset: Outset, ranked: Sequence[Item], size: int, drop: float, today: Forecasts
) -> Proposal:
    """Return the suite of the first so many items."""
    items = ranked[:size]
    starts = outset.starts * outset.scenes // size
    rounds = min(outset.budget // size, starts)
    seen = tuple(each.seen for each in items)
    suite = replace(
        outset,
        strata=tuple(each.stratum for each in items),
        seen=seen,
        rules=replace(
            outset.rules,
            tiers=tuple("critical" if each.critical else "supporting" for each in items),
        ),
        budget=rounds * size,
        starts=starts,
        known=False,
    )
    _, after = _chances(seen, _log_factor(outset.seen, drop))
    worse = [
        float(ends(chance, len(each.counts) - 1) @ each.values)
        for chance, each in zip(after, seen, strict=True)
    ]
    own = success_of(seen) - float(np.mean(worse))
    return Proposal(
        items=tuple(sorted(items, key=_rank)),
        left_out=tuple(each for each in ranked[size:] if not each.rung),
        rounds=rounds,
        starts=starts,
        today=today,
        proposed=_forecasts(suite, own, drop / outset.baseline),
    )


def _forecasts(outset: Outset, drop: float, share: float) -> Forecasts:
    """Return what a gate does.

    Args:
        outset: of the gate.
        drop: of the worse policy, in this suite.
        share: of its success that the evenly worse policy loses.
    """
    equal, worse = outset.points((0.0, drop))
    (evenly,) = outset.points((share * outset.baseline,), "all or nothing")
    return Forecasts(equal=equal, worse=worse, evenly=evenly)


def _log_factor(seen: Sequence[SceneCounts], drop: float) -> float:
    """Return the logarithm of the factor of all odds with which a policy is worse by a drop."""
    mean = _mean(seen)
    left = max(mean - drop, 1e-6)
    before, after = (chances_at(list(seen), each) for each in (mean, left))
    # All scenes have the same one; where the odds are even it is known best.
    place = int(np.abs(before - 0.5).argmin())
    return _log_odds(float(after[place])) - _log_odds(float(before[place]))


def _chances(seen: Sequence[SceneCounts], factor: float) -> tuple[Floats, Floats]:
    """Return the chances of the baseline and of the worse policy, each of shape (S,)."""
    before = chances_at(list(seen), _mean(seen))
    odds = before / (1.0 - before) * np.exp(factor)
    return before, odds / (1.0 + odds)


def _mean(seen: Sequence[SceneCounts]) -> float:
    """Return mean success; of a baseline that never failed, as if half a trial more had failed."""
    return min(success_of(seen), 1.0 - 0.5 / (1 + sum(each.trials for each in seen)))


def _log_odds(chance: float) -> float:
    return log(chance / (1.0 - chance))
