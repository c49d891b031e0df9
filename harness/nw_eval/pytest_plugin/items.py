"""The tests of a suite: when each fails, and when there is nothing to say."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.errors import NwEvalError
from nw_eval.pytest_plugin.options import SETTINGS

if TYPE_CHECKING:
    from nw_eval.api import RunReport
    from nw_eval.pytest_plugin.tested import TestedSuite
    from nw_eval.reporting.scene_states import SceneState


class SuiteItem(pytest.Item):
    """A test of a suite. It fails with the verdict in its words, and without a traceback."""

    suite: TestedSuite

    def __init__(self, *, line: int, parent: TestedSuite, **kwargs: Any) -> None:
        super().__init__(parent=parent, **kwargs)
        self.line = line
        self.suite = parent
        self.add_marker("nw")

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return the suite's file, the line there (from 0), and a title.

        Dots of a title that a node's id ends with would be shown as `::`.
        """
        return self.path, self.line - 1, f"{self.suite.name}: {self.name}"

    def judged(self) -> RunReport:
        """Return the suite's run; an error of pytest's where it came to no verdict."""
        try:
            return self.suite.judged()
        except NwEvalError as error:
            fault = str(error)
        # Raised in there, it would be shown with what it was raised in.
        pytest.fail(fault, pytrace=False)


class SceneItem(SuiteItem):
    """Passes where the run passes with this scene, and fails where it regressed.

    A scene of which the gate has shown nothing is skipped (`reporting.scene_states`).
    """

    state: SceneState

    def setup(self) -> None:
        """Run the suite if nobody has; a scene without all of its results is an error."""
        from nw_eval.clean import clean
        from nw_eval.pytest_plugin.telling.properties import scene_properties
        from nw_eval.pytest_plugin.telling.texts import scene_text
        from nw_eval.reporting.scene_states import scene_states

        judged = self.judged()
        (self.state,) = [each for each in scene_states(judged.verdict) if each.scene == self.name]
        self.user_properties += scene_properties(judged, self.state)
        is_invalid = self.state.state == "unjudged" and not self.suite.has_verdict
        if self.state.result == "error" or is_invalid:
            pytest.fail(scene_text(judged, self.state), pytrace=False)
        if self.state.result == "skipped" and not self._is_blamed(judged):
            pytest.skip(clean(self.state.sentence))

    def runtest(self) -> None:
        """Fail if the scene fell, or shares in what no other test is here to say."""
        from nw_eval.pytest_plugin.telling.texts import scene_text

        judged = self.judged()
        if self.state.result != "passed":
            pytest.fail(scene_text(judged, self.state), pytrace=False)

    def _is_blamed(self, judged: RunReport) -> bool:
        """Whether the scenes are worse together, none of them by itself, and no test says so.

        That is so where the verdict's own test is not among those that run.
        """
        from nw_eval.reporting.scene_states import scene_states

        return (
            judged.verdict.verdict == "REGRESSED"
            and not self.suite.has_verdict
            and self.state.score.tier != "informational"
            and not any(each.result == "failed" for each in scene_states(judged.verdict))
        )


class VerdictItem(SuiteItem):
    """Fails where the verdict does."""

    def setup(self) -> None:
        """Run the suite if nobody has; what can be judged by nobody is an error."""
        from nw_eval.pytest_plugin.telling.properties import verdict_properties
        from nw_eval.pytest_plugin.telling.texts import verdict_text

        if self.config.stash[SETTINGS].update_baseline:
            return
        judged = self.judged()
        self.user_properties += verdict_properties(judged)
        if judged.verdict.verdict in {"INFRASTRUCTURE", "INVALID"}:
            pytest.fail(verdict_text(judged), pytrace=False)

    def runtest(self) -> None:
        """Fail unless the verdict is PASS, or RAN where the suite has no bar."""
        from nw_eval.pytest_plugin.bank import update
        from nw_eval.pytest_plugin.telling.texts import verdict_text
        from nw_eval.reporting.headline import headline

        settings = self.config.stash[SETTINGS]
        if settings.update_baseline:
            update(self.suite)
            return
        judged = self.judged()
        if judged.verdict.verdict == "INCONCLUSIVE":
            if settings.inconclusive == "xfail":
                pytest.xfail(headline(judged.verdict, judged.info))
            if settings.inconclusive == "pass":
                return
        if not judged.passed:
            pytest.fail(verdict_text(judged), pytrace=False)
