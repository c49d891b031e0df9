"""Features and matches of a calibration so far, in a file of the scene's folder."""

from __future__ import annotations

import sqlite3
import time
from contextlib import closing
from pathlib import Path

from nw_base.errors import StoreError

_SAVED = 5.0
"""Seconds after which what was found is on disk."""


_TABLE = "CREATE TABLE kept (key BLOB PRIMARY KEY, content BLOB)"


class Kept:
    """Features and matches in a file, by digests of what they depend on.

    Only the thread that opened it may use it.

    Args:
        path: of the file; one that is damaged, a link, or of anything but our table is replaced.

    Raises:
        StoreError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._saved = path, time.monotonic()
        try:
            if path.is_symlink() or (path.exists() and not self._is_ours()):
                path.unlink()
            self._file = sqlite3.connect(path)
            if not self._file.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                self._file.execute(_TABLE)
        except IsADirectoryError:
            raise StoreError(f"{path} is a folder", fix="remove it") from None
        except (OSError, sqlite3.Error) as error:
            raise self._unwritable(error) from None

    def _is_ours(self) -> bool:
        """Whether the file holds our table alone: a view or a trigger would run its own SQL."""
        if self._path.is_dir():
            return False
        try:
            with closing(sqlite3.connect(self._path)) as opened:
                rows = opened.execute("SELECT sql FROM sqlite_master WHERE sql NOT NULL").fetchall()
        except sqlite3.Error:
            return False
        return rows in ([], [(_TABLE,)])

    def get(self, key: bytes) -> bytes | None:
        """Return the stored bytes, or None."""
        try:
            row = self._file.execute("SELECT content FROM kept WHERE key = ?", (key,)).fetchone()
        except sqlite3.Error:  # Damaged: found again.
            return None
        return row[0] if row is not None and isinstance(row[0], bytes) else None

    def put(self, key: bytes, content: bytes) -> None:
        """Keep something; it is on disk some seconds later.

        Raises:
            StoreError: it cannot be written.
        """
        try:
            self._file.execute("INSERT OR REPLACE INTO kept VALUES (?, ?)", (key, content))
            if time.monotonic() - self._saved >= _SAVED:
                self._file.commit()
                self._saved = time.monotonic()
        except sqlite3.Error as error:
            raise self._unwritable(error) from None

    def close(self) -> None:
        """Write the entries that are not written yet.

        Raises:
            StoreError: it cannot be written.
        """
        try:
            self._file.commit()
        except sqlite3.Error as error:
            raise self._unwritable(error) from None
        finally:
            self._file.close()

    def _unwritable(self, error: Exception) -> StoreError:
        return StoreError(f"cannot write {self._path}: {error}", fix="free disk space")
