"""What a calibration has found so far, in a file of the scene's folder."""

from __future__ import annotations

import sqlite3
import time
from pathlib import Path

from nw_eval.errors import StoreError

_SAVED = 5.0
"""Seconds after which what was found is on disk."""


class Kept:
    """Features and matches in a file, by digests of what they depend on.

    Only the thread that opened it may use it.

    Args:
        path: of the file; one that is damaged, or a link, is replaced.

    Raises:
        StoreError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._saved = path, time.monotonic()
        try:
            if path.is_symlink():
                path.unlink()
            try:
                self._file = self._opened()
            except sqlite3.DatabaseError:
                path.unlink()
                self._file = self._opened()
        except (OSError, sqlite3.Error) as error:
            raise self._unwritable(error) from None

    def _opened(self) -> sqlite3.Connection:
        opened = sqlite3.connect(self._path)
        opened.execute("CREATE TABLE IF NOT EXISTS kept (key BLOB PRIMARY KEY, content BLOB)")
        return opened

    def get(self, key: bytes) -> bytes | None:
        """Return what was kept, or None."""
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
        """Write what is not written yet.

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
