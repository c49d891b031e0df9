"""The operating system's fence round a process that opens untrusted files, and what it came to.

`Rules` say what a process may do, its memory and time, and `confine` makes it so.

Landlock: from now on this thread, and what it starts, opens only what lies below some paths.
Rights, structures and numbers: the kernel's `include/uapi/linux/landlock.h`. Each version of the
interface knows more rights; all that this kernel knows are taken away and given back where due.
"""

from __future__ import annotations

import ctypes
import math
import os
import resource
import site
import stat
import sys
import threading
from collections.abc import Generator, Iterable
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from nw_base.confinement import kernel, seccomp
from nw_base.confinement.family import die_with_parent, leave_terminal
from nw_base.confinement.rights import give_up
from nw_base.confinement.seccomp import Network
from nw_base.words import Kernels

# Programs' and libraries' own files; what the loader and the C library ask; what NumPy, torch and
# onnxruntime ask about the processor. Nothing of a user, and no list of other processes.
_SYSTEM = (
    "/usr",
    "/lib",
    "/lib64",
    "/nix/store",
    "/etc/ld.so.cache",
    "/etc/localtime",
    "/etc/nsswitch.conf",
    # Not all of /proc/self, which has mounts, the network and descriptors.
    *(f"/proc/self/{name}" for name in ("auxv", "cgroup", "cmdline", "maps", "stat", "statm")),
    "/proc/self/status",
    "/proc/cpuinfo",
    "/proc/meminfo",
    "/proc/stat",
    "/proc/sys/vm",
    "/sys/devices/system",
    "/sys/bus/pci/devices",  # Its entries are links, which `_pci_facts` follows.
    "/sys/fs/cgroup",
    "/dev/urandom",
    "/dev/random",
)
# What JAX and torch ask each device of the machine to find accelerators.
_PCI_FACTS = ("vendor", "device", "class", "subsystem_vendor", "subsystem_device", "numa_node")
_NETWORK = (
    "/etc/resolv.conf",
    "/etc/hosts",
    "/etc/host.conf",
    "/etc/gai.conf",
    "/etc/services",
    "/etc/ssl",
    "/etc/pki",
    "/run/systemd/resolve",
)

DEVICES = (Path(os.devnull),)
"""Which may be written, too. Shared memory of /dev/zero would be counted nowhere."""


@dataclass(frozen=True, kw_only=True)
class Fence:
    """What stands between a process and the rest of the machine."""

    landlock: int = 0
    """The kernel's version of Landlock; 0 = it has none for us: files are open."""
    seccomp: bool = False
    """Whether system calls are refused; if not, programs may be started and sockets made."""
    network: Network = "none"
    """Which sockets may be made in any case."""
    off: str = ""
    """Why none was raised; empty = one was."""

    def __str__(self) -> str:
        if self.off:
            return f"off: {self.off}"
        if not self.landlock and not self.seccomp:
            return "none: the system has neither Landlock nor seccomp"
        parts = (
            f"landlock {self.landlock}" if self.landlock else "no Landlock",
            "seccomp" if self.seccomp else "no seccomp",
            *(() if self.network == "none" else ("network allowed",)),
        )
        return ", ".join(parts)


def raise_fence(*, reads: tuple[Path, ...], writes: tuple[Path, ...], network: Network) -> Fence:
    """Fence this thread, and all threads that it starts, in for good.

    Args:
        reads: files and folders that may be read, besides those of libraries.
        writes: folders below which files may be read, made, written and removed.
        network: which sockets may be made.

    Returns:
        What the kernel did. It does less, or nothing, where it is old, is not Linux, or where a
        container forbids it; that is no error.
    """
    allowed = (*_library_paths(network=network == "all"), *reads)
    try:
        known = restrict(reads=allowed, writes=(*writes, *DEVICES), network=network)
    except OSError:
        known = 0
    refused = seccomp.restrict_calls(
        network=network,
        writes=bool(writes),
        opens_to_write=bool(writes) or known >= _KNOWS_TRUNCATE,
    )
    fence = Fence(landlock=known, seccomp=refused, network=network)
    if threading.current_thread() is threading.main_thread():
        global _stands  # noqa: PLW0603 - a process has one fence.
        _stands = bool(fence.landlock) and fence.seccomp
    return fence


_stands = False


def fence_stands() -> bool:
    """Return whether this process is fenced in: files and system calls both."""
    return _stands


@cache
def offered(*, network: Network = "none") -> Fence:
    """Return what a fence comes to on this machine: a thread is fenced in to find out."""
    fences: list[Fence] = []

    def attempt() -> None:
        fences.append(raise_fence(reads=(), writes=(), network=network))

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return fences[0]


