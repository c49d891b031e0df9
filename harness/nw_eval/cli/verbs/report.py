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
    """Judge a finished or interrupted run again from its rows, and write its report.

    Of several runs, write one page that lists them and shows trends by scene; their own pages stay
    as they are.
    """

    leaves_verdict: ClassVar = True  # In a file, whatever becomes of the print.

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """The folder of a run, or of several. Of several what is no run is skipped: a glob may find
    pages and badges of before."""
    out: Path | None = None
    """Where to write the Markdown, with the page in HTML beside it; the run's own report.md and
    report.html when absent. Of several runs, where to write their page; when absent, index.html
    in the folder that all of them lie in."""
    open: bool = False
    """Show the page in HTML in a browser."""
    site: Path | None = None
    """Write a leaderboard over the runs into this folder, to be published as it is: policies by
    suites and tasks, scenes with pictures, an index of the runs and their reports, badges. A site
    that is there is replaced."""
    title: str | None = None
    """Of the page over several runs, or of the leaderboard."""
    pictures: bool = True
    """Without drawings of the built-in scenes on a page over several runs. A drawing takes about a
    second, and is kept in the cache."""

    def __call__(self) -> int:
        if self.site is not None:
            return self._site(self.site)
        if len(self.runs) != 1:
            return self._index()
        return self._judge()

    def _judge(self) -> int:
        from nw_base.errors import UsageError
        from nw_eval import api
        from nw_eval.cli.terminal.last_words import show
        from nw_eval.cli.verbs.options import summary

        if self.title is not None:
            raise UsageError(
                "--title is of a page over several runs, and one run is named",
                fix="name another one, or --site",
            )
        with self.publishing(str(self.runs[0])) as judged:
            judged.run = outcome = api.report(self.runs[0], out=self.out)
            print(summary(outcome, folded=self.on_github))
            if self.open and outcome.html is not None:
                show(outcome.html)
            judged.code = outcome.exit_code
        return judged.code

    def _site(self, folder: Path) -> int:
        from nw_base.errors import UsageError
        from nw_base.plural import plural
        from nw_eval import api
        from nw_eval.cli.terminal.last_words import show, tell

        if self.out is not None or self.shows_one_run:
            raise UsageError(
                "--out, --junit, --github, --comment, --track and --reporter with --site",
                fix="drop them",
            )
        title = self.title or "Leaderboard"
        found = api.write_site(self.runs, folder, title=title, pictures=self.pictures)
        _tell_skipped(found.skipped)
        for sentence in found.left_out:
            tell(f"warning: left out: {sentence}")
        print(f"leaderboard of {plural(found.runs, 'run')}: {found.page}")
        if self.open:
            show(found.page)
        return found.exit_code

    def _index(self) -> int:
        from nw_base.errors import UsageError
        from nw_base.plural import plural
        from nw_eval import api
        from nw_eval.cli.terminal.last_words import show, tell

        if self.shows_one_run:
            raise UsageError(
                "--junit, --github, --comment, --track and --reporter are of one run",
                fix="name one, or drop them",
            )
        found = api.index_runs(self.runs, out=self.out, title=self.title, pictures=self.pictures)
        _tell_skipped(found.skipped)
        for sentence in found.unread:
            tell(f"warning: not read: {sentence}")
        print(f"index of {plural(len(found.runs), 'run')}: {found.typed_page}")
        if self.open:
            show(found.page)
        return found.exit_code


def _tell_skipped(paths: Sequence[Path]) -> None:
    """Say what a glob has found beside the runs, such as pages and badges of before."""
    from nw_base.plural import plural
    from nw_eval.cli.terminal.last_words import tell

    if paths:
        names = ", ".join(clean(path.name, at_most=80) for path in paths[:_NAMED])
        more = f" and {len(paths) - _NAMED} more" if len(paths) > _NAMED else ""
        tell(f"skipped {plural(len(paths), 'path')} without a run: {names}{more}")
