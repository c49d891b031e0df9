"""The outermost place: however a verb ends, its exit code is true, and it says one line.

* An error that nw-eval raises on purpose ends with its own code.
* Ctrl-C and SIGTERM end with 130.
* Whatever nobody foresaw ends with 4, and its traceback is in a file: SystemExit out of a verb, a
  full disk, no memory. It never ends with 0 or 1, which are words of a written verdict.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nw_eval.clean import clean
from nw_eval.cli.interruption import INTERRUPTED, interruption
from nw_eval.errors import NwEvalError, StoreError
from nw_eval.traceback_file import keep_traceback


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
        # A verb that forgets its code has not passed: int(None) raises.
        return End(code=int(verb()), is_written=getattr(verb, "leaves_verdict", False))
    except BaseException as error:  # noqa: BLE001 - this is the outermost place.
        return End(code=_code_of(error))


def tell(line: str) -> None:
    """Say something on standard error, if that still works."""
    try:
        print(line, file=sys.stderr, flush=True)
    except (OSError, ValueError):
        return


def unforeseen(error: BaseException) -> str:
    """Return in one line what happened, where, and which file has the traceback."""
    try:
        kept = keep_traceback(error)
        frames = traceback.extract_tb(error.__traceback__)
        place = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
        where = "there is no room for its traceback" if kept is None else f"traceback: {kept}"
        return f"unforeseen: {type(error).__name__}: {clean(error)}{place}; {where}"
    except Exception:  # noqa: BLE001 - no memory is left for a sentence, or `__str__` raises.
        return "unforeseen, and it cannot be said what"


def _code_of(error: BaseException) -> int:
    """Say what happened in one line, and return its code."""
    # Some libraries turn a KeyboardInterrupt that meets their import into an error of their own.
    if isinstance(error, KeyboardInterrupt) or interruption.was_heard:
        tell("interrupted")
        return INTERRUPTED
    if isinstance(error, NwEvalError):
        tell(f"error: {error}")
        return error.exit_code
    tell(f"error: {unforeseen(error)}")
    return NwEvalError.exit_code
