"""seccomp: from now on this thread, and what it starts, is refused some system calls.

A list of what is refused, with all else allowed: the readers of checkpoints are large libraries,
and one call that an allow-list forgets would end honest runs. The filter is a program of classic
BPF, see `linux/filter.h` and `linux/seccomp.h`.
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from nw_eval.confinement import kernel
from nw_eval.confinement.calls import (
    CLONE,
    CLONE3,
    CONNECT,
    MACHINES,
    ON_PROCESSES,
    REFUSED,
    SOCKETS,
    Network,
    Numbers,
)

_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_NUMBER, _MACHINE, _FIRST_ARGUMENT = 0, 4, 16  # Offsets in struct seccomp_data; little-endian.
_ALLOW, _KILL, _FAIL = 0x7FFF0000, 0x80000000, 0x00050000
_CLONE_THREAD = 0x00010000
_X32 = 0x40000000  # The first number of a second interface that x86_64 has.
_NO_NEW_PRIVILEGES, _SET_SECCOMP, _MODE_FILTER = 38, 22, 2


class _Instruction(ctypes.Structure):
    _fields_ = (
        ("code", ctypes.c_ushort),
        ("if_true", ctypes.c_ubyte),
        ("if_false", ctypes.c_ubyte),
        ("value", ctypes.c_uint32),
    )


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("code", ctypes.POINTER(_Instruction)))


@dataclass(frozen=True)
class Instruction:
    """One instruction of a filter; a comparison skips `if_true` or `if_false` instructions."""

    code: int
    value: int
    if_true: int = 0
    if_false: int = 0


def refuse(*, network: Network) -> bool:
    """Refuse system calls to this thread, for good.

    Args:
        network: which sockets may be made.

    Returns:
        Whether it was done: this machine's numbers are known, and the kernel can.
    """
    if platform.machine() not in MACHINES:
        return False
    try:
        install(program(platform.machine(), process=os.getpid(), network=network))
    except OSError:
        return False
    return True


def install(steps: Sequence[Instruction]) -> None:
    """Put a filter round this thread, besides those that are there already.

    Raises:
        OSError: the kernel refuses it, or has no filters.
    """
    code = (_Instruction * len(steps))(
        *((step.code, step.if_true, step.if_false, step.value) for step in steps)
    )
    kernel.prctl(_NO_NEW_PRIVILEGES, 1)
    kernel.prctl(_SET_SECCOMP, _MODE_FILTER, ctypes.byref(_Program(len(steps), code)))


def program(machine: str, *, process: int, network: Network) -> tuple[Instruction, ...]:
    """Return the filter of a machine.

    Args:
        machine: a key of `MACHINES`.
        process: which may be sent signals and given limits: this one.
        network: which sockets may be made.
    """
    column = list(MACHINES).index(machine)

    def numbers(calls: Numbers) -> list[int]:
        return [number for of in calls.values() if (number := of[column]) is not None]

    refused = numbers(REFUSED)
    if network != "all":
        refused += numbers(CONNECT)
    if network == "none":
        refused += numbers(SOCKETS)
    return (
        Instruction(_LOAD, _MACHINE),
        Instruction(_EQUAL, MACHINES[machine], if_true=1),
        Instruction(_RETURN, _KILL),
        Instruction(_LOAD, _NUMBER),
        *([Instruction(_AT_LEAST, _X32, if_false=1), _fail(errno.EPERM)] if column == 0 else ()),
        *_for_each(refused, [_fail(errno.EPERM)]),
        # The C library then takes `clone`, whose flags can be seen here.
        *_for_each(numbers(CLONE3), [_fail(errno.ENOSYS)]),
        *_for_each(
            numbers(CLONE),
            [
                Instruction(_LOAD, _FIRST_ARGUMENT),
                Instruction(_ANY_BIT, _CLONE_THREAD, if_false=1),
                Instruction(_RETURN, _ALLOW),
                _fail(errno.EPERM),
            ],
        ),
        *_for_each(
            numbers(ON_PROCESSES),
            [
                Instruction(_LOAD, _FIRST_ARGUMENT),
                Instruction(_EQUAL, process, if_true=1),
                Instruction(_EQUAL, 0, if_false=1),
                Instruction(_RETURN, _ALLOW),
                _fail(errno.EPERM),
            ],
        ),
        Instruction(_RETURN, _ALLOW),
    )


def _for_each(numbers: Iterable[int], then: Sequence[Instruction]) -> list[Instruction]:
    """Return steps that go into `then`, which returns, at each of some numbers."""
    return [
        step
        for number in numbers
        for step in (Instruction(_EQUAL, number, if_false=len(then)), *then)
    ]


def _fail(number: int) -> Instruction:
    return Instruction(_RETURN, _FAIL | number)
