"""Judging what ran, and its pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.errors import IncomparableError, NwEvalError, StoreError
from nw_eval.api.paths import as_path

if TYPE_CHECKING:
    from collections.abc import Callable
    from os import PathLike

    from nw_eval.api.evidence import KeptEvidence
    from nw_eval.reporting.html.evidence import LogEvidence
    from nw_eval.suite import Suite
    from nw_gate.results.baseline import BaselinePolicy, LoadedBaseline, Start
    from nw_gate.results.ended import RunRows
    from nw_gate.results.provenance import BaselineInfo, RunInfo
    from nw_gate.results.row import Row
    from nw_gate.results.run_folder import RunFolder
    from nw_gate.verdict import ScoreFinding, Verdict


@dataclass(frozen=True, kw_only=True)
class TrainingStep:
    """Where in a training the checkpoint of a run was written."""

    step: int
    folder: Path
    """Of the watch: what all runs of one training have in common."""


@dataclass(frozen=True, kw_only=True)
class RunReport:
    """A judged run: its verdict, and where its evidence lies."""

    folder: Path
    info: RunInfo
    """Where its rows come from: what run.json says."""
    verdict: Verdict
    rows: tuple[Row, ...]
    page: Path | None
    """Its report in Markdown; None if none was written."""
    html: Path | None = None
    """The same for a browser, in one file beside it; None if none was written."""
    evidence: LogEvidence | None = None
    """What its logs showed on that page; None if none was written."""
    baseline: BaselineInfo | None = None
    """The baseline that it was compared with."""
    rivals: Mapping[str, Row | Start] = field(default_factory=dict[str, "Row | Start"])
    """What the baseline's policy did from the starts of its trials, by their names."""
    baseline_policy: BaselinePolicy | None = None
    """The policy that the baseline was saved with."""
    training: TrainingStep | None = None
    """Of a watched training: trackers show its scores at this step of a curve."""

    @property
    def scores(self) -> dict[str, ScoreFinding]:
        """What was measured beside success, by name: means, bounds, changes, words of the gate."""
        return {item.spec.name: item for item in self.verdict.scores}

    @property
    def interrupted(self) -> bool:
        """Whether a signal ended it."""
        return self.info.interrupted

    @property
    def passed(self) -> bool:
        """Whether nothing speaks against the policy: PASS, or RAN where the suite has no bar."""
        return self.exit_code == 0

    @property
    def exit_code(self) -> int:
        """0 PASS or RAN, 1 REGRESSED, 3 INCONCLUSIVE, 4 errors or missing trials, 5 INVALID."""
        return self.verdict.exit_code

    @property
    def typed_folder(self) -> Path:
        """The folder as one would type it here."""
        return typed(self.folder)

    @property
    def typed_page(self) -> Path | None:
        """The page as one would type it here."""
        return None if self.page is None else typed(self.page)

    @property
    def typed_html(self) -> Path | None:
        """The page for a browser as one would type it here."""
        return None if self.html is None else typed(self.html)

    def __repr__(self) -> str:
        """Return a line; thousands of rows would say no more."""
        return f"RunReport({self.verdict.verdict}, {str(self.typed_folder)!r})"


def report(run: str | Path, *, out: str | PathLike[str] | None = None) -> RunReport:
    """Judge a run as it was begun, by its bar and its baseline, and write its two pages.

    Args:
        run: the run's folder.
        out: the Markdown file to write, with an HTML page beside it (default: the run's report.md
            and report.html).

    Raises:
        StoreError: there is no such run, its rows are damaged, or the report cannot be written.
    """
    from nw_gate.results.run_folder import RunFolder

    out = as_path(out)
    judged = as_begun(run)
    return written(judged, RunFolder(path=judged.folder).report_md if out is None else out)


def prepare_pages() -> None:
    """Import and compile what pages are made with, so that they take a while less afterwards.

    Nothing is raised: what cannot be had, `report` says.
    """
    with suppress(Exception):
        from nw_eval.api import evidence
        from nw_eval.reporting import markdown
        from nw_eval.reporting.html.environment import compile_templates
        from nw_gate.baseline import combine
        from nw_gate.results import parquet

        _ = evidence, combine, markdown, parquet
        compile_templates()


