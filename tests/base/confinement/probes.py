"""What code of a policy may try against its machine; `tried` says which of it got through.

Runs inside of a policy's process. A call got through unless it is refused: a kernel that looks at
the arguments, and finds them wrong, has taken it.
"""

import ctypes
import errno
import json
import mmap
import os
import platform
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

REFUSED = {errno.EPERM, errno.EACCES, errno.ENOSYS, errno.EAFNOSUPPORT}
MOST_THREADS = 1000

_library = ctypes.CDLL(None, use_errno=True)
_column = ["x86_64", "aarch64"].index(platform.machine())


def call(number, *arguments):
    """Make a system call, of a number or of those of x86_64 and aarch64."""
    number = number if isinstance(number, int) else number[_column]
    if number is None:
        raise PermissionError
    wide = [
        ctypes.c_long(argument) if isinstance(argument, int) else argument for argument in arguments
    ]
    answer = _library.syscall(ctypes.c_long(number), *wide)
    if answer < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return answer


IOCTLS = {
    "FIFREEZE": 0xC0045877,
    "FITHAW": 0xC0045878,
    "FS_IOC_SETFSLABEL": 0x41009432,
    "EXT4_IOC_SHUTDOWN": 0x8004587D,
    "FS_IOC_SETFLAGS": 0x40086602,
    "FS_IOC_FSSETXATTR": 0x401C5820,
    "FS_IOC_GETFLAGS": 0x80086601,
    "FICLONE": 0x40049409,
    "FS_IOC_FIEMAP": 0xC020660B,
    "BLKDISCARD": 0x1277,
    "TIOCSTI": 0x5412,
    "TIOCSCTTY": 0x540E,
    "FIOASYNC": 0x5452,
    "FIOSETOWN": 0x8901,
    "SIOCGIFCONF": 0x8912,
}
PRCTLS = {
    "PR_SET_PDEATHSIG": 1,
    "PR_SET_DUMPABLE": 4,
    "PR_SET_KEEPCAPS": 8,
    "PR_SET_SECCOMP": 22,
    "PR_CAPBSET_DROP": 24,
    "PR_SET_SECUREBITS": 28,
    "PR_SET_TIMERSLACK": 29,
    "PR_SET_MM": 35,
    "PR_SET_CHILD_SUBREAPER": 36,
    "PR_SET_THP_DISABLE": 41,
    "PR_CAP_AMBIENT": 47,
    "PR_SET_PTRACER": 0x59616D61,
}
FCNTLS = {
    "F_SETLK": 6,
    "F_SETOWN": 8,
    "F_SETSIG": 10,
    "F_SETOWN_EX": 15,
    "F_OFD_SETLK": 37,
    "F_SETLEASE": 1024,
    "F_NOTIFY": 1026,
    "F_SETPIPE_SZ": 1031,
    "F_ADD_SEALS": 1033,
    "F_SET_RW_HINT": 1036,
}
FAMILIES = {"UNIX": 1, "INET": 2, "INET6": 10, "NETLINK": 16, "PACKET": 17, "ALG": 38, "VSOCK": 40}
READ = (
    "/proc/self/net/tcp",
    "/proc/net/unix",
    "/proc/self/mountinfo",
    "/proc/self/mounts",
    "/proc/self/task/{own}/net/tcp",
    "/proc/self/mem",
    "/proc/self/fdinfo/0",
    "/proc/{victim}/environ",
    "/proc/{victim}/maps",
    "/proc/{victim}/cmdline",
    "/proc/1/cgroup",
    "/proc/keys",
    "/proc/sys/kernel/osrelease",
    "/etc/passwd",
    "/dev/zero",
    "{outside}/secret",
)


def _started_threads():
    threading.stack_size(2**16)
    wait = threading.Event()
    try:
        for _ in range(MOST_THREADS):
            threading.Thread(target=wait.wait, daemon=True).start()
    except RuntimeError:
        raise PermissionError from None
    finally:
        wait.set()
    return MOST_THREADS


def _mapped(flags):
    mmap.mmap(-1, mmap.PAGESIZE, flags=flags).close()


def _cleared_capabilities():
    status = Path("/proc/self/status").read_text()
    lines = [line.split() for line in status.splitlines() if line.startswith("Cap")]
    own = [kind for kind, held in lines if int(held, 16) and (kind != "CapBnd:" or _was_root)]
    if not own:
        raise PermissionError
    return own


