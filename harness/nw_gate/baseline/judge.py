"""Whether the candidate is worse than the baseline: from a run's rows to a comparison.

The candidate's rows become trials in the order of the draw (`finding.Met`), these become evidence
and a word (`finding.find`), and what that may claim depends on what the baseline is to the run
(`match.basis_of`). Here are also the waypoint at which the candidate diverges from the baseline,
the comparison in words, and what is simulated for a report: other policies at this gate, and this
one after more trials.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nw_base.plural import plural
from nw_base.trials import DrawnStart
from nw_gate.baseline.finding import (
    Finding,
    Met,
    budget_of,
    by_place,
    check_level,
    find,
    margins_of,
    numbers_of,
    reference_of,
    scores_of,
    strata_that_count,
)
from nw_gate.baseline.match import (
    basis_of,
    check_match,
    check_starts,
    claim_of,
    drawn_order,
    met_others,
    recheck,
)
from nw_gate.baseline.power_forecast import Forecast, Outset, about_more_trials, outset_of_baseline
from nw_gate.results.baseline import BaselineResults, LoadedBaseline, Panel, Start, Stratum, score
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.settings import Gate
from nw_gate.stats.baseline.curve import progress_from
from nw_gate.stats.baseline.interval import drop_interval_after
from nw_gate.stats.baseline.trials import CRITICAL_TRIALS, SUSPECT, most_false_alarms
from nw_gate.stats.hazard import Ends, first_partings
from nw_gate.stats.interval import Interval
from nw_gate.validity import over_the_cap, that_left
from nw_gate.verdict import Basis, Claim, Comparison, Paired, SceneDrop, percent_sure

_FURTHER = 4
"""How many times its budget of trials a run that is undecided might have, for what more bring."""


@dataclass(frozen=True, kw_only=True)
class ComparisonSetup:
    """A run against a baseline that holds for it, before anything of its trials is looked at."""

    run: RunInfo
    against: LoadedBaseline
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
    """Scenes of the baseline that the run was not asked for."""
    is_own: bool = False
    """Whether the candidate is the baseline's own policy, with other bits than the baseline's."""

    def on(self, rows: Sequence[Row]) -> ComparisonSetup:
        """Return the setup, once rows show whether the baseline's own policy has its bits here.

        Where it has, its results are the baseline's. Where it has not, they are compared with the
        baseline like those of any candidate: what changed is the machine or the version.

        Args:
            rows: of the candidate so far.

        Raises:
            IncomparableError: bits are others, and the baseline has too few starts for a claim, or
                scores too little for a drop of max_drop.
        """
        done = [row for row in rows if row.status == "ok"]
        if self.basis != "same" or not done:
            return self
        has_others = met_others(self.run, self.results)
        if not has_others:
            repeat = recheck(done, self.run, self.results)
            if repeat.equal or repeat.differing:
                return self
        self.check_comparable()
        return replace(self, basis="fresh" if has_others else "panel", is_own=True)

    def check_comparable(self) -> None:
        """Refuse a baseline whose results are no measure of the trials of any candidate.

        Raises:
            IncomparableError: as `check_starts` and `check_level`.
        """
        check_starts(self.results, self.gate, self.run)
        check_level(self.panel, self.judged, self.gate)

    @property
    def goes_by_rounds(self) -> bool:
        """Whether trials come round by round, one of each scene: the baseline's own policy's."""
        return (self.run.is_recheck or self.run.goes_by_rounds) and self.run.drawn_from is not None

    @property
    def results(self) -> BaselineResults:
        """The baseline."""
        return self.against.results

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
            most = max(rounds, min(_FURTHER * rounds, self.results.manifest.starts))
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
            met,
            self.judged,
            self.panel,
            self.basis,
            self.gate,
            claim=self.claim,
            by_rounds=self.goes_by_rounds,
            alone=alone,
        )


def setup_of(run: RunInfo, against: LoadedBaseline, gate: Gate) -> ComparisonSetup:
    """Return a run against a baseline.

    Args:
        run: the candidate's. What it says of the baseline (`BaselineInfo.checked`) counts.
        against: the baseline.
        gate: margins, errors and tiers.

    Raises:
        IncomparableError: the baseline does not hold for the run, or has too few starts for its
            trials; or it is unchecked on this machine type; or no scene of it counts.
    """
    baseline = against.results
    check_match(run, baseline)
    known = run.baseline
    is_begun = known is not None and known.sha256 == against.info.sha256
    basis, panel = basis_of(
        run, baseline, known.checked if known is not None and is_begun else None
    )
    left_aside = {start.scene for start in panel.starts} - set(run.scenes)
    panel = replace(panel, starts=tuple(x for x in panel.starts if x.scene in run.scenes))
    strata = tuple(panel.by_stratum)
    judged = strata_that_count(strata, gate)
    rounds = budget_of(run)
    return ComparisonSetup(
        run=run,
        against=against,
        gate=gate,
        basis=basis,
        claim=claim_of(run, baseline, basis, rounds, gate),
        panel=panel,
        strata=strata,
        judged=judged,
        order=drawn_order(run, strata, rounds),
        left_aside=len(left_aside),
    )


def compare(
    rows: Sequence[Row],
    run: RunInfo,
    against: LoadedBaseline,
    gate: Gate,
    *,
    power_forecast: bool = False,
) -> Comparison:
    """Compare the trials that a run has so far with a baseline.

    Args:
        rows: of the candidate, in any order.
        run: what they are of.
        against: the baseline, with the control's rows if one ran.
        gate: margins, errors and tiers.
        power_forecast: also find intervals, and simulate what this gate would show of other
            policies, and
            of this one after more trials: for a report, and too slow to be asked after each trial.

    Raises:
        IncomparableError: as `setup_of`, or the gate could never flag.
        StoreError: a row is not of this run, or appears twice.
    """
    setup = setup_of(run, against, gate).on(rows)
    met = setup.met(rows)
    finding = setup.find(met, alone=power_forecast)
    basis, panel, strata = setup.basis, setup.panel, setup.strata
    used = frozenset(finding.used) | {
        index for index in range(finding.first) if met.order[index][0] not in _scenes(setup)
    }
    parting = _waypoints(finding.worst, met, used, panel)
    scenes = [
        _scene(stratum, met, used, panel, gate, finding, parting.get(stratum)) for stratum in strata
    ]
    margins = margins_of(gate)
    is_own = basis == "same" or setup.is_own
    meets_starts = is_own and not met_others(run, setup.results)
    capped = over_the_cap(rows, met.left, gate)
    critical = sum(gate.tier(scene) == "critical" for scene, _ in setup.judged)
    alpha_pass = 1.0 - gate.confidence
    bars = [gate.success_rate, *(asked.bar for asked in gate.scores.values())]
    comparison = Comparison(
        word="INCONCLUSIVE" if capped else finding.word,
        baseline_name=setup.results.manifest.name,
        policy=setup.results.manifest.policy.name,
        basis=basis,
        claim=setup.claim,
        trials=len(finding.used),
        budget=len(met.places(setup.judged)),
        starts=setup.results.manifest.starts,
        paired=_paired(setup, met, finding),
        baseline_met=_level_met(setup, met, finding),
        baseline=_level(finding, panel, setup.judged),
        drop=finding.drop,
        interval=finding.interval,
        mean_regressed=finding.mean_regressed,
        false_alarm=most_false_alarms(
            bar=None if all(bar is None for bar in bars) else alpha_pass,
            bar_critical=critical > 0,
            baseline=gate.false_alarm,
            critical=critical,
            scenes=len(setup.judged),
        ),
        max_drop=margins.max_drop,
        tolerate=margins.tolerate,
        scene_drop=margins.scene_drop,
        alpha_pass=alpha_pass,
        alpha_regr=gate.false_alarm / gate.shared,
        scenes=tuple(scenes),
        reasons=(),
        left_aside=setup.left_aside,
        control=0 if met.control is None else sum(row is not None for row in met.control),
        control_drop=_control_drop(setup, met, finding) if power_forecast else None,
        is_own=setup.is_own,
        again=recheck(rows, run, setup.results) if meets_starts else None,
    )
    curve = more = None
    if power_forecast and basis != "same" and not setup.is_own:
        further = setup.met(rows, further=True)
        curve, more = _power_forecast(comparison, further, setup.judged, panel, gate)
    reasons = _in_words(comparison, finding)
    return replace(
        comparison,
        reasons=(capped, *reasons) if capped else reasons,
        more=None if capped else more,
        curve=curve,
    )


def _control_drop(
    setup: ComparisonSetup, met: Met, finding: Finding
) -> tuple[float, Interval] | None:
    """Return how much less the control scores than the baseline says; None without a control.

    The control's trials are drawn as the candidate's, so that they are judged as a candidate's are:
    by the baseline's results from these starts, or in these scenes where the starts are others.
    """
    places = [place for place in finding.used if place < finding.first]
    if met.control is None or not places:
        return None
    alone = replace(met, rows=met.control, control=None, left=met.control_left)
    reference = reference_of(setup.panel, setup.judged, "panel", "fresh")
    basis: Basis = "fresh" if met_others(setup.run, setup.results) else "panel"
    trials = numbers_of(alone, setup.judged, setup.panel, basis, reference)
    known = {place: index for index, place in enumerate(met.places(setup.judged).tolist())}
    seen = trials.at([known[place] for place in places])
    drops = reference.means[seen.scenes] - seen.candidate
    if np.isnan(drops).all():
        return None
    ends = drop_interval_after(
        reference,
        seen,
        alpha_pass=1.0 - setup.gate.confidence,
        alpha_regr=setup.gate.false_alarm / setup.gate.shared,
    )
    return float(np.nanmean(drops)), ends


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
        ends=_ends(stratum, met, used, panel),
    )


def _level(finding: Finding, panel: Panel, judged: Sequence[Stratum]) -> float:
    """Return the baseline's mean success: the control's, where one was compared with."""
    if finding.control is not None:
        return finding.control
    return float(np.mean([scores_of(panel, stratum).mean() for stratum in judged]))


def _level_met(setup: ComparisonSetup, met: Met, finding: Finding) -> float | None:
    """Return the baseline's mean in the scenes of the trials that bear on the mean."""
    if finding.drop is None:
        return None
    places = [place for place in finding.used if place < finding.first]
    scores = np.concatenate([met.scores(stratum, places) for stratum in setup.judged])
    known = scores[~np.isnan(scores)]
    return float(known.mean()) + finding.drop if known.size else None


