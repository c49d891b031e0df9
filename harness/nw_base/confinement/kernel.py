"""Linux's own calls, where Python has no function for them."""

from __future__ import annotations

import ctypes
import os
import sys
from functools import cache
from typing import Any


@cache
def _libc() -> Any:
    return ctypes.CDLL(None, use_errno=True)


def call(number: int, *arguments: Any) -> int:
    """Make a system call by its number.

    Raises:
        OSError: the kernel refuses it, or does not know it; there is no Linux here.
    """
    if sys.platform != "linux":
        raise OSError("no Linux")
    function = _libc().syscall
    function.restype = ctypes.c_long
    return _checked(function(ctypes.c_long(number), *map(_wide, arguments)))


def prctl(option: int, *arguments: Any) -> int:
    """Make a call of `prctl(2)`.

    Raises:
        OSError: the kernel refuses it, or does not know it; there is no Linux here.
    """
    if sys.platform != "linux":
        raise OSError("no Linux")
    wide = [_wide(argument) for argument in (*arguments, 0, 0, 0, 0)[:4]]
    return _checked(_libc().prctl(ctypes.c_int(option), *wide))


def _wide(argument: Any) -> Any:
    """Return an argument as C passes it through `...`: ctypes would pass 32 bits of a number."""
    return ctypes.c_ulong(argument) if isinstance(argument, int) else argument


def _checked(answer: int) -> int:
    if answer < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return answer
