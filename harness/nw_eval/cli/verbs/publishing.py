"""The options that say where a judged run is shown: those of `run`, `gate` and `report`."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import tyro

from nw_eval.errors import NwEvalError, UsageError

if TYPE_CHECKING:
    from nw_eval.api import Published, RunReport, Surfaces
    from nw_eval.words import Tracker


@dataclass(frozen=True, kw_only=True)
class Publishing:
    """Where a verb shows the run that it judged. A surface that cannot be written is a warning."""

    junit: Path | None = None
    """Write a JUnit file here: a test case for each scene, and one for the verdict."""
    github: bool = False
    """Write what GitHub's runner reads: step summary, outputs, annotations, groups.
    On by itself where GITHUB_ACTIONS is true."""
    no_github: bool = False
    """Write nothing of that, also there."""
    comment: Path | None = None
    """Write the Markdown of a comment on a pull request here; nothing is posted."""
    track: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="TRACKER[,TRACKER]")
    ] = ()
    """Show the run in a tracker, on the run of its checkpoint: wandb, mlflow, tensorboard."""

    def publishing(self, suite: str, verb: Callable[[], tuple[RunReport, int]]) -> int:
        """Run what gives a judged run and an exit code, show it, and return the code.

        Args:
            suite: what is run or judged, as it was typed.
            verb: what to run. An error that keeps it from a verdict is shown, and raised.
        """
        from nw_eval import api

        where = self._surfaces()
        try:
            api.check_surfaces(where)
            judged, code = verb()
        except NwEvalError as error:
            _tell(api.publish_error(error, suite, where))
            raise
        _tell(api.publish(judged, where, exit_code=code))
        return code

    @property
    def on_github(self) -> bool:
        """Whether GitHub's runner reads what is printed.

        Raises:
            UsageError: it is asked for, and its opposite too.
        """
        if self.github and self.no_github:
            raise UsageError("--github and --no-github exclude each other", fix="drop one of them")
        here = os.environ.get("GITHUB_ACTIONS") == "true"
        return self.github or (here and not self.no_github)

    def _surfaces(self) -> Surfaces:
        from nw_eval import api

        words = ",".join(self.track).split(",")
        names = dict.fromkeys(word.strip() for word in words if word.strip())
        return api.Surfaces(
            junit=self.junit,
            github=self.on_github,
            comment=self.comment,
            track=cast("tuple[Tracker, ...]", tuple(names)),  # Whether they are: `check_surfaces`.
        )


def _tell(published: Published) -> None:
    from nw_eval.cli.terminal.last_words import tell

    for command in published.commands:
        print(command, flush=True)
    for warning in published.warnings:
        tell(f"warning: {warning}")
