"""Comparing policies, with each other and with the robot. Needs no simulation.

Runs and baselines go in; ranks and where policies part, or the agreement with results on the robot,
come out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.errors import UsageError, nearest

if TYPE_CHECKING:
    from nw_eval.reporting.html.limits import LadderLimit
    from nw_gate.limits.limit import Limit
    from nw_gate.limits.with_robot import MeasuredLimit
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.real import RealLimit
    from nw_gate.results.row import Row
    from nw_gate.side_by_side import Entrant, PolicyComparison
    from nw_gate.stats.agreement import Agreement


def compare(
    runs: Sequence[str | Path],
    *,
    out: str | Path | None = None,
    picture: str | Path | None = None,
    confidence: float = 0.95,
) -> PolicyComparison:
    """Compare the policies of two or more runs or baselines of one suite, side by side.

    They are compared on the starts that all have a result from. Nothing is judged.

    Args:
        runs: run folders, and baselines by path or, beside a run, by name. Each is compared with
            the first.
        out: write a Markdown page here.
        picture: write a PNG of all scenes and policies here.
        confidence: confidence level, per interval and jointly for ranks.

    Raises:
        UsageError: there are fewer than two, one is neither a run nor a baseline, or the confidence
            is not between 0 and 1.
        IncomparableError: they differ in suite, scenes, starts or simulator; each field is named.
        StoreError: rows are damaged, or a page cannot be written.
    """
    from nw_gate.side_by_side import side_by_side

    check_share(confidence)
    comparison = side_by_side(entrants(runs), confidence)
    if out is not None:
        from nw_base.files.cache import followed
        from nw_eval.reporting.markdown import write_report
        from nw_eval.reporting.side_by_side import comparison_page

        write_report(followed(Path(out)), comparison_page(comparison))
    if picture is not None:
        from nw_eval.reporting.pictures import draw_comparison

        draw_comparison(comparison, Path(picture))
    return comparison


def check_share(confidence: float) -> None:
    """Refuse a confidence that is no probability, such as 95.

    Raises:
        UsageError: it is not between 0 and 1.
    """
    if not 0.0 < confidence < 1.0:
        raise UsageError(f"confidence {confidence} is not between 0 and 1", fix="0.95 is 95 %")


def entrants(sources: Sequence[str | Path]) -> list[Entrant]:
    """Return the policies of runs and baselines, in this order.

    Raises:
        UsageError, IncomparableError, StoreError: as `compare`.
    """
    from nw_gate.side_by_side import entrant_of_run

    runs = {str(source): _run(Path(source)) for source in sources}
    infos = [run[0] for run in runs.values() if run is not None]
    return [
        _baseline(source, infos) if run is None else entrant_of_run(source, *run)
        for source, run in ((str(source), runs[str(source)]) for source in sources)
    ]


def _run(path: Path) -> tuple[RunInfo, Sequence[Row], Mapping[str, Limit]] | None:
    """Return a run's provenance, rows and limits; None for what is not a run folder."""
    from nw_eval.api.limit_gates import run_limits
    from nw_eval.api.saved_run import saved_rows
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import open_run_folder

    try:
        folder = open_run_folder(path)
    except UsageError:
        if path.is_dir():
            raise
        return None
    info = read_run_info(folder.run_json)
    return info, saved_rows(folder, info), run_limits(folder, info)


def _baseline(source: str, runs: Sequence[RunInfo]) -> Entrant:
    """Return a baseline, on the machine type of the first run if it has been there."""
    from nw_gate.results.baseline import machine_of
    from nw_gate.results.baseline_file import find_baseline, read_baseline
    from nw_gate.side_by_side import entrant_of_baseline

    if not runs and "/" not in source and not source.endswith(".parquet"):
        raise UsageError(
            f"{source} is not a run folder, and without a run no baseline is known by its name",
            fix="name the baseline's file",
        )
    try:
        path = find_baseline(source, suite=str(runs[0].suite.get("name", "")) if runs else "")
    except UsageError as error:
        raise UsageError(
            f"{source} is not a run folder, and {error.message}", fix=error.fix
        ) from None
    baseline = read_baseline(path)
    panel = (baseline.panel_of(machine_of(runs[0])) if runs else None) or baseline.panels[0]
    return entrant_of_baseline(source, baseline, panel)


