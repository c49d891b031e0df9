"""What a process gives up for good before it is confined: capabilities, and threads without end.

The kernel counts threads for a real user in a user namespace, and counts nothing for root. To have
a count of its own, a process of root takes a real user of its own, and keeps root as the effective
one, whose files it reads. A process of anybody else enters a user namespace of its own.

Sources: capabilities(7), user_namespaces(7), getrlimit(2); `copy_process` in Linux's kernel/fork.c.
"""

from __future__ import annotations

import ctypes
import os
import platform
import resource
from contextlib import suppress
from pathlib import Path

from nw_base.confinement import kernel

_NUMBERS = {"x86_64": (117, 126, 272), "aarch64": (147, 91, 97)}
"""Of `setresuid`, `capset` and `unshare`."""
_VERSION_3 = 0x20080522
_DROP_FROM_BOUNDS, _AMBIENT, _CLEAR = 24, 47, 4  # prctl
_CAPABILITIES = 64
_NEEDED = 1 << 7 | 1 << 19
"""CAP_SETUID; CAP_SYS_PTRACE, without which the owner could not see how much memory a process of
another real user holds."""
_NEW_USERS = 0x10000000  # CLONE_NEWUSER
_COUNTS = 5, 14
"""The first Linux that counts in each user namespace."""
_OWN_USERS = 2**30
"""User IDs from here on belong to no account."""
_THREADS, _OF_A_CORE = 256, 8
"""Threads that a process may have: JAX starts three pools with one for each core."""


def give_up() -> None:
    """Give up all capabilities, and all but so many threads."""
    cores = os.cpu_count() or 1
    most = _THREADS + _OF_A_CORE * cores
    if not _is_counted_alone():
        # So many for each process that there may be, besides what this user's others have.
        most = _threads_of_user() + most * (cores + 1)
    with suppress(OSError):
        kernel.prctl(_AMBIENT, _CLEAR)
    with suppress(OSError):  # The kernel has no more of them, or this process may not.
        for number in range(_CAPABILITIES):
            kernel.prctl(_DROP_FROM_BOUNDS, number)
    with suppress(OSError, KeyError):
        header, none = (ctypes.c_uint32 * 2)(_VERSION_3, 0), (ctypes.c_uint32 * 6)()
        _, capset, _ = _NUMBERS[platform.machine()]
        kernel.call(capset, ctypes.byref(header), ctypes.byref(none))
    with suppress(ValueError, OSError):
        _, hard = resource.getrlimit(resource.RLIMIT_NPROC)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(resource.RLIMIT_NPROC, (most, most))


def _is_counted_alone() -> bool:
    """Let the kernel count this process's threads apart from all others; return whether it does."""
    with suppress(OSError, KeyError, IndexError, ValueError):
        setresuid, _, unshare = _NUMBERS[platform.machine()]
        user, group = os.geteuid(), os.getegid()
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        capabilities = int(status.partition("CapEff:")[2].split()[0], 16)
        if capabilities & _NEEDED == _NEEDED and user == 0:
            os.environ.setdefault("LOGNAME", "root")  # No list of users has the new one.
            kernel.call(setresuid, _OWN_USERS + os.getpid(), 2**32 - 1, 2**32 - 1)
            return True
        if user == 0 or _forbids_namespaces():
            return False
        kernel.call(unshare, _NEW_USERS)
        for name, text in (
            ("setgroups", "deny"),
            ("uid_map", f"{user} {user} 1"),
            ("gid_map", f"{group} {group} 1"),
        ):
            Path("/proc/self", name).write_text(text, encoding="ascii")
        return True
    return False


def _forbids_namespaces() -> bool:
    """Return whether a user namespace would count nothing, or would have no users."""
    major, minor = platform.release().split(".")[:2]
    if (int(major), int("".join(filter(str.isdigit, minor)))) < _COUNTS:
        return True
    with suppress(OSError):
        forbids = Path("/proc/sys/kernel/apparmor_restrict_unprivileged_userns")
        return forbids.read_text(encoding="ascii").strip() == "1"
    return False


def _threads_of_user() -> int:
    """Return how many threads there are of this user's processes."""
    count, user = 0, os.getuid()
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError, ValueError):
            if folder.stat().st_uid == user:
                text = (folder / "stat").read_text(encoding="utf-8", errors="replace")
                count += int(text.rpartition(")")[2].split()[17])
    return count