def report_here(run: Path, *, how: Callable[[Path], RunReport] | None = None) -> RunReport:
    """As `report`, of a run that this machine has just made: earlier ones may have its logs, too.

    Args:
        run: its folder.
        how: judges it; None = `as_begun`.

    Raises:
        StoreError: as `report`.
    """
    from nw_eval.api.evidence import KeptEvidence
    from nw_gate.results.run_folder import RunFolder

    judged = (how or as_begun)(run)
    kept = KeptEvidence.of_run(judged.info)
    return written(judged, RunFolder(path=judged.folder).report_md, kept=kept, is_ours=True)


def as_begun(run: str | Path) -> RunReport:
    """Judge a run as it was begun, by its bar and its baseline, and write nothing.

    What of its rows was not judged, or was damaged and has another copy, is among the reasons.
    Where the baseline that it was begun against is gone or does not hold for it the verdict is
    INVALID, and what the bar alone would say is among the reasons. A part of a run is not judged:
    RAN.

    Raises:
        UsageError: it is not a run folder.
        StoreError: its run.json or its rows are damaged.
    """
    from nw_eval.api.loaded_baselines import kept_baseline
    from nw_eval.api.saved_run import saved_suite
    from nw_gate.baseline.combine import without_baseline
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import open_run_folder

    folder = open_run_folder(Path(run))
    info = read_run_info(folder.run_json)
    suite = saved_suite(info)
    try:
        return _judged(folder, info, suite, lambda: kept_baseline(folder, info))
    except IncomparableError as error:
        judged = _judged(folder, info, suite, lambda: None)
        return replace(judged, verdict=without_baseline(judged.verdict, str(error)))


def as_published(run: Path) -> RunReport:
    """Judge a run as `as_begun`, where somebody else may have written its folder.

    Its rows are those of its journal, and the folder is as `nw-eval verify --offline` has it; logs
    may be absent. No link is followed, nothing is written there, and nothing outside is read.

    Raises:
        UsageError: it is not a run folder.
        StoreError: a file of it is none of its own, damaged, or not as it was when the run ended.
    """
    from nw_eval.api.loaded_baselines import kept_baseline
    from nw_eval.api.saved_run import saved_suite, saved_trials
    from nw_gate.baseline.combine import without_baseline
    from nw_gate.results.evidence_check import check_files
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import check_plain, find_run_folder
    from nw_scenes import limits

    folder = find_run_folder(run)
    check_plain(folder)
    info = read_run_info(folder.run_json)
    suite = saved_suite(info)
    files, rows = check_files(folder, info, {trial.id for trial in saved_trials(info, suite)})
    logs = (f"{folder.logs.name}/", f"{folder.cached.name}/")
    findings = list(files.findings)
    for nested in folder.limit_runs:
        own = read_run_info(nested.run_json)
        ids = {trial.id for trial in saved_trials(own, saved_suite(own))}
        at = folder.relative(nested.path)
        findings += [
            replace(each, file=f"{at}/{each.file}")
            for each in check_files(nested, own, ids)[0].findings
            if each.what != "missing" or not each.file.startswith(logs)
        ]
    for each in findings:
        if each.what != "missing" or not each.file.startswith(logs):
            where = f"{each.file} ({each.trial})" if each.trial else each.file
            about = f": {each.about}" if each.about else ""
            raise StoreError(
                f"{where} is {each.what}{about}", fix=f"nw-eval verify --offline {typed(run)}"
            )
    for row in rows.values():
        if row.waypoints_total > limits.WAYPOINTS:  # Pages have a line for each.
            raise StoreError(
                f"trial {row.trial_id} has {row.waypoints_total} waypoints",
                fix=f"no scene has more than {limits.WAYPOINTS}",
            )
    try:
        baseline = kept_baseline(folder, info, elsewhere=False)
    except IncomparableError as error:
        judged = _judged(folder, info, suite, lambda: None, mend=False)
        return replace(judged, verdict=without_baseline(judged.verdict, str(error)))
    return _judged(folder, info, suite, lambda: baseline, mend=False)


