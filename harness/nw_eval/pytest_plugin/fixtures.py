"""What the fixtures give to tests that are written by hand."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.errors import NwEvalError
from nw_eval.pytest_plugin.options import SETTINGS
from nw_eval.pytest_plugin.runs import runs_of

if TYPE_CHECKING:
    from nw_eval.api import RunReport


@dataclass(frozen=True, kw_only=True)
class Gated:
    """What a gate says."""

    report: RunReport
    passed: bool
    """Whether the verdict is PASS; or INCONCLUSIVE, in a session that lets that pass."""

    def __repr__(self) -> str:
        """Return what a failing `assert` is to show: the verdict with its figures."""
        from nw_eval.reporting.headline import headline

        return headline(self.report.verdict, self.report.info)


class RunSuite:
    """Runs suites for tests; each run is made once in a session.

    Args:
        config: of the session, whose options hold for what a call leaves out.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    def __call__(self, suite: str | Path, **changes: Any) -> RunReport:
        """Run a suite, or return its run.

        Args:
            suite: a file, or the name of a shipped one.
            changes: fields of `nw_eval.Request` by name.
        """
        from nw_eval import api

        settings = self._config.stash[SETTINGS]
        options = {
            "policy": settings.policy,
            "checkpoint": settings.checkpoint,
            "baseline": settings.baseline,
            "trials": settings.rounds,
        }
        try:
            request = api.Request.of(suite, **{**options, **changes})
            return runs_of(self._config).of(request)
        except NwEvalError as error:
            fault = str(error)
        pytest.fail(fault, pytrace=False)


class GateSuite:
    """Gates policies for tests, with the runs of `RunSuite`.

    Args:
        config: of the session.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._run = RunSuite(config)

    def __call__(self, suite: str | Path, **changes: Any) -> Gated:
        """Run a suite, or take its run, and return what its gate says.

        A test fails here if there is nothing to say: trials without a result, a baseline that does
        not hold, a suite without a gate. The text of a verdict that does not pass is printed, which
        pytest shows with the test that fails.

        Args:
            suite: a file, or the name of a shipped one.
            changes: fields of `nw_eval.Request` by name.
        """
        from nw_eval.pytest_plugin.telling.texts import verdict_text

        judged = self._run(suite, **changes)
        word = judged.verdict.verdict
        if word in {"INFRASTRUCTURE", "INVALID", "RAN"}:
            pytest.fail(verdict_text(judged), pytrace=False)
        gated = Gated(report=judged, passed=judged.passed)
        if word == "INCONCLUSIVE":
            inconclusive = self._config.stash[SETTINGS].inconclusive
            if inconclusive == "xfail":
                pytest.xfail(repr(gated))
            gated = Gated(report=judged, passed=inconclusive == "pass")
        if not gated.passed:
            sys.stdout.write(verdict_text(judged) + "\n")
        return gated
