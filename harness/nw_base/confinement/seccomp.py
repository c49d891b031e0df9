"""seccomp: from now on this thread, and what it starts, may make a few system calls only.

A list of what is allowed, from recordings of policies in six runtimes. Whatever else there is, or a
later kernel adds, is refused: with EPERM, or with ENOSYS where the call is newer than Linux 5.1, so
that libraries take the older one. The filter is a program of classic BPF, see `linux/filter.h` and
`linux/seccomp.h`: a binary search by the number of the call. The kernel (since 5.11) finds out once
which numbers are allowed whatever their arguments, and does not run the filter for them again.
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from nw_base.confinement import kernel

MACHINES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
"""AUDIT_ARCH of `linux/audit.h`, in the order of the numbers in `ALLOWED`."""

ALLOWED: Mapping[str, str] = MappingProxyType(
    {
        "every runtime": """
            read/0/63 readv/19/65 pread64/17/67 write/1/64 writev/20/66 lseek/8/62 close/3/57
            openat/257/56 stat/4 fstat/5/80 lstat/6 newfstatat/262/79 statx/332/291 access/21
            faccessat/269/48 faccessat2/439/439 readlink/89 readlinkat/267/78 getdents64/217/61
            getcwd/79/17 fcntl/72/25 ioctl/16/29 dup/32/23
            mmap/9/222 munmap/11/215 mremap/25/216 mprotect/10/226 madvise/28/233 brk/12/214
            clone/56/220 exit/60/93 exit_group/231/94 futex/202/98 rseq/334/293 gettid/186/178
            set_robust_list/273/99 sched_yield/24/124 sched_getaffinity/204/123 getpid/39/172
            rt_sigaction/13/134 rt_sigprocmask/14/135 rt_sigreturn/15/139 sigaltstack/131/132
            restart_syscall/219/128 clock_gettime/228/113 clock_nanosleep/230/115 nanosleep/35/101
            getrandom/318/278 prlimit64/302/261 getuid/102/174 geteuid/107/175 getgid/104/176
            getegid/108/177 uname/63/160 sysinfo/99/179
        """,
        "NumPy (OpenBLAS)": "mbind/237/235",
        "ONNX Runtime, torch, JAX": "arch_prctl/158",
        "ONNX Runtime, torch": "sched_setaffinity/203/122",
        "torch": "open/2",
        "JAX": "eventfd2/290/19 prctl/157/167 sched_getparam/143/121 sched_getscheduler/145/120",
        "Numba": "getppid/110/173 statfs/137/43",
        "plain Python": """
            poll/7 ppoll/271/73 select/23 pselect6/270/72 epoll_create1/291/20 epoll_ctl/233/21
            epoll_wait/232 epoll_pwait/281/22 pipe/22 pipe2/293/59 dup2/33 dup3/292/24
            socketpair/53/199 getsockname/51/204 sendto/44/206 recvfrom/45/207 shutdown/48/210
            kill/62/129 tgkill/234/131 setitimer/38/103 getitimer/36/102 alarm/37 pause/34
            rt_sigtimedwait/128/137 rt_sigpending/127/136 getrusage/98/165 times/100/153
            gettimeofday/96/169 time/201 clock_getres/229/114 getpriority/140/141 getpgrp/111
            getpgid/121/155 getsid/124/156 getresuid/118/148 getresgid/120/150 getgroups/115/158
            fstatfs/138/44 getcpu/309/168
        """,
    }
)
"""System calls that every confined process may make, under who needs them first.

Each is a name, and its numbers of x86_64 and aarch64 where there are such."""

WRITING = """
    mkdir/83 mkdirat/258/34 rename/82 renameat/264/38 renameat2/316/276 unlink/87 unlinkat/263/35
    rmdir/84 ftruncate/77/46 fallocate/285/47 fsync/74/82 fdatasync/75/83 pwrite64/18/68
    sendfile/40/71 copy_file_range/326/285 umask/95/166
