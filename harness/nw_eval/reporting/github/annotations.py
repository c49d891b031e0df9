"""What GitHub shows beside lines of a suite: the verdict and its worst scenes, at most eight."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from nw_eval.errors import NwEvalError, Problem
from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.github.commands import command
from nw_eval.reporting.headline import headline
from nw_eval.reporting.scene_states import SceneState, scene_states, worst_first
from nw_eval.reporting.suite_lines import SuiteLines
from nw_eval.results.provenance import RunInfo

MOST = 8
"""Annotations of a run. GitHub shows ten of a kind and step, and drops others without a word."""


def run_annotations(run: RunInfo, verdict: Verdict, lines: SuiteLines | None) -> tuple[str, ...]:
    """Return commands: an error for a verdict that is no pass, and one for each scene to look at.

    A scene that makes the verdict is an error, one that is weak in a run that passes is a warning.

    Args:
        run: the run's provenance.
        verdict: what the gate says of it.
        lines: where the suite's file speaks of its scenes; None if it is not in the repository.
    """
    suite = run.suite.get("name", "suite")
    shown: list[str] = []
    if verdict.exit_code:
        why = "; ".join([headline(verdict, run), *verdict.reasons[:1]])
        title = f"{verdict.verdict}: {suite}"
        line = None if lines is None else lines.gate
        shown.append(_at(lines, line, "error", title, why))
    for state in worst_first(scene_states(verdict)):
        if state.state in {"failed", "error", "weak"}:
            line = None if lines is None else lines.scenes.get(state.scene, lines.gate)
            title = f"{_title(state)}: {state.scene}"
            shown.append(_at(lines, line, _level(state), title, state.sentence))
    return tuple(shown[:MOST])


def error_annotations(error: NwEvalError, root: Path) -> tuple[str, ...]:
    """Return commands for an error that kept a run from a verdict: one for each fault of a file.

    Args:
        error: what happened.
        root: the repository's folder, to which the places of faults are relative.
    """
    if not error.problems:
        return (command("error", str(error), title="nw-eval"),)
    return tuple(_of_problems(error.problems[:MOST], root))


def _of_problems(problems: Iterable[Problem], root: Path) -> Iterable[str]:
    for problem in problems:
        path = Path(problem.file).resolve()
        here = path.is_relative_to(root.resolve())
        yield command(
            "error",
            str(problem),
            file=path.relative_to(root.resolve()).as_posix() if here else None,
            line=problem.line if here else None,
            col=problem.column if here else None,
            title="nw-eval",
        )


def _title(state: SceneState) -> str:
    """Return what is wrong with a scene; one below the bar did not regress from a baseline."""
    if state.state == "error":
        return "incomplete"
    return "regressed" if any(item.named for item in state.drops) else "below the bar"


def _level(state: SceneState) -> str:
    return "warning" if state.state == "weak" else "error"


def _at(lines: SuiteLines | None, line: int | None, level: str, title: str, message: str) -> str:
    file = None if lines is None else lines.file
    return command(level, message, file=file, line=line, title=title)
