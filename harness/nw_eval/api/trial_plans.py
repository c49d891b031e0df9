"""How many trials a gate takes, what it can see, and into which parts a run goes. Runs nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.errors import IncomparableError, UsageError
from nw_eval.api.paths import as_path
from nw_eval.api.renamed import keywords_were

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from nw_eval.api.proposals import MeasuredPolicy
    from nw_eval.engine.plan import Forecast, Plan
    from nw_eval.suite import Suite
    from nw_gate.baseline.informative import Item, Proposal
    from nw_gate.baseline.power_forecast import Outset
    from nw_gate.baseline.scores import ScoreForecast
    from nw_gate.results.request import Request
    from nw_gate.stats.baseline.curve import CurvePoint, Progress


@dataclass(frozen=True, kw_only=True)
class TrialPlan:
    """What a gate against a baseline takes and sees, by simulation."""

    suite: str
    source: str
    """What it is computed from: a baseline or a run, as text."""
    outset: Outset
    """What is known before the first trial: the baseline's scores, margins, budget."""
    detect: float
    """The drop that is asked about."""
    dropped: Progress
    """How soon policies of that drop are judged, with all starts of the baseline run."""
    equal: Progress
    """How soon equal ones are."""
    curve: tuple[CurvePoint, ...]
    resolved: Plan
    """What a run of the suite would be."""
    workers: int | None
    scores: tuple[ScoreForecast, ...] = ()
    """What it makes of each gated score."""
    items: tuple[Item, ...] = ()
    """What a trial of each scene, and of each measured rung, says of a policy of the drop."""
    proposal: Proposal | None = None
    """A suite that costs as much and finds the drop in fewer trials, where one was asked for."""
    ladders: tuple[str, ...] = ()
    """Ladders of the same classes, none of which was measured."""
    policy: str = ""
    """What a command calls the policy that was measured; empty where that is not known."""

    def minutes(self, trials: float) -> float:
        """Return about how many minutes so many trials take at most."""
        from nw_eval.engine.plan import minutes_of

        return minutes_of(trials, self.resolved, workers=self.workers)


@dataclass(frozen=True, kw_only=True)
class BarPlan:
    """What a gate that has a bar and no baseline takes and sees, by simulation."""

    suite: str
    bar: float
    confidence: float
    scenes: int
    """Those that count, each as often as it has cells of perturbations."""
    trials: int
    """Of each of them, as the suite has it."""
    needed: int
    """Of each of them, so that a policy that never fails passes."""
    sizes: tuple[int, ...]
    """Numbers of trials that `curve` is about: the needed ones, the suite's, and more."""
    curve: tuple[tuple[float, tuple[float, ...]], ...]
    """True success, the same in all scenes, and how often such a policy passes at each size."""
    obstacles: tuple[str, ...]
    """Why no policy can pass the suite as it is; none where one can."""


