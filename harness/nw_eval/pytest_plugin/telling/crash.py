"""Where a suite's test failed or was skipped, and why: one line, for summaries and JUnit."""

from __future__ import annotations

import os

import pytest

from nw_eval.pytest_plugin.items import SuiteItem


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
