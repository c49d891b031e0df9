"""Scores beside success: what each came to, and whether it passes what `gate.scores` asks.

A score is a bounded number with a direction and a range, which its declaration states before any
trial runs. Scaled to [0, 1], 1 the best, it is judged as success is:

* *bar*: the lower bound of its mean at `gate.confidence` must reach the bar to PASS, and the upper
  one be below it to be REGRESSED (`stats.betting`).
* *max_drop*: the interval of its drop against the baseline, of the same starts and the same claim
  as that of success (`stats.baseline.interval`), must end below `max_drop` to PASS, and begin above
  `tolerate` to be REGRESSED.

A critical scene flags by a score alone as it does by success: its own upper bound is below the
bar at a confidence that all critical scenes share, or its own interval of the drop begins above
`max_drop` at a level that all scenes share.

PASS asks for every score, so that each may err with the whole 1 - confidence. REGRESSED by any one
is REGRESSED: there the errors are split over all gated scores and success (`Gate.shared`, after
Bonferroni). All trials of the budget run, and the scores are looked at once, at the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from nw_base.plural import plural
from nw_gate.baseline.finding import (
    Met,
    numbers_of,
    reference_of,
    scores_of,
    strata_that_count,
)
from nw_gate.baseline.judge import ComparisonSetup, setup_of
from nw_gate.baseline.match import renewing
from nw_gate.results.baseline import BaselineResults, LoadedBaseline, Start, Stratum
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.scores import ScoreSpec
from nw_gate.settings import Gate, ScoreGate
from nw_gate.stats.baseline.evidence import Reference
from nw_gate.stats.baseline.interval import (
    drop_interval_after,
    drops_ruled_out,
    scene_drop_intervals,
)
from nw_gate.stats.baseline.trials import DrawnTrials
from nw_gate.stats.betting import lower_bound, upper_bound
from nw_gate.stats.interval import Interval
from nw_gate.verdict import ScoreFinding, Verdict, Word, percent_sure


def with_scores(
    verdict: Verdict, rows: Sequence[Row], run: RunInfo, gate: Gate, against: LoadedBaseline | None
) -> Verdict:
    """Return a verdict with the scores of its trials, and with what `gate.scores` makes of it.

    Args:
        verdict: on success. A run that is INFRASTRUCTURE or INVALID stays so.
        rows: those that it is of.
        run: what they are of; its `scores` declare what was measured.
        gate: the settings to judge by.
        against: the baseline, where there is one.
    """
    if not run.scores and not gate.scores:
        return verdict
    if missing := [name for name in gate.scores if name not in run.scores]:
        why = f"{', '.join(missing)} was not measured in this run: run again with this suite"
        reasons = (why, *verdict.reasons)
        return replace(verdict, verdict=worse(verdict.verdict, "INVALID"), reasons=reasons)
    setup = None
    asked = any(one.max_drop is not None for one in gate.scores.values())
    if against is not None and verdict.against is not None and asked:
        setup = setup_of(run, against, gate).on(rows)
    met = None if setup is None else setup.met(rows)
    findings = tuple(
        _finding(spec, gate.scores.get(name), rows, verdict, gate, setup, met)
        for name, spec in run.scores.items()
    )
    verdict = replace(verdict, scores=findings)
    if verdict.verdict in {"INFRASTRUCTURE", "INVALID"}:
        return verdict
    word = verdict.verdict
    for item in findings:
        if item.word is not None:
            word = worse(word, item.word)
    judged = [item for item in findings if item.word is not None]
    verdict = without_unjudged(verdict) if judged else verdict
    judged.sort(key=lambda item: _ORDER.index(item.word or "PASS"), reverse=True)
    told = [reason for item in judged for reason in item.reasons]
    told += [reason for item in findings if item.word is None for reason in item.reasons]
    return reworded(verdict, word, told)


def without_unjudged(verdict: Verdict) -> Verdict:
    """Return a verdict without the reason that nothing was judged, true of success alone."""
    kept = tuple(
        each
        for each in verdict.reasons
        if "nothing was judged" not in each and "no bar was judged" not in each
    )
    return replace(verdict, reasons=kept)


def reworded(verdict: Verdict, word: Word, told: Sequence[str]) -> Verdict:
    """Return a verdict with another word and more reasons; these come first if they made it."""
    first = word not in {verdict.verdict, "PASS"}
    reasons = (*told, *verdict.reasons) if first else (*verdict.reasons, *told)
    return replace(verdict, verdict=word, reasons=reasons)


_ORDER: tuple[Word, ...] = (
    "RAN",
    "PASS",
    "INCONCLUSIVE",
    "REGRESSED",
    "INFRASTRUCTURE",
    "INVALID",
)


def worse(one: Word, other: Word) -> Word:
    """Return the word of two findings together, of which a PASS needs both."""
    return one if _ORDER.index(one) >= _ORDER.index(other) else other


def counted(trial: Row | Start, *, spec: ScoreSpec) -> float | None:
    """Return a trial's score scaled to [0, 1], None where the trial has no result.

    A policy that failed by itself counts as the score says of what is undefined.
    """
    if trial.success is None:
        return None
    value = None if trial.outcome == "policy_failed" else dict(trial.scores).get(spec.name)
    return spec.scaled(value)


def _finding(
    declared: ScoreSpec,
    asked: ScoreGate | None,
    rows: Sequence[Row],
    verdict: Verdict,
    gate: Gate,
    setup: ComparisonSetup | None,
    met: Met | None,
) -> ScoreFinding:
    spec = declared if asked is None else asked.spec(declared)
    scenes: dict[str, list[float]] = {}
    worst: dict[str, list[float]] = {}
    best: dict[str, list[float]] = {}
    undefined = kept = 0
    for row in sorted(rows, key=lambda row: row.trial_id):
        value = counted(row, spec=spec)
        if value is None or gate.tier(row.scene) == "informational":
            continue
        left = row.trial_id in verdict.left
        worst.setdefault(row.scene, []).append(0.0 if left else value)
        best.setdefault(row.scene, []).append(1.0 if left else value)
        if not left:
            scenes.setdefault(row.scene, []).append(value)
            undefined += spec.name not in dict(row.scores)
            kept += value == 1.0
    low = lower_bound(_arrays(worst), gate.confidence)
    high = upper_bound(_arrays(best), 1.0 - (1.0 - gate.confidence) / gate.shared)
    mean = float(np.mean([np.mean(each) for each in scenes.values()])) if scenes else None
    ends = sorted((spec.unscaled(low), spec.unscaled(high)))
    finding = ScoreFinding(
        spec=spec,
        trials=sum(map(len, scenes.values())),
        undefined=undefined,
        kept=kept,
        mean=None if mean is None else spec.unscaled(mean),
        interval=Interval(*ends),
        per_scene={scene: spec.unscaled(float(np.mean(each))) for scene, each in scenes.items()},
        bar=None if asked is None else asked.bar,
        max_drop=None if asked is None else asked.max_drop,
    )
    if asked is None:
        return finding
    words: list[Word] = []
    reasons: list[str] = []
    if asked.bar is not None:
        word, reason = _by_bar(spec, asked.bar, low, high, gate)
        words.append(word)
        reasons.append(reason)
        if alone := _below_alone(spec, asked.bar, best, verdict, gate):
            words.append("REGRESSED")
            reasons += alone
    if asked.max_drop is not None and setup is not None and met is not None:
        word, reason, finding = _by_baseline(finding, asked, asked.max_drop, gate, setup, met)
        words.append(word)
        reasons.append(reason)
    elif asked.max_drop is not None:
        reasons.append(
            f"{spec.name}: max_drop {asked.max_drop:g} was ignored, there is no baseline"
        )
    word = max(words, key=_ORDER.index) if words else None
    if len(words) == len(reasons):  # What decided comes first.
        ranked = sorted(zip(words, reasons, strict=True), key=lambda x: -_ORDER.index(x[0]))
        reasons = [reason for _, reason in ranked]
    return replace(finding, word=word, reasons=tuple(reasons))


def lacks_score(baseline: BaselineResults, name: str) -> str:
    """Return that a baseline was saved before its suite measured a score."""
    return f"the baseline {baseline.manifest.name} has no {name}"


def _arrays(groups: Mapping[str, Sequence[float]]) -> list[NDArray[np.float64]]:
    return [np.array(each, dtype=np.float64) for each in groups.values()]


def _by_bar(spec: ScoreSpec, bar: float, low: float, high: float, gate: Gate) -> tuple[Word, str]:
    """Return what the bounds of a scaled mean say of a bar in the score's unit."""
    share = spec.scaled(bar)
    least, most = ("at least", "at most") if spec.better == "higher" else ("at most", "at least")
    name, unit = spec.name, f" {spec.unit}" if spec.unit else ""
    if low >= share:
        sure = percent_sure(1.0 - gate.confidence)
        return "PASS", (
            f"{name} is {least} {spec.unscaled(low):.4g}{unit} ({sure} confidence), the bar is "
            f"{bar:g}"
        )
    if high < share:
        sure = percent_sure((1.0 - gate.confidence) / gate.shared)
        return "REGRESSED", (
            f"{name} is {most} {spec.unscaled(high):.4g}{unit} ({sure} confidence), the bar is "
            f"{bar:g}"
        )
    ends = sorted((spec.unscaled(low), spec.unscaled(high)))
    return "INCONCLUSIVE", (
        f"{name}: the bar {bar:g} lies between its bounds, {ends[0]:.4g} and {ends[1]:.4g}{unit}"
    )