"""
"""Further ones of a process that writes files; Landlock says which."""

Network = Literal["none", "server", "all"]
"""Which sockets a process may have: none of its own, those that others connect to, any."""

SERVING = """
    socket/41/198 bind/49/200 listen/50/201 accept/43/202 accept4/288/242 setsockopt/54/208
    getsockopt/55/209 getpeername/52/205 sendmsg/46/211 recvmsg/47/212 sendmmsg/307/269
    recvmmsg/299/243
"""
"""Further ones of a process with sockets."""
CONNECTING = "connect/42/203"
"""Further ones of a process with sockets of any kind."""

CHECKED: Mapping[str, Mapping[int, str]] = MappingProxyType(
    {
        "ioctl": {
            1: """TCGETS/0x5401 TIOCGWINSZ/0x5413 FIONREAD/0x541B FIONBIO/0x5421 FIONCLEX/0x5450
                FIOCLEX/0x5451"""
        },
        "fcntl": {1: "F_DUPFD/0 F_GETFD/1 F_SETFD/2 F_GETFL/3 F_SETFL/4 F_DUPFD_CLOEXEC/1030"},
        "prctl": {0: "PR_SET_NAME/15 PR_GET_NAME/16 PR_SVE_GET_VL/51 PR_SET_VMA/0x53564D41"},
        "arch_prctl": {
            0: "ARCH_GET_XCOMP_SUPP/0x1021 ARCH_GET_XCOMP_PERM/0x1022 ARCH_REQ_XCOMP_PERM/0x1023"
        },
        "kill": {0: "itself/-1"},
        "tgkill": {0: "itself/-1"},
        "prlimit64": {0: "itself/0 itself/-1"},
        "socket": {0: "AF_INET/2 AF_INET6/10"},
        # One of datagrams could send to any address.
        "socketpair": {
            0: "AF_UNIX/1",
            1: "SOCK_STREAM/1 CLOEXEC/0x80001 NONBLOCK/0x801 both/0x80801",
        },
    }
)
"""Of some calls, the indices of arguments and the values that they may have, each with its name.

-1 stands for the number of this process. The kernel reads the lower 32 bits of each."""

_NEW = 424
"""The first number of calls that came after Linux 5.1, the same ones on every machine: libraries do
without what answers ENOSYS. `clone3` is among them, whose flags cannot be seen here."""

_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _JUMP, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x05, 0x06
_NUMBER, _MACHINE, _ARGUMENTS = 0, 4, 16  # Offsets in struct seccomp_data; little-endian.
_ALLOW, _KILL, _FAIL = 0x7FFF0000, 0x80000000, 0x00050000
_FARTHEST = 255  # Instructions that a comparison can skip.
_THREAD, _THREADS_FLAGS = 0x00010000, 0x007D0F00  # CLONE_THREAD; all that C libraries give with it.
_SHARED, _ANONYMOUS, _GROWS_DOWN = 0x01, 0x20, 0x0100  # MAP_... of mmap(2)
_WRITES = 0o1103  # O_WRONLY, O_RDWR, O_CREAT, O_TRUNC
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


def restrict_calls(*, network: Network, writes: bool = False, opens_to_write: bool = True) -> bool:
    """Refuse system calls to this thread, for good.

    Args:
        network: which sockets may be made.
        writes: whether files may be made, moved and removed.
        opens_to_write: whether files may be opened for writing; Landlock may say which.

    Returns:
        Whether it was done: this machine's numbers are known, and the kernel can.
    """
    if platform.machine() not in MACHINES:
        return False
    try:
        steps = program(
            platform.machine(),
            process=os.getpid(),
            network=network,
            writes=writes,
            opens_to_write=opens_to_write,
        )
        install(steps)
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


def program(
    machine: str,
    *,
    process: int,
    network: Network,
    writes: bool = False,
    opens_to_write: bool = True,
) -> tuple[Instruction, ...]:
    """Return the filter of a machine.

    Args:
        machine: a key of `MACHINES`.
        process: which may be sent signals and given limits: this one.
        network: as for `restrict_calls`, and so are `writes` and `opens_to_write`.
        writes: see there.
        opens_to_write: see there.
    """
    texts = [*ALLOWED.values(), *([WRITING] if writes else [])]
    texts += {"none": [], "server": [SERVING], "all": [SERVING, CONNECTING]}[network]
    column = list(MACHINES).index(machine)
    rows = (each for text in texts for each in named(text))
    calls = {numbers[column]: name for name, numbers in rows if column < len(numbers)}
    spans = [(0, [_fail(errno.EPERM)])]
    for number, name in sorted(calls.items()):
        if number > _NEW:
            spans.append((_NEW, [_fail(errno.ENOSYS)]))
        judged = _judged(name, process=process, opens_to_write=opens_to_write)
        spans.append((number, judged))
        spans.append((number + 1, [_fail(errno.ENOSYS if number > _NEW else errno.EPERM)]))
    return (
        Instruction(_LOAD, _MACHINE),
        Instruction(_EQUAL, MACHINES[machine], if_true=1),
        Instruction(_RETURN, _KILL),
        Instruction(_LOAD, _NUMBER),
        *_searched(sorted(dict(spans).items())),  # Later ones are in place of gaps of no width.
    )


def named(text: str) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Yield each name and its numbers of a text such as `ALLOWED` has."""
    for word in text.split():
        name, *numbers = word.split("/")
        yield name, tuple(int(number, 0) for number in numbers)


