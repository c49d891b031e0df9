"""The outermost place: however a verb ends, its exit code is true, and it says one line.

* An error that nw-eval raises on purpose ends with its own code.
* Ctrl-C and SIGTERM end with 130.
* Whatever nobody foresaw ends with 4, and its traceback is in a file: SystemExit out of a verb, a
  full disk, no memory. It never ends with 0 or 1, which are words of a written verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nw_eval.cli.terminal.fetching import fetches_shown
from nw_eval.cli.terminal.interruption import INTERRUPTED, interruption
from nw_eval.cli.terminal.last_words import tell, unforeseen
from nw_eval.errors import NwEvalError, StoreError


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
    if isinstance(error, NwEvalError):
        tell(f"error: {error}")
        return error.exit_code
    tell(f"error: {unforeseen(error)}")
    return NwEvalError.exit_code
