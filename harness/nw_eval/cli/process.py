"""The process of the command line: its streams, its signals, what its threads raise, its end."""

from __future__ import annotations

import gc
import os
import sys
import threading
from typing import TYPE_CHECKING, NoReturn

from nw_eval.cli.outermost import end_of
from nw_eval.cli.terminal.interruption import interruption, leave, nothing_left_to_interrupt
from nw_eval.cli.terminal.last_words import tell, unforeseen
from nw_eval.cli.terminal.streams import Streams
from nw_eval.errors import StoreError

if TYPE_CHECKING:
    from sys import UnraisableHookArgs


def run_process(*, description: str) -> NoReturn:
    """Run the verb that the process was started with, and end the process with its exit code."""
    # A verb ends with its process: rows and tables make many objects, and hardly a cycle of them.
    gc.set_threshold(100_000, 50, 100)
    # MuJoCo would start a program to look for OpenGL when it is imported, which Ctrl-C would reach.
    os.environ.setdefault("MUJOCO_GL", "disable")
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
