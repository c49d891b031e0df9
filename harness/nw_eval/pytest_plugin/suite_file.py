"""A suite as a test file: a test for each scene and ladder, and one for the verdict on all."""

from __future__ import annotations

import os
from contextlib import chdir
from functools import partial
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from nw_base.errors import NwEvalError
from nw_base.plural import plural
from nw_eval.pytest_plugin.options import SETTINGS
from nw_eval.pytest_plugin.runs import runs_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from nw_eval.api import RunReport, ShownSuite
    from nw_eval.reporting.scene_states import SceneState
    from nw_gate.verdict import LimitFinding


VERDICT = "verdict"
"""The name of the test of a suite's verdict, which no scene may have."""


class SuiteFile(pytest.File):
    """A suite's file. Its tests are named by scenes and ladders, and the last one `VERDICT`."""

    shown: ShownSuite

    def collect(self) -> Iterator[SuiteItem]:
        """Yield a test for each scene and ladder, in the order in which they run; the verdict's.

        Raises:
            CollectError: the file is not a suite, with all that is wrong with it.
        """
        from nw_eval import api

        with chdir(self.project):
            try:
                self.shown = shown = api.show_suite(self.typed)
            except NwEvalError as error:
                raise self.CollectError(str(error)) from None
        if VERDICT in self.shown.scenes:
            raise self.CollectError(
                f"{self.typed}: a scene is called {VERDICT!r}, as the suite's own test is; "
                "give it another name"
            )
        items = [
            *(SceneItem.from_parent(self, name=name, line=n) for name, n in shown.scenes.items()),
            *(LadderItem.from_parent(self, name=name, line=n) for name, n in shown.ladders.items()),
        ]
        for item in items:
            if self.config.stash[SETTINGS].update_baseline:
                item.add_marker(pytest.mark.skip(reason="the baseline is being saved"))
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
        # A limit is judged in a run of all scenes, which says whether the baseline holds here.
        if VERDICT in names or names & self.shown.ladders.keys() or names >= {*self.shown.scenes}:
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