def _below_alone(
    spec: ScoreSpec,
    bar: float,
    best: Mapping[str, Sequence[float]],
    verdict: Verdict,
    gate: Gate,
) -> list[str]:
    """Return a sentence for each critical scene that is beyond the bar by itself."""
    critical = [item.scene for item in verdict.per_scene if gate.tier(item.scene) == "critical"]
    alpha = (1.0 - gate.confidence) / (max(1, len(critical)) * gate.shared)
    sentences: list[str] = []
    for scene in critical:
        if not best.get(scene):
            continue
        high = upper_bound(_arrays({scene: best[scene]}), 1.0 - alpha)
        if high < spec.scaled(bar):
            most, unit = "at most" if spec.better == "higher" else "at least", spec.unit
            sentences.append(
                f"critical scene {scene} alone: {spec.name} is {most} {spec.unscaled(high):.4g}"
                f"{' ' if unit else ''}{unit} ({percent_sure(alpha)} confidence), the bar is "
                f"{bar:g}"
            )
    return sentences


def _between(low: float, high: float) -> str:
    """Return the changes for the worse that are possible."""
    if low <= 0.0:
        return f"at most {max(high, 0.0):.4g} worse"
    return f"{low:.4g} to {high:.4g} worse"


def _fallen_alone(
    spec: ScoreSpec,
    max_drop: float,
    gate: Gate,
    judged: Sequence[Stratum],
    reference: Reference,
    seen: DrawnTrials,
) -> list[str]:
    """Return a sentence for each critical scene whose own drop is certainly over `max_drop`.

    Each is tested at alpha_regr / S, S all scenes that count: as scenes are named by success.
    """
    critical = [place for place, each in enumerate(judged) if gate.tier(each[0]) == "critical"]
    if not critical:
        return []
    alpha = gate.false_alarm / gate.shared / len(judged)
    own = seen.at(np.flatnonzero(np.isin(seen.scenes, critical)).tolist())
    drops = scene_drop_intervals(reference, own, alpha_pass=1.0 - gate.confidence, alpha_regr=alpha)
    unit = f" {spec.unit}" if spec.unit else ""
    sentences: list[str] = []
    for place in critical:
        low = drops[place].low * spec.width
        if low <= max_drop:
            continue
        scene, changed = judged[place]
        name = " ".join([scene, *(f"{axis} {value:g}" for axis, value in changed)])
        there = own.at(np.flatnonzero(own.scenes == place).tolist())
        before = there.baseline if reference.paired else reference.means[there.scenes]
        pairs = ~np.isnan(before - there.candidate)
        was, mean = (spec.unscaled(float(each[pairs].mean())) for each in (before, there.candidate))
        sentences.append(
            f"critical scene {name} alone: {spec.name} "
            f"{was:.4g} -> {mean:.4g}{unit} in {plural(int(pairs.sum()), 'trial')}, at least "
            f"{low:.4g} worse ({percent_sure(alpha)} confidence), max_drop {max_drop:g}"
        )
    return sentences


