"""The absolute bar: whether mean success significantly reaches what the suite asks for.

1.  Complete? Errors left, trials missing or a critical scene without results: INFRASTRUCTURE. No
    trials at all can never pass.
2.  No bar: RAN, which says that every trial ran and nothing of how well.
3.  Lower bound of mean success at or above the bar: PASS. Upper bound below it: REGRESSED.
4.  Otherwise INCONCLUSIVE, with the chance that more trials would decide.

Trials that left the captured volume (`gate.validity`) count for neither side: the lower bound takes
them for failures, the upper one for successes. Where too many did, nothing is judged: INCONCLUSIVE.

Scenes weigh equally; `informational` ones do not count. Each bound errs with probability at most
1 - confidence, for any distribution of success (`stats.betting`), however often one adds whole
rounds of trials and looks again. A `critical` scene is also judged alone, and can only flag: its
upper bound, at a confidence that is shared among all critical scenes, must not be below the bar.
The mean and the critical scenes each flag wrongly with probability 1 - confidence at most, so
together with at most twice that. Alone, ten trials flag a scene whose true success is .5 in one
run of six where the bar is .75 (all or nothing): the test is valid, not keen.

All this speaks of fresh starts in the suite's scenes. On the seed set that the suite's seed
names success is not estimated but known, and of scenes that the suite does not have nothing is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from math import ceil

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import StoreError
from nw_base.plural import plural
from nw_gate.results.row import Row
from nw_gate.settings import Gate
from nw_gate.stats.betting import Groups, lower_bound, trials_to_certify, upper_bound
from nw_gate.stats.bootstrap import mean_of_scenes
from nw_gate.stats.interval import Interval
from nw_gate.stats.power import SceneCounts, shares_after
from nw_gate.validity import in_a_sentence, over_the_cap, that_left, too_many
from nw_gate.verdict import Comparison, SceneScore, Verdict, Word

_NAMED = 3  # Scenes or trials that a reason names before it says "and more".


def judge(
    rows: Sequence[Row],
    gate: Gate,
    planned: Mapping[str, int],
    *,
    against: Comparison | None = None,
    left_out: Collection[str] = (),
    drawn: Sequence[Row] | None = None,
) -> Verdict:
    """Judge one run against its suite's absolute bar.

    Args:
        rows: one for each trial that ended, with a result or an error.
        gate: the suite's gate settings.
        planned: number of trials that were to be run, by scene.
        left_out: scenes of the suite that were not to be run. A critical one is a hole.
        against: what the rows show against a baseline, if they were compared with one. It changes
            nothing of the verdict (`baseline.combine` does), but what is worth saying beside it.
        drawn: those rows, the first in the order of a random draw of scenes and starts, that alone
            bear on the mean: one sample, of which scenes have unequal numbers. None = all rows,
            scene by scene.

    Raises:
        StoreError: a trial appears twice.
    """
    groups, left = by_scene(rows, planned), that_left(rows, gate)
    scores = tuple(
        score(scene, group, planned.get(scene, 0), gate, left) for scene, group in groups.items()
    )
    critical = [item.scene for item in scores if item.tier == "critical"]
    if drawn is None:
        bar = _bar(rows, gate, left, critical, is_drawn=False)
    else:
        bar = _bar(drawn, gate, left, critical, is_drawn=True)
    flagged, bounds = bar.flagged, bar.bounds
    scores = tuple(replace(item, flagged=item.scene in flagged) for item in scores)
    counted = [values for group in bar.groups if (values := successes(group, left)).size]
    success = float(np.mean([values.mean() for values in counted])) if counted else None
    seen = courses(groups, scores, left)
    word, reasons = _compare(bounds, scores, gate, against)
    if holes := _holes(rows, scores, gate, left_out, is_drawn=drawn is not None):
        word, reasons = "INFRASTRUCTURE", holes
    elif bar.capped:
        word, reasons = "INCONCLUSIVE", [bar.capped]
    elif flagged:
        # The suite's mean speaks first only if it flags too.
        alone = [_alone(scene, most, gate) for scene, most in flagged.items()]
        word, reasons = "REGRESSED", [*(reasons if word == "REGRESSED" else ()), *alone]
    elif word in {"PASS", "RAN"} and (unseen := _unseen(scores)):
        word, reasons = "INCONCLUSIVE", [*unseen, *reasons]
    elif _is_open(word, left, against) and gate.success_rate is not None:
        cells = len({row.perturbation for row in rows})
        reasons.append(advice(counted, seen, gate, gate.success_rate, cells=cells))
    return Verdict(
        verdict=word,
        success=success,
        interval=bounds,
        confidence=gate.confidence,
        bar=gate.success_rate,
        n=sum(item.n for item in scores if item.tier != "informational"),
        planned=sum(planned.values()),
        errors=sum(item.errors for item in scores),
        reasons=(
            *reasons,
            *in_a_sentence(rows, left, gate),
            *_weak_scenes(scores),
        ),
        per_scene=scores,
        left=left,
        failures=how_most_failed(
            [row for row in rows if gate.tier(row.scene) != "informational"], left
        ),
    )


def how_most_failed(rows: Sequence[Row], left: Collection[str] = ()) -> str:
    """Return how most trials that did not complete ended, and where; nothing if all completed.

    Args:
        rows: of scenes that count.
        left: trials that left the captured volume.
    """
    failed = [
        row for row in rows if row.status == "ok" and not row.completed and row.trial_id not in left
    ]
    if not failed:
        return ""
    outcome, count = min(
        Counter(row.outcome for row in failed).items(), key=lambda item: (-item[1], item[0])
    )
    how = _HOW.get(outcome, f"ended as {outcome}")
    said = f"{count} of the {plural(len(failed), 'failed trial')} {how}"
    if count == len(failed):
        said = f"{'the failed trial' if count == 1 else 'all failed trials'} {how}"
    missed = Counter(
        row.waypoints_reached + 1
        for row in failed
        if row.outcome == outcome and row.waypoints_total
    )
    if not missed:
        return said
    waypoint, times = min(missed.items(), key=lambda item: (-item[1], item[0]))
    often = "" if times == count else "most often "
    return f"{said}, {often}before waypoint {waypoint}"


_HOW: Mapping[str, str] = {
    "collided": "collided",
    "fell": "fell",
    "timeout": "ran out of time",
    "stuck": "got stuck",
    "off_course": "left the course",
    "policy_failed": "ended with an error of the policy",
}
"""Outcomes of trials as verbs."""


@dataclass(frozen=True, kw_only=True)
class _Bar:
    """What rows show of the bar."""

    groups: Sequence[Sequence[Row]]
    """Of scenes that count, each with the same weight; one alone of a random draw."""
    bounds: Interval
    flagged: Mapping[str, float]
    """Critical scenes that are certainly below the bar, with their upper bounds."""
    capped: str | None
    """Why nothing is judged: too many left the captured volume."""


def _bar(
    rows: Sequence[Row],
    gate: Gate,
    left: frozenset[str],
    critical: Sequence[str],
    *,
    is_drawn: bool,
) -> _Bar:
    scenes: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: row.scene):
        if gate.tier(row.scene) != "informational":
            scenes.setdefault(row.scene, []).append(row)
    counted = list(scenes.values())
    # A random draw is one sample of the mean over scenes, however many it has of each.
    groups = [[row for each in counted for row in each]] if is_drawn else counted
    return _Bar(
        groups=groups,
        bounds=_bounds(groups, left, gate),
        flagged=_flagged(scenes, left, gate, critical),
        capped=over_the_cap(rows, left, gate),
    )


def word_of_bar(rows: Sequence[Row], gate: Gate, scenes: Collection[str]) -> Word:
    """Return whether a bar is decided by the first trials of a random draw of scenes and starts.

    It is the word of `judge` where there are no holes, and fast.

    Args:
        rows: of these trials.
        gate: with a bar.
        scenes: the run's.
    """
    assert gate.success_rate is not None, "a gate without a bar has nothing to decide"
    critical = [scene for scene in scenes if gate.tier(scene) == "critical"]
    left = that_left(rows, gate)
    bar = _bar(rows, gate, left, critical, is_drawn=True)
    if bar.capped:
        return "INCONCLUSIVE"
    if bar.flagged or bar.bounds.high < gate.success_rate:
        return "REGRESSED"
    outside = Counter(row.scene for row in rows if row.trial_id in left)
    trials = Counter(row.scene for row in rows)
    unseen = any(too_many(outside[scene], trials[scene], gate) for scene in critical)
    passes = bar.bounds.low >= gate.success_rate and not unseen
    return "PASS" if passes else "INCONCLUSIVE"


def _bounds(judged: Sequence[Sequence[Row]], left: frozenset[str], gate: Gate) -> Interval:
    """Return the bounds of mean success; what left the captured volume counts against each."""
    worst = [successes(each, left, counted=0.0) for each in judged]
    best = [successes(each, left, counted=1.0) for each in judged]
    most = 1.0 - (1.0 - gate.confidence) / gate.shared
    return Interval(lower_bound(worst, gate.confidence), upper_bound(best, most))


def _is_open(word: Word, left: frozenset[str], against: Comparison | None) -> bool:
    """Return whether it can be said what more trials would bring to the bar.

    They change nothing once the baseline has flagged; and how many would leave the captured
    volume, once some have, is unknown.
    """
    moot = against is not None and against.word == "REGRESSED"
    return word == "INCONCLUSIVE" and not left and not moot


def _unseen(scores: Sequence[SceneScore]) -> list[str]:
    """Return which critical scenes say too little, because so many of their trials left."""
    return [
        f"{item.outside} of {plural(item.outside + item.n, 'trial')} of critical scene "
        f"{item.scene} left the captured volume: capture more of it from the robot's height"
        for item in scores
        if item.tier == "critical" and item.unseen
    ]


def _holes(
    rows: Sequence[Row],
    scores: Sequence[SceneScore],
    gate: Gate,
    left_out: Collection[str],
    *,
    is_drawn: bool,
) -> list[str]:
    """Return why the run is not complete, in words; nothing if it is.

    A run that ended before its random order came to a critical scene is complete: what it was
    REGRESSED by needs none, and a PASS waits for trials of each.
    """
    reasons: list[str] = []
    if not any(item.planned for item in scores):
        reasons.append("no trials were planned, and nothing can pass without trials")
    if failed := [row for row in rows if row.status == "error"]:
        outcomes = Counter(row.outcome for row in failed).most_common()
        kinds = ", ".join(f"{count} {kind}" for kind, count in outcomes)
        first = failed[0]
        reasons.append(
            f"{plural(len(failed), 'trial')} ended in errors ({kinds}), first {first.trial_id}: "
            f"{first.error_text or first.error_type}; --resume tries them again"
        )
    if missing := [item for item in scores if item.missing]:
        places = _listed([f"{item.scene} {item.missing}" for item in missing])
        total = sum(item.missing for item in missing)
        reasons.append(f"{plural(total, 'trial')} missing ({places}); --resume runs them")
    having = [item.scene for item in scores if item.n or item.outside]
    unseen = dict.fromkeys(scene for scene in sorted(left_out) if gate.tier(scene) == "critical")
    known = [item.scene for item in scores] if is_drawn else having
    # A run of an older nw-eval does not say which scenes of its suite it left out.
    unseen |= dict.fromkeys(
        pattern
        for pattern, tier in gate.tiers.items()
        if tier == "critical"
        and not any(fnmatchcase(scene, pattern) for scene in (*known, *left_out))
    )
    reasons += [
        f"critical scene {scene} has no result, and the suite cannot pass without it"
        for scene in unseen
    ]
    if not reasons and all(item.tier == "informational" for item in scores if item.scene in having):
        reasons.append("no scene counts: all are informational; make one supporting or critical")
    return reasons


def _compare(
    bounds: Interval, scores: Sequence[SceneScore], gate: Gate, against: Comparison | None
) -> tuple[Word, list[str]]:
    """Return what the bounds of mean success say, and one reason.

    Beside a comparison with a baseline the reason has no bounds: a page makes one statement of
    confidence, which is the comparison's, and its table has the others. What flags keeps its own.
    """
    compared = against is not None and against.again is None and against.drop is not None
    confidence = f"{100 * gate.confidence:.4g} % confidence"
    bar = gate.success_rate
    if bar is None:
        total = plural(sum(item.n for item in scores), "trial")
        judged = "nothing was judged" if against is None else "no bar was judged"
        is_taken = against is not None and against.again is not None and against.again.taken_over
        did = "are the baseline's" if is_taken else "ran"
        return "RAN", [f"{total} {did} and {judged}: the suite sets no gate.success_rate"]
    if compared and bounds.low >= bar:
        return "PASS", [f"success meets the bar {bar:g}"]
    if bounds.low >= bar:
        return "PASS", [f"success is at least {bounds.low:.3f} ({confidence}), the bar is {bar:g}"]
    if bounds.high < bar:
        most = f"{100 * (1.0 - (1.0 - gate.confidence) / gate.shared):.4g} % confidence"
        return "REGRESSED", [f"success is at most {bounds.high:.3f} ({most}), the bar is {bar:g}"]
    if compared:
        return "INCONCLUSIVE", [f"the trials do not decide the bar {bar:g}"]
    return "INCONCLUSIVE", [_open(bar, bounds, confidence)]


def _open(bar: float, bounds: Interval, confidence: str) -> str:
    """Return why a bar is not decided; a bound that is the end of the range says nothing."""
    least, most = bounds.low >= _NEXT_TO, bounds.high <= 1.0 - _NEXT_TO
    if least and most:
        ends = f"{bounds.low:.3f} and {bounds.high:.3f} ({confidence} each)"
        return f"the bar {bar:g} lies between the bounds of success, {ends}"
    if least:
        return f"success is at least {bounds.low:.3f} ({confidence}), less than the bar {bar:g}"
    if most:
        return f"success is at most {bounds.high:.3f} ({confidence}), more than the bar {bar:g}"
    return f"too few trials for any bound of success; the bar is {bar:g}"


_NEXT_TO = 5e-4
"""What is printed with three digits as the end of a range is that end."""


def _flagged(
    groups: Mapping[str, Sequence[Row]],
    left: frozenset[str],
    gate: Gate,
    critical: Sequence[str],
) -> dict[str, float]:
    """Return the critical scenes that are certainly below the bar, with their upper bounds."""
    if gate.success_rate is None or not critical:
        return {}
    confidence = 1.0 - (1.0 - gate.confidence) / (len(critical) * gate.shared)
    best = {
        scene: successes(groups[scene], left, counted=1.0) for scene in critical if scene in groups
    }
    known = {scene: values for scene, values in best.items() if values.size}
    most = {scene: upper_bound([values], confidence) for scene, values in known.items()}
    return {scene: bound for scene, bound in most.items() if bound < gate.success_rate}


def _alone(scene: str, most: float, gate: Gate) -> str:
    return (
        f"critical scene {scene} alone: success is at most {most:.3f}, "
        f"the bar is {gate.success_rate:g}"
    )


def _weak_scenes(scores: Sequence[SceneScore]) -> list[str]:
    """Return a reason that names the scenes whose whole interval lies below the bar, if any do."""
    weak = [item for item in scores if item.weak]
    if not weak:
        return []
    scenes = [
        f"{item.scene} completed {item.completed} of {item.n}, success {item.mean:.3f}"
        for item in sorted(weak, key=lambda item: (item.interval.high, item.scene))
    ]
    which = "itself" if len(weak) == 1 else "themselves"
    return [f"{plural(len(weak), 'scene')} below the bar by {which}: {_listed(scenes, '; ')}"]


def _listed(words: Sequence[str], between: str = ", ") -> str:
    more = len(words) - _NAMED
    return between.join(words[:_NAMED]) + (f"{between}and {more} more" if more > 0 else "")


_DRAWS = 2000
"""For the interval of one scene, of which there may be hundreds: shown with two digits."""


def successes(
    rows: Sequence[Row], left: Collection[str] = (), *, counted: float | None = None
) -> NDArray[np.float64]:
    """Return the success rates of the trials that have a result, shape (n,).

    Args:
        rows: in any order.
        left: trials that left the captured volume.
        counted: as which success these count; they are left out if None.
    """
    values = [
        counted if row.trial_id in left else row.success for row in rows if row.success is not None
    ]
    return np.array([value for value in values if value is not None], dtype=np.float64)


def by_scene(rows: Sequence[Row], planned: Mapping[str, int]) -> dict[str, list[Row]]:
    """Return the rows of every scene that was planned or met, scenes in alphabetical order.

    Raises:
        StoreError: a trial appears twice, which would count it twice.
    """
    groups: dict[str, list[Row]] = {scene: [] for scene in sorted({*planned, *_scenes(rows)})}
    seen: set[str] = set()
    for row in rows:
        if row.trial_id in seen:
            raise StoreError(
                f"trial {row.trial_id} appears twice among the rows", fix="keep one row of a trial"
            )
        seen.add(row.trial_id)
        groups[row.scene].append(row)
    return groups


def score(
    scene: str, rows: Sequence[Row], planned: int, gate: Gate, left: Collection[str] = ()
) -> SceneScore:
    """Return the score of one scene from its rows, but for trials that left the captured volume."""
    outside = sum(row.trial_id in left for row in rows)
    rows = [row for row in rows if row.trial_id not in left]
    values = successes(rows)
    completed = sum(row.completed for row in rows)
    estimate = mean_of_scenes([values], gate.confidence, draws=_DRAWS) if values.size else None
    bar = gate.success_rate
    return SceneScore(
        scene=scene,
        tier=gate.tier(scene),
        planned=planned,
        n=values.size,
        errors=sum(row.status == "error" for row in rows),
        completed=completed,
        mean=estimate.mean if estimate else None,
        interval=estimate.interval if estimate else Interval(0.0, 1.0),
        weak=bar is not None and estimate is not None and estimate.interval.high < bar,
        outside=outside,
        unseen=too_many(outside, outside + values.size, gate),
    )


def _scenes(rows: Sequence[Row]) -> set[str]:
    return {row.scene for row in rows}


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
    courses: list[SceneCounts] = []
    for item in scores:
        rows = [
            row
            for row in groups[item.scene]
            if row.success is not None and row.trial_id not in left
        ]
        if item.tier != "informational" and rows:
            # A trial of a task without parts counts as one, which is done or not.
            waypoints = [max(1, row.waypoints_total) for row in rows]
            reached = [
                row.waypoints_reached if row.waypoints_total else round(row.success or 0.0)
                for row in rows
            ]
            courses.append(SceneCounts.of(reached, waypoints, alone=item.tier == "critical"))
    return courses


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
    number, where = (n, "") if rest else (each, " in each scene")
    return (
        f"{2 * number} trials{where} (now {number}) decide the bar with {twice} probability, "
        f"{4 * number} with {four_times}, if the policy is as it looks so far; --resume with more "
        "--trials adds them"
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
