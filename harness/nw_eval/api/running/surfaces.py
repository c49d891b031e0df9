"""Where a judged run is shown besides its report: a JUnit file, GitHub's runner, trackers.

None of them is worth a verdict. Whatever keeps one from being written is a warning, and changes no
exit code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.errors import NwEvalError
from nw_eval.words import Tracker

if TYPE_CHECKING:
    from nw_eval.api.running.reports import RunReport


@dataclass(frozen=True, kw_only=True)
class Surfaces:
    """Where to show a run; nowhere by default."""

    junit: Path | None = None
    """A file of JUnit XML."""
    track: tuple[Tracker, ...] = ()
    """Trackers of experiments."""


@dataclass(frozen=True, kw_only=True)
class Published:
    """What became of the surfaces of a run."""

    surfaces: tuple[str, ...]
    """Those that show it now."""
    warnings: tuple[str, ...]
    """A line for each that does not, with the reason."""


def check_surfaces(where: Surfaces) -> None:
    """Check, before anything runs, that what is asked for is there.

    Raises:
        UsageError: there is no such tracker.
        PrerequisiteError: its extra is not installed.
    """
    if where.track:
        from nw_eval.reporting.trackers import check_trackers

        check_trackers(where.track)


def publish(judged: RunReport, where: Surfaces) -> Published:
    """Show a judged run; what cannot be written is among the warnings, and never raised."""
    writers: list[_Writer] = []
    if where.junit is not None:
        writers.append(("JUnit", partial(_write_junit, judged, where.junit)))
    writers += [(f"{name} run", partial(_track, judged, name)) for name in where.track]
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
        writers.append(("JUnit", partial(_write_junit_error, error, suite, where.junit)))
    return _write_all(writers)


_Writer = tuple[str, Callable[[], None]]


def _write_all(writers: Sequence[_Writer]) -> Published:
    surfaces: list[str] = []
    warnings: list[str] = []
    for name, write in writers:
        try:
            write()
        except Exception as error:  # noqa: BLE001 - no surface is worth a verdict.
            kind = "" if isinstance(error, NwEvalError) else f"{type(error).__name__}: "
            warnings.append(f"no {name}: {kind}{clean(error)}")
        else:
            surfaces.append(name)
    return Published(surfaces=tuple(surfaces), warnings=tuple(warnings))


def _write_junit(judged: RunReport, path: Path) -> None:
    from nw_eval.reporting.junit import junit_xml
    from nw_eval.reporting.suite_lines import suite_lines

    lines = suite_lines(judged.info, Path.cwd())
    rows, verdict = judged.rows, judged.verdict
    _write(path, junit_xml(judged.info, rows, verdict, judged.typed_folder, lines))


def _write_junit_error(error: NwEvalError, suite: str, path: Path) -> None:
    from nw_eval.reporting.junit import junit_of_error

    _write(path, junit_of_error(suite, error))


def _track(judged: RunReport, tracker: Tracker) -> None:
    from nw_eval.reporting.trackers import track, tracked_run

    pages = () if judged.page is None else (judged.page,)
    track(tracker, tracked_run(judged.info, judged.verdict, judged.folder, pages))


def _write(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    from nw_eval.files.cache import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