@keywords_were(png="out")
def plan_trials(
    suite: str | Path | Suite,
    *,
    detect: float | None = None,
    baseline: str | None = None,
    run: str | Path | None = None,
    out: str | PathLike[str] | None = None,
    workers: int | None = None,
    limits: Sequence[str | PathLike[str]] = (),
    write_suite: str | PathLike[str] | None = None,
) -> TrialPlan | BarPlan:
    """Return how many trials it takes to flag a drop, and what else the suite's gate sees.

    Of a suite that has a bar, and neither names a baseline nor has one, it says what the bar takes.

    `plan` resolves a request to its trials; this one says how many would be needed.

    Args:
        suite: a file, the name of a shipped one, or one that was read already.
        detect: drop of mean success (default: the suite's `gate.max_drop`).
        baseline: the baseline to compare with, by name or path (default: the suite's, else its only
            one).
        run: a run's folder instead of a baseline: what it scored is taken for the baseline's
            success.
        out: file to draw the curve into.
        workers: processes assumed for the estimate in minutes (default: one per core).
        limits: folders of `nw-eval limits` of the same policy; a suite is proposed, in which their
            rungs may replace scenes that tell nothing.
        write_suite: file to write a proposed suite to; it takes the file's name.

    Raises:
        UsageError: there is neither a baseline nor a run, the run is a part of one, no policy can
            drop by `detect`, or no suite can be proposed and one is to be written.
        SuiteError, PolicyError: as `plan`.
        StoreError: the baseline or the run is damaged, or the picture cannot be written.
        IncomparableError: the baseline or the run has other scenes than the suite.
    """
    from nw_eval.api.loaded_baselines import NO_BASELINE
    from nw_eval.api.plans import plan
    from nw_eval.engine.how import check_workers

    out, file = as_path(out), as_path(write_suite)
    check_workers(workers)
    if baseline is not None and run is not None:
        raise UsageError("--baseline and --run exclude each other", fix="drop one of them")
    resolved = plan(suite, baseline=NO_BASELINE)  # The baseline is here what is asked about.
    gate = resolved.suite.gate
    if run is None and detect is None and (baseline or gate.baseline) in {None, NO_BASELINE}:
        from nw_gate.results.baseline_file import baseline_files

        asked_for = baseline == NO_BASELINE
        if gate.success_rate is not None and (asked_for or not baseline_files(resolved.suite.name)):
            if out is not None:
                raise UsageError(
                    "--out without a baseline: the curve is of drops against one",
                    fix="name a baseline with --baseline, or a run of the suite with --run",
                )
            if limits or file is not None:
                raise UsageError(
                    "no baseline to propose a suite with",
                    fix="name one with --baseline, or a run of the suite with --run",
                )
            return _of_bar(resolved, gate.success_rate)
    policy, outset = (
        _of_baseline(resolved, baseline or resolved.suite.gate.baseline)
        if run is None
        else _of_run(resolved, Path(run))
    )
    drop = outset.rules.margins.max_drop if detect is None else detect
    if not 0.0 < drop < outset.baseline:
        raise UsageError(
            f"--detect {drop:g}: the baseline's mean success is {outset.baseline:.3f}",
            fix="give a drop between 0 and that",
        )
    planned = TrialPlan(
        suite=resolved.suite.name,
        source=policy.source,
        outset=outset,
        detect=drop,
        dropped=outset.progress(drop),
        equal=outset.progress(0.0),
        curve=outset.curve(),
        resolved=resolved,
        workers=workers,
    )
    if run is None and gate.scores:
        planned = replace(planned, scores=_of_scores(resolved, baseline or gate.baseline))
    planned = _proposed(planned, policy, [Path(each) for each in limits], file)
    if out is not None:
        _draw(planned, out)
    return planned


def _proposed(
    planned: TrialPlan, policy: MeasuredPolicy, limits: Sequence[Path], file: Path | None
) -> TrialPlan:
    """Return a plan with what scenes tell; with a proposed suite where one is asked for."""
    from nw_eval.api import proposals
    from nw_gate.baseline.informative import items_of, propose

    resolved, outset = planned.resolved, planned.outset
    scenes = [scene.name for scene in resolved.scenes]
    measured = proposals.measured_rungs(limits, policy, resolved.suite.robot, scenes)
    items = items_of(outset, planned.detect, measured.rungs)
    planned = replace(planned, items=items, policy=policy.typed)
    if not measured.rungs:
        planned = replace(planned, ladders=proposals.ladders_like(scenes))
    if not limits and file is None:
        return planned
    if resolved.suite.perturb.cells != ((),):
        raise UsageError(
            f"suite {planned.suite!r} has perturbations, and a suite is proposed only without",
            fix="drop --limits and --write-suite, or leave `perturb` out of the suite",
        )
    if file is not None:
        proposals.check_name(file, planned.suite)
    found = propose(outset, items, planned.detect)
    if file is not None:
        if found is None:
            raise UsageError(
                f"--write-suite {file}: no suite of these scenes finds a drop of "
                f"{planned.detect:g} in fewer trials",
                fix="measure rungs with `nw-eval limits`, and name its folder with --limits",
            )
        proposals.write_proposal(file, resolved, found, policy, measured.seeds)
    return replace(planned, proposal=found)


