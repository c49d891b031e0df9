"""The operating system's fence round a process that opens untrusted files, and what it came to."""

from __future__ import annotations

import os
import site
import sys
import threading
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from nw_eval.confinement import landlock, seccomp
from nw_eval.confinement.seccomp import Network

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
    "/proc/self",
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

DEVICES = tuple(Path(name) for name in ("/dev/null", "/dev/zero"))
"""Which may be written, too."""


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
        known = landlock.restrict(reads=allowed, writes=(*writes, *DEVICES), network=network)
    except OSError:
        known = 0
    fence = Fence(landlock=known, seccomp=seccomp.refuse(network=network), network=network)
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
    found: list[Fence] = []

    def attempt() -> None:
        found.append(raise_fence(reads=(), writes=(), network=network))

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return found[0]


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
        str(Path(__file__).resolve().parents[1]),
    ]
    return tuple(dict.fromkeys([*(Path(name) for name in names if name), *_pci_facts()]))


def _pci_facts() -> list[Path]:
    """Return the files that say what each device on the PCI bus is; none of its memory."""
    return [
        file.resolve()
        for name in _PCI_FACTS
        for file in sorted(Path("/sys/bus/pci/devices").glob(f"*/{name}"))
    ]
