"""Processes that are forked from one that has imported what they need, each in some milliseconds.

A `ForkServer` is what its owner sees, with a `Child` for each process. The other half of this file
runs in the fork server: it imports, forks, and says how a child ended. It opens no untrusted file.

`multiprocessing` has a fork server, which is not used here. It listens at an address where a policy
that has left its fence could have it start a process without one; it collects the dead at once, so
that their numbers, by which groups are killed, may belong to another process; and each child keeps
it alive when its owner is gone. This one has a pair of sockets and no address.
"""

from __future__ import annotations

import errno
import gc
import importlib
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal, NoReturn

from nw_base.confinement.family import (
    environment_of_child,
    interrupts_blocked,
    leave_terminal,
    set_parent,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_ANSWERS = 300.0
"""Seconds within which it answers: it may be importing, on a slow disk."""
_LOOKS, _STOPPED = 0.5, 6
"""Seconds between two looks, and how many in a row find it stopped before it is given up. Whoever
stops a whole run, this process too, and goes on with it later is not meant."""
_GONE = -signal.SIGKILL
"""How a child ended if it cannot be known: it ended with the fork server."""
_FAILED = 70
"""Exit code of a child whose function raised."""


class ForkServer:
    """One process that forks others; for confined ones, since it starts with their environment.

    It ends with the process that owns it.

    Raises:
        OSError: it cannot be started, or this system cannot watch its children.
    """

    def __init__(self) -> None:
        os.close(os.pidfd_open(os.getpid()))  # Linux 5.3 has it.
        self._line, theirs = Pipe()
        self._lock = threading.Lock()
        self._learnt = {"__main__"}  # Of that name it has a module of its own.
        life, self._life = Pipe(duplex=False)  # It ends when this end is closed.
        # Not `multiprocessing`'s, which would print a traceback if this process were killed now.
        start = f"from {serve.__module__} import begin; "
        start = f"from nw_base.files.lifeline import hold; hold({life.fileno()}); {start}"
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
        """Let it import modules, each once, for all children to come, without waiting for it."""
        with self._lock, suppress(OSError):
            new = tuple(module for module in modules if module not in self._learnt)
            if new:
                self._line.send(_Request(kind="import", modules=new))
                self._learnt.update(new)

    def fork(
        self,
        function: Callable[..., None],
        arguments: Sequence[Any],
        connections: Sequence[Connection] = (),
    ) -> Child:
        """Start a process that calls a function, and wait for its start.

        Args:
            function: of a module, which the next children have from their start on.
            arguments: for it; what `pickle` takes.
            connections: more arguments for it, after the others. They remain the caller's too.

        Raises:
            OSError: there is no process to be had, or the fork server is gone.
        """
        self.learn(function.__module__)
        theirs, orders = Pipe(duplex=False)
        passed = (theirs, *connections)
        with orders:
            with theirs, self._lock:
                try:
                    self._line.send(_Request(kind="fork", connections=len(passed)))
                    for connection in passed:
                        send_handle(self._line, connection.fileno(), self._process.pid)
                    pid: int = self._answer()
                except (EOFError, OSError) as error:
                    self._process.kill()  # Half a request would be taken for the start of the next.
                    raise OSError(f"the process that starts workers is gone: {error}") from None
            if pid < 0:  # The children that there are go on.
                raise OSError(-pid, os.strerror(-pid))
            child = Child(pid, self)
            with suppress(BrokenPipeError):  # It has ended, which its owner will see.
                orders.send(_ProcessContext.of_this_process())
                orders.send((function, tuple(arguments)))
        return child

    def collect(self, pid: int) -> int:
        """Return the exit code of a child that has ended, and forget it; negative = signal."""
        with self._lock:
            try:
                self._line.send(_Request(kind="collect", process=pid))
                code: int = self._answer()
            except (EOFError, OSError):
                self._process.kill()  # It may be stopped, and its children with it.
                return _GONE
        return code

    def _answer(self) -> Any:
        """Return what the process says to a request.

        Raises:
            OSError: it is stopped, or does not answer in time.
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
    """A process that a fork server forked: what of `multiprocessing.Process` its owner needs."""

    def __init__(self, pid: int, fork_server: ForkServer) -> None:
        self.pid = pid
        self._fork_server = fork_server
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
            self._code = self._fork_server.collect(self.pid)
        return self._code

    def kill(self) -> None:
        """End it, without waiting."""
        if self._code is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)

    def join(self, timeout: float | None = None) -> None:
        """Wait until it has ended, or so many seconds."""
        if self._code is None and wait([self._watch], timeout):
            _ = self.exitcode  # Collected, it leaves no zombie.

    def close(self) -> None:
        """Forget it; it has ended."""
        if self._watch >= 0:
            os.close(self._watch)
            self._watch = -1


@dataclass(frozen=True, kw_only=True)
class _ProcessContext:
    """What a child takes over from the process that asked for it, as it is at that moment."""

    environment: dict[str, str]
    folder: Path | None
    path: list[str]

    @classmethod
    def of_this_process(cls) -> _ProcessContext:
        """Return those of this process."""
        folder = None
        with suppress(OSError):  # It was removed; nothing that a child is given is relative to it.
            folder = Path.cwd()
        return cls(environment=dict(os.environ), folder=folder, path=list(sys.path))

    def enter(self) -> None:
        """Make them this process's."""
        os.environ.clear()
        os.environ.update(self.environment)
        sys.path[:] = self.path
        if self.folder is not None:
            with suppress(OSError):
                os.chdir(self.folder)


@dataclass(frozen=True, kw_only=True)
class _Request:
    """What the fork server is to do next. Only its owner can send it."""

    kind: Literal["import", "fork", "collect"]
    modules: tuple[str, ...] = ()
    connections: int = 0
    """How many follow. From the first the child hears its surroundings and what it is to call; the
    others are its last arguments."""
    process: int = 0
    """Whose end is asked for."""


def begin(line: int, life: int) -> NoReturn:
    """Serve an owner: the program of the fork server.

    Args:
        line: file descriptor of the line to the owner.
        life: file descriptor of the lifeline, which children have no use for.
    """
    serve(Connection(line), life)


def serve(owner: Connection, life: int) -> NoReturn:
    """Do what the owner requests until it is gone."""
    leave_terminal(None)
    while True:
        try:
            request: _Request = owner.recv()
            if request.kind == "import":
                _import(request.modules)
            elif request.kind == "fork":
                owner.send(_fork(request, owner, life))
            else:
                owner.send(_collected(request.process))
        except (EOFError, OSError):
            os._exit(0)  # Children go with it: see `family.die_with_parent`.


def _import(modules: tuple[str, ...]) -> None:
    gc.disable()
    for module in modules:
        with suppress(Exception):  # The child that needs it says what is wrong.
            importlib.import_module(module)
    # What is there by now is hardly ever garbage, and children wait for this: to look for some
    # takes a tenth of a second. A child that looked for it would copy every page.
    gc.freeze()
    gc.enable()


def _fork(request: _Request, owner: Connection, life: int) -> int:
    """Return the number of a new child; where there is none to be had, the error's, negative."""
    own = os.getpid()
    handles = [recv_handle(owner) for _ in range(request.connections)]
    try:
        child = os.fork()
    except OSError as error:
        child = -(error.errno or errno.EAGAIN)
    if child == 0:
        os.close(life)
        _be_child(owner, handles, parent=own)
    for handle in handles:
        os.close(handle)
    return child


def _be_child(owner: Connection, handles: list[int], *, parent: int) -> NoReturn:
    try:
        owner.close()
        set_parent(parent)
        orders, *connections = map(Connection, handles)
        with orders:
            surroundings: _ProcessContext = orders.recv()
            surroundings.enter()
            function, arguments = orders.recv()
        function(*arguments, *connections)
    except BaseException:  # noqa: BLE001 - the owner is gone.
        os._exit(_FAILED)
    os._exit(0)


def _collected(process: int) -> int:
    """Return how a child that has ended did so: as `multiprocessing` says it, negative = signal."""
    _, status = os.waitpid(process, 0)
    return os.waitstatus_to_exitcode(status)
