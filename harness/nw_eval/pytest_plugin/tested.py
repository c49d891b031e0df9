"""A suite that is a test file: where it lies, which of its scenes run, and their run."""

from __future__ import annotations

from contextlib import chdir
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from nw_eval.pytest_plugin.options import SETTINGS
from nw_eval.pytest_plugin.runs import runs_of

if TYPE_CHECKING:
    from nw_eval.api import RunReport, ShownSuite

VERDICT = "verdict"
"""The name of the test of a suite's verdict, which no scene may have."""


class TestedSuite(pytest.File):
    """A suite's file. Its items are named by the scenes, and the last one `VERDICT`."""

    shown: ShownSuite

    @property
    def project(self) -> Path:
        """Where names are looked for, and the suite is run."""
        return self.config.stash[SETTINGS].project

    @property
    def typed(self) -> Path:
        """The file as one would type it in the project's folder."""
        below = self.path.is_relative_to(self.project)
        return self.path.relative_to(self.project) if below else self.path

    @property
    def has_verdict(self) -> bool:
        """Whether the verdict's own test is among those that are to run."""
        return VERDICT in self._names

    @property
    def _names(self) -> set[str]:
        return {item.name for item in self.session.items if item.parent is self}

    @property
    def wanted(self) -> tuple[str, ...] | None:
        """The scenes to run, for those tests that are to run; None for all of them."""
        names = self._names
        if VERDICT in names or len(names) == len(self.shown.scenes):
            return None
        return tuple(scene for scene in self.shown.scenes if scene in names)

    def judged(self) -> RunReport:
        """Return the run of the scenes that are wanted, which is made once.

        Raises:
            NwEvalError: it came to no verdict.
        """
        from nw_eval import api

        settings, wanted = self.config.stash[SETTINGS], self.wanted
        request = api.Request(
            suite=self.typed,
            policy=settings.policy,
            checkpoint=settings.checkpoint,
            baseline=settings.baseline,
            trials=settings.rounds,
            scenes=None if wanted is None else tuple(escape(scene) for scene in wanted),
        )
        with chdir(self.project):
            return runs_of(self.config).of(request)
