"""What a machine offers nw-eval, for bug reports; and what is missing or broken."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from nw_base import __version__
from nw_base.errors import NwEvalError, StoreError
from nw_base.words import KERNELS

if TYPE_CHECKING:
    from packaging.requirements import Requirement

USES = MappingProxyType(
    {
        "cuda": "run --render cuda",
        "hub": "hub: names of policies, robots and scenes",
        "mlflow": "--track mlflow",
        "onnxruntime": "runtime: native of ONNX files, and operators that nw-eval does not run",
        "orbax": "policies fold of a step that Orbax saved",
        "ray": "run --engine ray",
        "remote": "policies serve, adapter: remote",
        "rerun": "replay --rrd, replay --layout rerun",
        "robots": "menagerie: names of robots",
        "tensorboard": "--track tensorboard",
        "torch": "TorchScript, torch.export, mlp, act and other policies in files of torch",
        "train": "train, study",
        "twin": "twin, scenes import",
        "video": "replay --video",
        "view": "view, twin label",
        "wandb": "--track wandb",
    }
)
"""What needs an extra."""

LIBRARIES = ("mujoco", "numpy", "numba", "llvmlite", "onnxruntime", "torch", "pyarrow")
_UNPACKAGED = (
    "nw-eval runs from a folder that is not installed: its requirements and extras were not "
    "checked; install it, such as with `pip install -e .`"
)
_LEAST_FREE = 2 * 10**9
"""Bytes that runs and splats of built-in scenes soon take."""


@dataclass(frozen=True, kw_only=True)
class Checkup:
    """What a machine offers."""

    versions: Mapping[str, str]
    """nw-eval, python, system and libraries; OpenBLAS with the kernels that it chose."""
    fence: Mapping[str, str | int | bool]
    """`landlock`: the kernel's version, 0 = none; `seccomp`; `meaning`: in words."""
    processor: Mapping[str, str | int]
    """`name`; `kind`, as rows have it; `usable` cores, of which `affinity` and `installed`."""
    memory: Mapping[str, int | None]
    """Bytes: `installed`, `available`, and the `limit` of the control group, None = no limit."""
    cache: Mapping[str, str | int]
    """`folder`, `bytes` in it and `free` bytes of its disk."""
    kernels: tuple[str, ...]
    """Which of the renderer's kernels are compiled for this processor: `ewa`, `ray`, `lens`."""
    gpus: tuple[str, ...]
    """Names that NVIDIA's driver gives."""
    extras: Mapping[str, tuple[str, ...]]
    """Of each extra, the requirements that are not met; none: it is installed."""
    warnings: tuple[str, ...]
    """What goes on, but worse."""
    problems: tuple[str, ...]
    """What nw-eval needs and does not find."""

    @property
    def exit_code(self) -> int:
        """0 where nw-eval has what it needs, else 4."""
        return NwEvalError.exit_code if self.problems else 0


def check_up() -> Checkup:
    """Look at this machine. No simulator, no torch and no driver of a GPU is loaded."""
    from nw_base.confinement import offered

    fence = offered()
    unmet: dict[str, tuple[str, ...]] = {}
    warnings: list[str] = []
    try:
        unmet |= _unmet()
    except metadata.PackageNotFoundError:
        warnings.append(_UNPACKAGED)
    problems = [f"{need}: pip install --upgrade nw-eval" for need in unmet.pop("", ())]
    cache, unusable = _cache()
    problems += unusable
    if not (fence.landlock and fence.seccomp):
        warnings.append(
            "the fence is not whole: TorchScript, torch.export and Python policies need "
            "--allow-code, and can then do what you may"
        )
    if "free" in cache and int(cache["free"]) < _LEAST_FREE:
        warnings.append(f"the disk of the cache {cache['folder']} is nearly full")
    compiled = () if problems else _compiled()
    if not compiled:
        warnings.append("kernels are not compiled: `nw-eval warmup` does it ahead of the first run")
    return Checkup(
        versions=_versions(),
        fence={"landlock": fence.landlock, "seccomp": fence.seccomp, "meaning": str(fence)},
        processor={} if problems else _processor(),
        memory=_memory(),
        cache=cache,
        kernels=compiled,
        gpus=tuple(_gpus()),
        extras=unmet,
        warnings=tuple(warnings),
        problems=tuple(problems),
    )


def _versions() -> dict[str, str]:
    versions = {
        "nw-eval": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
    }
    for name in LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    if kernel := _blas_kernel():
        versions["openblas"] = kernel
    return versions


