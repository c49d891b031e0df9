"""A line for each suite at the end of a session, wherever its tests ran."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


def write_last_lines(terminal: pytest.TerminalReporter) -> None:
    """Write each suite's verdict and where its page is; nothing without a suite."""
    lines = dict(_lines(terminal))
    if lines and terminal.config.get_verbosity() >= 0:
        terminal.write_sep("-", "nw-eval")
        for suite, line in sorted(lines.items()):
            terminal.write_line(f"{suite}: {line}")


def _lines(terminal: pytest.TerminalReporter) -> Iterator[tuple[str, str]]:
    """Yield the headline and the page of every suite whose verdict was a test."""
    for reports in list(terminal.stats.values()):
        for report in reports:
            if not getattr(report, "nodeid", "").endswith("::verdict"):
                continue
            properties = dict(getattr(report, "user_properties", ()))
            if "headline" in properties:
                suite = report.nodeid.removesuffix("::verdict")
                yield suite, f"{properties['headline']} · report: {properties['report']}"
