"""Landlock: from now on this thread, and what it starts, opens only what lies below some paths.

Rights, structures and numbers: the kernel's `include/uapi/linux/landlock.h`. Each version of the
interface knows more rights; all that this kernel knows are taken away and given back where due.
"""

from __future__ import annotations

import ctypes
import os
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from nw_eval.confinement import kernel
from nw_eval.confinement.seccomp import Network

_CREATE, _ADD_RULE, _RESTRICT = 444, 445, 446  # The same numbers on every machine.
_ASK_VERSION = 1
_PATH_BENEATH = 1
_NO_NEW_PRIVILEGES = 38

_WRITE_FILE, _READ_FILE, _READ_DIR = 1 << 1, 1 << 2, 1 << 3
_REMOVE_DIR, _REMOVE_FILE, _MAKE_DIR, _MAKE_REG = 1 << 4, 1 << 5, 1 << 7, 1 << 8
_REFER, _TRUNCATE = 1 << 13, 1 << 14  # A link or a rename between folders; cutting a file short.
_FIRST = (1 << 13) - 1
_SINCE = {2: _REFER, 3: _TRUNCATE, 5: 1 << 15}  # 5: ioctl of devices.
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
