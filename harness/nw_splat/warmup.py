"""Compiling the renderer's kernels ahead of the first frame."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nw_base.lens import Distortion
from nw_base.words import SPLAT_KERNELS, Backend, Kernels
from nw_splat.camera import Camera
from nw_splat.gaussians import Gaussians
from nw_splat.store import memory_store

if TYPE_CHECKING:
    from collections.abc import Collection

KERNEL_FOLDER = Path(__file__).parent / "kernels"


def warmup(
    backend: Backend = "cpu",
    *,
    surfaces: bool = False,
    kernels: Collection[Kernels] = SPLAT_KERNELS,
) -> float:
    """Compile kernels into the user's cache, or load them from there.

    Workers that start afterwards find everything there; in a fence they could not write it.

    Args:
        backend: whose.
        surfaces: also those of `CpuRenderer.surface`.
        kernels: CPU kernels, named by their use (default: all).

    Returns:
        Seconds that it took: when compiled about 15 for what all share and one kind, 10 for each
        further one; when loaded 0.5.

    Raises:
        PrerequisiteError: when the backend's packages or device are missing.
    """
    from nw_splat.render import CpuRenderer, open_renderer

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
    if backend != "cpu":
        open_renderer(store, backend).render(camera)
        return time.perf_counter() - started
    from nw_base.machine_code import mark_compiled  # It knows numba.

    straight = Distortion(model="fisheye", coefficients=(0.0, 0.0, 0.0, 0.0))
    for kind in kernels:
        if kind == "lens":
            open_renderer(store).render(replace(camera, distortion=straight))
        else:
            open_renderer(store, projection=kind).render(camera)
        mark_compiled(KERNEL_FOLDER, kind)
    _warm_insertion()
    if surfaces:
        CpuRenderer(store).surface(camera)
    return time.perf_counter() - started


def _warm_insertion() -> None:
    """Call what puts objects into pictures, with arrays of the types that sensors have."""
    from nw_splat.kernels import insert

    colours, values = np.ones((4, 4, 3), np.float32), np.ones((4, 4), np.float32)
    colour, line = colours.reshape(-1, 3), values.reshape(-1)
    lines, numbers, cells = np.ones((16, 3)), np.zeros(16, np.intp), np.ones((1, 1, 4))
    half = colours[:2, :2].copy(), values[:2, :2].copy(), values[:2, :2].copy()
    insert.mean_of_four(colours, values, values, *half)
    insert.composite((colour, line, line), (colour, line, line), colour[0], (colour, line, line))
    fixed = colours.copy()
    fixed.flags.writeable = False  # Sensors share pictures of the splat alone.
    for picture in (colours, fixed):
        insert.sum_cells(
            picture, np.ones((4, 4)), (1, 1), 0.0, 1.0, (numbers[:1], numbers[:1]), cells
        )
    of_light = ((1.0, 1.0, 1.0), 1.0, 1.0, 1.0, 1.0)
    insert.light_at(cells[..., :3] / 1.0, (4, 4), numbers, numbers, of_light, colour)
    insert.near_any(lines, lines, lines[0], 1.0, numbers)
    insert.outline(values > 0.0, numbers)
    insert.rays_around(lines, numbers[:1], lines, lines.copy())
    insert.soften(np.ones(16), colour, numbers[:1], np.ones(16), colour, line)
