"""The process that forks: it imports what it is told to, and opens no stranger's file."""

from __future__ import annotations

import errno
import gc
import importlib
import os
import sys
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle
from pathlib import Path
from typing import Literal, NoReturn

from nw_eval.confinement.family import leave_terminal, set_parent

_FAILED = 70
"""Exit code of a child whose function raised."""


@dataclass(frozen=True, kw_only=True)
class Circumstances:
    """What a child takes over from the process that asked for it, as it is at that moment."""

    environment: dict[str, str]
    folder: Path | None
    path: list[str]

    @classmethod
    def here(cls) -> Circumstances:
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
class Wish:
    """What the nursery is to do next. Its owner sends it, and nobody else can."""

    kind: Literal["import", "fork", "collect"]
    modules: tuple[str, ...] = ()
    connections: int = 0
    """How many follow. From the first the child hears its surroundings and what it is to call; the
    others are its last arguments."""
    process: int = 0
    """Whose end is asked for."""


def begin(line: int, life: int) -> NoReturn:
    """Serve an owner: the program of the nursery.

    Args:
        line: file descriptor of the line to the owner.
        life: file descriptor of the lifeline, which children have no use for.
    """
    serve(Connection(line), life)


def serve(owner: Connection, life: int) -> NoReturn:
    """Do what the owner wishes until it is gone."""
    leave_terminal(None)
    while True:
        try:
            wish: Wish = owner.recv()
            if wish.kind == "import":
                _import(wish.modules)
            elif wish.kind == "fork":
                owner.send(_fork(wish, owner, life))
            else:
                owner.send(_collected(wish.process))
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


def _fork(wish: Wish, owner: Connection, life: int) -> int:
    """Return the number of a new child; where there is none to be had, the error's, negative."""
    own = os.getpid()
    handles = [recv_handle(owner) for _ in range(wish.connections)]
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
            surroundings: Circumstances = orders.recv()
            surroundings.enter()
            function, arguments = orders.recv()
        function(*arguments, *connections)
    except BaseException:  # noqa: BLE001 - nobody is there to hear of it.
        os._exit(_FAILED)
    os._exit(0)


def _collected(process: int) -> int:
    """Return how a child that has ended did so: as `multiprocessing` says it, negative = signal."""
    _, status = os.waitpid(process, 0)
    return os.waitstatus_to_exitcode(status)
