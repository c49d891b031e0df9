"""Starts confined processes: forked from the nursery where there is a fence, else from nothing.

What has no fence may start processes of its own and use what does not survive a fork, such as CUDA.
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
from contextlib import suppress
from multiprocessing import Pipe, get_context, resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from nw_eval.confinement import (
    Nursery,
    Rules,
    child_environment,
    interrupts_blocked,
    without_script,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence
    from multiprocessing.connection import Connection

    from nw_eval.cards import Card

_PRELOAD = "nw_eval.rollout.confined.preload"
_KERNELS = "nw_eval.rollout.confined.kernels"
_LIBRARY = {"onnx": "onnxruntime"}
_NONE = frozenset({"remote", "zero"})
"""Adapters that need no library for their networks; those that are not named need torch."""

_WARM = b"warm"
_WARMS = 120.0
"""Seconds in which a process that has been forked says whether it has kernels."""

_OURS = ("NW_EVAL_", "PYTEST_")
"""Variables of which no library that the nursery has imported has read any."""

_RIGHTS = ("Umask:", "Uid:", "Gid:", "Groups:", "CapEff:", "NoNewPrivs:", "Cpus_allowed:")
"""Lines of /proc/self/status."""

_lock = threading.Lock()
_nursery: Nursery | None = None
_born_in: Hashable = None
"""`_standing` of this process when the nursery was started."""
_with_kernels: Nursery | None = None
"""The nursery that was told to load kernels."""


class Started(Protocol):
    """A process that was started here."""

    @property
    def pid(self) -> int | None:
        """Its number."""
        ...

    @property
    def sentinel(self) -> int:
        """What is ready when it has ended."""
        ...

    @property
    def exitcode(self) -> int | None:
        """How it ended; negative = signal; None while it runs."""
        ...

    def kill(self) -> None:
        """End it, without waiting."""
        ...

    def join(self, timeout: float | None = None) -> None:
        """Wait until it has ended, or so many seconds."""
        ...

    def close(self) -> None:
        """Forget it."""
        ...


def prepare() -> None:
    """Let the nursery be started, and import what every trial needs, while others plan them."""
    with suppress(OSError):  # Processes are started one by one, then.
        _ = _open_nursery()


def prepare_for(card: Card) -> None:
    """Let a nursery that there is import what a policy's checkpoint is opened with."""
    nursery = _nursery
    if nursery is not None and card.adapter not in _NONE:
        nursery.learn(_LIBRARY.get(card.adapter, "torch"))


def prepare_kernels() -> None:
    """Let a nursery that there is load the CPU renderer's kernels, if they have been compiled.

    It takes as long as all else that it imports: what does not draw is forked before.
    """
    if _nursery is not None:
        _load_kernels(_nursery)


def has_kernels() -> bool:
    """Return whether processes to come have the CPU renderer's kernels; waits for the nursery."""
    receiver, sender = Pipe(duplex=False)
    with receiver, suppress(OSError, EOFError):
        with sender:
            nursery = _open_nursery()
            _load_kernels(nursery)
            child = nursery.fork(_tell_warmth, (), (sender,))
        is_told = receiver.poll(_WARMS)
        warmth = receiver.recv_bytes() if is_told else b""
        child.join(_WARMS if is_told else 0.0)
        child.kill()
        return child.exitcode == 0 and warmth == _WARM
    return False


def _tell_warmth(sender: Connection) -> None:
    from nw_eval.rollout.confined.kernels import WARM

    sender.send_bytes(_WARM if WARM else b"")


def renew() -> None:
    """Forget the nursery: kernels have been compiled that it does not have."""
    global _nursery  # noqa: PLW0603 - one a process is the point.
    with _lock:
        _nursery = None


def start_process(
    function: Callable[..., None],
    arguments: Sequence[Any],
    connections: Sequence[Connection],
    *,
    rules: Rules,
    is_one_of_many: bool,
) -> Started:
    """Return a new process that calls a function.

    Args:
        function: of a module, which confines its process first of all.
        arguments: for it; what `pickle` takes.
        connections: more arguments for it, after the others.
        rules: by which it will confine itself.
        is_one_of_many: whether a nursery is worth it if there is none. One that is not may have no
            processes of its own.

    Raises:
        OSError: no process can be started.
    """
    if not rules.off and (is_one_of_many or _nursery is not None):
        with suppress(OSError):
            nursery = _open_nursery()
            if is_one_of_many:
                _load_kernels(nursery)
            return nursery.fork(function, arguments, connections)
    process = get_context("spawn").Process(
        target=function, args=(*arguments, *connections), daemon=not is_one_of_many
    )
    resource_tracker.ensure_running()  # Starting later, it would lift the block.
    atexit.unregister(_let_tracker_end)
    atexit.register(_let_tracker_end)
    with child_environment(fenced=not rules.off), interrupts_blocked(), without_script():
        process.start()
    return process


def _let_tracker_end() -> None:
    """Continue `multiprocessing`'s helper, should somebody have stopped it.

    It is waited for at the end of this process, and has its standard output.
    """
    process = getattr(vars(resource_tracker).get("_resource_tracker"), "_pid", None)
    if process is not None:
        with suppress(OSError):
            os.kill(process, signal.SIGCONT)


def _open_nursery() -> Nursery:
    """Return the nursery of this process, a new one if children would inherit what is no longer so.

    Raises:
        OSError: there can be none.
    """
    global _nursery, _born_in
    standing = _standing()
    with _lock:
        if _nursery is None or not _nursery.is_alive or _born_in != standing:
            _nursery, _born_in = Nursery(), standing
            _nursery.learn(_PRELOAD)
        return _nursery


def _load_kernels(nursery: Nursery) -> None:
    """Let a nursery load kernels, once, without waiting for it."""
    global _with_kernels  # noqa: PLW0603 - one a process is the point.
    with _lock:
        if nursery is not _with_kernels:
            nursery.learn(_KERNELS)
            _with_kernels = nursery


def _standing() -> Hashable:
    """Return what of this process its children have from their start on.

    Libraries read the environment once (`engine.machine.cpu`); limits, rights and cores are the
    system's to know.
    """
    environment = frozenset(
        (name, value) for name, value in os.environ.items() if not name.startswith(_OURS)
    )
    limits, status = (
        Path(f"/proc/self/{name}").read_text(encoding="utf-8") for name in ("limits", "status")
    )
    lines = status.splitlines()
    rights = tuple(line for line in lines if line.startswith(_RIGHTS))
    return environment, limits, rights, Path("/proc/self/ns/mnt").readlink(), os.nice(0)
