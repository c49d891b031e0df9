"""The nursery as its owner sees it, and the children that it has there."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import send_handle
from typing import TYPE_CHECKING, Any

from nw_eval.confinement.environment import child_environment
from nw_eval.confinement.family import interrupts_blocked, without_script
from nw_eval.confinement.nursery.process import Circumstances, Wish, serve

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

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
        context = get_context("spawn")
        self._line, theirs = context.Pipe()
        self._lock = threading.Lock()
        self._process = context.Process(target=serve, args=(theirs,), daemon=True)
        try:
            with child_environment(), interrupts_blocked(), without_script():
                self._process.start()
        finally:
            theirs.close()

    @property
    def is_alive(self) -> bool:
        """Whether it can still be asked for children."""
        return self._process.is_alive()

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
                    child = Child(self._line.recv(), self)
                except (EOFError, OSError) as error:
                    self._process.kill()  # Half a wish would be taken for the start of the next.
                    raise OSError(f"the process that starts workers is gone: {error}") from None
            with suppress(BrokenPipeError):  # It has ended, which its owner will see.
                orders.send(Circumstances.here())
                orders.send((function, tuple(arguments)))
        return child

    def collect(self, pid: int) -> int:
        """Return the exit code of a child that has ended, and forget it; negative = signal."""
        with self._lock:
            try:
                self._line.send(Wish(kind="collect", process=pid))
                code: int = self._line.recv()
            except (EOFError, OSError):
                return _GONE
        return code


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
        if self._code is None:
            wait([self._watch], timeout)

    def close(self) -> None:
        """Forget it; it has ended."""
        if self._watch >= 0:
            os.close(self._watch)
            self._watch = -1
