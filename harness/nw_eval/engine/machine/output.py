"""What workers print: never on the console, the beginning of it in a file of the run folder."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from multiprocessing import Pipe
from typing import TYPE_CHECKING, Self

from nw_eval.clean import clean
from nw_eval.files.cache import open_own

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LARGEST = 2**20
"""Characters that are kept. What comes later is read and dropped: a checkpoint that prints for
hours neither fills the disk nor waits for a reader."""

_CHUNK = 2**16
_PATIENCE = 5.0  # s for the last words of workers that are gone
_MORE = "(the run printed more, which was not kept)"


class WorkerOutput:
    """A pipe that workers print to, and a thread that writes down what comes; a context manager.

    A checkpoint may print anything: lines are cleaned. Where nothing is printed, there is no file.

    Args:
        path: of the file, to which lines are appended.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._receiver, self.end = Pipe(duplex=False)
        self._thread = threading.Thread(target=self._write_down, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end.close()
        self._thread.join(_PATIENCE)

    def _write_down(self) -> None:
        """Read until the last worker is gone; write the first lines."""
        left = LARGEST
        for line in self._lines():
            if left > 0:
                text = clean(line)
                left -= len(text) + 1
                self._append(text if left > 0 else _MORE)

    def _append(self, line: str) -> None:
        with suppress(OSError):
            handle = open_own(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            with os.fdopen(handle, "a", encoding="utf-8", errors="replace") as file:
                file.write(f"{line}\n")

    def _lines(self) -> Iterator[str]:
        """Yield lines as they come, those that are longer than a chunk in pieces."""
        begun = b""
        with self._receiver:
            while chunk := os.read(self._receiver.fileno(), _CHUNK):
                *whole, begun = (begun + chunk).split(b"\n")
                if len(begun) > _CHUNK:
                    whole, begun = [*whole, begun], b""
                yield from (line.decode(errors="replace") for line in whole)
        if begun:
            yield begun.decode(errors="replace")
