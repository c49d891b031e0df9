"""Where a judged run is shown besides its report: JUnit, GitHub's runner, a comment, trackers.

Reporting never changes the verdict: whatever keeps one from being written is a warning, and
changes no exit code.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.errors import NwEvalError
from nw_eval.words import Tracker

if TYPE_CHECKING:
    from nw_eval.api.reports import RunReport


@dataclass(frozen=True, kw_only=True)
class TrainingStep:
    """Where in a training a run's checkpoint was written."""

    step: int
    folder: Path
    """Of the watch: what all runs of one training have in common."""


@dataclass(frozen=True, kw_only=True)
class Surfaces:
    """Where to show a run; nowhere by default."""

    junit: Path | None = None
    """A file of JUnit XML."""
    github: bool = False
    """GitHub's runner, as the environment describes it: summary, outputs, annotations."""
    comment: Path | None = None
    """A file of Markdown, short enough for a comment on a pull request."""
    track: tuple[Tracker, ...] = ()
    """Trackers of experiments."""
    training: TrainingStep | None = None
    """Trackers then show the run's scores at this step of a curve."""


@dataclass(frozen=True, kw_only=True)
class Published:
    """What became of the surfaces of a run."""

    surfaces: tuple[str, ...]
    """Those that show it now."""
    warnings: tuple[str, ...]
    """A line for each that does not, with the reason."""
    commands: tuple[str, ...] = ()
    """Lines that GitHub's runner reads from standard output: annotations."""


def check_surfaces(where: Surfaces) -> Surfaces:
    """Return surfaces, once it is known that what they need is there: before anything runs.

    Raises:
        UsageError: there is no such tracker, or a folder is where a file is to be written.
        PrerequisiteError: its extra is not installed.
    """
    from nw_eval.files.cache import followed

    for path in (where.junit, where.comment):
        if path is not None:
            followed(path)
    if where.track:
        from nw_eval.reporting.trackers.tracked import check_trackers

        check_trackers(where.track)
    return where


def publish(judged: RunReport, where: Surfaces, *, exit_code: int | None = None) -> Published:
    """Show a judged run; what cannot be written is among the warnings, and never raised.

    Args:
        judged: the run.
        where: the surfaces.
        exit_code: of the process that judged it, where it is not the verdict's.
    """
    code = judged.exit_code if exit_code is None else exit_code
    writers: list[_Writer] = []
    if where.junit is not None:
        writers.append(("JUnit file", partial(_write_junit, judged, where.junit)))
    if where.comment is not None:
        writers.append(("comment", partial(_write_comment, judged, where.comment)))
    if where.github:
        writers += [
            ("step summary", partial(_write_summary, judged)),
            ("step outputs", partial(_write_outputs, _outputs(judged, code))),
            ("annotations", partial(_annotations, judged)),
        ]
    writers += [
        (f"{name} run", partial(_track_run, judged, name, where.training)) for name in where.track
    ]
    return _write_all(writers)


def publish_error(error: NwEvalError, suite: str, where: Surfaces) -> Published:
    """Show that a run came to no verdict, so that nobody takes an earlier one for its own.

    Args:
        error: what kept it from one.
        suite: what was to be run, as it was typed.
        where: the surfaces.
    """
    writers: list[_Writer] = []
    if where.junit is not None:
        writers.append(("JUnit file", partial(_write_junit_error, error, suite, where.junit)))
    if where.comment is not None:
        writers.append(("comment", partial(where.comment.unlink, missing_ok=True)))
    if where.github:
        outputs = {"verdict": "", "exit-code": str(error.exit_code)}
        writers += [
            ("step outputs", partial(_write_outputs, outputs)),
            ("annotations", partial(_annotations_of_error, error)),
        ]
    return _write_all(writers)


_Writer = tuple[str, Callable[[], Sequence[str] | None]]
"""A surface's name, and what writes it; what that returns is for the runner to read."""


def _write_all(writers: Sequence[_Writer]) -> Published:
    surfaces: list[str] = []
    warnings: list[str] = []
    commands: list[str] = []
    for name, write in writers:
        try:
            commands += write() or ()
        except Exception as error:  # noqa: BLE001 - no surface is worth a verdict.
            kind = "" if isinstance(error, NwEvalError) else f"{type(error).__name__}: "
            warnings.append(f"no {name}: {kind}{clean(error)}")
        else:
            surfaces.append(name)
    return Published(surfaces=tuple(surfaces), warnings=tuple(warnings), commands=tuple(commands))


def _write_junit(judged: RunReport, path: Path) -> None:
    from nw_eval.reporting.junit import junit_xml
    from nw_eval.reporting.scene_states import suite_lines

    lines = suite_lines(judged.info, Path.cwd())
    rows, verdict = judged.rows, judged.verdict
    _write(path, junit_xml(judged.info, rows, verdict, judged.typed_folder, lines))


def _write_junit_error(error: NwEvalError, suite: str, path: Path) -> None:
    from nw_eval.reporting.junit import junit_of_error

    _write(path, junit_of_error(suite, error))


def _write_comment(judged: RunReport, path: Path) -> None:
    from nw_eval.reporting.github import comment_page

    page = comment_page(judged.info, judged.rows, judged.verdict, judged.typed_folder)
    _write(path, page.encode())


def _write_summary(judged: RunReport) -> None:
    from nw_eval.reporting.github import SUMMARY, append, room_in, runner_of, summary_page

    summary = runner_of(os.environ).summary
    page = summary_page(
        judged.info,
        judged.rows,
        judged.verdict,
        judged.typed_folder,
        budget=min(SUMMARY, room_in(summary)),
    )
    append(summary, page, "GITHUB_STEP_SUMMARY")


def _outputs(judged: RunReport, exit_code: int) -> dict[str, str]:
    mean = judged.verdict.success
    success = "" if mean is None else f"{mean:.6f}"
    return {
        "verdict": judged.verdict.verdict,
        "exit-code": str(exit_code),
        "success": success,
        "effect": success,  # Its name until 0.1; goes with the next release.
        "trials": str(judged.verdict.n),
        "report-path": str(judged.typed_folder),
    }


def _write_outputs(outputs: dict[str, str]) -> None:
    from nw_eval.reporting.github import append, outputs_text, runner_of

    append(runner_of(os.environ).output, outputs_text(outputs), "GITHUB_OUTPUT")


def _annotations(judged: RunReport) -> Sequence[str]:
    from nw_eval.reporting.github import run_annotations, runner_of
    from nw_eval.reporting.scene_states import suite_lines

    lines = suite_lines(judged.info, runner_of(os.environ).workspace)
    return run_annotations(judged.info, judged.verdict, lines)


def _annotations_of_error(error: NwEvalError) -> Sequence[str]:
    from nw_eval.reporting.github import error_annotations, runner_of

    return error_annotations(error, runner_of(os.environ).workspace)


def _write(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    from nw_eval.files.cache import atomic_path, followed

    with atomic_path(followed(path)) as temporary:
        temporary.write_bytes(content)


def _track_run(judged: RunReport, tracker: Tracker, training: TrainingStep | None) -> None:
    """Show a run in a tracker, with pages and clips that were written of this verdict.

    Raises:
        Exception: whatever the tracker's library raises.
    """
    from nw_eval.reporting.trackers.tracked import track, tracked_run

    pages = tuple(page for page in (judged.page, judged.html) if page is not None)
    clips = () if judged.evidence is None else judged.evidence.clips
    run = tracked_run(judged.info, judged.verdict, judged.folder, pages, clips)
    track(tracker, run if training is None else run.at_step(training.step, training.folder))