def sim2real(
    real: str | Path,
    runs: Sequence[str | Path],
    *,
    confidence: float = 0.95,
    score: str | None = None,
) -> Agreement:
    """Say how well the simulator ranks policies as the robot does.

    A policy of the CSV is named as in its run, or by the name of its run's folder or its baseline;
    with limits, as `nw-eval limits` names it.

    Args:
        real: a CSV with the columns policy, scene, trials, success (0 to 1). For limits: policy,
            ladder, and limit (or lower, cleared, and upper, not cleared) in the ladder's unit.
        runs: run folders, and baselines by path or, beside a run, by name; or folders of
            `nw-eval limits`; other policies are ignored.
        confidence: confidence level, per interval.
        score: compare this score of the runs in place of success; the CSV has a column of that
            name, in the score's unit. Gaps are in that unit.

    Raises:
        UsageError: the CSV is none, or names a policy, scene or ladder that no run has; there is no
            run, or limits are among them and runs, too; or the confidence is not between 0 and 1.
        IncomparableError: the runs differ in suite, scenes or simulator; each field is named.
        StoreError: rows are damaged.
    """
    from nw_eval.api.saved_limits import limits_file
    from nw_gate.results.real import read_real_results
    from nw_gate.side_by_side import measured, score_of
    from nw_gate.stats.agreement import agreement
    from nw_gate.stats.interval import Interval

    check_share(confidence)
    if not runs:
        raise UsageError("no run to compare the robot with", fix="name the runs of its policies")
    limits = [path for path in map(Path, runs) if limits_file(path)]
    if limits:
        return _of_limits(Path(real), limits, [str(x) for x in runs], confidence, score)
    policies = entrants(runs)
    spec = None if score in {None, "success"} else score_of(str(score), policies)
    results = read_real_results(Path(real), spec)
    agreed = agreement(measured(results, policies, spec), confidence)
    if spec is None:
        return agreed
    sign = spec.width if spec.better == "higher" else -spec.width
    gaps = tuple(
        replace(
            gap,
            value=sign * gap.value,
            interval=Interval(*sorted((sign * gap.interval.low, sign * gap.interval.high))),
        )
        for gap in agreed.gaps
    )
    return replace(agreed, gaps=gaps, score=spec.name, unit=spec.unit)


def _of_limits(
    real: Path, folders: Sequence[Path], given: Sequence[str], confidence: float, score: str | None
) -> Agreement:
    """Return how well simulated limits agree with those of the robot.

    Args:
        real: the CSV.
        folders: of limits.
        given: all that was named.
        confidence: as for `sim2real`.
        score: as there.
    """
    from nw_eval.api.saved_limits import read_limits
    from nw_gate.limits.with_robot import agreement_of_limits
    from nw_gate.results.real import read_real_limits

    if len(folders) < len(given):
        other = next(each for each in given if Path(each) not in folders)
        raise UsageError(
            f"{folders[0]} holds limits, and {other} does not",
            fix="compare limits and runs one after the other",
        )
    if score is not None:
        raise UsageError(f"--score {score} with limits", fix="drop --score")
    saved = [each for folder in folders for each in read_limits(folder)]
    measured = [_measured_limit(line, saved) for line in read_real_limits(real)]
    return agreement_of_limits(measured, confidence)


def _measured_limit(line: RealLimit, saved: Sequence[LadderLimit]) -> MeasuredLimit:
    """Return a limit of the robot with the simulated one of that policy and ladder.

    Raises:
        UsageError: there is none, or two; or the cleared value is harder than the failed one.
    """
    from nw_gate.limits.with_robot import MeasuredLimit

    own = [each for each in saved if each.policy == line.policy]
    if not own:
        raise UsageError(
            f"{line.place}: policy {line.policy!r} has no limit in the simulator",
            fix=nearest(line.policy, {each.policy for each in saved}),
        )
    found = [each for each in own if each.ladder == line.ladder]
    if not found:
        raise UsageError(
            f"{line.place}: {line.policy} has no limit on ladder {line.ladder!r}",
            fix=nearest(line.ladder, {each.ladder for each in own}),
        )
    if len(found) > 1:
        raise UsageError(
            f"{line.place}: the limit of {line.policy} on {line.ladder} is in {found[0].run} "
            f"and in {found[1].run}",
            fix="name one of them",
        )
    limit = found[0].limit
    if line.lower is not None and line.upper is not None:
        harder = line.lower > line.upper if limit.ladder.rises else line.lower < line.upper
        if harder:
            raise UsageError(
                f"{line.place}: lower {line.lower:g} was cleared and is harder than upper "
                f"{line.upper:g}",
                fix="lower is the hardest value that was cleared, upper the easiest that was not",
            )
    return MeasuredLimit(
        policy=line.policy,
        ladder=line.ladder,
        simulated=limit,
        lower=line.lower,
        upper=line.upper,
    )
