"""Standard output and error that cannot hurt: trouble with them is remembered, never raised.

A verdict is in a file before it is printed. A reader that leaves (`| head`), a full device, a
stream that was closed from the start or one that speaks Latin-1 changes nothing about it.
"""

from __future__ import annotations

import codecs
import errno
import io
import os
import select
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

# What tables are drawn with, for streams that know no such letters.
_PLAIN = {"─": "-", "━": "-", "│": "|", "·": "-"}


class _Raw(io.FileIO):
    """A file descriptor that swallows what it cannot write; `trouble` says why."""

    trouble: OSError | None = None

    def write(self, data: ReadableBuffer, /) -> int:
        while self.trouble is None:
            try:
                # The annotations say int; it is None when a shared pipe was made non-blocking.
                if (written := super().write(data)) is not None:  # pyright: ignore[reportUnnecessaryComparison]
                    return written
                select.select((), (self.fileno(),), ())
            except OSError as error:
                self.trouble = error
        return memoryview(data).nbytes


class Streams:
    """The process's own standard streams, made harmless."""

    def __init__(self) -> None:
        # A closed one's number would go to the next file that is opened, and prints into that.
        for number in (0, 1, 2):
            try:
                os.fstat(number)
            except OSError:
                with suppress(OSError):
                    os.open(os.devnull, os.O_RDWR)
        self._out = _Raw(1, "w", closefd=False)
        sys.stdout = _text(self._out, sys.stdout)
        sys.stderr = _text(_Raw(2, "w", closefd=False), sys.stderr)

    def trouble(self) -> OSError | None:
        """Return why not everything that was printed has been written, unless its reader left."""
        with suppress(ValueError):  # Closed by somebody else's code.
            sys.stdout.flush()
        trouble = self._out.trouble
        return None if trouble is None or trouble.errno == errno.EPIPE else trouble


def _text(raw: _Raw, before: TextIO | None) -> TextIO:
    """Return a text stream on `raw` that can print anything, like the one before it in the rest."""
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=getattr(before, "encoding", None) or "utf-8",
        errors="nw-eval-plain",
        line_buffering=raw.fileno() == 2 or raw.isatty(),
        write_through=getattr(before, "write_through", False),
    )


def _plainer(error: UnicodeError) -> tuple[str, int]:
    """Return what to print for letters that a stream's encoding does not have."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    plain = (_PLAIN.get(one) or one.encode("ascii", "backslashreplace").decode() for one in letters)
    return "".join(plain), error.end


codecs.register_error("nw-eval-plain", _plainer)