def _paired(setup: ComparisonSetup, met: Met, finding: Finding) -> Paired | None:
    """Return how many trials completed of those that both policies have from one start."""
    ours: list[bool] = []
    theirs: list[bool] = []
    if setup.basis == "fresh":
        return None
    for place in finding.used:
        row, (scene, cell, start) = met.rows[place], met.order[place]
        beside = (
            setup.panel.by_stratum[scene, cell][start]
            if met.control is None
            else met.control[place]
        )
        if row is not None and beside is not None and row.trial_id not in met.left:
            ours.append(row.completed)
            theirs.append(beside.completed)
    return Paired(sum(ours), sum(theirs), len(ours)) if ours else None


def _waypoints(
    strata: Iterable[Stratum], met: Met, used: Collection[int], panel: Panel
) -> Mapping[Stratum, int]:
    """Return the first waypoint, from 1, of each stratum at which the two part significantly.

    The baseline is all of its starts, or the control's trials beside the candidate's; the
    candidate is the trials judged that have a result. All strata are looked at together
    (`stats.hazard`), and some may have none.

    Args:
        strata: where to look.
        met: trials of the candidate.
        used: places of those that are judged.
        panel: of the baseline.
    """
    pairs = {stratum: _ends(stratum, met, used, panel) for stratum in strata}
    known = {stratum: pair for stratum, pair in pairs.items() if pair is not None}
    return {stratum: partings.waypoint for stratum, partings in first_partings(known).items()}