def judge(
    run: str | Path,
    *,
    baseline: str | None = None,
    max_drop: float | None = None,
    tolerate: float | None = None,
    out: str | PathLike[str] | None = None,
) -> RunReport:
    """Judge the rows that a run has, by its suite's bar and against a baseline.

    Args:
        run: the folder of a run, finished, unfinished or interrupted.
        baseline: the baseline to compare with: a name, a file, or `none` (default: the baseline the
            run was started with, else the suite's).
        max_drop: drop in mean success that a PASS must rule out (default: the suite's).
        tolerate: largest drop in mean success that is still accepted (default: the suite's).
        out: write the report to this Markdown file, with an HTML page beside it (default: write
            none).

    Raises:
        UsageError: it is not a run folder or that of a part of a run, there is no such baseline, or
            a drop is none.
        IncomparableError: the baseline does not hold for the run, or has too few starts for it.
        StoreError: its rows or the baseline are damaged, or the report cannot be written.
    """
    from nw_eval.api.loaded_baselines import judging_baseline
    from nw_eval.api.saved_run import check_whole, saved_suite
    from nw_eval.suite.model import override_gate
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import open_run_folder

    out = as_path(out)
    folder = open_run_folder(Path(run))
    info = check_whole(read_run_info(folder.run_json))
    suite = override_gate(saved_suite(info), max_drop=max_drop, tolerate=tolerate)
    judged = _judged(folder, info, suite, lambda: judging_baseline(folder, info, suite, baseline))
    return judged if out is None else written(judged, out)


def _judged(
    folder: RunFolder,
    info: RunInfo,
    suite: Suite,
    baseline: Callable[[], LoadedBaseline | None],
    *,
    mend: bool = True,
) -> RunReport:
    """Return the verdict on the rows of a run's plan."""
    from concurrent.futures import ThreadPoolExecutor

    from nw_eval.api.saved_run import saved_trials, spare_trials
    from nw_gate.results.ended import read_trials

    # A process of its own reads the baseline, which takes as long as the rows do.
    with ThreadPoolExecutor(max_workers=1) as beside:
        opened = beside.submit(baseline)
        trials, spare = saved_trials(info, suite), spare_trials(info, suite)
        recorded = read_trials(folder, info, trials, spare=spare, mend=mend)
    return judged_rows(folder, info, suite, opened.result(), recorded, mend=mend)


def judged_rows(
    folder: RunFolder,
    info: RunInfo,
    suite: Suite,
    against: LoadedBaseline | None,
    recorded: RunRows,
    *,
    mend: bool = True,
) -> RunReport:
    """Return the verdict on rows that are read already, with what there is to remark on them.

    Raises:
        IncomparableError, StoreError: as `judge`.
    """
    from nw_gate.baseline.combine import judge_run, with_limits
    from nw_gate.results.evidence_check import lost_logs

    verdict = judge_run(recorded.rows, info, suite.gate, against)
    if suite.gate.limits:
        from nw_eval.api.limit_gates import limit_findings

        shown = limit_findings(folder, info, suite, against, verdict, mend=mend)
        verdict = with_limits(verdict, shown)
    remarks = (*recorded.remarks, *lost_logs(recorded.rows))
    is_fresh = verdict.against is None or verdict.against.basis == "fresh"
    verdict = replace(verdict, reasons=(*verdict.reasons, *remarks))
    return RunReport(
        folder=folder.path,
        info=info,
        verdict=verdict,
        rows=recorded.rows,
        page=None,
        baseline=None if against is None else against.info,
        rivals={} if against is None or is_fresh else against.rivals(recorded.rows, info),
        baseline_policy=None if against is None else against.results.manifest.policy,
    )


def written(
    judged: RunReport, out: Path, *, kept: KeptEvidence | None = None, is_ours: bool = False
) -> RunReport:
    """Write the pages of a judged run: one in Markdown, and beside it the other in HTML.

    Beside a device or a pipe nothing is written.

    Args:
        judged: the run.
        out: of either page.
        kept: what its logs may have shown before; None = they are read.
        is_ours: whether this machine has just made the run, so that what its logs name is opened.

    Raises:
        StoreError: they cannot be written.
    """
    from nw_base.files.cache import followed, is_stream
    from nw_eval.api.evidence import gather_evidence
    from nw_eval.reporting.html.page import render_html
    from nw_eval.reporting.markdown import render_markdown, write_report
    from nw_gate.cause import read_cause_file
    from nw_gate.results.run_folder import RunFolder

    page, html = _pages(out)
    facts = (judged.info, judged.rows, judged.verdict, judged.typed_folder)
    folder = RunFolder(path=judged.folder)
    # Links in a run's folder may be untrusted.
    is_own = out == folder.report_md
    only = None if is_own or not is_stream(out) else out
    evidence = gather_evidence(folder, judged.rows, kept)
    evidence = _drawn(evidence, folder, judged, judged.rows, is_own=is_ours)
    cause = read_cause_file(folder.cause)
    texts = {
        html: render_html(*facts, evidence, cause, judged.rivals),
        page: render_markdown(*facts, cause, judged.rivals),
    }
    for path, text in texts.items():
        if only in {None, path}:
            write_report(path if is_own else followed(path), text)
    return replace(
        judged,
        page=page if only in {None, page} else None,
        html=html if only in {None, html} else None,
        evidence=evidence,
    )


