"""Logs of trials that were taken over: also where a run's other logs are, in `mcap/`, as links.

A row that was taken over names its log in `cached/`, whose files are the cache's own and which no
worker process may write. When a run has ended, `mcap/` gets a symbolic link to each of them, so
that a file browser or Foxglove finds all logs in one folder. A link is relative and within the
run's folder, and its text follows from its name; every reader refuses one with another text. There
are none while trials run.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from nw_base.files.inside import what_is

if TYPE_CHECKING:
    from nw_gate.results.row import Row

_LOGS, _CACHED = "mcap", "cached"
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW


def linked_name(row: Row) -> str | None:
    """Return what the link to a row's log is called, from the run's folder; None if it has none."""
    name = f"{row.scene}/{row.trial_id}.mcap"
    return f"{_LOGS}/{name}" if row.cached and row.mcap_path == f"{_CACHED}/{name}" else None


def is_own_link(path: Path, name: str) -> bool:
    """Return whether a link leads from a name in `mcap/` to the same name in `cached/`.

    Args:
        path: of the link.
        name: its path from the run's folder, with slashes.
    """
    first, *parts = PurePosixPath(name).parts
    try:
        return first == _LOGS and str(path.readlink()) == _text(parts)
    except (OSError, ValueError):  # No link.
        return False


def link_logs(run: Path, rows: Iterable[Row]) -> None:
    """Make the links of the rows that were taken over, as far as the file system has links.

    What is there already stays, and no link on the way is followed: workers could write there.

    Args:
        run: the run's folder.
        rows: of its plan.
    """
    for row in rows:
        name = linked_name(row)
        if name is not None and what_is(run / row.mcap_path) == "file":
            with suppress(OSError):
                _link(run, PurePosixPath(name).parts[1:])


def drop_links(run: Path) -> None:
    """Remove the links, before trials run: workers find none."""
    for path in list((run / _LOGS).rglob("*.mcap")):
        if is_own_link(path, path.relative_to(run).as_posix()):
            with suppress(OSError):
                path.unlink()


def taken_over_log(log: Path) -> Path:
    """Return where the log of a trial lies that is named as RUN/mcap/SCENE/TRIAL.mcap.

    That of a trial that was reused from an earlier run lies in `RunFolder.cached`. A path is
    returned as it is where a file is there, or none is in either place.
    """
    for index in range(len(log.parts) - 2, 0, -1):
        if log.parts[index] != _LOGS:
            continue
        if what_is(log) == "nothing" or is_own_link(log, "/".join(log.parts[index:])):
            beside = Path(*log.parts[:index], _CACHED, *log.parts[index + 1 :])
            if what_is(beside) == "file":
                return beside
    return log


def _text(parts: Iterable[str]) -> str:
    names = list(parts)
    return "/".join([*[".."] * len(names), _CACHED, *names])


def _link(run: Path, parts: tuple[str, ...]) -> None:
    *folders, log = parts
    at = os.open(run, _FOLDER)
    try:
        for folder in (_LOGS, *folders):
            with suppress(FileExistsError):
                os.mkdir(folder, dir_fd=at)
            above, at = at, os.open(folder, _FOLDER, dir_fd=at)
            os.close(above)
        os.symlink(_text(parts), log, dir_fd=at)
    finally:
        os.close(at)
