"""Compiling all kernels of a trial ahead of its first step: pictures, networks and rays."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import nw_policies.executor
import nw_scenes.ray_tree
from nw_base.words import KERNELS, Backend, Kernels
from nw_splat import warmup as pictures

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

_FOLDERS: dict[Kernels, Path] = {
    "networks": Path(nw_policies.executor.__path__[0]),
    "rays": Path(nw_scenes.ray_tree.__path__[0]),
}


def warmup(
    backend: Backend = "cpu",
    *,
    surfaces: bool = False,
    kernels: Collection[Kernels] = KERNELS,
) -> float:
    """Compile kernels into the user's cache, or load them from there.

    Workers that start afterwards find everything there; in a fence they could not write it.

    Args:
        backend: that draws pictures.
        surfaces: also those of `CpuRenderer.surface`.
        kernels: those of the CPU, by what they are for; all of them if nothing is said.

    Returns:
        Seconds that it took: when compiled about 15 for what all share and one kind, 10 for each
        further one; when loaded 0.5.

    Raises:
        PrerequisiteError: when the backend's packages or device are missing.
    """
    started = time.perf_counter()
    own: dict[Kernels, Callable[[], None]] = {"networks": _warm_networks, "rays": _warm_rays}
    for kind, warm in own.items():
        if kind in kernels:
            warm()
            if backend == "cpu":
                from nw_base.machine_code import mark_compiled  # It knows numba.

                mark_compiled(_FOLDERS[kind], kind)
    pictures.warmup(
        backend, surfaces=surfaces, kernels=[kind for kind in kernels if kind not in _FOLDERS]
    )
    return time.perf_counter() - started


def _warm_networks() -> None:
    from nw_policies.executor import Graph
    from nw_policies.executor.network import Network
    from nw_policies.executor.plan import plan

    graph = Graph()
    given = graph.input("x", (1, 1))
    graph.outputs = [graph.add("Tanh", given)]
    Network(plan(graph))({"x": np.zeros((1, 1), np.float32)})


def _warm_rays() -> None:
    from nw_scenes.ray_tree.tree import Tree

    Tree(np.eye(3), np.array([[0, 1, 2]])).cast(np.zeros(3), np.ones((1, 3)))


def warm_kernels() -> tuple[Kernels, ...]:
    """Return which of the CPU's kernels `warmup` finds compiled, by this version of them."""
    from nw_base.machine_code import is_compiled  # It knows numba.

    return tuple(
        kind for kind in KERNELS if is_compiled(_FOLDERS.get(kind, pictures.KERNEL_FOLDER), kind)
    )


def kernel_note() -> str | None:
    """Return why the user's cache cannot keep compiled kernels, in one line; None if it can."""
    from nw_base.machine_code import folder_note

    return folder_note()
