"""What the engine asks of the machine and of the terminal.

How many trials run at a time, and which kind of processor results come from: numerical libraries
choose their kernels by it. What is left of a session that has ended. How much memory a worker and
its children hold, and who ends first where there is none left. What workers print: never on the
console, the beginning of it in a file of the run folder. Ctrl-C and SIGTERM: the first asks for an
orderly stop, the second ends at once.

Resident memory is what a machine runs out of. Pages that several processes share, such as libraries
and the map of a splat, count in parts: each process has its share of them (PSS), and the shares of
all workers together are what they take.

Sources: proc(5) and Linux's Documentation/filesystems/proc.rst for `statm`, `smaps_rollup`
and `oom_score_adj`; setrlimit(2) for RLIMIT_DATA.
"""

from __future__ import annotations

import os
import resource
import signal
import threading
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from multiprocessing import Pipe
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Self

from nw_base.clean import clean
from nw_base.files.cache import open_own
from nw_gate.results.provenance import usable_cores
from nw_sim.rollout.confined.progress import descendants, stat_of, text_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from types import FrameType, TracebackType

    from nw_base.confinement import Rules

# What else, on one and the same processor, makes a library take other kernels: numba's own
# settings, torch, MKL and oneDNN under it, OpenBLAS and SIMD under NumPy, the C library's sin.
_SETTINGS = (
    "ATEN_CPU_CAPABILITY",
    "DNNL_MAX_CPU_ISA",
    "GLIBC_TUNABLES",
    "MKL_CBWR",
    "MKL_DEBUG_CPU_TYPE",
    "MKL_ENABLE_INSTRUCTIONS",
    "NPY_DISABLE_CPU_FEATURES",
    "NPY_ENABLE_CPU_FEATURES",
    "NUMBA_ENABLE_AVX",
    "NUMBA_OPT",
    "ONEDNN_MAX_CPU_ISA",
    "OPENBLAS_CORETYPE",
)
_PROC = Path("/proc")
_PAGE = resource.getpagesize()
_SHARE_HOLDS = 1.0
"""Seconds for which it is taken as known what of the memory others have, too. To sum up the shares
of 700 MB takes the kernel 3 ms, in which the process cannot map memory; `statm` takes 5 us."""
_BETWEEN_LOOKS = 2**30
"""Bytes by which a process may go beyond its limit until somebody looks. Libraries reserve up to
280 MB that they never touch (`confinement.fence`)."""
_ENDS_FIRST = b"1000"
"""Of the kernel's scale: whoever has it ends before all others."""
LARGEST = 2**20
"""Characters of output that are kept. What comes later is read and dropped: a checkpoint that
prints for hours neither fills the disk nor waits for a reader."""

_OUTPUT_CHUNK = 2**16
_PATIENCE = 5.0  # s for the last words of workers that are gone
_MORE_OUTPUT = "(the run printed more, which was not kept)"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def worker_count(wanted: int | None, jobs: int) -> int:
    """Return the number of workers that have something to do.

    Args:
        wanted: one for each core if None.
        jobs: those that are to be run.
    """
    return max(1, min(usable_cores() if wanted is None else wanted, jobs))


def cpu_kind() -> str:
    """Return a short text that is equal where the kernels are, such as `znver4 1f0c77a2`.

    The name is LLVM's, or what `NUMBA_CPU_NAME` says; the digits are a digest of the instruction
    sets, or of `NUMBA_CPU_FEATURES`. Settings by which libraries choose other kernels follow.
    """
    from llvmlite import binding

    name = os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name()
    flags = os.environ.get("NUMBA_CPU_FEATURES")
    if flags is None:
        try:
            flags = binding.get_host_cpu_features().flatten()
        except RuntimeError:  # LLVM cannot tell on this platform; numba then uses none.
            flags = ""
    listed = ",".join(sorted(flag.strip() for flag in flags.split(",")))
    words = [name, sha256(listed.encode()).hexdigest()[:8]]
    words += [f"{key}={value}" for key in _SETTINGS if (value := os.environ.get(key))]
    return clean(" ".join(words), at_most=200)


def can_be_listed() -> bool:
    """Whether this system says what a process has started."""
    return (_PROC / f"self/task/{os.getpid()}/children").exists()


def left_by(leader: int) -> list[int]:
    """Return what is left of the session of a process that has ended and is waited for.

    It costs some ms. A number that is another process's by now leaves nothing.
    """
    if (_PROC / str(leader)).exists():
        return []
    found: list[int] = []
    for entry in _PROC.iterdir():
        with suppress(OSError, ValueError, IndexError):
            if int(stat_of(int(entry.name))[3]) == leader:
                found.append(int(entry.name))
    return found


def kill(processes: Iterable[int]) -> None:
    """End processes, at once."""
    for each in processes:
        with suppress(OSError):
            os.kill(each, signal.SIGKILL)