def _of_scores(resolved: Plan, reference: str | None) -> tuple[ScoreForecast, ...]:
    """Return what the gate makes of each score that it compares with a baseline."""
    from nw_gate.baseline.scores import forecast_scores
    from nw_gate.results.baseline_file import read_baseline

    baseline = read_baseline(_baseline_file(resolved.suite, reference))
    return forecast_scores(baseline, resolved.suite.measured, resolved.suite.gate)


def _of_bar(resolved: Plan, bar: float) -> BarPlan:
    """Return what the bar of a suite takes and sees; courses are as long as its scenes' trails."""
    import numpy as np

    from nw_eval.engine.plan import obstacles_of
    from nw_gate.absolute import trials_to_pass
    from nw_gate.stats.power import SceneCounts, shares_at

    suite = resolved.suite
    gate, cells = suite.gate, len(suite.perturb.cells)
    judged = [each for each in resolved.scenes if gate.tier(each.name) != "informational"]
    strata = len(judged) * cells
    needed = trials_to_pass(gate, strata) if strata else 0
    sizes = sorted({needed, suite.trials, *(most * suite.trials for most in (2, 4))} - {0})

    def passed(success: float, size: int) -> float:
        courses = [
            SceneCounts(
                counts=np.bincount([len(each.trail)], [size * cells]).astype(np.int64),
                alone=gate.tier(each.name) == "critical",
            )
            for each in judged
        ]
        return shares_at(courses, success, bar=bar, confidence=gate.confidence).passed

    truths = [round(bar + share * (1.0 - bar), 4) for share in (0.0, 0.2, 0.4, 0.6, 0.8, 0.96)]
    return BarPlan(
        suite=suite.name,
        bar=bar,
        confidence=gate.confidence,
        scenes=strata,
        trials=suite.trials,
        needed=needed,
        sizes=tuple(sizes),
        curve=tuple(
            (truth, tuple(passed(truth, size) for size in sizes)) for truth in truths if judged
        ),
        obstacles=obstacles_of(resolved),
    )


def _draw(planned: TrialPlan, png: Path) -> None:
    from nw_eval.reporting.pictures import draw_curve

    outset = planned.outset
    draw_curve(
        planned.curve,
        png,
        margins=outset.rules.margins,
        title=f"{planned.suite}, success {outset.baseline:.3f}: {outset.in_words}",
    )


def _of_baseline(resolved: Plan, reference: str | None) -> tuple[MeasuredPolicy, Outset]:
    """Return whose results a baseline has, and what is known with it."""
    from nw_eval.api.proposals import MeasuredPolicy
    from nw_gate.baseline.power_forecast import outset_of_baseline
    from nw_gate.results.baseline_file import read_baseline

    suite = resolved.suite
    baseline = read_baseline(_baseline_file(suite, reference))
    manifest, own = baseline.manifest, baseline.manifest.policy
    policy = MeasuredPolicy(
        source=f"baseline {manifest.name} of {own.name}",
        name=own.name,
        typed="" if own.typed == "PATH" else own.typed,
        digests=(own.checkpoint_digest, own.card_digest),
        key=manifest.key,
    )
    _check(resolved, policy)
    return policy, outset_of_baseline(baseline.panels[0], suite.gate)


def _baseline_file(suite: Suite, reference: str | None) -> Path:
    from nw_eval.api.loaded_baselines import NO_BASELINE
    from nw_gate.results.baseline_file import find_baseline

    if reference is None or reference == NO_BASELINE:
        return _only_baseline(suite.name)
    return find_baseline(reference, suite=suite.name)


