"""A suite as a test file: a test for each scene, and one for the verdict on all of them."""

from __future__ import annotations

from contextlib import chdir
from typing import TYPE_CHECKING

import pytest

from nw_eval.errors import NwEvalError
from nw_eval.pytest_plugin.items import SceneItem, VerdictItem
from nw_eval.pytest_plugin.options import SETTINGS
from nw_eval.pytest_plugin.tested import VERDICT, TestedSuite

if TYPE_CHECKING:
    from collections.abc import Iterator


class SuiteFile(TestedSuite):
    """A suite's file, and the tests in it."""

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
                item.add_marker(pytest.mark.skip(reason="the baseline is being saved"))
            yield item
        yield VerdictItem.from_parent(self, name=VERDICT, line=self.shown.gate)
