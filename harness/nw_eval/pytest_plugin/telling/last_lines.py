"""A line for each suite at the end of a session, wherever its tests ran."""

from __future__ import annotations

from collections.abc import Iterable

import pytest


def write_last_lines(
    terminal: pytest.TerminalReporter, verdicts: Iterable[pytest.TestReport]
) -> None:
    """Write each suite's verdict and where its page is.

    Args:
        terminal: where to.
        verdicts: reports of verdicts' tests, and of whatever else is called like them.
    """
    lines: dict[str, str] = {}
    for report in verdicts:
        properties = dict(report.user_properties)
        if "headline" in properties:
            suite = report.nodeid.removesuffix("::verdict")
            lines[suite] = f"{properties['headline']} · report: {properties['report']}"
    if lines and terminal.config.get_verbosity() >= 0:
        terminal.write_sep("-", "nw-eval")
        for suite, line in sorted(lines.items()):
            terminal.write_line(f"{suite}: {line}")
