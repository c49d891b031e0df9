"""What a run's provenance says about code, machine and library versions."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from nw_eval import __version__
from nw_eval.results.provenance import CodeInfo, MachineInfo

LIBRARIES = ("mujoco", "numpy", "torch", "onnxruntime", "numba", "embreex", "pyarrow")
"""Whose versions may change results or how they are kept."""


JUDGING = frozenset(
    {"__init__", "amounts", "clean", "errors", "plural", "request", "words"}
    | {"api", "cli", "gate", "onboarding", "pytest_plugin", "reporting", "results", "stats"}
    | {"hub", "learn", "twin", "viewing"}
)
"""Rooms that no bit of a row comes from: they say what is to be run, fetch it, keep rows, judge
them, show logs, or make policies and places. All others count, those that are added too."""

_PACKAGE = Path(__file__).resolve().parents[1]


@cache
def rows_code_digest() -> str:
    """Return the hex sha256 of the code that makes rows: all rooms but those that only judge.

    A report may be worded anew, and a run still be resumed, and a bank still be of this machine.
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
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else _count(),
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
        python=platform.python_version(),
    )


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
    return sorted(_PACKAGE.rglob("*.py"))


def _room(source: Path) -> str:
    return source.relative_to(_PACKAGE).parts[0].removesuffix(".py")


def _digest(sources: Iterable[Path]) -> str:
    content = sha256()
    for path in sources:
        content.update(path.relative_to(_PACKAGE).as_posix().encode() + b"\0")
        content.update(sha256(path.read_bytes()).digest())
    return content.hexdigest()


def _count() -> int:
    return os.cpu_count() or 1


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