def _drawn(
    evidence: LogEvidence,
    folder: RunFolder,
    judged: RunReport,
    rows: Sequence[Row],
    *,
    is_own: bool,
) -> LogEvidence:
    """Return evidence with pictures that no log has."""
    from nw_eval.api.evidence import KeptEvidence
    from nw_eval.api.evidence_baseline import with_baseline_films
    from nw_eval.api.evidence_drawn import with_drawn
    from nw_gate.results.evidence_check import present_logs

    info, logs = judged.info, present_logs(folder, rows)
    kept = KeptEvidence.of_run(info)
    evidence = with_drawn(
        evidence,
        folder,
        rows,
        logs,
        digests={name: scene.digest for name, scene in info.scenes.items()},
        kept=kept,
        is_own=is_own,
    )
    if judged.baseline_policy is None:
        return evidence
    return with_baseline_films(
        evidence,
        folder,
        info,
        {row.trial_id: row for row in rows},
        logs,
        policy=judged.baseline_policy,
        rivals=judged.rivals,
        kept=kept,
        runs=is_own,
    )


def write_anew(judged: RunReport, path: Path, *, logs: bool, draws: bool) -> None:
    """Write the HTML page of a run of `as_published`; nothing of its folder's pages is read.

    Args:
        judged: the run.
        path: of the page.
        logs: whether to show what its logs hold, as far as its rows have their digests. Pictures
            are made anew of what confined processes read.
        draws: whether to show its worst trials from outside, too, and built-in scenes from above.

    Raises:
        StoreError: the page cannot be written, or cause.json is damaged.
    """
    from nw_eval.api.evidence import gather_evidence
    from nw_eval.reporting.html.evidence import LogEvidence
    from nw_eval.reporting.html.page import render_html
    from nw_eval.reporting.markdown import write_report
    from nw_gate.cause import read_cause_file
    from nw_gate.results.run_folder import RunFolder

    folder = RunFolder(path=judged.folder)
    absent = (
        "Paths and clips are not on this page; `nw-eval report` on the run's folder shows them."
    )
    evidence = LogEvidence(remarks=(absent,))
    if logs:
        known = [row if row.mcap_sha256 else replace(row, mcap_path="") for row in judged.rows]
        evidence = gather_evidence(folder, known)
        if draws:
            evidence = _drawn(evidence, folder, judged, known, is_own=False)
    cause = read_cause_file(folder.cause)
    facts = (judged.info, judged.rows, judged.verdict, judged.typed_folder)
    write_report(path, render_html(*facts, evidence, cause, judged.rivals))


def fault_of(error: Exception) -> str:
    """Return in words what keeps a run of somebody else's from being shown.

    Whatever its files do to those who read them, the pages of other runs are to be written.
    """
    if isinstance(error, NwEvalError):
        return str(error)
    return clean(f"{type(error).__name__}: {error}", at_most=300)


def _pages(out: Path) -> tuple[Path, Path]:
    """Return where the page in Markdown goes, and that in HTML, of which one was named."""
    if out.suffix.lower() in {".html", ".htm"}:
        return out.with_suffix(".md"), out
    beside = out.with_suffix("") if out.suffix.lower() == ".md" else out
    return out, beside.with_name(f"{beside.name}.html")


def typed(path: Path) -> Path:
    """Return a path as one would type it here: relative where it lies below."""
    resolved, folder = path.resolve(), Path.cwd()
    return resolved.relative_to(folder) if resolved.is_relative_to(folder) else resolved
