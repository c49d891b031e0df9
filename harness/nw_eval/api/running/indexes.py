"""Many runs on one page: what each came to, and trends by scene."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from nw_eval.clean import clean
from nw_eval.errors import StoreError, UsageError

if TYPE_CHECKING:
    from nw_eval.api.running.reports import RunReport
    from nw_eval.reporting.html.runs import ListedRun


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
    """Judge runs again as they were begun, and write a page over all and one of each.

    Nothing of the runs' own pages is shown or linked, as somebody else may have written them; they
    stay as they are. A run that is not as it was when it ended is named, and not shown.

    Args:
        runs: their folders.
        out: where to write the page; if None, `index.html` in the folder that all of them lie in.
            Those of the runs are in a folder beside it: of `index.html`, in `index-runs`.

    Raises:
        UsageError: one is no run's folder, or there is none.
        StoreError: the page cannot be written.
    """
    from nw_eval.api.running.reports import as_published, fault_of
    from nw_eval.files.cache import followed
    from nw_eval.reporting.html.runs import render_index
    from nw_eval.reporting.markdown import write_report
    from nw_eval.results.run_folder import open_run_folder

    if not runs:
        raise UsageError("no run to list", fix="name the folders of some")
    folders = list(dict.fromkeys(open_run_folder(Path(run)).path.resolve() for run in runs))
    page = Path(os.path.commonpath([folder.parent for folder in folders])) / "index.html"
    page = out or page
    judged: list[RunReport] = []
    listed: list[ListedRun] = []
    unread: list[str] = []
    for folder in folders:
        try:
            run = as_published(folder)
            listed.append(_listed(run, page))
        except Exception as error:  # noqa: BLE001 - One run costs no other run its line.
            unread.append(f"{clean(folder.name)}: {fault_of(error)}")
        else:
            judged.append(run)
    write_report(page if out is None else followed(page), render_index(listed, unread))
    return RunIndex(runs=tuple(judged), unread=tuple(unread), page=page)


def _listed(judged: RunReport, page: Path) -> ListedRun:
    """Return a run as the page lists it, once its own page is written beside it."""
    from nw_eval.api.running.reports import write_anew
    from nw_eval.reporting.html.runs import ListedRun

    # Two runs of one name lie in two folders.
    digest = sha256(os.fsencode(judged.folder)).hexdigest()[:8]
    name = f"{re.sub(r'[^A-Za-z0-9_-]+', '-', judged.folder.name)[:80]}-{digest}.html"
    beside = f"{page.stem}-runs"
    write_anew(judged, page.with_name(beside) / name, logs=False)
    return ListedRun(
        folder=str(judged.typed_folder),
        href=quote(f"{beside}/{name}"),
        info=judged.info,
        verdict=judged.verdict,
    )
