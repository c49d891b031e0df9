"""A Ray cluster that is joined, or one on this machine that is started and ends with the run.

It is the only module that imports ray.
"""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import signal
import socket
import sys
import tempfile
import threading
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from secrets import token_hex
from time import monotonic
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit
from warnings import catch_warnings, simplefilter

from nw_base.clean import clean
from nw_base.errors import PrerequisiteError, TrialError, UsageError
from nw_gate.results.provenance import usable_cores

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping

HERE = "local"
"""In place of an address: a cluster of this machine alone."""

# Ray's usage reports and announcements are off.
_QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_BACKEND_LOG_LEVEL": "error",
    # A minute after the head is lost Ray would end this process, with exit code 1. `Joined.check`
    # is earlier, and says what it was.
    "RAY_gcs_rpc_server_reconnect_timeout_s": "3600",
}
_CONNECT = 10.0  # s
_ABSENCE = 20.0  # s in which a head may be started anew
_ATTEMPTS = "2"  # Of some 40 s each, at asking what answers at an address, but is no cluster.
_CLIENT_PORT, _HEAD_PORT = 10001, 6379
# Bytes in shared memory on this machine: logs on their way, pieces of splats. More goes to disk.
_STORE = 2**28
# Lets this process and what it starts into a cluster of this machine, and no other. One for all
# of them: Ray remembers the first that it has seen.
_TOKEN = token_hex(32)
_SHORT = 40  # Characters of a folder in which a Unix socket's path, 107 at most, has room.


@dataclass(kw_only=True)
class Joined:
    """A cluster that this process has joined."""

    ray: Any
    """Ray's own module: it describes few of its types."""
    head: tuple[str, int] = ("", 0)
    """Host and port at which the cluster is there as long as its head is."""
    is_lost: bool = False
    """Whether nothing may be asked of it any more: no answer would ever come."""
    seen: float = field(default_factory=monotonic)
    """When its head was there."""

    @property
    def cores(self) -> int:
        """How many trials its nodes run at a time, at least 1."""
        return max(1, int(self.ray.cluster_resources().get("CPU", 0)))

    @property
    def answers(self) -> bool:
        """Whether the head is there. What asks it of something would wait where it is not."""
        try:
            socket.create_connection(self.head, timeout=_CONNECT).close()
        except OSError:
            return False
        self.seen = monotonic()
        return True

    def check(self) -> bool:
        """Return whether the head is there.

        Raises:
            TrialError: it has not been for a while.
        """
        if self.answers:
            return True
        self.is_lost = monotonic() > self.seen + _ABSENCE
        if self.is_lost:
            raise TrialError(
                f"the head of the cluster has not answered for {_ABSENCE:.0f} s",
                fix="resume with --resume, on this machine or another cluster",
            )
        return False

    def on(self, node: str, task: Any, *, cores: int, once: bool = False) -> Any:
        """Return a function or a class as it runs on one node and nowhere else.

        Args:
            node: its id.
            task: of a module that nodes have, too.
            cores: that are taken while it runs; an actor, as long as it lives.
            once: whether its process ends with it.
        """
        strategies = import_module("ray.util.scheduling_strategies")
        where = strategies.NodeAffinitySchedulingStrategy(node, soft=False)
        options: dict[str, Any] = {"num_cpus": cores, "scheduling_strategy": where}
        # Whatever is lost is the engine's to try again, which counts it.
        options["max_restarts" if isinstance(task, type) else "max_retries"] = 0
        if once:
            options["max_calls"] = 1
        return self.ray.remote(**options)(task)


@contextmanager
def joined(address: str, *, cores: int | None) -> Generator[Joined]:
    """Join a cluster inside the `with` block. Who has joined one already stays in it.

    Args:
        address: `HERE`, `auto`, `host:port` or `ray://host:port`.
        cores: workers of a cluster that is started here (default: one for each core).

    Raises:
        PrerequisiteError: Ray is not installed.
        UsageError: there is no answer at the address, or no cluster that can be used.
    """
    with ExitStack() as cleanup:
        cleanup.enter_context(_environment(**_QUIET))
        try:
            ray = import_module("ray")
        except ImportError as error:
            raise PrerequisiteError(
                "--engine ray needs the package ray, which is not installed",
                fix="pip install 'nw-eval[ray]'",
            ) from error
        found = Joined(ray=ray)
        if not ray.is_initialized():
            _check_answers(address)
            options = _started_here(cleanup, cores) if address == HERE else _found_there(cleanup)
            cleanup.enter_context(_silence())
            cleanup.callback(_leave, found)
            _init(ray, address, options)
        found.head = _head(ray, address)
        yield found