def _library_paths(*, network: bool) -> tuple[Path, ...]:
    """Return files and folders that this process's libraries read.

    Args:
        network: whether names of hosts and certificates are among them.
    """
    # What stands first is the folder of the script, or where somebody happened to be.
    imported = sys.path if sys.flags.safe_path else sys.path[1:]
    names = [
        *_SYSTEM,
        *(_NETWORK if network else ()),
        *(sys.prefix, sys.exec_prefix, sys.base_prefix, sys.base_exec_prefix),
        *(site.getusersitepackages() if site.ENABLE_USER_SITE else "",),
        *imported,
        *os.environ.get("LD_LIBRARY_PATH", "").split(":"),
        str(Path(__file__).resolve().parents[2]),
    ]
    return tuple(dict.fromkeys([*(Path(name) for name in names if name), *_pci_facts()]))


def _pci_facts() -> list[Path]:
    """Return the files that say what each device on the PCI bus is; none of its memory."""
    return [
        file.resolve()
        for name in _PCI_FACTS
        for file in sorted(Path("/sys/bus/pci/devices").glob(f"*/{name}"))
    ]


_OPENING = 2**30
"""Bytes to open a small file in. Measured: libraries take 60 to 280 MB of it."""

_RUNNING = 2**31
"""Bytes to run trials in, without their scenes."""
_SCENE = 2**28
"""Bytes that a scene may take, with its rays and its physics."""
_SCENES = 32
"""Scenes that a process keeps at once."""
_RESERVED = 2**38
"""Bytes of address space that libraries may reserve; tables take a 512th of them at most."""
_COPIES = 8
"""Copies of a file that its reader may have at once: bytes, members, tensors, a graph's own."""


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What a process may do from its start on."""

    reads: tuple[Path, ...] = ()
    """Files and folders that it reads, besides those of libraries."""
    writes: tuple[Path, ...] = ()
    """Folders in which it makes, writes and removes files."""
    network: Network = "none"
    memory: int | None = _OPENING
    """Bytes of its own; None = as many as there are."""
    seconds: int | None = None
    """Of processor time; None = any."""
    python: Path | None = None
    """The interpreter that runs it, where that is not this one."""
    off: str = ""
    """Why there is neither fence nor limit; empty = there are."""
    kernels: tuple[Kernels, ...] = ()
    """What is loaded before: the cache of kernels is out of its reach then."""


def confine(rules: Rules, *, output: int | None = None) -> Fence:
    """Confine this process: at its start, before it has other threads or an untrusted file.

    Args:
        rules: what it may do.
        output: file descriptor for what it prints; None = nowhere.

    Returns:
        What the kernel did of it.
    """
    leave_terminal(output)
    if not rules.off:
        give_up()
    die_with_parent(has_children=bool(rules.off))
    if rules.off:
        limit(memory=None, seconds=None)
        return Fence(off=rules.off)
    limit(memory=rules.memory, seconds=rules.seconds)
    return raise_fence(reads=rules.reads, writes=rules.writes, network=rules.network)


def memory_to_open(size: int) -> int:
    """Return how many bytes a process may hold that opens a file of `size` bytes."""
    return _OPENING + _COPIES * size


def memory_to_run(size: int, *, scenes: int) -> int:
    """Return how many bytes a process may hold that runs such a file in scenes."""
    return _RUNNING + _SCENE * min(scenes, _SCENES) + _COPIES * size


def limit(*, memory: int | None, seconds: int | None) -> None:
    """Limit this process: no core dumps, so much memory of its own, so much processor time.

    Memory is what only this process has: heap, stacks, private maps. Address space would be the
    wrong measure, libraries reserve gigabytes of it; without end it takes memory for its tables.
    """
    _set(resource.RLIMIT_CORE, 0, 0)
    if memory is not None:
        _set(resource.RLIMIT_DATA, memory, memory)
        _set(resource.RLIMIT_AS, memory + _RESERVED, memory + _RESERVED)
    if seconds is not None:
        # SIGXCPU at the first limit says what happened; SIGKILL at the second would not.
        _set(resource.RLIMIT_CPU, seconds, seconds + 1)


@contextmanager
def processor_time(seconds: int) -> Generator[None]:
    """Let this process take so much more processor time inside the `with` block.

    Longer than that, and the system ends it with SIGXCPU, in the midst of native code too.
    """
    used = resource.getrusage(resource.RUSAGE_SELF)
    before, hard = resource.getrlimit(resource.RLIMIT_CPU)
    most = math.ceil(used.ru_utime + used.ru_stime) + seconds
    known = [limit for limit in (before, hard) if limit != resource.RLIM_INFINITY]
    _set(resource.RLIMIT_CPU, min([most, *known]), hard)
    try:
        yield
    finally:
        _set(resource.RLIMIT_CPU, before, hard)


def _set(kind: int, soft: int, hard: int) -> None:
    with suppress(ValueError, OSError):  # A lower limit is there already, or the system has none.
        resource.setrlimit(kind, (soft, hard))


_CREATE, _ADD_RULE, _RESTRICT = 444, 445, 446  # The same numbers on every machine.
_ASK_VERSION = 1
_PATH_BENEATH = 1
_NO_NEW_PRIVILEGES = 38

_WRITE_FILE, _READ_FILE, _READ_DIR = 1 << 1, 1 << 2, 1 << 3
_REMOVE_DIR, _REMOVE_FILE, _MAKE_DIR, _MAKE_REG = 1 << 4, 1 << 5, 1 << 7, 1 << 8
_REFER, _TRUNCATE = 1 << 13, 1 << 14  # A link or a rename between folders; cutting a file short.
_FIRST = (1 << 13) - 1
_KNOWS_TRUNCATE = 3
_SINCE = {2: _REFER, _KNOWS_TRUNCATE: _TRUNCATE, 5: 1 << 15}  # 5: ioctl of devices.
_BIND, _CONNECT = 1 << 0, 1 << 1  # of TCP, since 4
_TCP: dict[Network, int] = {"none": _BIND | _CONNECT, "server": _CONNECT, "all": 0}
_UNIX, _SIGNALS = 1 << 0, 1 << 1  # Unix sockets without a path; signals: to others, since 6

_READ = _READ_FILE | _READ_DIR
_WRITE = _READ | _WRITE_FILE | _REMOVE_DIR | _REMOVE_FILE | _MAKE_DIR | _MAKE_REG | _REFER
_OF_FILES = _READ_FILE | _WRITE_FILE | _TRUNCATE


class _Ruleset(ctypes.Structure):
    _fields_ = (
        ("files", ctypes.c_uint64),
        ("network", ctypes.c_uint64),
        ("scopes", ctypes.c_uint64),
    )


class _Beneath(ctypes.Structure):
    _pack_ = 1
    _layout_ = "ms"  # Which `_pack_` means; later Pythons want it said.
    _fields_ = (("rights", ctypes.c_uint64), ("folder", ctypes.c_int32))


def version() -> int:
    """Return which version of Landlock the kernel has; 0 = none, or switched off."""
    with suppress(OSError):
        return kernel.call(_CREATE, 0, 0, _ASK_VERSION)
    return 0


def restrict(*, reads: Iterable[Path], writes: Iterable[Path], network: Network) -> int:
    """Take away all of the file system but these paths; nothing can give it back.

    Args:
        reads: files, and folders with all below them, that may be read. Nothing may be executed.
        writes: may be written too, made and removed.
        network: which sockets may be used.

    Returns:
        The kernel's version of Landlock; 0 = it has none, and nothing was done.

    Raises:
        OSError: the kernel has it and refuses.
    """
    known = version()
    if not known:
        return 0
    handled = _FIRST
    for since, rights in _SINCE.items():
        handled |= rights if known >= since else 0
    rules = _Ruleset(
        files=handled,
        network=_TCP[network] if known >= 4 else 0,
        scopes=0 if known < 6 else _SIGNALS if network == "all" else _SIGNALS | _UNIX,
    )
    size = 8 if known < 4 else 16 if known < 6 else 24
    ruleset = kernel.call(_CREATE, ctypes.byref(rules), size, 0)
    try:
        for path in reads:
            _allow(ruleset, path, _READ & handled)
        for path in writes:
            _allow(ruleset, path, (_WRITE | _TRUNCATE) & handled)
        kernel.prctl(_NO_NEW_PRIVILEGES, 1)
        kernel.call(_RESTRICT, ruleset, 0)
    finally:
        os.close(ruleset)
    return known


def _allow(ruleset: int, path: Path, rights: int) -> None:
    """Allow rights below a path; what is not there, or cannot be reached, stays out of reach."""
    try:
        folder = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        if not stat.S_ISDIR(os.fstat(folder).st_mode):
            rights &= _OF_FILES
        beneath = _Beneath(rights=rights, folder=folder)
        kernel.call(_ADD_RULE, ruleset, _PATH_BENEATH, ctypes.byref(beneath), 0)
    finally:
        os.close(folder)