def _by_baseline(
    finding: ScoreFinding,
    asked: ScoreGate,
    max_drop: float,
    gate: Gate,
    setup: ComparisonSetup,
    met: Met,
) -> tuple[Word, str, ScoreFinding]:
    """Return what the trials say of a score's change against the baseline."""
    spec = finding.spec
    name, unit = spec.name, f" {spec.unit}" if spec.unit else ""
    if setup.basis != "control" and name not in setup.results.manifest.scores:
        why = f"{lacks_score(setup.results, name)}: save it again with "
        return "INVALID", f"{why}`{renewing(setup.run, setup.results)}`", finding
    if setup.basis == "same":
        return "PASS", f"{name}: same policy as the baseline, nothing to compare", finding
    value = partial(counted, spec=spec)
    met, judged = replace(met, counted=value), setup.judged
    reference = reference_of(setup.panel, judged, setup.basis, setup.claim, value)
    trials = numbers_of(met, judged, setup.panel, setup.basis, reference)
    ended = np.flatnonzero(met.ended(met.places(judged).tolist())).tolist()
    seen = trials.at(ended)
    known = seen.baseline if reference.paired else reference.means[seen.scenes]
    pairs = ~np.isnan(known - seen.candidate)
    if not pairs.any():
        return "INCONCLUSIVE", f"{name}: no trial has been compared with the baseline", finding
    level = (
        float(known[pairs].mean())
        if reference.paired
        else float(np.mean([scores_of(setup.panel, stratum, value).mean() for stratum in judged]))
    )
    if level * spec.width <= max_drop:
        reason = (
            f"{name}: no policy can be worse than the baseline's {spec.unscaled(level):.4g}{unit} "
            f"by {max_drop:g}, so near is the end of its range: lower max_drop"
        )
        return "INVALID", reason, finding
    alpha_pass, alpha_regr = 1.0 - gate.confidence, gate.false_alarm / gate.shared
    drops = drop_interval_after(
        reference,
        seen,
        alpha_pass=alpha_pass,
        alpha_regr=alpha_regr,
        # Within a round the order of scenes is fixed, and a bet that learns would know it.
        learns=not setup.goes_by_rounds,
    )
    mean = float(seen.candidate[pairs].mean())
    drop = float((known - seen.candidate)[pairs].mean()) * spec.width
    low, high = drops.low * spec.width, drops.high * spec.width
    finding = replace(
        finding,
        baseline=spec.unscaled(level),
        drop=drop,
        drops=Interval(low, high),
    )
    change = (
        f"{name} {spec.unscaled(level):.4g} -> {spec.unscaled(mean):.4g}{unit} in "
        f"{plural(int(pairs.sum()), 'trial')}, max_drop {max_drop:g}"
    )
    if alone := _fallen_alone(spec, max_drop, gate, judged, reference, seen):
        return "REGRESSED", "; ".join((*alone, change)), finding
    if high < max_drop:
        sure = percent_sure(alpha_pass)
        return "PASS", f"{change}: at most {max(high, 0.0):.4g} worse ({sure} confidence)", finding
    if low > asked.tolerated:
        sure = percent_sure(alpha_regr)
        return "REGRESSED", f"{change}: at least {low:.4g} worse ({sure} confidence)", finding
    return (
        "INCONCLUSIVE",
        f"{change}: too few trials to decide, {_between(low, high)}",
        finding,
    )


