"""A suite as a test file: a test for each scene, and one for the verdict on all of them."""

from __future__ import annotations

from contextlib import chdir
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from nw_eval.errors import NwEvalError
from nw_eval.pytest_plugin.items import VERDICT, SceneItem, VerdictItem
from nw_eval.pytest_plugin.options import SETTINGS
from nw_eval.pytest_plugin.runs import runs_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from nw_eval.api import RunReport, ShownSuite


class SuiteFile(pytest.File):
    """A suite's file."""

    shown: ShownSuite

    def collect(self) -> Iterator[SceneItem | VerdictItem]:
        """Yield a test for each scene, in the order in which they run, and then the verdict's.

        Raises:
            CollectError: the file is no suite, with all that is wrong with it.
        """
        from nw_eval import api

        with chdir(self.project):
            try:
                self.shown = api.show_suite(self.typed)
            except NwEvalError as error:
                raise self.CollectError(str(error)) from None
        if VERDICT in self.shown.scenes:
            raise self.CollectError(
                f"{self.typed}: a scene is called {VERDICT!r}, as the suite's own test is; "
                "give it another name"
            )
        for scene, line in self.shown.scenes.items():
            item = SceneItem.from_parent(self, name=scene, line=line)
            if self.config.stash[SETTINGS].update_baseline:
                item.add_marker(pytest.mark.skip(reason="the bank is being saved"))
            yield item
        yield VerdictItem.from_parent(self, name=VERDICT, line=self.shown.gate)

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
    def wanted(self) -> tuple[str, ...] | None:
        """The scenes to run, for those tests that are to run; None for all of them."""
        chosen = [item for item in self.session.items if item.parent is self]
        names = {item.name for item in chosen if isinstance(item, SceneItem)}
        if any(isinstance(item, VerdictItem) for item in chosen) or len(names) == len(
            self.shown.scenes
        ):
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
