"""Compiling the kernels ahead of the first frame."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from nw_eval.lens import Distortion
from nw_eval.splat.camera import Camera
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.store import memory_store
from nw_eval.words import Backend

_KERNELS = Path(__file__).parent / "kernels"


def warmup(backend: Backend = "cpu", *, surfaces: bool = False) -> float:
    """Compile every kernel into the user's cache, or load it from there.

    Workers that start afterwards find everything there; in a fence they could not write it.

    Args:
        backend: whose.
        surfaces: also those of `CpuRenderer.surface`.

    Returns:
        Seconds that it took: about 30 when compiled, 0.5 when loaded.

    Raises:
        PrerequisiteError: when the backend's packages or device are missing.
    """
    from nw_eval.splat.render import CpuRenderer, open_renderer

    started = time.perf_counter()
    gaussians = Gaussians(
        means=np.array([[0, 0, 2]], dtype=np.float32),
        log_scales=np.full((1, 3), -1, dtype=np.float32),
        quats=np.array([[1, 0, 0, 0]], dtype=np.float32),
        opacity_logits=np.zeros(1, dtype=np.float32),
        sh=np.zeros((1, 4, 3), dtype=np.float32),
    )
    camera = Camera.from_fovy(width=16, height=16, fovy=1.0, T_world_camera=np.eye(4))
    store = memory_store(gaussians)
    open_renderer(store, backend).render(camera)
    if backend == "cpu":
        open_renderer(store, projection="ray").render(camera)
        straight = Distortion(model="fisheye", coefficients=(0.0, 0.0, 0.0, 0.0))
        open_renderer(store).render(replace(camera, distortion=straight))
        if surfaces:
            CpuRenderer(store).surface(camera)
        from nw_eval.machine_code import mark_compiled  # It knows numba.

        mark_compiled(_KERNELS)
    return time.perf_counter() - started


def is_warm() -> bool:
    """Return whether `warmup` finds the CPU's kernels compiled, by this version of them."""
    from nw_eval.machine_code import is_compiled  # It knows numba.

    return is_compiled(_KERNELS)


def kernel_note() -> str | None:
    """Return why the user's cache cannot keep compiled kernels, in one line; None if it can."""
    from nw_eval.machine_code import folder_note

    return folder_note()
