"""Ctrl-C and SIGTERM while no run listens to them itself (see `engine.machine.Interrupts`)."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130
"""Exit code: 128 + SIGINT, what a shell expects of an interrupted command."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _Interruption:
    """The first signal raises KeyboardInterrupt in the main thread, the second ends at once."""

    was_heard = False

    def listen(self) -> None:
        for number in _SIGNALS:
            signal.signal(number, self._heard)

    def _heard(self, _number: int, _frame: FrameType | None) -> None:
        if self.was_heard:
            leave()
        self.was_heard = True
        raise KeyboardInterrupt


interruption = _Interruption()
"""Of this process: signals are the process's, not a caller's."""


def leave_at_signals() -> None:
    """End at the first signal: while everything is still being imported, nothing can be lost."""
    for number in _SIGNALS:
        signal.signal(number, leave)


def stopped_by_signals() -> threading.Event:
    """Return what Ctrl-C and SIGTERM set from now on, for verbs that serve until then."""
    stop = threading.Event()
    for number in _SIGNALS:
        # Said outright: a shell starts its background jobs with SIGINT ignored.
        signal.signal(number, lambda *_: stop.set())
    return stop


def nothing_left_to_interrupt(code: int) -> None:
    """Let the interpreter come to its end with a code that stands already."""
    # Blocked, not ignored: the interpreter puts the handler of Ctrl-C back before it ends.
    if hasattr(signal, "pthread_sigmask"):  # Not on Windows.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, lambda *_: os._exit(code))


def leave(*_: object) -> NoReturn:
    """End the process here and now."""
    with suppress(OSError):
        os.write(2, b"interrupted\n")
    os._exit(INTERRUPTED)