class SuiteItem(pytest.Item):
    """A test of a suite. It fails with the verdict in its words, and without a traceback."""

    suite: SuiteFile

    def __init__(self, *, line: int, parent: SuiteFile, **kwargs: Any) -> None:
        super().__init__(parent=parent, **kwargs)
        self.line = line
        self.suite = parent
        self.add_marker("nw")

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return the suite's file, the line there (from 0), and a title.

        Dots of a title that a node's id ends with would be shown as `::`.
        """
        return self.path, self.line - 1, f"{self.suite.typed}: {self.name}"

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
        """Run the suite if it has not run; a scene without all of its results is an error."""
        from nw_base.clean import clean
        from nw_eval.pytest_plugin.runs import scene_properties
        from nw_eval.reporting.scene_states import scene_states

        judged = self.judged()
        (self.state,) = [each for each in scene_states(judged.verdict) if each.scene == self.name]
        self.user_properties += scene_properties(judged, self.state)
        is_invalid = self.state.state == "unjudged" and not self.suite.has_verdict
        if self.state.result == "error" or is_invalid:
            pytest.fail(self._text(judged), pytrace=False)
        if self.state.result == "skipped" and not self._is_blamed(judged):
            pytest.skip(clean(self.state.sentence))

    def runtest(self) -> None:
        """Fail if the scene regressed, or shares in what no other test is here to say."""
        judged = self.judged()
        if self.state.result != "passed":
            pytest.fail(self._text(judged), pytrace=False)

    def _text(self, judged: RunReport) -> str:
        """Return what a failure shows; the verdict only if no test of its own shows it."""
        from nw_eval.pytest_plugin.runs import scene_text

        return scene_text(judged, self.state, with_verdict=not self.suite.has_verdict)

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


class LadderItem(SuiteItem):
    """Passes where the policy's limit on a ladder does, and fails where it does not.

    A ladder that the gate does not judge is skipped.
    """

    def setup(self) -> None:
        """Run the suite if it has not run; a ladder without its results is an error."""
        from nw_eval.reporting.junit import limit_properties

        self.user_properties += list(limit_properties(self._finding).items())
        if self._finding.word in {"INFRASTRUCTURE", "INVALID"}:
            pytest.fail(self._text, pytrace=False)
        if self._finding.word is None:
            pytest.skip(self._text)

    def runtest(self) -> None:
        """Fail unless the gate has shown that the limit is good enough."""
        word, accepted = self._finding.word, self.config.stash[SETTINGS].inconclusive
        if word == "INCONCLUSIVE" and accepted == "xfail":
            pytest.xfail(self._text)
        if word == "REGRESSED" or (word == "INCONCLUSIVE" and accepted != "pass"):
            pytest.fail(self._text, pytrace=False)

    @property
    def _finding(self) -> LimitFinding:
        limits = self.judged().verdict.limits
        return next(each for each in limits if each.ladder == self.name)

    @property
    def _text(self) -> str:
        from nw_base.clean import clean

        return clean(self._finding.sentence)


class VerdictItem(SuiteItem):
    """Fails where the verdict does."""

    def setup(self) -> None:
        """Run the suite if it has not run; a run that cannot be judged is an error."""
        from nw_eval.pytest_plugin.runs import verdict_properties, verdict_text

        if self.config.stash[SETTINGS].update_baseline:
            return
        judged = self.judged()
        self.user_properties += verdict_properties(judged)
        if judged.verdict.verdict in {"INFRASTRUCTURE", "INVALID"}:
            pytest.fail(verdict_text(judged), pytrace=False)

    def runtest(self) -> None:
        """Fail unless the verdict is PASS, or RAN where the suite has no bar."""
        from nw_eval.pytest_plugin.runs import verdict_text
        from nw_eval.reporting.headline import headline

        settings = self.config.stash[SETTINGS]
        if settings.update_baseline:
            save_baseline(self.suite)
            return
        judged = self.judged()
        if judged.verdict.verdict == "INCONCLUSIVE":
            if settings.inconclusive == "xfail":
                pytest.xfail(headline(judged.verdict, judged.info))
            if settings.inconclusive == "pass":
                return
        if not judged.passed:
            pytest.fail(verdict_text(judged), pytrace=False)


def place_crash(report: pytest.TestReport, item: pytest.Item) -> None:
    """Let a report's crash be the suite's own line, and its message the first line of its text.

    A skipped scene is said to be skipped at that line, too.
    """
    if isinstance(item, SuiteItem) and isinstance(report.longrepr, tuple):
        report.longrepr = (os.fspath(item.path), item.line, report.longrepr[2])
    crash = getattr(report.longrepr, "reprcrash", None)
    if not isinstance(item, SuiteItem) or crash is None:
        return
    crash.path = os.fspath(item.path)
    crash.lineno = item.line
    crash.message = crash.message.removeprefix("Failed: ").partition("\n")[0]


def leave_verdicts_out(session: pytest.Session) -> None:
    """Deselect the verdict of a suite of which some scenes are to run, and not all.

    Where a scene failed the verdict did, and it takes every scene to say another. It is still among
    the last failed, and `--lf` runs it as soon as no scene of its suite is.
    """
    chosen: dict[SuiteFile, int] = {}
    for item in session.items:
        if isinstance(item, SceneItem):
            chosen[item.suite] = chosen.get(item.suite, 0) + 1
    left_out: list[pytest.Item] = [
        item
        for item in session.items
        if isinstance(item, VerdictItem)
        and 0 < chosen.get(item.suite, 0) < len(item.suite.shown.scenes)
    ]
    if left_out:
        session.config.hook.pytest_deselected(items=left_out)
        session.items[:] = [item for item in session.items if item not in left_out]


def save_baseline(suite: SuiteFile) -> None:
    """Save the baseline of a suite; fail if that changed it, so that it is reviewed first."""
    from nw_eval import api
    from nw_eval.pytest_plugin.runs import Log

    settings = suite.config.stash[SETTINGS]
    # The suite's baseline is that of its own policy: another one is not saved over it.
    name = settings.baseline or (suite.shown.baseline if settings.policy is None else None)
    save = partial(
        api.save_baseline,
        suite.typed,
        policy=settings.policy,
        name=None if name == "none" else name,
        workers=settings.workers,
        cache=settings.cache,
        checkpoint=settings.checkpoint,
        listener=Log(),
    )
    saved, fault = None, ""
    try:
        with chdir(suite.project):
            saved = save()
            if saved.action == "kept":  # Only what says something else is replaced.
                saved = save(renew=True)
    except NwEvalError as error:
        fault = str(error)
    if saved is None:
        pytest.fail(fault, pytrace=False)
    if saved.action == "unchanged":
        return
    manifest = saved.baseline.manifest
    pytest.fail(
        f"{saved.file} is {saved.action}: {manifest.policy.name}, "
        f"{plural(manifest.starts, 'initial state')} in each scene\n"
        "Check what has changed, commit it, and run again without --nw-update-baseline.",
        pytrace=False,
    )