def _ends(
    stratum: Stratum, met: Met, used: Collection[int], panel: Panel
) -> tuple[Ends, Ends] | None:
    """Return how many trials of both ended after 0, 1, .. K waypoints; None without waypoints."""
    starts = panel.by_stratum[stratum] if met.control is None else met.beside(stratum, used)
    rows = met.of(stratum, used)
    total = max((trial.waypoints_total for trial in (*starts, *rows)), default=0)
    return (_ended(starts, total), _ended(rows, total)) if total else None


def _ended(trials: Sequence[Start | Row], total: int) -> Ends:
    reached = np.array([trial.waypoints_reached for trial in trials], dtype=np.int64)
    return [int(count) for count in np.bincount(reached, minlength=total + 1)]


_NONE_LEFT = "this run has no trial of these scenes left"
_NAMED = 3  # scenes that a reason names before it says "and more"


def _in_words(comparison: Comparison, finding: Finding) -> tuple[str, ...]:
    """Return why a comparison says what it says, and of what it speaks: the main reason first.

    Args:
        comparison: with the baseline.
        finding: what it rests on.
    """
    if comparison.basis == "same":
        repeat = comparison.again
        if repeat is None:
            return (f"same policy as baseline {comparison.baseline_name}: nothing to compare",)
        return (f"same policy as baseline {comparison.baseline_name}: {repeat.in_words}",)
    fallen, mean = _fallen(comparison), _mean(comparison)
    if comparison.is_own and comparison.word == "REGRESSED":
        mean = _moved(comparison)
    by_scenes_alone = comparison.word == "REGRESSED" and not comparison.mean_regressed
    return (
        *((*fallen, mean) if by_scenes_alone else (mean, *fallen)),
        *_largest(comparison),
        *_waiting(comparison, finding),
        *_limits(comparison),
    )