def _blas_kernel() -> str:
    """Return for which processor OpenBLAS, as NumPy's wheels have it, chose its kernels."""
    spec = find_spec("numpy")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        for library in Path(folder).parent.glob("numpy.libs/*openblas*"):
            with suppress(OSError, AttributeError):
                name = ctypes.CDLL(str(library)).scipy_openblas_get_corename64_
                name.restype = ctypes.c_char_p
                return name().decode()
    return ""


def _unmet() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each extra, `` for nw-eval itself, with the requirements that are not met.

    Raises:
        PackageNotFoundError: nw-eval is not installed.
    """
    from packaging.requirements import Requirement  # matplotlib has it.

    package = metadata.distribution("nw-eval")
    needs = [Requirement(line) for line in package.requires or ()]
    for extra in ("", *sorted(USES)):
        own = [
            need
            for need in needs
            if (need.marker is None and not extra)
            or (need.marker is not None and need.marker.evaluate({"extra": extra}))
        ]
        if own:
            yield extra, tuple(f"{need.name}{need.specifier}" for need in own if not _is_met(need))


def _is_met(need: Requirement) -> bool:
    try:
        return need.specifier.contains(metadata.version(need.name), prereleases=True)
    except metadata.PackageNotFoundError:
        return False


def _processor() -> dict[str, str | int]:
    from nw_eval.engine.machine import cpu_kind
    from nw_gate.results.provenance import machine_info, processors

    machine, (affinity, installed) = machine_info(), processors()
    return {
        "name": machine.cpu,
        "kind": cpu_kind(),
        "usable": machine.cores,
        "affinity": affinity,
        "installed": installed,
    }


def _memory() -> dict[str, int | None]:
    """Return bytes as Linux tells them (proc(5), cgroups(7)); nothing elsewhere."""
    memory: dict[str, int | None] = {}
    with suppress(OSError, ValueError):
        lines = Path("/proc/meminfo").read_text(encoding="utf-8").splitlines()
        sizes = {line.partition(":")[0]: int(line.split()[1]) * 1024 for line in lines}
        memory |= {
            "installed": sizes["MemTotal"],
            "available": sizes["MemAvailable"],
            "limit": None,
        }
    for file in ("memory.max", "memory/memory.limit_in_bytes"):
        with suppress(OSError, ValueError, KeyError):
            limit = int(Path("/sys/fs/cgroup", file).read_text(encoding="utf-8"))
            if limit < (memory["installed"] or 0):
                memory["limit"] = limit
    return memory


def _cache() -> tuple[dict[str, str | int], list[str]]:
    """Return place, size and free space of the cache, and why it cannot be used."""
    from nw_base.files.cache import cache_dir

    try:
        folder = cache_dir()
        free = shutil.disk_usage(folder).free
    except (StoreError, OSError) as error:
        return {}, [str(error)]
    if not os.access(folder, os.W_OK):
        return {"folder": str(folder)}, [f"the cache {folder} cannot be written: set NW_EVAL_CACHE"]
    size = 0
    for base, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                size += Path(base, name).lstat().st_size
    return {"folder": str(folder), "bytes": size, "free": free}, []


def _compiled() -> tuple[str, ...]:
    """Return what `warmup.warm_kernels` does, without a second for importing numba."""
    from nw_base.files.cache import cache_dir

    try:
        libraries = [metadata.version(name) for name in ("numba", "llvmlite", "numpy")]
    except metadata.PackageNotFoundError:
        return ()
    versions = (platform.python_version(), *libraries)
    from llvmlite import binding

    packages, folder = Path(__file__).parents[2], cache_dir() / "kernels"

    def is_compiled(kind: str, sources: Path) -> bool:
        digest = hashlib.sha256(" ".join(versions).encode())
        vectors = sorted((packages / "nw_base" / "simd").glob("*.py"))
        for path in (*sorted(sources.glob("*.py")), *vectors):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        known = f"{digest.hexdigest()[:16]}.{binding.get_host_cpu_name()}.compiled"
        return (folder / f"{sources.parent.name}-{kind}.{known}").is_file()

    pictures = packages / "nw_splat" / "kernels"
    own = {
        "networks": packages / "nw_policies" / "executor",
        "rays": packages / "nw_scenes" / "ray_tree",
    }
    return tuple(kind for kind in KERNELS if is_compiled(kind, own.get(kind, pictures)))


def _gpus() -> Iterator[str]:
    for file in sorted(Path("/proc/driver/nvidia/gpus").glob("*/information")):
        with suppress(OSError):
            for line in file.read_text(encoding="utf-8").splitlines():
                if line.startswith("Model:"):
                    yield line.partition(":")[2].strip()
