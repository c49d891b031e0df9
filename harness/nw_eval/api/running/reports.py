"""Judging: rows in, verdict and pages out. Needs neither MuJoCo nor torch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.gate.verdict import Verdict
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row


@dataclass(frozen=True, kw_only=True)
class RunReport:
    """A judged run: its verdict, and where its evidence lies."""

    folder: Path
    info: RunInfo
    """Where its rows come from: what run.json says."""
    verdict: Verdict
    rows: tuple[Row, ...]

    @property
    def interrupted(self) -> bool:
        """Whether a signal ended it."""
        return self.info.interrupted

    @property
    def exit_code(self) -> int:
        """0 PASS or RAN, 1 REGRESSED, 3 INCONCLUSIVE, 4 errors or trials missing, 5 INVALID."""
        return self.verdict.exit_code

    @property
    def typed_folder(self) -> Path:
        """The folder as one would type it here: relative where it lies below."""
        resolved, here = self.folder.resolve(), Path.cwd()
        return resolved.relative_to(here) if resolved.is_relative_to(here) else resolved


def report(run: str | Path, *, out: Path | None = None) -> RunReport:
    """Judge a run from the rows of its plan, write report.md, and return the verdict.

    What of its rows was not judged, or was damaged and has another copy, is among the reasons.

    Raises:
        StoreError: there is no such run, its rows are damaged, or the report cannot be written.
    """
    from nw_eval.api.running.saved_run import saved_suite, saved_trials
    from nw_eval.api.running.verdicts import verdict_on
    from nw_eval.reporting.markdown import render_markdown, write_report
    from nw_eval.results.ended import read_trials
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import open_run_folder

    folder = open_run_folder(Path(run))
    info = read_run_info(folder.run_json)
    suite = saved_suite(info)
    found = read_trials(folder, info, saved_trials(info, suite))
    verdict = verdict_on(folder, info, suite, found.rows)
    verdict = replace(verdict, reasons=(*verdict.reasons, *found.remarks))
    judged = RunReport(folder=folder.path, info=info, verdict=verdict, rows=found.rows)
    page = render_markdown(info, judged.rows, verdict, judged.typed_folder)
    write_report(out or folder.report_md, page)
    return judged
