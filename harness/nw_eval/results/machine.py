"""What a run's provenance says about code, machine and library versions."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterable, Iterator
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from math import ceil
from pathlib import Path, PurePosixPath

from nw_eval import __version__
from nw_eval.results.provenance import CodeInfo, MachineInfo

LIBRARIES = ("mujoco", "numpy", "torch", "onnxruntime", "numba", "embreex", "pyarrow")
"""Whose versions may change results or how they are kept."""


JUDGING = frozenset(
    {"__init__", "amounts", "clean", "errors", "plural", "request", "words"}
    | {
        "api",
        "cli",
        "gate",
        "onboarding",
        "pytest_plugin",
        "reporting",
        "results",
        "stats",
        "testing",
    }
    | {"hub", "learn", "twin", "viewing"}
)
"""Rooms that no bit of a row comes from: they say what is to be run, fetch it, keep rows, judge
them, show logs, or make policies and places. All others count, those that are added too."""

_PACKAGE = Path(__file__).resolve().parents[1]


@cache
def rows_code_digest() -> str:
    """Return the hex sha256 of the code that makes rows: all rooms but those that only judge.

    The robots that come with it count as code, since rows name them by their names alone.

    A report may be worded anew, and a run still be resumed, and a baseline still be of this
    machine.
    """
    return _digest(path for path in _sources() if _room(path) not in JUDGING)


@cache
def code_info() -> CodeInfo:
    """Return version and content of the code, and the commit of its checkout if it has one."""
    package = _PACKAGE
    commit = _git(package, "rev-parse", "HEAD")
    return CodeInfo(
        version=__version__,
        digest=_digest(_sources()),
        commit=commit,
        dirty=bool(commit) and bool(_git(package, "status", "--porcelain", "--", str(package))),
    )


def machine_info() -> MachineInfo:
    """Return what the machine says about itself."""
    return MachineInfo(
        host=platform.node(),
        cpu=_cpu_name(),
        cores=usable_cores(),
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
        python=platform.python_version(),
    )


def processors() -> tuple[int, int]:
    """Return how many processors this process may run on, and how many there are."""
    installed = os.cpu_count() or 1
    has_affinity = hasattr(os, "sched_getaffinity")
    return len(os.sched_getaffinity(0)) if has_affinity else installed, installed


def usable_cores(root: Path = Path("/")) -> int:
    """Return the number of cores that this process may use; everything that counts cores asks here.

    The least of two: the processors it may run on (sched_getaffinity(2)), and the processor time
    that its control groups may take, rounded up (cpu.max of cgroups v2, cpu.cfs_quota_us of v1, see
    Linux's Documentation/admin-guide/cgroup-v2.rst and scheduler/sched-bwc.rst). Containers are
    limited by the latter.

    Args:
        root: of the file system, which says the control groups.
    """
    cores, _ = processors()
    try:
        quotas = [_quota(folder, is_v2=is_v2) for folder, is_v2 in _cgroups(root)]
    except (OSError, ValueError):  # No Linux, or no control groups.
        quotas = []
    return max(1, min([cores, *(ceil(quota) for quota in quotas if quota is not None)]))


def library_versions() -> dict[str, str]:
    """Return installed versions without importing anything."""
    found: dict[str, str] = {}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _sources() -> list[Path]:
    return sorted([*_PACKAGE.rglob("*.py"), *_PACKAGE.glob("robots/*/robot.*")])


def _room(source: Path) -> str:
    return source.relative_to(_PACKAGE).parts[0].removesuffix(".py")


def _digest(sources: Iterable[Path]) -> str:
    content = sha256()
    for path in sources:
        content.update(path.relative_to(_PACKAGE).as_posix().encode() + b"\0")
        content.update(sha256(path.read_bytes()).digest())
    return content.hexdigest()


def _cgroups(root: Path) -> Iterator[tuple[Path, bool]]:
    """Yield the folders of this process's control groups of processor time, and their parents.

    Args:
        root: of the file system.

    Yields:
        The folder, and whether it is of version 2.

    Raises:
        OSError: this system has none.
    """
    mounted = root / "sys/fs/cgroup"
    for line in (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines():
        _, controllers, name = line.split(":", 2)
        own = name.strip("/")
        if not controllers:
            # A container may see its own group as the root, by either name.
            for folder in dict.fromkeys((mounted / own, *_parents(mounted, own), mounted)):
                yield folder, True
        elif "cpu" in controllers.split(","):
            for kind in (controllers, "cpu"):
                base = mounted / kind
                for folder in dict.fromkeys((base / own, *_parents(base, own), base)):
                    yield folder, False


def _parents(base: Path, own: str) -> list[Path]:
    return [base / parent for parent in PurePosixPath(own).parents if str(parent) != "."]


def _quota(folder: Path, *, is_v2: bool) -> float | None:
    """Return how many cores a control group may use at a time; None = as many as there are."""
    try:
        if is_v2:
            quota, period = (folder / "cpu.max").read_text(encoding="utf-8").split()
        else:
            quota, period = (
                (folder / f"cpu.cfs_{word}_us").read_text(encoding="utf-8").strip()
                for word in ("quota", "period")
            )
        share = float(quota) / float(period)  # `max` is no number.
    except (OSError, ValueError, ZeroDivisionError):
        return None
    return share if share > 0 else None  # -1 is version 1's `max`.


def _cpu_name() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"


def _git(folder: Path, *arguments: str) -> str:
    """Return what git says about the package's own checkout; empty where there is none."""
    if not (folder.parents[1] / ".git").exists():
        return ""  # An installed wheel may lie in somebody else's repository.
    try:
        done = subprocess.run(  # noqa: S603  # Fixed arguments, no shell.
            ["git", "-C", str(folder), *arguments],  # noqa: S607  # Whichever git the user has.
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