def _searched(spans: Sequence[tuple[int, Sequence[Instruction]]]) -> list[Instruction]:
    """Return steps that go into those of the span that a number is in, by a binary search."""
    if len(spans) == 1:
        return list(spans[0][1])
    middle = len(spans) // 2
    low, high = _searched(spans[:middle]), _searched(spans[middle:])
    start = spans[middle][0]
    if len(low) <= _FARTHEST:
        return [Instruction(_AT_LEAST, start, if_true=len(low)), *low, *high]
    far = Instruction(_JUMP, len(low))
    return [Instruction(_AT_LEAST, start, if_false=1), far, *low, *high]


def _judged(name: str, *, process: int, opens_to_write: bool) -> list[Instruction]:
    """Return steps that allow a call, or refuse it by its arguments."""
    allow, refuse = Instruction(_RETURN, _ALLOW), _fail(errno.EPERM)
    if name == "sched_setaffinity":
        return [_fail(0)]  # "Done", and nothing is: its threads' numbers might be others'.
    if name == "clone":
        return [
            _load(0),
            Instruction(_ANY_BIT, _THREAD, if_false=1),
            Instruction(_ANY_BIT, 2**32 - 1 - _THREADS_FLAGS, if_false=1),
            refuse,
            allow,
        ]
    if name == "mmap":  # What is shared, or called a stack, is not counted by RLIMIT_DATA.
        return [
            _load(3),
            Instruction(_ANY_BIT, _GROWS_DOWN, if_true=2),
            Instruction(_ANY_BIT, _SHARED, if_false=2),
            Instruction(_ANY_BIT, _ANONYMOUS, if_false=1),
            refuse,
            allow,
        ]
    if name in {"open", "openat"} and not opens_to_write:
        place = 1 if name == "open" else 2
        return [_load(place), Instruction(_ANY_BIT, _WRITES, if_false=1), refuse, allow]
    steps: list[Instruction] = []
    for place, text in CHECKED.get(name, {}).items():
        values = [process if value < 0 else value for _, (value,) in named(text)]
        steps.append(_load(place))
        steps += [
            Instruction(_EQUAL, value, if_true=len(values) - at) for at, value in enumerate(values)
        ]
        steps.append(refuse)
    return [*steps, allow]


def _load(index: int) -> Instruction:
    """Return the instruction that loads the lower half of an argument."""
    return Instruction(_LOAD, _ARGUMENTS + 8 * index)


def _fail(number: int) -> Instruction:
    return Instruction(_RETURN, _FAIL | number)
