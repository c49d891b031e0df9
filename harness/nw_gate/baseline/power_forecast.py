"""What a gate would show of policies that it has not met: by simulation, or of one without a fault.

The simulation starts from a baseline, or from the rows of a plain run: then for a baseline that is
not there yet, as if what the run scored were the baseline's true success. Whether a gate can pass
at all is asked before anything runs, by a policy that never fails.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nw_base.errors import IncomparableError, StoreError
from nw_base.plural import plural
from nw_base.trials import DrawnStart
from nw_gate.absolute import percent, trials_to_pass
from nw_gate.baseline.finding import (
    Met,
    margins_of,
    numbers_of,
    reference_of,
    rules_of,
    strata_that_count,
)
from nw_gate.results.baseline import Panel, Start, Stratum, score
from nw_gate.results.row import Row
from nw_gate.settings import Gate
from nw_gate.stats.baseline.curve import (
    KINDS,
    ComparisonKind,
    CurvePoint,
    Kind,
    Progress,
    operating_curve,
    progress_at,
    success_of,
    trials_for,
)
from nw_gate.stats.baseline.trials import TrialRules, settle
from nw_gate.stats.power import SceneCounts

NOTHING_MORE = (
    "every initial state of the baseline was used: continue with a baseline of more initial "
    "states, and with as many trials"
)
_SO_FAR = "if the candidate is as it looks so far"
Forecast = tuple[tuple[CurvePoint, ...], tuple[CurvePoint, ...], tuple[CurvePoint, ...]]
"""Of no drop, half of max_drop and max_drop: a point for each kind of policy (`curve.KINDS`)."""

_FEW = 400
"""Simulated gates where a report waits for them: the standard error is at most 2.5 %."""

_FEWEST, _DRAWS = 200, 2_000_000
"""Of baselines with many thousand starts: at most 3.5 %, and as many starts drawn in all."""


@dataclass(frozen=True, kw_only=True)
class Outset:
    """What is known of a gate before its first trial."""

    strata: tuple[Stratum, ...]
    """Scenes (and cells of perturbations) that count."""
    seen: tuple[SceneCounts, ...]
    """The baseline's trials in each of them."""
    rules: TrialRules
    budget: int
    """Most trials of scenes that count."""
    starts: int
    """M."""
    known: bool
    """Whether `seen` is the baseline; else baselines are drawn from it."""
    against: ComparisonKind = "fresh"
    """What the gate speaks of, and what it compares with."""

    @property
    def baseline(self) -> float:
        """B, mean success."""
        return success_of(self.seen)

    @property
    def scenes(self) -> int:
        """S."""
        return len(self.seen)

    @property
    def in_words(self) -> str:
        """The budget, and of how many scenes."""
        return f"at most {plural(self.budget, 'trial')} in {plural(self.scenes, 'scene')}"

    def curve(self) -> tuple[CurvePoint, ...]:
        """Return what the gate flags, passes and leaves open at drops of .00 to .30."""
        return operating_curve(
            self.seen, self.rules, budget=self.budget, starts=self._drawn, against=self.against
        )

    def progress(self, drop: float) -> Progress:
        """Return after how many trials policies of this drop are judged, with all starts run."""
        return progress_at(self.seen, self.rules, drop, starts=self._drawn, against=self.against)

    def power_forecast(self) -> Forecast:
        """Return three points of the curve, fast: no drop, half of max_drop, and max_drop."""
        worst = self.rules.margins.max_drop
        of_kinds = [self.points((0.0, worst / 2, worst), kind) for kind in KINDS]
        same, half, worse = zip(*of_kinds, strict=True)
        return same, half, worse

    def points(self, drops: Sequence[float], kind: Kind = KINDS[0]) -> tuple[CurvePoint, ...]:
        """Return some points of the curve, fast, of policies that fail in one way."""
        return operating_curve(
            self.seen,
            self.rules,
            budget=self.budget,
            starts=self._drawn,
            drops=drops,
            repetitions=self.few,
            against=self.against,
            kind=kind,
        )

    @property
    def few(self) -> int:
        """Repetitions that take about as long whatever the size of the baseline."""
        return max(_FEWEST, min(_FEW, _DRAWS // (self.starts * len(self.seen))))

    @property
    def _drawn(self) -> int | None:
        return None if self.known else self.starts


def outset_of_baseline(
    panel: Panel, gate: Gate, *, budget: int | None = None, against: ComparisonKind = "fresh"
) -> Outset:
    """Return the outset of a gate against a baseline.

    Args:
        panel: of the baseline, on one class of machine.
        gate: of the suite.
        budget: most trials of scenes that count; by `gate.rounds` if None.
        against: what the gate speaks of, and what it compares with.

    Raises:
        IncomparableError: no scene of the baseline counts, or its success is not above max_drop.
    """
    starts = min(len(outset) for outset in panel.by_stratum.values())
    outset = _outset(panel.by_stratum, gate, starts, known=True)
    pairs = starts * outset.scenes
    return replace(
        outset,
        budget=outset.budget if budget is None else min(budget, pairs),
        against=against,
    )


def outset_of_rows(rows: Iterable[Row], gate: Gate, starts: int) -> Outset:
    """Return the outset of a gate against a baseline that would score as a run did.

    Args:
        rows: of the run, each once.
        gate: of the suite.
        starts: M of the baseline.

    Raises:
        StoreError: no trial of the run has a result.
        IncomparableError: as `outset_of_baseline`.
    """
    groups: dict[Stratum, list[Row]] = {}
    for row in rows:
        if row.success is not None:
            groups.setdefault((row.scene, row.perturbation), []).append(row)
    if not groups:
        raise StoreError("no trial of the run has a result", fix="--resume tries them again")
    return _outset(groups, gate, starts, known=False)


def in_a_sentence(forecast: Forecast, budget: int) -> str:
    """Return what `Outset.power_forecast` found in words: the power of the gate, as ranges.

    Args:
        forecast: of policies that fail in one way each.
        budget: most trials of scenes that count.
    """
    same, half, worse = forecast
    flags = [
        f"a {p[0].drop:.2g} regression in {_shares([x.regressed for x in p])}"
        for p in (worse, half)
    ]
    return (
        f"With at most {plural(budget, 'trial')}, this gate flags {flags[0]} of cases and "
        f"{flags[1]}, and passes an equally good policy in {_shares([x.passed for x in same])} "
        "(simulated)"
    )


def about_more_trials(progress: Progress) -> str:
    """Return in words about how many more trials would settle a run: a spread, never one number.

    It is said of the candidate as it looks so far: of all candidates that look alike, not of each.

    Args:
        progress: of simulated ends of the run, after each further trial that may be run.
    """
    settled, left = progress.settled, len(progress.settled)
    if not left:
        return NOTHING_MORE
    half, most = trials_for(settled, 0.5), trials_for(settled, 0.9)
    first = left if half is None else half
    text = f"{_SO_FAR}, about {plural(first, 'more trial')} {'decides' if first == 1 else 'decide'}"
    if half is None:
        return f"{text} with {percent(settled[-1])} probability"
    if half == most:
        return f"{text} with 90 % probability"
    if most is None:
        return f"{text} with 50 % probability, {left} with {percent(settled[-1])}"
    return f"{text} with 50 % probability, {most} with 90 %"


def _outset(
    groups: Mapping[Stratum, Sequence[Start] | Sequence[Row]],
    gate: Gate,
    starts: int,
    *,
    known: bool,
) -> Outset:
    judged = sorted(strata_that_count(groups, gate))
    seen = tuple(_counts(groups[place]) for place in judged)
    margins = margins_of(gate)
    if not success_of(seen) > margins.max_drop:
        raise IncomparableError(
            f"the baseline's mean success is {success_of(seen):.3f}: no policy can be worse by "
            f"max_drop {margins.max_drop:g}",
            fix="lower max_drop, or compare with a better policy",
        )
    rules = rules_of(gate, judged)
    budget = min(gate.rounds_for(len(seen), starts), starts) * len(seen)
    return Outset(
        strata=tuple(judged),
        seen=seen,
        rules=rules,
        budget=budget,
        starts=starts,
        known=known,
    )


def _counts(trials: Sequence[Start] | Sequence[Row]) -> SceneCounts:
    # A trial of a task without parts counts as one, which is done or not.
    counted = [(score(trial) or 0.0, max(1, trial.waypoints_total)) for trial in trials]
    reached = [round(success * waypoints) for success, waypoints in counted]
    return SceneCounts.of(reached, [waypoints for _, waypoints in counted])


def _shares(shares: Sequence[float]) -> str:
    """Return the range of simulated shares, such as `88 to 96 %`, or one where all are alike."""
    low, high = percent(min(shares)), percent(max(shares))
    return high if low == high else f"{low.removesuffix(' %')} to {high}"


def trials_to_pass_baseline(
    gate: Gate, panel: Panel, order: Sequence[DrawnStart], *, fresh: bool
) -> int | None:
    """Return after how many trials a policy that never fails passes against a baseline.

    Args:
        gate: its margins, errors and tiers.
        panel: of the baseline.
        order: of trials, in which they would be met.
        fresh: whether these are of others than the baseline's starts.

    Returns:
        None if it does not within all that `order` has.
    """
    strata = {(scene, cell) for scene, cell, _ in order}
    judged = sorted(place for place in strata if gate.tier(place[0]) != "informational")
    met = Met(order=order, rows=[None] * len(order))
    basis = "fresh" if fresh else "panel"
    claim = gate.claim if not fresh else "fresh"
    reference = reference_of(panel, judged, basis, claim, margins=margins_of(gate))
    trials = numbers_of(met, judged, panel, basis, reference)
    perfect = replace(trials, candidate=np.ones(len(trials.scenes)))
    decision = settle(reference, perfect, rules_of(gate, judged))
    return decision.trials if decision.word == "PASS" else None


def perfect_panel(strata: Sequence[Stratum], starts: int) -> Panel:
    """Return the results of a policy that never fails, with so many starts of each stratum."""
    perfect = [
        Start(
            scene=scene,
            task="",
            perturbation=cell,
            seed_index=index,
            success=1.0,
            completed=True,
            waypoints_reached=1,
            waypoints_total=1,
            outcome="completed",
            end_reason="",
            trajectory="",
        )
        for scene, cell in strata
        for index in range(starts)
    ]
    return Panel(machine={}, starts=tuple(perfect))


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
