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
from typing import Literal

from nw_eval.confinement import kernel

Numbers = dict[str, tuple[int | None, int | None]]
"""By name: of x86_64, of aarch64."""

MACHINES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
"""AUDIT_ARCH of `linux/audit.h`, in the order of the numbers."""

REFUSED: Numbers = {
    # other programs and processes (fork and threads: see below)
    "execve": (59, 221),
    "execveat": (322, 281),
    "fork": (57, None),
    "vfork": (58, None),
    "ptrace": (101, 117),
    "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271),
    "process_madvise": (440, 440),
    "kcmp": (312, 272),
    "pidfd_open": (434, 434),
    "pidfd_getfd": (438, 438),
    "pidfd_send_signal": (424, 424),
    "tkill": (200, 130),
    "rt_sigqueueinfo": (129, 138),
    "rt_tgsigqueueinfo": (297, 240),
    # what Landlock does not see: rights, owners and times of files, handles in place of paths
    "chmod": (90, None),
    "fchmod": (91, 52),
    "fchmodat": (268, 53),
    "fchmodat2": (452, 452),
    "chown": (92, None),
    "fchown": (93, 55),
    "lchown": (94, None),
    "fchownat": (260, 54),
    "setxattr": (188, 5),
    "lsetxattr": (189, 6),
    "fsetxattr": (190, 7),
    "setxattrat": (463, 463),
    "removexattr": (197, 14),
    "lremovexattr": (198, 15),
    "fremovexattr": (199, 16),
    "removexattrat": (466, 466),
    "file_setattr": (469, 469),
    "utime": (132, None),
    "utimes": (235, None),
    "futimesat": (261, None),
    "utimensat": (280, 88),
    "name_to_handle_at": (303, 264),
    "open_by_handle_at": (304, 265),
    # how fast others run: each takes any process of this user
    "setpriority": (141, 140),
    "ioprio_set": (251, 30),
    "sched_setparam": (142, 118),
    "sched_setscheduler": (144, 119),
    "sched_setattr": (314, 274),
    # memory and queues that processes share by name
    "shmget": (29, 194),
    "shmat": (30, 196),
    "semget": (64, 190),
    "msgget": (68, 186),
    "mq_open": (240, 180),
    # ways round this filter, and parts of the kernel with a history
    "io_uring_setup": (425, 425),
    "io_uring_enter": (426, 426),
    "io_uring_register": (427, 427),
    "bpf": (321, 280),
    "perf_event_open": (298, 241),
    "userfaultfd": (323, 282),
    "keyctl": (250, 219),
    "add_key": (248, 217),
    "request_key": (249, 218),
    "personality": (135, 92),
    "modify_ldt": (154, None),
    "lookup_dcookie": (212, 18),
    "fanotify_init": (300, 262),
    # the machine itself: mounts, namespaces, modules, clocks
    "mount": (165, 40),
    "umount2": (166, 39),
    "pivot_root": (155, 41),
    "chroot": (161, 51),
    "open_tree": (428, 428),
    "open_tree_attr": (467, 467),
    "move_mount": (429, 429),
    "fsopen": (430, 430),
    "fsconfig": (431, 431),
    "fsmount": (432, 432),
    "fspick": (433, 433),
    "mount_setattr": (442, 442),
    "unshare": (272, 97),
    "setns": (308, 268),
    "swapon": (167, 224),
    "swapoff": (168, 225),
    "quotactl": (179, 60),
    "quotactl_fd": (443, 443),
    "acct": (163, 89),
    "syslog": (103, 116),
    "reboot": (169, 142),
    "kexec_load": (246, 104),
    "kexec_file_load": (320, 294),
    "init_module": (175, 105),
    "finit_module": (313, 273),
    "delete_module": (176, 106),
    "iopl": (172, None),
    "ioperm": (173, None),
    "settimeofday": (164, 170),
    "clock_settime": (227, 112),
    "adjtimex": (159, 171),
    "clock_adjtime": (305, 266),
    "sethostname": (170, 161),
    "setdomainname": (171, 162),
}

Network = Literal["none", "server", "all"]
"""Which sockets a process may have: none of its own, those that others connect to, any."""

_SOCKETS: Numbers = {"socket": (41, 198), "bind": (49, 200), "listen": (50, 201)}
_CONNECT: Numbers = {"connect": (42, 203)}

_IOCTL: Numbers = {"ioctl": (16, 29)}
_SET_ATTRIBUTES = (0x40086602, 0x40046602, 0x401C5820)
"""FS_IOC_SETFLAGS, FS_IOC32_SETFLAGS and FS_IOC_FSSETXATTR of `linux/fs.h`, which Landlock does not
see on files that may be read."""

_ON_PROCESSES: Numbers = {"kill": (62, 129), "tgkill": (234, 131), "prlimit64": (302, 261)}
"""Whose first argument is a process: allowed on this one only."""

_CLONE: Numbers = {"clone": (56, 220)}
_CLONE3: Numbers = {"clone3": (435, 435)}
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_NUMBER, _MACHINE, _FIRST_ARGUMENT = 0, 4, 16  # Offsets in struct seccomp_data; little-endian.
_SECOND_ARGUMENT = _FIRST_ARGUMENT + 8
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
        refused += numbers(_CONNECT)
    if network == "none":
        refused += numbers(_SOCKETS)
    return (
        Instruction(_LOAD, _MACHINE),
        Instruction(_EQUAL, MACHINES[machine], if_true=1),
        Instruction(_RETURN, _KILL),
        Instruction(_LOAD, _NUMBER),
        *([Instruction(_AT_LEAST, _X32, if_false=1), _fail(errno.EPERM)] if column == 0 else ()),
        *_for_each(refused, [_fail(errno.EPERM)]),
        # The C library then takes `clone`, whose flags can be seen here.
        *_for_each(numbers(_CLONE3), [_fail(errno.ENOSYS)]),
        *_for_each(
            numbers(_CLONE),
            [
                Instruction(_LOAD, _FIRST_ARGUMENT),
                Instruction(_ANY_BIT, _CLONE_THREAD, if_false=1),
                Instruction(_RETURN, _ALLOW),
                _fail(errno.EPERM),
            ],
        ),
        *_for_each(
            numbers(_IOCTL),
            [
                Instruction(_LOAD, _SECOND_ARGUMENT),
                *(
                    Instruction(_EQUAL, request, if_true=len(_SET_ATTRIBUTES) - place)
                    for place, request in enumerate(_SET_ATTRIBUTES)
                ),
                Instruction(_RETURN, _ALLOW),
                _fail(errno.EPERM),
            ],
        ),
        *_for_each(
            numbers(_ON_PROCESSES),
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
