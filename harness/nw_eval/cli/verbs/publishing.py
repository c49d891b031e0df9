"""The options that say where a judged run is shown: those of `run`, `gate` and `report`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from nw_eval.errors import NwEvalError

if TYPE_CHECKING:
    from nw_eval.api import Published, RunReport, Surfaces


@dataclass(frozen=True, kw_only=True)
class Publishing:
    """Where a verb shows the run that it judged. A surface that cannot be written is a warning."""

    junit: Path | None = None
    """Write a JUnit file here: a test case for each scene, and one for the verdict."""
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
            _warn(api.publish_error(error, suite, where))
            raise
        _warn(api.publish(judged, where))
        return code

    def _surfaces(self) -> Surfaces:
        from nw_eval import api

        names = (name.strip() for words in self.track for name in words.split(","))
        trackers = dict.fromkeys(name for name in names if name)
        return api.Surfaces(junit=self.junit, track=tuple(trackers))


def _warn(published: Published) -> None:
    from nw_eval.cli.terminal.last_words import tell

    for warning in published.warnings:
        tell(f"warning: {warning}")