def _mean(comparison: Comparison) -> str:
    """Return what was found of the mean."""
    name, drops, trials = (
        f"baseline {comparison.baseline_name}",
        comparison.interval,
        plural(comparison.trials, "trial"),
    )
    if not comparison.trials or comparison.drop is None:
        return f"no trial has been compared with {name} yet"
    drop = f"estimated drop from {name}: {comparison.drop:z.3f} ({trials})"
    if comparison.drop < 0.0:
        drop = f"estimated gain over {name}: {-comparison.drop:.3f} ({trials})"
    if drops is None:
        return drop
    most = f"{percent_sure(comparison.alpha_pass)} confidence"
    if comparison.word == "PASS":
        worst = f"{_at_most(drops, comparison)} than {name} ({most}, {trials})"
        return f"{worst}; max_drop is {comparison.max_drop:g}"
    if comparison.mean_regressed:
        least = f"{percent_sure(comparison.alpha_regr)} confidence, {trials}"
        worse = f"mean success is at least {drops.low:z.3f} worse"
        # Rounded it would contradict the verdict.
        if float(f"{drops.low:.3f}") <= comparison.tolerate:
            worse = f"mean success is more than {comparison.tolerate:g} worse"
        return f"{worse} than {name} ({least}); tolerate is {comparison.tolerate:g}"
    if drops.high < comparison.max_drop:
        return (
            f"{drop}; {_at_most(drops, comparison)} ({most}), max_drop is {comparison.max_drop:g}"
        )
    gains = comparison.drop < 0.0
    change = f"{'gain' if gains else 'drop'} {abs(comparison.drop):.3f} ({trials})"
    high = ""
    if comparison.known_high is not None:
        high = f", {'a drop of ' if gains else ''}at most {comparison.known_high:z.3f} ({most})"
    return f"the comparison with {name} is undecided: estimated {change}{high}"


def _at_most(drops: Interval, comparison: Comparison) -> str:
    """Return how much worse the candidate is at most."""
    if drops.high <= 0.0:
        return "no worse"
    # Rounded it would contradict the verdict.
    if float(f"{drops.high:.3f}") >= comparison.max_drop:
        return f"less than {comparison.max_drop:g} worse"
    return f"at most {max(drops.high, 0.001):.3f} worse"


def _moved(comparison: Comparison) -> str:
    """Return what was found of a machine or version on which the baseline's policy scores less."""
    assert comparison.drop is not None, "something was found"
    span = "" if comparison.interval is None else f", {_range(comparison.interval)},"
    return (
        f"this machine or version scores {comparison.drop:.3f} less than baseline "
        f"{comparison.baseline_name}{span} ({plural(comparison.trials, 'trial')} of the same "
        "policy): no candidate can be judged here; find what changed, or save the baseline again"
    )


def _range(drops: Interval) -> str:
    return f"{drops.low:z.3f} to {drops.high:z.3f}"


def _fallen(comparison: Comparison) -> tuple[str, ...]:
    """Return which scenes regressed, whatever the word; those that flag first."""
    order = {"critical": 0, "supporting": 1, "informational": 2}
    named = [item for item in comparison.scenes if item.named]
    named.sort(key=lambda item: (order[item.tier], -item.evidence, item.name))
    shown = tuple(_fell(item) for item in named[:_NAMED])
    if len(named) > _NAMED:
        return (
            *shown,
            f"{plural(len(named) - _NAMED, 'more scene')} regressed, see the table of scenes",
        )
    return shown


def _fell(item: SceneDrop) -> str:
    which = "critical scene" if item.tier == "critical" else "scene"
    return f"{which} {item.name} regressed: {_change(item)}"


def _largest(comparison: Comparison) -> Iterable[str]:
    """Return where a policy that the mean flags seems worst, if no scene flags alone."""
    if not comparison.mean_regressed or any(item.named for item in comparison.scenes):
        return
    lower = [item for item in comparison.scenes if item.counts and item.drop and item.drop > 0.0]
    lower.sort(key=lambda item: (-item.evidence, item.name))
    if lower:
        worst = "; ".join(f"{item.name} {_change(item)}" for item in lower[:_NAMED])
        yield f"largest drops, none significant alone: {worst}"