_was_root = os.geteuid() == 0


def _signals(victim):
    """Yield what would signal, slow down or look into another process."""
    parent, one = os.getppid(), ctypes.create_string_buffer(128)
    for name, process in (
        ("the group", 0),
        ("all", -1),
        ("a victim", victim),
        ("its owner", parent),
    ):
        yield f"kill {name}", lambda process=process: os.kill(process, 0)
    yield "kill its whole group", lambda: os.killpg(os.getpgid(0), 0)
    yield "tgkill", lambda: call((234, 131), victim, victim, 0)
    yield "tkill", lambda: call((200, 130), victim, 0)
    yield "rt_sigqueueinfo", lambda: call((129, 138), victim, signal.SIGUSR1, one)
    yield "rt_tgsigqueueinfo", lambda: call((297, 240), victim, victim, signal.SIGUSR1, one)
    yield "pidfd_open", lambda: os.pidfd_open(victim)
    yield "pidfd_send_signal", lambda: call(424, 0, 0, None, 0)
    yield "pidfd_getfd", lambda: call(438, 0, 0, 0)
    yield "timer_create", lambda: call((222, 107), 1, None, one)
    yield "prlimit of another", lambda: call((302, 261), victim, 7, None, one)
    yield "setpriority", lambda: os.setpriority(os.PRIO_PROCESS, victim, 19)
    yield "sched_setscheduler", lambda: os.sched_setscheduler(victim, 5, os.sched_param(0))
    yield "ioprio_set", lambda: call((251, 30), 1, victim, 3 << 13)
    yield "ptrace", lambda: call((101, 117), 16, victim, 0, 0)
    yield "process_vm_readv", lambda: call((310, 270), victim, one, 1, one, 1, 0)
    yield "process_madvise", lambda: call(440, 0, one, 1, 4, 0)
    yield "kcmp", lambda: call((312, 272), victim, victim, 0, 0, 0)
    yield "move_pages", lambda: call((279, 239), victim, 0, None, None, None, 0)
    yield "get_robust_list", lambda: call((274, 100), victim, one, one)


def _queues(queue):
    """Yield what would use what processes share by name."""
    text = ctypes.create_string_buffer(128)
    yield "msgget", lambda: call((68, 186), 0x1234, 0)
    yield "msgrcv", lambda: call((70, 188), queue, text, 64, 0, 0o4000)
    yield "msgsnd", lambda: call((69, 189), queue, text, 1, 0o4000)
    yield "msgctl, removed", lambda: call((71, 187), queue, 0, None)
    yield "semget", lambda: call((64, 190), 0, 1, 0o600)
    yield "semop", lambda: call((65, 193), 0, text, 1)
    yield "shmget", lambda: call((29, 194), 0, 4096, 0o600)
    yield "shmat", lambda: call((30, 196), 0, None, 0)
    yield "mq_open", lambda: call((240, 180), b"nw-eval-test", 0, 0, None)
    yield "mq_unlink", lambda: call((241, 181), b"nw-eval-test")
    yield "mq_timedreceive", lambda: call((243, 183), 0, text, 1, None, None)


def _writes(own, outside):
    secret = outside / "secret"
    yield "write outside", lambda: secret.write_text("mine")
    yield "append outside", lambda: secret.open("a")
    yield "cut outside", lambda: os.truncate(secret, 0)
    yield "make outside", (outside / "new").touch
    yield "make a folder", (outside / "folder").mkdir
    yield "remove outside", secret.unlink
    yield "move outside", lambda: secret.rename(outside / "moved")
    yield "link outside", lambda: (outside / "link").hardlink_to(secret)
    yield "link by name", lambda: (outside / "symlink").symlink_to(secret)
    yield "make a pipe", lambda: os.mkfifo(outside / "pipe")
    yield "chmod", lambda: secret.chmod(0o777)
    yield "chown", lambda: os.chown(secret, 1, 1)
    yield "utime", lambda: os.utime(secret)
    yield "getxattr", lambda: os.getxattr(secret, "user.word")
    yield "listxattr", lambda: os.listxattr(secret)
    yield "setxattr", lambda: os.setxattr(secret, "user.other", b"x")
    yield "write its own", lambda: own.write_text("mine")
    yield "compile its own", lambda: own.with_suffix(".pyc").write_bytes(b"x")
    yield "shared memory by name", lambda: Path("/dev/shm/nw-eval-test").write_bytes(b"x")


