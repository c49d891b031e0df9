"""Logs of merged trials: linked where that goes, copied where not, and never from elsewhere.

A folder may be a stranger's. A row's log is taken only from below its folder, links followed, and
put only where a trial's log has its place. Links are hard ones, so that the parts may be removed; a
log is never written over (`rollout.mcap.file` renames), hence nothing is that both have.
"""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path, PurePosixPath

from nw_eval.errors import StoreError
from nw_eval.files.inside import OutsideError, checked, inside
from nw_eval.plural import plural
from nw_eval.results.merge.rows import SourcedRow
from nw_eval.results.row import Row
from nw_eval.results.run_folder import RunFolder


def take_logs(held: Iterable[SourcedRow], folder: RunFolder) -> tuple[str, ...]:
    """Put the logs that rows name into a folder; return sentences about those that are not there.

    Raises:
        StoreError: a row names another place than its log's, or the folder cannot be written.
    """
    lost: list[str] = []
    for one in held:
        if not one.row.mcap_path:
            continue
        place = folder.path / _name(one)
        if not any(_take(source.folder, one.row, place) for source in one.sources):
            lost.append(one.row.trial_id)
    if not lost:
        return ()
    return (
        f"{plural(len(lost), 'log')} not there, or not of the size that its row says: {lost[0]}"
        + (f" and {len(lost) - 1} more" if len(lost) > 1 else ""),
    )


def _name(one: SourcedRow) -> PurePosixPath:
    """Return where a row's log lies in its folder, and goes in another: `<folder>/<scene>/<trial>`.

    Nothing else of a run is called so.

    Raises:
        StoreError: the row names another place.
    """
    row = one.row
    with suppress(OutsideError):
        name = checked(row.mcap_path)
        if name.parts[1:] == PurePosixPath(row.scene, f"{row.trial_id}.mcap").parts:
            return name
    raise StoreError(
        f"{one.sources[0]}: the row of trial {row.trial_id} has its log at {row.mcap_path!r}, "
        "where none of a run has its place",
        fix="merge folders that nw-eval wrote",
    )


def _take(source: RunFolder, row: Row, place: Path) -> bool:
    """Link or copy a row's log; False if it is not there."""
    try:
        path = inside(source.path, row.mcap_path)
        facts = path.lstat()
    except (OutsideError, OSError, ValueError):
        return False
    if not stat.S_ISREG(facts.st_mode) or facts.st_size != row.mcap_bytes:
        return False
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with suppress(OSError):  # Another file system, another user's file, or none that has links.
            os.link(path, place, follow_symlinks=False)
            return True
        shutil.copyfile(path, place, follow_symlinks=False)
    except OSError as error:
        raise StoreError(
            f"cannot write {place}: {error.strerror}", fix="free disk space, or check its rights"
        ) from error
    return True