def _change(item: SceneDrop) -> str:
    onwards = "" if item.waypoint is None else f", worse from waypoint {item.waypoint}"
    return f"{item.baseline:.2f} -> {item.candidate:.2f}{onwards}"


def _waiting(comparison: Comparison, finding: Finding) -> Iterable[str]:
    waited = [item for item in comparison.scenes if item.stratum in finding.waits_for]
    suspect = [item.name for item in waited if item.evidence >= SUSPECT]
    critical = [item.name for item in waited if item.evidence < SUSPECT]
    if suspect:
        yield f"PASS is withheld: the mean passes, but {_listed(suspect)} may have regressed"
    if critical:
        yield (
            f"PASS is withheld: the mean passes, but critical {_scenes_named(critical)} "
            f"{CRITICAL_TRIALS} trials"
        )
    if waited and not finding.pending:
        yield "this run has no trial of it left" if len(waited) == 1 else _NONE_LEFT


def _scenes_named(names: Sequence[str]) -> str:
    several = len(names) > 1
    return f"{'scenes' if several else 'scene'} {_listed(names)} {'need' if several else 'needs'}"


def _limits(comparison: Comparison) -> Iterable[str]:
    """Return of which starts it speaks, and what was left out."""
    if comparison.claim == "panel":
        yield (
            f"gate.claim is panel: this applies to the baseline's {comparison.starts} initial "
            "states in each scene, not to new ones"
        )
    if comparison.basis == "control":
        yield (
            "this machine computes slightly different results from the one that saved the "
            f"baseline, so the candidate is compared with {plural(comparison.control, 'trial')} of "
            f"{comparison.policy} that ran here from the same initial states; "
            "`nw-eval baseline save` on this machine saves that time"
        )
    if comparison.control_drop is not None:
        drop, drops = comparison.control_drop
        change = f"{drop:.3f} less" if drop >= 0.0 else f"{-drop:.3f} more"
        yield (f"here {comparison.policy} scores {change} than the baseline says ({_range(drops)})")
    if comparison.is_own and comparison.again is not None:
        yield (
            "the policy is the baseline's own, but this machine or version computes different "
            f"results ({plural(comparison.again.ran, 'trial')} re-run): its trials are compared "
            "with the baseline's like those of a new policy"
        )
    unmet = [item.name for item in comparison.scenes if item.counts and not item.trials]
    if comparison.word == "PASS" and unmet:
        yield (
            f"PASS is for the mean of all scenes: no trial ran in {_listed(unmet)}; a critical "
            f"scene gets {CRITICAL_TRIALS} trials before a PASS (gate.tiers)"
        )
    if comparison.left_aside:
        left_aside = plural(comparison.left_aside, "scene")
        yield f"only a part of the suite was run: {left_aside} of the baseline not compared"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"


def _power_forecast(
    comparison: Comparison, met: Met, judged: Sequence[Stratum], panel: Panel, gate: Gate
) -> tuple[Forecast, str | None]:
    """Simulate what a comparison leaves open.

    Returns:
        How this gate ends for an equal policy, and for ones worse by half of max_drop and by it;
        and about how many more trials would settle it, None where it is settled.

    Args:
        comparison: with the baseline.
        met: trials of the candidate, and those that may be run beyond the budget.
        judged: strata that count, in the order of the seed set.
        panel: of the baseline, in the scenes of the run.
        gate: margins, errors and tiers.
    """
    against = "control" if comparison.basis == "control" else comparison.claim
    outset = outset_of_baseline(panel, gate, budget=comparison.budget, against=against)
    is_open = comparison.word == "INCONCLUSIVE" and comparison.trials > 0
    more = _more(met, judged, panel, comparison, outset) if is_open else None
    return outset.power_forecast(), more


def _more(
    met: Met, judged: Sequence[Stratum], panel: Panel, comparison: Comparison, outset: Outset
) -> str:
    rules = outset.rules
    reference = reference_of(
        panel, judged, comparison.basis, comparison.claim, margins=rules.margins
    )
    progress = progress_from(
        reference,
        numbers_of(met, judged, panel, comparison.basis, reference),
        rules,
        known=met.ended(met.places(judged).tolist()),
        seen=outset.seen,
    )
    words = about_more_trials(progress)
    return f"{words}; --resume with more --trials runs them" if progress.settled else words