def _leave(found: Joined) -> None:
    """Take leave of a cluster. If its head is lost, that is left to the end of this process.

    Ray's own way out would wait for the head, and its native code would then end the process with a
    signal, or with exit code 1, which is a verdict's.
    """
    if not found.is_lost:
        found.ray.shutdown()
        return
    atexit.unregister(import_module("ray._private.worker").shutdown)
    atexit.register(_end_at_once)


def _end_at_once() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(TrialError.exit_code)


def _head(ray: Any, address: str) -> tuple[str, int]:
    """Return where the head of a cluster that has been joined answers."""
    known = address if "://" in address else f"//{ray.get_runtime_context().gcs_address}"
    parts = urlsplit(known)
    return parts.hostname or "", parts.port or _CLIENT_PORT


def _init(ray: Any, address: str, options: Mapping[str, Any]) -> None:
    with _own_signals(), _muted(), catch_warnings():
        simplefilter("ignore")
        try:
            ray.init(
                address=address, log_to_driver=False, logging_level=logging.CRITICAL, **options
            )
        except SystemExit as error:  # What Ray makes of SIGTERM meanwhile.
            raise KeyboardInterrupt from error
        except Exception as error:
            raise _unusable(address, error) from error


def _found_there(cleanup: ExitStack) -> dict[str, Any]:
    """Return the options of joining a cluster, in bounded time."""
    cleanup.enter_context(_environment(RAY_gcs_server_port_wait_time_s=_ATTEMPTS))
    return {}


def _started_here(cleanup: ExitStack, cores: int | None) -> dict[str, Any]:
    """Return the options of a cluster of this machine, which leaves nothing behind."""
    # Ray asks for a token by default, sets the mode itself, and would keep one in the user's home.
    token, mode = os.environ.get("RAY_AUTH_TOKEN", _TOKEN), os.environ.get("RAY_AUTH_MODE")
    cleanup.enter_context(_environment(RAY_AUTH_TOKEN=token, RAY_AUTH_MODE=mode))
    base = tempfile.gettempdir()
    folder = tempfile.mkdtemp(prefix="nw-", dir=base if len(base) < _SHORT else "/tmp")  # noqa: S108 - sockets need a short path; mkdtemp makes it private.
    cleanup.callback(shutil.rmtree, folder, ignore_errors=True)
    return {
        "num_cpus": usable_cores() if cores is None else cores,
        "num_gpus": 0,
        "include_dashboard": False,
        "object_store_memory": _STORE,
        "_temp_dir": folder,
    }


def _check_answers(address: str) -> None:
    """Find out in seconds that the address does not answer; Ray itself tries for minutes.

    Raises:
        UsageError: it does not answer, or the address is invalid.
    """
    if address in {HERE, "auto"}:
        return
    try:
        parts = urlsplit(address if "://" in address else f"//{address}")
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise _unusable(address, error) from None
    if not host or parts.scheme not in {"", "ray"}:
        raise UsageError(
            f"--address {address!r} is not an address of a Ray cluster",
            fix="give auto, host:port of its head, or ray://host:port",
        )
    port = port or (_CLIENT_PORT if parts.scheme else _HEAD_PORT)
    try:
        socket.create_connection((host, port), timeout=_CONNECT).close()
    except OSError as error:
        raise _unusable(address, error) from None


def _unusable(address: str, error: Exception) -> UsageError:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [repr(error)]
    reason = lines[-1] if "Traceback" in str(error) else " ".join(lines)
    where = "on this machine" if address in {HERE, "auto"} else f"at {address}"
    return UsageError(
        f"no Ray cluster can be used {where}: {clean(reason, at_most=300)}",
        fix="check --address and `ray status` on the cluster's head node; without --address a "
        "cluster of this machine is started",
    )


@contextmanager
def _environment(**values: str | None) -> Generator[None]:
    """Let Ray, and what it starts, find variables set inside the `with` block.

    Args:
        values: by name; None is left for Ray to set.
    """
    before = {name: os.environ.get(name) for name in values}
    os.environ.update({name: value for name, value in values.items() if value is not None})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _silence() -> Generator[None]:
    """Keep pages about lost nodes off the console, which says it in a line of its own.

    No option does: with `log_to_driver=False` Ray still prints what its raylets report.
    """
    module = import_module("ray._private.worker")
    before = getattr(module, "print_to_stdstream", None)
    vars(module)["print_to_stdstream"] = _unheard
    try:
        yield
    finally:
        vars(module)["print_to_stdstream"] = before


@contextmanager
def _muted() -> Generator[None]:
    """Drop what native code writes to standard error, such as each attempt to connect."""
    sys.stderr.flush()
    before, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)


def _unheard(*_: Any, **__: Any) -> None:
    """Replace what prints."""


@contextmanager
def _own_signals() -> Generator[None]:
    """Keep the handler of SIGTERM, in whose place `ray.init` puts its own."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