def _only_baseline(suite: str) -> Path:
    """Return the baseline that a suite which names none can be planned with.

    Raises:
        UsageError: it has none, or several.
    """
    from nw_gate.results.baseline_file import baseline_files

    files = baseline_files(suite)
    if len(files) == 1:
        return files[0]
    there = f"has {', '.join(sorted({file.stem for file in files}))}" if files else "has none"
    raise UsageError(
        f"suite {suite!r} names no baseline to plan with, and {there}",
        fix="name one with --baseline, or a run of the suite with --run",
    )


def _of_run(resolved: Plan, folder: Path) -> tuple[MeasuredPolicy, Outset]:
    """Return whose results a run has, and what is known with it."""
    from nw_eval.api.baselines_saved import starts_for
    from nw_eval.api.proposals import MeasuredPolicy
    from nw_eval.api.saved_run import check_whole, saved_rows
    from nw_gate.baseline.power_forecast import outset_of_rows
    from nw_gate.results.baseline import key_of
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import open_run_folder

    opened = open_run_folder(folder)
    info = check_whole(read_run_info(opened.run_json))
    rows = saved_rows(opened, info)
    policy = MeasuredPolicy(
        source=f"run {info.id} of {info.policy.name}",
        name=info.policy.name,
        typed="",
        digests=(info.policy.checkpoint_digest, info.policy.card_digest),
        key=key_of(info),
    )
    _check(resolved, policy)
    return policy, outset_of_rows(
        rows,
        resolved.suite.gate,
        starts_for(len(policy.key.scenes) * len(resolved.suite.perturb.cells)),
    )


def _check(resolved: Plan, policy: MeasuredPolicy) -> None:
    """Refuse trials of another suite.

    Raises:
        IncomparableError: naming what differs.
    """
    suite_digest, scenes = policy.key.suite_digest, policy.key.scenes
    suite, ours = resolved.suite, {scene.name: scene.digest for scene in resolved.scenes}
    differing = sorted(name for name, _ in {*ours.items()} ^ {*scenes.items()})
    if differing:
        fault = f"scene {differing[0]} is in one of them only, or has changed"
    elif suite_digest != suite.digest:
        fault = f"its suite digest is {suite_digest[:8]}, here it is {suite.digest[:8]}"
    else:
        return
    raise IncomparableError(
        f"{policy.source} is not of suite {suite.name!r} as it is: {fault}",
        fix=f"repeat it with `nw-eval run {suite.name}` or `nw-eval baseline save {suite.name}`",
    )


@dataclass(frozen=True, kw_only=True)
class ShardPlan:
    """The parts of a run, in their order: what each of them would be."""

    suite: str
    """As it was asked for."""
    parts: tuple[Forecast, ...]

    @property
    def trials(self) -> int:
        """Of all parts."""
        return sum(part.trials for part in self.parts)


def plan_shards(
    request: Request | str | Path, shards: int, *, workers: int | None = None, **changes: Any
) -> ShardPlan:
    """Return the parts of a run: their trials, and about how long each takes.

    Args:
        request: as for `plan`.
        shards: how many parts.
        workers: processes of each shard assumed for the estimate (default: one per core).
        changes: fields of `Request` by name.

    Raises:
        UsageError: there would be no part, or parts without a trial; or as `plan`.
        SuiteError, PolicyError: as `plan`.
    """
    from nw_eval.api.plans import plan
    from nw_eval.engine.how import check_workers
    from nw_eval.engine.order import shards_of
    from nw_eval.engine.plan import forecast
    from nw_gate.results.request import Request

    check_workers(workers)
    whole = plan(Request.of(request, **changes, shard=None))
    parts = [
        replace(whole, trials=trials, shard=shard)
        for trials, shard in shards_of(whole.trials, shards)
    ]
    return ShardPlan(
        suite=str(whole.request.suite or whole.suite.name),
        parts=tuple(forecast(part, workers=workers) for part in parts),
    )
