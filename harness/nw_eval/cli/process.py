"""The process of the command line: its streams, its signals, and how it ends.

However a verb ends, its exit code is true, and it says one line.

* An error that nw-eval raises on purpose ends with its own code.
* Ctrl-C and SIGTERM end with 130.
* An unforeseen error ends with 4, and its traceback is in a file: SystemExit out of a verb, a
  full disk, no memory. It never ends with 0 or 1, which are words of a written verdict.

A verdict is in a file before it is printed. Trouble with standard output and error is remembered,
never raised: a reader that leaves (`| head`), a full device, a stream that was closed from the
start or one that speaks Latin-1 changes nothing about it.
"""

from __future__ import annotations

import codecs
import errno
import gc
import io
import os
import select
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn, TextIO

from nw_base.errors import NwEvalError, StoreError, not_installed
from nw_eval.cli.terminal.fetching import fetches_shown
from nw_eval.cli.terminal.final_output import tell, unforeseen
from nw_eval.cli.terminal.interruption import (
    INTERRUPTED,
    interruption,
    leave,
    nothing_left_to_interrupt,
)

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

    from _typeshed import ReadableBuffer


@dataclass(frozen=True, kw_only=True)
class End:
    """How a verb ended."""

    code: int
    is_written: bool = False  # A verdict: it is in a file already, printed or not.


def end_of(arguments: Sequence[str], *, description: str) -> End:
    """Parse arguments, run the verb that they name, and return how that ended."""
    try:
        from nw_eval.cli.verbs import parse

        try:
            verb = parse(arguments, description=description)
        except SystemExit as error:  # Help, or usage.
            return End(code=error.code if isinstance(error.code, int) else StoreError.exit_code)
        with fetches_shown():
            # A verb that forgets its code has not passed: int(None) raises.
            return End(code=int(verb()), is_written=getattr(verb, "leaves_verdict", False))
    except BaseException as error:  # noqa: BLE001 - this is the outermost place.
        return End(code=_code_of(error))


def _code_of(error: BaseException) -> int:
    """Say what happened in one line, and return its code."""
    # Some libraries turn a KeyboardInterrupt that meets their import into an error of their own.
    if isinstance(error, KeyboardInterrupt) or interruption.was_heard:
        tell("interrupted")
        return INTERRUPTED
    error = not_installed(error) or error
    if isinstance(error, NwEvalError):
        tell(f"error: {error}")
        return error.exit_code
    tell(f"error: {unforeseen(error)}")
    return NwEvalError.exit_code


# What tables are drawn with, for streams that know no such letters.
_PLAIN = {"─": "-", "━": "-", "│": "|", "·": "-"}


def run_process(*, description: str) -> NoReturn:
    """Run the verb that the process was started with, and end the process with its exit code."""
    # A verb ends with its process: rows and tables make many objects, and hardly a cycle of them.
    gc.set_threshold(100_000, 50, 100)
    # Nothing here needs OpenGL. MuJoCo would start a program to look for it when it is imported,
    # which Ctrl-C would reach, and fails to be imported where the variable names what is not there.
    os.environ["MUJOCO_GL"] = "disable"
    streams = Streams()
    threading.excepthook = _thread_failed
    sys.unraisablehook = _not_raised
    try:
        interruption.listen()
        end = end_of(sys.argv[1:], description=description)
        code = end.code
        if (trouble := streams.trouble()) is not None:
            tell(f"error: cannot write to standard output: {trouble.strerror or trouble}")
            if code == 0 and not end.is_written:
                code = StoreError.exit_code
        nothing_left_to_interrupt(code)
    except KeyboardInterrupt:  # Between two steps, or while a slow reader is waited for.
        leave()
    # The interpreter collects garbage twice as it ends, and would look at every object for nothing.
    gc.freeze()
    sys.exit(code)


def _thread_failed(args: threading.ExceptHookArgs) -> None:
    """Say that a library's thread failed; results do not come from threads."""
    if args.exc_value is not None and not isinstance(args.exc_value, SystemExit):
        tell(f"warning: a thread failed, {unforeseen(args.exc_value)}")


def _not_raised(args: UnraisableHookArgs) -> None:
    """Say what was raised where nothing can be raised: in a callback, a finaliser, at exit."""
    if isinstance(args.exc_value, KeyboardInterrupt):
        leave()  # It would be lost.
    if args.exc_value is not None:
        tell(f"warning: {unforeseen(args.exc_value)}")


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
        sys.stdout = _text_stream(self._out, sys.stdout)
        sys.stderr = _text_stream(_Raw(2, "w", closefd=False), sys.stderr)

    def trouble(self) -> OSError | None:
        """Return why not everything that was printed has been written, unless its reader left."""
        with suppress(ValueError):  # Closed by somebody else's code.
            sys.stdout.flush()
        trouble = self._out.trouble
        return None if trouble is None or trouble.errno == errno.EPIPE else trouble


def _text_stream(raw: _Raw, before: TextIO | None) -> TextIO:
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