@dataclass(frozen=True, kw_only=True)
class ScoreForecast:
    """What a gate makes of policies whose score is worse by some changes, by simulation."""

    spec: ScoreSpec
    """With the range that counts."""
    level: float
    """The baseline's mean, in the score's unit."""
    max_drop: float
    tolerate: float
    trials: int
    """Of each gate."""
    gates: int
    """That were simulated at each change."""
    points: tuple[tuple[float, float, float], ...]
    """Change for the worse, in the score's unit, and the shares that pass and are REGRESSED."""


_GATES = 200
_CHANGES = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Of max_drop, beside none and what is tolerated."""


def forecast_scores(
    baseline: BaselineResults, declared: Mapping[str, ScoreSpec], gate: Gate
) -> tuple[ScoreForecast, ...]:
    """Return what the gate makes of each score that it compares with a baseline.

    A candidate's trial has the value of a start of the baseline, drawn at random in its scene, less
    the change; values stay within the range, so that where many are at its end the true change is
    less. As many trials as the budget has are drawn, all of them looked at once.

    Args:
        baseline: to compare with; scores that it lacks are left out.
        declared: what the suite measures.
        gate: of the suite.
    """
    panel = baseline.panels[0]
    judged = strata_that_count(tuple(panel.by_stratum), gate)
    forecasts: list[ScoreForecast] = []
    for name, asked in gate.scores.items():
        if asked.max_drop is None or name not in baseline.manifest.scores or not judged:
            continue
        spec = asked.spec(declared[name])
        values = np.array(
            [scores_of(panel, stratum, partial(counted, spec=spec)) for stratum in judged]
        )
        known = Reference.of(values).fresh()
        rng = np.random.Generator(np.random.PCG64(len(forecasts)))
        total = gate.rounds_for(len(judged), baseline.manifest.starts) * len(judged)
        points: list[tuple[float, float, float]] = []
        changes = sorted({asked.tolerated, *(share * asked.max_drop for share in _CHANGES)})
        for change in changes:
            words = [
                _simulated(known, values, change / spec.width, rng, total, asked, spec, gate)
                for _ in range(_GATES)
            ]
            points.append((change, words.count("PASS") / _GATES, words.count("REGRESSED") / _GATES))
        forecasts.append(
            ScoreForecast(
                spec=spec,
                level=spec.unscaled(float(known.means.mean())),
                max_drop=asked.max_drop,
                tolerate=asked.tolerated,
                trials=total,
                gates=_GATES,
                points=tuple(points),
            )
        )
    return tuple(forecasts)


def _simulated(
    reference: Reference,
    values: NDArray[np.float64],
    drop: float,
    rng: np.random.Generator,
    total: int,
    asked: ScoreGate,
    spec: ScoreSpec,
    gate: Gate,
) -> Word:
    scenes = rng.integers(len(values), size=total)
    starts = rng.integers(values.shape[1], size=total)
    drawn = DrawnTrials(
        candidate=np.clip(values[scenes, starts] - drop, 0.0, 1.0),
        baseline=reference.means[scenes],
        scenes=scenes,
    )
    above, below = drops_ruled_out(
        reference,
        drawn,
        (asked.tolerated / spec.width, (asked.max_drop or 0.0) / spec.width),
        alpha_pass=1.0 - gate.confidence,
        alpha_regr=gate.false_alarm / gate.shared,
        learns=True,
    )
    return "PASS" if below else "REGRESSED" if above else "INCONCLUSIVE"
