"""Depth maps in one volume of sparse blocks of voxels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.twin.reconstruct.depth.maps import DepthMap
from nw_eval.twin.reconstruct.depth.view import F32, F64, WorkingView
from nw_eval.twin.reconstruct.kernels.slopes import slopes
from nw_eval.twin.reconstruct.kernels.voxels import SIDE, VOXELS, integrate, mark

_TRUNCATION = 4.0
"""Voxels on each side of a surface where its distance counts."""
_LARGEST = 64_000_000
"""Blocks of the box about all points, which costs 4 bytes each."""
_STRAY = 0.05
"""Percent of points at each end of an axis that may lie far off."""
_AT_ONCE = 256
"""Blocks of one job."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Volume:
    """Signed distances near surfaces.

    Attributes:
        origin: (3,) centre of the first voxel.
        voxel: edge of a voxel.
        grid: (X, Y, Z) int32: number of each block, -1 where there is none.
        distance: (N, 512) float32: positive before a surface, in units of the truncation.
        weight: (N, 512) float32: sum of confidences.
        colour: (N, 512, 3) float32: 0 to 255.
    """

    origin: F64
    voxel: float
    grid: NDArray[np.int32]
    distance: F32
    weight: F32
    colour: F32


def voxel_of(maps: Sequence[DepthMap]) -> float:
    """Return two pixels' breadth at the median depth: what the maps can show, and no more.

    Raises:
        SceneError: no depth is known.
    """
    breadths = [
        float(np.median(each.depth[each.depth > 0])) / each.view.K[0, 0]
        for each in maps
        if (each.depth > 0).any()
    ]
    if not breadths:
        raise SceneError(
            "no two photographs agree on any depth",
            fix="photograph what has texture, from places closer to each other",
        )
    return 2.0 * float(np.median(breadths))


def fuse(
    maps: Sequence[DepthMap],
    voxel: float,
    most: int,
    say: Callable[[str], None],
    threads: int = 2,
) -> Volume:
    """Join depth maps in a volume.

    Each block sees the maps in their order, whoever works at it: threads change no bit.

    Raises:
        SceneError: no depth is known, or it takes more than `most` blocks.
    """
    volume, blocks = _empty(maps, voxel, most)
    say(f"fuses {len(maps)} depth maps in {len(blocks)} blocks of voxels of {voxel:.4g}")
    lattice = np.array([*volume.origin, voxel, _TRUNCATION * voxel])
    leaning = [np.zeros((*each.depth.shape, 2), np.float32) for each in maps]
    for each, slope in zip(maps, leaning, strict=True):
        slopes(each.depth, slope)

    pull = np.zeros_like(volume.weight)

    def job(first: int) -> None:
        end = min(first + _AT_ONCE, len(blocks))
        for each, slope in zip(maps, leaning, strict=True):
            view, K = each.view, each.view.K
            lens = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
            integrate(
                blocks, first, end, lattice, each.depth, slope, each.confidence, view.rgb, lens,
                view.T_camera_world, volume.distance, volume.weight, volume.colour, pull,
            )  # fmt: skip

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(job, range(0, len(blocks), _AT_ONCE)))
    return volume


def _empty(maps: Sequence[DepthMap], voxel: float, most: int) -> tuple[Volume, NDArray[np.int32]]:
    """Return a volume with a block wherever a surface is near, and the blocks' places."""
    size, reach = SIDE * voxel, _TRUNCATION * voxel
    clouds = [_cloud(each.view, each.depth) for each in maps]
    sample = np.concatenate([cloud[::16] for cloud in clouds])
    if len(sample) == 0:
        raise SceneError("no depth is known", fix="photograph what has texture")
    low, high = np.percentile(sample, [_STRAY, 100.0 - _STRAY], axis=0)
    origin = np.floor((low - size) / size) * size
    shape = np.ceil((high + size - origin) / size).astype(np.int64)
    if shape.prod() > _LARGEST:
        raise SceneError(
            f"the place is {shape.tolist()} blocks of {SIDE} voxels large",
            fix=f"give a larger voxel than {voxel:.4g}",
        )
    grid = np.full(tuple(shape), -1, np.int32)
    for cloud in clouds:
        mark(cloud, origin, size, reach, grid)
    blocks = np.argwhere(grid == 0).astype(np.int32)
    if len(blocks) > most:
        raise SceneError(
            f"the surface takes {len(blocks)} blocks of voxels, {most} are allowed",
            fix=f"give a larger voxel than {voxel:.4g}, or more blocks",
        )
    grid[tuple(blocks.T)] = np.arange(len(blocks))
    n = len(blocks)
    volume = Volume(
        origin=origin,
        voxel=voxel,
        grid=grid,
        distance=np.zeros((n, VOXELS), np.float32),
        weight=np.zeros((n, VOXELS), np.float32),
        colour=np.zeros((n, VOXELS, 3), np.float32),
    )
    return volume, blocks


def _cloud(view: WorkingView, depth: F32) -> F64:
    """Return the points of a depth map, (N, 3), in the capture's frame."""
    rows, columns = np.nonzero(depth > 0)
    z = depth[rows, columns].astype(np.float64)
    x = (columns + 0.5 - view.K[0, 2]) / view.K[0, 0] * z
    y = (rows + 0.5 - view.K[1, 2]) / view.K[1, 1] * z
    T = np.linalg.inv(view.T_camera_world)
    return np.column_stack([x, y, z]) @ T[:3, :3].T + T[:3, 3]