class Resident:
    """Watches the memory of processes and of those that they started.

    Args:
        *processes: their numbers.
    """

    def __init__(self, *processes: int) -> None:
        self._processes = processes
        self._of_others = 0
        self._known_until = 0.0

    def beyond(self, limit: int) -> int | None:
        """Return how many bytes they hold, if these are more than a limit.

        What they map is summed first, which is cheap and never too little. Shares are summed only
        where that is too much.
        """
        family = [each for own in self._processes for each in (own, *descendants(own))]
        mapped = sum(map(_mapped, family))
        now = monotonic()
        if mapped - (self._of_others if now < self._known_until else 0) <= limit:
            return None
        held = sum(map(_share, family))
        self._of_others, self._known_until = mapped - held, now + _SHARE_HOLDS
        return held if held > limit else None

    def restrain(self, limit: int | None) -> None:
        """Keep them from taking the whole machine between two looks.

        Where memory runs out the kernel ends them, and not whoever started them. And with a limit
        no process of them can reserve much more than that: it is refused, and Python says
        MemoryError.

        Args:
            limit: bytes that they may hold.
        """
        for process in self._processes:
            with suppress(OSError):
                Path(f"/proc/{process}/oom_score_adj").write_bytes(_ENDS_FIRST)
            if limit is None:
                continue
            with suppress(OSError, ValueError):
                known = resource.prlimit(process, resource.RLIMIT_DATA)
                finite = (most for most in known if most != resource.RLIM_INFINITY)
                most = min([*finite, limit + _BETWEEN_LOOKS])
                resource.prlimit(process, resource.RLIMIT_DATA, (most, most))


def restrained(rules: Rules, limit: int | None) -> Rules:
    """Return rules by which a process cannot reserve much more than it may hold.

    Args:
        rules: what it may do.
        limit: bytes that it may hold; None = any.
    """
    most = [] if limit is None else [limit + _BETWEEN_LOOKS]
    most += [] if rules.memory is None else [rules.memory]
    return replace(rules, memory=min(most, default=None))


def _mapped(process: int) -> int:
    """Return the bytes of memory that a process maps and that are there; 0 if it has ended."""
    with suppress(OSError, IndexError, ValueError):
        return int(text_of(f"/proc/{process}/statm").split()[1]) * _PAGE
    return 0


def _share(process: int) -> int:
    """Return a process's share of memory in bytes; what it maps, where it hides its share."""
    with suppress(OSError, IndexError, ValueError):
        kilobytes = text_of(f"/proc/{process}/smaps_rollup").partition("\nPss:")[2].split()[0]
        return int(kilobytes) * 1024
    return _mapped(process)


class WorkerOutput:
    """A pipe that workers print to, and a thread that writes down what comes; a context manager.

    A checkpoint may print anything: lines are cleaned. Where nothing is printed, there is no file.

    Args:
        path: of the file, to which lines are appended.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._receiver, self.end = Pipe(duplex=False)
        self._thread = threading.Thread(target=self._write_down, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end.close()
        self._thread.join(_PATIENCE)

    def _write_down(self) -> None:
        """Read until the last worker is gone; write the first lines."""
        left = LARGEST
        for line in self._lines():
            if left > 0:
                text = clean(line)
                left -= len(text) + 1
                self._append(text if left > 0 else _MORE_OUTPUT)

    def _append(self, line: str) -> None:
        with suppress(OSError):
            handle = open_own(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            with os.fdopen(handle, "a", encoding="utf-8", errors="replace") as file:
                file.write(f"{line}\n")

    def _lines(self) -> Iterator[str]:
        """Yield lines as they come, those that are longer than a chunk in pieces."""
        begun = b""
        with self._receiver:
            while chunk := os.read(self._receiver.fileno(), _OUTPUT_CHUNK):
                *whole, begun = (begun + chunk).split(b"\n")
                if len(begun) > _OUTPUT_CHUNK:
                    whole, begun = [*whole, begun], b""
                yield from (line.decode(errors="replace") for line in whole)
        if begun:
            yield begun.decode(errors="replace")


class Interrupts:
    """Listens for signals while a run is under way; blocks may be nested.

    Python delivers signals to the main thread only; elsewhere (a notebook's executor, a test's
    thread) this listens to nothing and `requested` stays None.
    """

    def __init__(self) -> None:
        self.requested: signal.Signals | None = None
        self._is_ending = False
        self._depth = 0
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        self._depth += 1
        if self._depth == 1 and threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._heard) for number in _SIGNALS}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._depth -= 1
        if self._depth == 0:
            for number, handler in self._before.items():
                signal.signal(number, handler)
            self._before = {}

    def _heard(self, number: int, _frame: FrameType | None) -> None:
        if self.requested is None:
            self.requested = signal.Signals(number)
        elif not self._is_ending:
            # Once: a third one would only disturb the end that the second asked for.
            self._is_ending = True
            raise KeyboardInterrupt
