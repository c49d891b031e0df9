"""Judging: rows in, verdict and pages out. Needs neither MuJoCo nor torch."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.gate.verdict import Verdict
    from nw_eval.results.row import Row

_PAGE = 120
"""Columns of text where there is no terminal to ask."""


@dataclass(frozen=True, kw_only=True)
class RunReport:
    """A judged run: its verdict, where its evidence lies, and the same in words."""

    folder: Path
    verdict: Verdict
    rows: tuple[Row, ...]
    interrupted: bool
    summary: str

    @property
    def exit_code(self) -> int:
        """0 PASS or RAN, 1 REGRESSED, 3 INCONCLUSIVE, 4 errors left or trials missing."""
        return self.verdict.exit_code


def report(run: str | Path, *, out: Path | None = None) -> RunReport:
    """Judge a run from the rows of its plan, write report.md, and return the verdict.

    What of its rows was not judged, or was damaged and has another copy, is among the reasons.

    Raises:
        StoreError: there is no such run, its rows are damaged, or the report cannot be written.
    """
    from nw_eval.api.saved_run import saved_suite, saved_trials
    from nw_eval.gate.absolute import judge
    from nw_eval.reporting.markdown import render_markdown, write_report
    from nw_eval.results.ended import read_trials
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import open_run_folder

    folder = open_run_folder(Path(run))
    info = read_run_info(folder.run_json)
    suite = saved_suite(info)
    found = read_trials(folder, info, saved_trials(info, suite))
    rows = found.rows
    verdict = judge(rows, suite.gate, info.planned)
    verdict = replace(verdict, reasons=(*verdict.reasons, *found.remarks))
    shown = _as_typed(folder.path)
    write_report(out or folder.report_md, render_markdown(info, rows, verdict, shown))
    return RunReport(
        folder=folder.path,
        verdict=verdict,
        rows=rows,
        interrupted=info.interrupted,
        summary=_summary(info, rows, verdict, shown),
    )


def _as_typed(path: Path) -> Path:
    """Return a path as one would type it here: relative where it lies below."""
    resolved = path.resolve()
    here = Path.cwd()
    return resolved.relative_to(here) if resolved.is_relative_to(here) else resolved


def _summary(info: Any, rows: Sequence[Row], verdict: Verdict, folder: Path) -> str:
    from rich.console import Console

    from nw_eval.reporting.console import print_summary

    stream = StringIO()
    screen = Console(file=sys.stdout)
    console = Console(
        file=stream,
        width=screen.width if screen.is_terminal else _PAGE,
        force_terminal=screen.is_terminal,
        no_color=screen.no_color,
    )
    print_summary(console, info, rows, verdict, folder)
    console.print(f"report: {folder / 'report.md'}", highlight=False, soft_wrap=True)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines())
