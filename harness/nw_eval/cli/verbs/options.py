"""Options that several verbs share: what to run, and where to show a judged run.

`Options` are those of `run` and `check`, `Publishing` those of `run`, `gate`, `merge` and `report`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import tyro

from nw_base.errors import NwEvalError, UsageError
from nw_base.words import PanelKind
from nw_eval.cli.verbs.shared import Scenes, Workers
from nw_gate.results.request import Request

if TYPE_CHECKING:
    from nw_base.words import Tracker
    from nw_eval.api import Published, RunReport, Surfaces


@dataclass(frozen=True, kw_only=True)
class Options(Request):
    """A request with its letters. Order and help of the options are those of its fields."""

    suite: tyro.conf.Positional[str | None] = None
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    scenes: Scenes = None
    panel: Annotated[PanelKind | None, tyro.conf.arg(name="seed-set")] = None
    workers: Workers = None

    @property
    def request(self) -> Request:
        """What is asked for, without how it is done."""
        return Request(**{field.name: getattr(self, field.name) for field in fields(Request)})


@dataclass
class Judged:
    """What a verb comes to."""

    run: RunReport | None = None
    code: int = NwEvalError.exit_code


@dataclass(frozen=True, kw_only=True)
class Publishing:
    """Where a verb shows the run that it judged. A surface that cannot be written is a warning."""

    junit: Path | None = None
    """Write a JUnit file here, with a test case per scene and one for the verdict."""
    github: bool = False
    """Write GitHub's step summary, outputs, annotations and log groups (default: on in GitHub
    Actions)."""
    no_github: bool = False
    """Turn GitHub output off."""
    comment: Path | None = None
    """Write a Markdown comment for a pull request here; nothing is posted."""
    track: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="TRACKER[,TRACKER]")
    ] = ()
    """Send the run to trackers, next to its checkpoint's run: wandb, mlflow, tensorboard."""
    reporter: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME[=PATH]")
    ] = ()
    """Show the run with a reporter: junit=PATH, comment=PATH, a tracker, or a plugin's."""

    json: bool = False
    """Print the verdict as JSON, and no GitHub output."""

    @property
    def shows_one_run(self) -> bool:
        """Whether something is asked for that only one run can be shown in."""
        asked = (self.junit, self.comment, self.github, self.track, self.reporter)
        return any(bool(each) for each in asked)

    @contextmanager
    def publishing(self, suite: str) -> Generator[Judged]:
        """Show the run that is judged within the block, or the error that leaves it.

        Args:
            suite: what is run or judged, as it was typed.

        Yields:
            Where the block puts the judged run and its exit code.
        """
        from nw_eval import api

        where, judged = self._surfaces(), Judged()
        try:
            api.check_surfaces(where)
            yield judged
        except NwEvalError as error:
            _tell(api.publish_error(error, suite, where))
            raise
        if judged.run is not None:
            _tell(api.publish(judged.run, where, exit_code=judged.code))

    @property
    def on_github(self) -> bool:
        """Whether GitHub's runner reads what is printed.

        Raises:
            UsageError: it is asked for, and its opposite too.
        """
        for name, given in (("--no-github", self.no_github), ("--json", self.json)):
            if self.github and given:
                raise UsageError(f"--github and {name} exclude each other", fix="drop one of them")
        is_github = os.environ.get("GITHUB_ACTIONS") == "true"
        return self.github or (is_github and not self.no_github and not self.json)

    def printed(self, judged: RunReport, code: int) -> str:
        """Return what is printed of a judged run: the tables and the verdict, or JSON."""
        from nw_eval.cli.verbs.printed import judged_json

        return judged_json(judged, code) if self.json else summary(judged, folded=self.on_github)

    def _surfaces(self) -> Surfaces:
        from nw_eval import api

        words = ",".join(self.track).split(",")
        names = dict.fromkeys(word.strip() for word in words if word.strip())
        return api.Surfaces(
            junit=self.junit,
            github=self.on_github,
            comment=self.comment,
            track=cast("tuple[Tracker, ...]", tuple(names)),  # Whether they are: `check_surfaces`.
            reporters=self.reporter,
        )


def summary(judged: RunReport, *, folded: bool = False) -> str:
    """Return the first tables of a judged run, its verdict and where its report lies.

    Args:
        judged: the run.
        folded: whether GitHub's runner is to fold the tables.
    """
    from rich.console import Console

    from nw_eval.reporting.console import print_tables, print_verdict
    from nw_eval.reporting.github import END_GROUP, begin_group

    stream = StringIO()
    screen = Console(file=sys.stdout)
    console = Console(
        file=stream,
        width=screen.width if screen.is_terminal else _PAGE,
        force_terminal=screen.is_terminal,
        no_color=screen.no_color,
    )
    if folded:
        stream.write(f"{begin_group('Tables')}\n")
    print_tables(console, judged.info, judged.rows, judged.verdict, judged.typed_folder)
    if folded:
        stream.write(f"{END_GROUP}\n")
    print_verdict(console, judged.info, judged.rows, judged.verdict)
    if judged.typed_page is not None:
        both = "" if judged.html is None else f" and {judged.html.name}"
        console.print(f"report: {judged.typed_page}{both}", highlight=False, soft_wrap=True)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines())


_PAGE = 120
"""Columns of text where there is no terminal to ask."""


def _tell(published: Published) -> None:
    from nw_eval.cli.terminal.final_output import tell

    for command in published.commands:
        print(command, flush=True)
    for warning in published.warnings:
        tell(f"warning: {warning}")
