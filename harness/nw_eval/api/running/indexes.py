"""Many runs on one page: what each came to, and trends by scene."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from nw_eval.errors import StoreError, UsageError

if TYPE_CHECKING:
    from nw_eval.api.running.reports import RunReport
    from nw_eval.reporting.html import ListedRun


@dataclass(frozen=True, kw_only=True)
class RunIndex:
    """Runs, judged again, and the page that lists them."""

    runs: tuple[RunReport, ...]
    unread: tuple[str, ...]
    """A sentence on each run whose rows or run.json are damaged: the page has it, too."""
    page: Path

    @property
    def typed_page(self) -> Path:
        """The page as one would type it here."""
        from nw_eval.api.running.reports import typed

        return typed(self.page)

    @property
    def exit_code(self) -> int:
        """4 if a run could not be read, else 0: the verdicts are those of the runs."""
        return StoreError.exit_code if self.unread else 0


def index_runs(runs: Sequence[str | Path], *, out: Path | None = None) -> RunIndex:
    """Judge runs again as they were begun, and write a page over all; their own stay as they are.

    Args:
        runs: their folders.
        out: where to write the page; if None, `index.html` in the folder that all of them lie in.

    Raises:
        UsageError: one is no run's folder, or there is none.
        StoreError: the page cannot be written.
    """
    from nw_eval.api.running.reports import as_begun
    from nw_eval.files.cache import followed
    from nw_eval.reporting.html import render_index
    from nw_eval.reporting.markdown import write_report
    from nw_eval.results.run_folder import open_run_folder

    if not runs:
        raise UsageError("no run to list", fix="name the folders of some")
    folders = list(dict.fromkeys(open_run_folder(Path(run)).path.resolve() for run in runs))
    page = Path(os.path.commonpath([folder.parent for folder in folders])) / "index.html"
    page = out or page
    judged: list[RunReport] = []
    unread: list[str] = []
    for folder in folders:
        try:
            judged.append(as_begun(folder))
        except StoreError as error:
            unread.append(f"{folder.name}: {error}")
    target = page if out is None else followed(page)
    write_report(target, render_index([_listed(each, page) for each in judged], unread))
    return RunIndex(runs=tuple(judged), unread=tuple(unread), page=page)


def _listed(judged: RunReport, page: Path) -> ListedRun:
    """Return a run as the page lists it, with a link that holds wherever both are moved to."""
    from nw_eval.reporting.html import ListedRun
    from nw_eval.results.run_folder import RunFolder

    folder = RunFolder(path=judged.folder)
    own = next((path for path in (folder.report_html, folder.report_md) if path.is_file()), None)
    relative = None if own is None else os.path.relpath(own, page.resolve().parent)
    return ListedRun(
        folder=str(judged.typed_folder),
        href=None if relative is None else quote(relative.replace(os.sep, "/")),
        info=judged.info,
        verdict=judged.verdict,
    )