def _rest(own):
    for name, request in IOCTLS.items():
        yield (
            f"ioctl {name}",
            lambda request=request: call((16, 29), os.pipe()[0], request, bytes(8)),
        )
    for name, option in PRCTLS.items():
        yield f"prctl {name}", lambda option=option: call((157, 167), option, 99, 0, 0, 0)
    for name, command in FCNTLS.items():
        yield f"fcntl {name}", lambda command=command: call((72, 25), os.pipe()[1], command, 1)
    for name, family in FAMILIES.items():
        yield f"socket {name}", lambda family=family: socket.socket(family)
    yield "pair of datagrams", lambda: socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    yield "pair of packets", lambda: socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    yield "memfd_create", lambda: os.memfd_create("more")
    yield "memfd_secret", lambda: call(447, 0)
    yield "shared memory", lambda: _mapped(mmap.MAP_SHARED | mmap.MAP_ANON)
    yield "a stack of any size", lambda: _mapped(mmap.MAP_PRIVATE | mmap.MAP_ANON | 0x100)
    yield "threads without end", _started_threads
    yield "capabilities", _cleared_capabilities
    yield "capset", lambda: call((126, 91), (ctypes.c_uint32 * 2)(0x20080522, 0), bytes(24))
    yield "setresuid", lambda: os.setresuid(-1, os.getuid(), -1)
    yield "setgroups", lambda: os.setgroups([])
    yield "setsid", os.setsid
    yield "unshare", lambda: call((272, 97), 0x10000000)
    yield "setns", lambda: call((308, 268), 0, 0)
    yield "clone into namespaces", lambda: call((56, 220), 0x10000000 | 17, 0, 0, 0, 0)
    yield "clone3", lambda: call(435, bytes(88), 88)
    yield "fork", os.fork
    yield "run", lambda: subprocess.run([sys.executable, "-c", ""], check=False)
    yield "spawn", lambda: os.posix_spawn(sys.executable, [sys.executable, "-c", ""], {})
    yield "execve", lambda: os.execve(sys.executable, [sys.executable, "-c", ""], {})
    yield "chroot", lambda: os.chroot("/")
    yield "flock", lambda: __import__("fcntl").flock(own.open().fileno(), 2)
    yield "inotify", lambda: call((294, 26), 0)


def _others():
    """Yield every system call that is on no list, but what never comes back or ends this."""
    from nw_base.confinement import seccomp

    known = [numbers for text in seccomp.ALLOWED.values() for _, numbers in seccomp.named(text)]
    allowed = {numbers[_column] for numbers in known if _column < len(numbers)}
    never = {57, 58, 153, 15, 59, 322} if _column == 0 else {58, 139, 221, 281}
    for number in sorted(set(range(480)) - allowed - never - set(range(335, 424))):
        yield f"call {number}", lambda number=number: call(number, -1, -1, -1, -1, -1, -1)


def tried(*, own, outside, victim, queue):
    """Return what of all this got through, and how many were tried.

    Args:
        own: the policy's file.
        outside: a folder that no rule names, with a file `secret`.
        victim: a process of the same user.
        queue: a message queue of System V of the same user.
    """
    own, outside = Path(own), Path(outside)
    reads = [name.format(victim=victim, outside=outside, own=os.getpid()) for name in READ]
    probes = [
        *((f"read {name}", lambda name=name: os.read(os.open(name, 0), 1)) for name in reads),
        ("list outside", lambda: [*outside.iterdir()]),
        ("list processes", lambda: [*Path("/proc").iterdir()]),
        *_signals(victim),
        *_queues(queue),
        *_writes(own, outside),
        *_rest(own),
        *(_others() if "nw_base.confinement" in sys.modules else ()),
    ]
    through = {}
    for name, probe in probes:
        try:
            through[name] = repr(probe())[:60]
        except OSError as error:
            if error.errno is not None and error.errno not in REFUSED:
                through[name] = errno.errorcode.get(error.errno, str(error.errno))
        except Exception as error:  # noqa: BLE001 - that is not how one is refused.
            through[name] = repr(error)
    os.write(1, b"\nprobes " + json.dumps([len(probes), through]).encode() + b"\n")
