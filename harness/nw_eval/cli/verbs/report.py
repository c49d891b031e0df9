"""`nw-eval report`: write a run's pages again, from its rows; or one page over many runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import tyro

from nw_base.clean import clean
from nw_eval.cli.verbs.options import Publishing

_NAMED = 4  # of what was skipped


@dataclass(frozen=True, kw_only=True)
class Report(Publishing):
    """Judge a finished or interrupted run from its saved results and write its report.

    For several runs, write one page that lists them and shows trends by scene. The runs' own pages
    do not change.
    """

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """One or more run folders. Folders without a run are skipped: a glob may also match old pages
    and badges."""
    out: Path | None = None
    """The Markdown file to write, with an HTML page beside it (default: the run's report.md and
    report.html). For several runs, their page (default: index.html in their common folder)."""
    open: bool = False
    """Open the HTML page in a browser."""
    site: Path | None = None
    """Write a leaderboard of the runs into this folder, ready to publish: policies by suite and
    task, scenes with pictures, the runs with their reports, badges. An existing leaderboard is
    replaced."""
    title: str | None = None
    """Title of the page or of the leaderboard."""
    pictures: bool = True
    """Do not draw built-in scenes on a page of several runs. A drawing takes about a second and is
    cached."""

    def __call__(self) -> int:
        if self.site is not None:
            return self._site(self.site)
        if len(self.runs) != 1:
            return self._index()
        return self._judge()

    def _judge(self) -> int:
        from nw_base.errors import UsageError
        from nw_eval import api
        from nw_eval.cli.terminal.final_output import show

        if self.title is not None:
            raise UsageError(
                "--title is of a page over several runs, and one run is named",
                fix="name another one, or --site",
            )
        with self.publishing(str(self.runs[0])) as judged:
            judged.run = outcome = api.report(self.runs[0], out=self.out)
            print(self.printed(outcome, outcome.exit_code))
            if self.open and outcome.html is not None:
                show(outcome.html)
            judged.code = outcome.exit_code
        return judged.code

    def _site(self, folder: Path) -> int:
        from nw_base.errors import UsageError
        from nw_base.plural import plural
        from nw_eval import api
        from nw_eval.cli.terminal.final_output import show, tell

        if self.out is not None or self.shows_one_run:
            raise UsageError(
                "--out, --junit, --github, --comment, --track and --reporter with --site",
                fix="drop them",
            )
        title = self.title or "Leaderboard"
        written = api.write_site(self.runs, folder, title=title, pictures=self.pictures)
        _tell_skipped(written.skipped)
        for sentence in written.left_out:
            tell(f"warning: left out: {sentence}")
        print(f"leaderboard of {plural(written.runs, 'run')}: {written.page}")
        if self.open:
            show(written.page)
        return written.exit_code

    def _index(self) -> int:
        from nw_base.errors import UsageError
        from nw_base.plural import plural
        from nw_eval import api
        from nw_eval.cli.terminal.final_output import show, tell

        if self.shows_one_run:
            raise UsageError(
                "--junit, --github, --comment, --track and --reporter are of one run",
                fix="name one, or drop them",
            )
        written = api.index_runs(self.runs, out=self.out, title=self.title, pictures=self.pictures)
        _tell_skipped(written.skipped)
        for sentence in written.unread:
            tell(f"warning: not read: {sentence}")
        print(f"index of {plural(len(written.runs), 'run')}: {written.typed_page}")
        if self.open:
            show(written.page)
        return written.exit_code


def _tell_skipped(paths: Sequence[Path]) -> None:
    """Say what a glob has found beside the runs, such as pages and badges of before."""
    from nw_base.plural import plural
    from nw_eval.cli.terminal.final_output import tell

    if paths:
        names = ", ".join(clean(path.name, at_most=80) for path in paths[:_NAMED])
        more = f" and {len(paths) - _NAMED} more" if len(paths) > _NAMED else ""
        tell(f"skipped {plural(len(paths), 'path')} without a run: {names}{more}")
