"""The nursery as its owner sees it, and the children that it has there."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import send_handle
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from nw_eval.confinement.environment import environment_of_child
from nw_eval.confinement.family import interrupts_blocked
from nw_eval.confinement.nursery.process import Circumstances, Wish, serve

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_ANSWERS = 300.0
"""Seconds within which it answers: it may be importing, on a slow disk."""
_LOOKS, _STOPPED = 0.5, 6
"""Seconds between two looks, and how many in a row find it stopped before it is given up. Whoever
stops a whole run, this process too, and goes on with it later is not meant."""
_GONE = -signal.SIGKILL
"""How a child ended of which nobody can say: it went with the nursery."""


class Nursery:
    """One process that forks others; for confined ones, since it starts with their environment.

    It ends with the process that owns it.

    Raises:
        OSError: it cannot be started, or this system cannot watch its children.
    """

    def __init__(self) -> None:
        os.close(os.pidfd_open(os.getpid()))  # Linux 5.3 has it.
        self._line, theirs = Pipe()
        self._lock = threading.Lock()
        life, self._life = Pipe(duplex=False)  # It ends when this end is closed.
        # Not `multiprocessing`'s, which would print a traceback if this process were killed now.
        start = f"from {serve.__module__} import begin; "
        start = f"from nw_eval.files.lifeline import hold; hold({life.fileno()}); {start}"
        start = f"import sys; sys.path[:] = {sys.path!r}; {start}"
        with theirs, life, interrupts_blocked():
            self._process = subprocess.Popen(  # noqa: S603  # Our own module, no shell.
                [sys.executable, "-P", "-c", f"{start}begin({theirs.fileno()}, {life.fileno()})"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(), life.fileno()),
                env=environment_of_child(),
            )

    def __del__(self) -> None:
        """End it: whoever has a child of it has it, too."""
        process = getattr(self, "_process", None)
        if process is not None:
            process.kill()
            process.wait()

    @property
    def is_alive(self) -> bool:
        """Whether it can still be asked for children."""
        return self._process.poll() is None

    def learn(self, *modules: str) -> None:
        """Let it import modules for all children to come, without waiting for it."""
        with self._lock, suppress(OSError):
            self._line.send(Wish(kind="import", modules=modules))

    def fork(
        self,
        function: Callable[..., None],
        arguments: Sequence[Any],
        connections: Sequence[Connection] = (),
    ) -> Child:
        """Start a process that calls a function, and wait for its start.

        Args:
            function: of a module.
            arguments: for it; what `pickle` takes.
            connections: more arguments for it, after the others. They remain the caller's too.

        Raises:
            OSError: there is no process to be had, or the nursery is gone.
        """
        theirs, orders = Pipe(duplex=False)
        passed = (theirs, *connections)
        with orders:
            with theirs, self._lock:
                try:
                    self._line.send(Wish(kind="fork", connections=len(passed)))
                    for connection in passed:
                        send_handle(self._line, connection.fileno(), self._process.pid)
                    pid: int = self._answer()
                except (EOFError, OSError) as error:
                    self._process.kill()  # Half a wish would be taken for the start of the next.
                    raise OSError(f"the process that starts workers is gone: {error}") from None
            if pid < 0:  # The children that there are go on.
                raise OSError(-pid, os.strerror(-pid))
            child = Child(pid, self)
            with suppress(BrokenPipeError):  # It has ended, which its owner will see.
                orders.send(Circumstances.here())
                orders.send((function, tuple(arguments)))
        return child

    def collect(self, pid: int) -> int:
        """Return the exit code of a child that has ended, and forget it; negative = signal."""
        with self._lock:
            try:
                self._line.send(Wish(kind="collect", process=pid))
                code: int = self._answer()
            except (EOFError, OSError):
                self._process.kill()  # It may be stopped, and its children with it.
                return _GONE
        return code

    def _answer(self) -> Any:
        """Return what the process says to a wish.

        Raises:
            OSError: it is stopped, and nobody goes on with it; or it says nothing in time.
            EOFError: it is gone.
        """
        deadline, stopped = monotonic() + _ANSWERS, 0
        while not self._line.poll(_LOOKS):
            stopped = stopped + 1 if _is_stopped(self._process.pid) else 0
            if stopped > _STOPPED or monotonic() > deadline:
                raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
        return self._line.recv()


def _is_stopped(process: int) -> bool:
    """Return whether SIGSTOP or the like has halted a process."""
    with suppress(OSError, IndexError):
        text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
        return text.rpartition(")")[2].split()[0] in {"T", "t"}
    return False


class Child:
    """A process that a nursery forked: what of `multiprocessing.Process` its owner needs."""

    def __init__(self, pid: int, nursery: Nursery) -> None:
        self.pid = pid
        self._nursery = nursery
        self._code: int | None = None
        # Its number stays its own until it is collected, however it has ended.
        self._watch = os.pidfd_open(pid)

    @property
    def sentinel(self) -> int:
        """What is ready when it has ended."""
        return self._watch

    @property
    def exitcode(self) -> int | None:
        """How it ended; None while it runs."""
        if self._code is None and wait([self._watch], 0):
            self._code = self._nursery.collect(self.pid)
        return self._code

    def kill(self) -> None:
        """End it, without waiting."""
        if self._code is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)

    def join(self, timeout: float | None = None) -> None:
        """Wait until it has ended, or so many seconds."""
        if self._code is None and wait([self._watch], timeout):
            _ = self.exitcode  # Collected, it is nobody's zombie.

    def close(self) -> None:
        """Forget it; it has ended."""
        if self._watch >= 0:
            os.close(self._watch)
            self._watch = -1
