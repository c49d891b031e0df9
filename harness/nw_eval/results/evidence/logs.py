"""A run's logs held against the digests that its rows have of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from nw_eval.files.inside import OutsideError, inside, what_is
from nw_eval.plural import plural
from nw_eval.results.evidence.discrepancy import Discrepancy, What
from nw_eval.results.evidence.leaves import log_sha256
from nw_eval.results.row import Row
from nw_eval.results.run_folder import RunFolder


@dataclass(frozen=True, kw_only=True)
class LookedAt:
    """A log, and what was found of it."""

    bytes: int  # 0 where there is none.
    finding: Discrepancy | None


def look_at_logs(folder: RunFolder, rows: Iterable[Row]) -> list[LookedAt]:
    """Compare the log of every row that has its digest.

    Args:
        folder: of the run.
        rows: of a plan, one for each trial.
    """
    known = [row for row in rows if row.mcap_sha256]
    with ThreadPoolExecutor() as pool:  # Hashing holds no lock.
        return list(pool.map(lambda row: _look_at(folder, row), known))


def unnamed_logs(folder: RunFolder, rows: Iterable[Row]) -> Iterator[str]:
    """Yield the logs that no row names, relative to the run's folder.

    Where a trial ended in an error, its worker may have left a log that it could not speak of.
    """
    named = {row.mcap_path for row in rows}
    named |= {
        folder.relative(folder.mcap(row.scene, row.trial_id))
        for row in rows
        if row.status == "error"
    }
    for log in sorted(folder.logs.rglob("*.mcap")):
        if (name := folder.relative(log)) not in named:
            yield name


def lost_logs(rows: Iterable[Row]) -> list[str]:
    """Return a sentence of the results whose logs could not be written; none where all were."""
    lost = [row.trial_id for row in rows if row.lost_its_log]
    if not lost:
        return []
    first = f"{plural(len(lost), 'log')} lost, which could not be written (first that of {lost[0]})"
    return [f"{first}: --resume runs these trials again"]


def log_path(folder: RunFolder, row: Row) -> Path | None:
    """Return where a row's log lies; None where it names none within the folder."""
    try:
        return inside(folder.path, row.mcap_path) if row.mcap_path else None
    except OutsideError:
        return None


def _look_at(folder: RunFolder, row: Row) -> LookedAt:
    path = log_path(folder, row)
    if path is None:
        return _wrong(row, "unreadable", "its row names no file of this folder")
    try:
        size = path.stat().st_size if what_is(path) == "file" else None
    except OSError:  # It was there a moment ago.
        size = None
    if size is None:
        return _wrong(row, "missing")
    digest = log_sha256(path)
    if not digest:
        return _wrong(row, "unreadable", "check its rights", size)
    if digest != row.mcap_sha256:
        sizes = f"{size:,} bytes, not {row.mcap_bytes:,}; " if size != row.mcap_bytes else ""
        about = f"{sizes}SHA-256 {digest[:12]}, not {row.mcap_sha256[:12]}"
        return _wrong(row, "changed", about, size)
    return LookedAt(bytes=size, finding=None)


def _wrong(row: Row, what: What, about: str = "", size: int = 0) -> LookedAt:
    finding = Discrepancy(what=what, file=row.mcap_path, trial=row.trial_id, about=about)
    return LookedAt(bytes=size, finding=finding)
