"""The pytest plugin: suites are test files, and tests written by hand can run and gate policies.

It costs a session that has no suite next to nothing: what is here imports nothing but pytest and
what pytest imports, prints nothing, and looks at no file that does not end in `.yaml` or `.yml`.
PYTEST_DONT_REWRITE: there is no assertion here to explain.
"""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.pytest_plugin.options import SETTINGS, Settings, add_options, is_suite

if TYPE_CHECKING:
    from nw_eval.pytest_plugin.runs import GateSuite, RunSuite
    from nw_eval.pytest_plugin.suite_file import SuiteFile

_MARKER = "nw: a test of nw-eval's: a scene of a suite, or a suite's verdict"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Tell pytest of the plugin's options."""
    add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    """Read the options; one that cannot be used ends the session with a line."""
    config.addinivalue_line("markers", _MARKER)
    config.stash[SETTINGS] = Settings.of(config)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Tell a worker of pytest-xdist which session it works for."""
    from nw_eval.pytest_plugin.runs import tell_worker

    tell_worker(node.config, node.workerinput)


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> SuiteFile | None:
    """Take a suite for a test file."""
    if not is_suite(file_path, parent.config):
        return None
    from nw_eval.pytest_plugin.suite_file import SuiteFile

    return SuiteFile.from_parent(parent, path=file_path)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Leave out verdicts of suites of which `--lf` chose some scenes only."""
    if session.config.getoption("lf", default=False):
        from nw_eval.pytest_plugin.suite_file import leave_verdicts_out

        leave_verdicts_out(session)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a suite's test once, also where a plugin runs failed tests again: its run is made once.

    Such a plugin would write a case that passed to the XML for each failure that it runs again.
    """
    if item.path.suffix not in {".yaml", ".yml"} or item.get_closest_marker("nw") is None:
        return None
    runner: Any = item.config.pluginmanager.get_plugin("runner")
    return runner.pytest_runtest_protocol(item, nextitem)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Say of a suite's test that it failed or was skipped where the suite says so, not here."""
    report = yield
    if item.path.suffix in {".yaml", ".yml"}:
        from nw_eval.pytest_plugin.suite_file import place_crash

        place_crash(report, item)
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what became of each suite; nothing where there was none."""
    ended = [report for reports in terminalreporter.stats.values() for report in reports]
    verdicts = [each for each in ended if getattr(each, "nodeid", "").endswith("::verdict")]
    if verdicts:
        from nw_eval.pytest_plugin.runs import write_last_lines

        write_last_lines(terminalreporter, verdicts)


@pytest.fixture(scope="session")
def nw_run(pytestconfig: pytest.Config) -> RunSuite:
    """Run a suite and return its `RunReport`: `nw_run("hurdles", policy="mine")`.

    Keywords are fields of `nw_eval.Request`; what is not given is as the session's options say.
    The same run is made once in a session.
    """
    from nw_eval.pytest_plugin.runs import RunSuite

    return RunSuite(pytestconfig)


@pytest.fixture(scope="session")
def nw_gate(pytestconfig: pytest.Config) -> GateSuite:
    """Ask a suite's gate about a policy, and return what it says as a value with `passed`.

    In a test: `assert nw_gate("hurdles", policy="mine").passed`.

    Arguments are those of `nw_run`. A run that cannot be judged fails the test at once.
    """
    from nw_eval.pytest_plugin.runs import GateSuite

    return GateSuite(pytestconfig)
