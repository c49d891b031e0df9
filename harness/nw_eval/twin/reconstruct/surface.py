"""From depth maps to a surface: a truncated signed distance in sparse blocks, and its zero.

The surface is cut where the distance is zero, by marching cubes (Lewiner et al. 2003).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.twin.reconstruct.depth import DepthMap
from nw_eval.twin.reconstruct.mesh import ColourMesh
from nw_eval.twin.reconstruct.packages import package
from nw_eval.twin.reconstruct.views import F32, F64, WorkingView
from nw_eval.twin.reconstruct.voxel_kernels import (
    SIDE,
    VOXELS,
    colours_at,
    cut,
    integrate,
    mark,
    slopes,
)

_TRUNCATION = 4.0
"""Voxels on each side of a surface where its distance counts."""
_LARGEST = 64_000_000
"""Blocks of the box about all points, which costs 4 bytes each."""
_STRAY = 0.05
"""Percent of points at each end of an axis that may lie far off."""
_AT_ONCE = 256
"""Blocks of one job."""

_BATCH = 8
"""Blocks along the edge of a part of the volume that is cut at once."""


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


def extract(volume: Volume, least_weight: float) -> ColourMesh:
    """Return the volume's surface, its faces counter-clockwise seen from where the cameras were.

    Only cells all of whose corners are known are cut. Parts of the volume share a layer of voxels,
    where both find the same vertices to the last bit; those become one.

    Raises:
        SceneError: there is no surface.
        PrerequisiteError: scikit-image is not installed.
    """
    span, shape = _BATCH * SIDE, np.array(volume.grid.shape)
    vertices: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    count = 0
    for batch in np.ndindex(*(-(-shape // _BATCH))):
        first = np.array(batch) * _BATCH
        corner = volume.grid[tuple(slice(a, a + _BATCH + 1) for a in first)]
        if (corner >= 0).any():
            found = _cut(volume, first * SIDE, span + 1, least_weight)
            if found is not None:
                vertices.append(found[0] + first * SIDE)
                faces.append(found[1] + count)
                count += len(found[0])
    if not faces:
        raise SceneError("the depth maps have no surface in common", fix="take more photographs")
    places, corners = _welded(np.concatenate(vertices), np.concatenate(faces), span)
    colours = np.zeros((len(places), 3))
    colours_at(places, volume.grid, volume.weight, volume.colour, colours)
    return ColourMesh(
        vertices=volume.origin + volume.voxel * places,
        faces=corners.astype(np.int32),
        colours=np.round(np.clip(colours, 0.0, 255.0)).astype(np.uint8),
    )


def _cut(
    volume: Volume, first: NDArray[np.int64], side: int, least: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    dense = np.empty((side, side, side), np.float32)
    known = np.empty(dense.shape, np.bool_)
    cut(volume.grid, first, volume.distance, volume.weight, least, dense, known)
    whole = known[1:, 1:, 1:].copy()
    for i, j, k in np.ndindex(2, 2, 2):
        whole &= known[i : side - 1 + i, j : side - 1 + j, k : side - 1 + k]
    if not whole.any():
        return None
    inner = dense[known]
    if not inner.min() < 0.0 < inner.max():
        return None
    # The mask's place i, j, k speaks for the cell that ends there.
    mask = np.zeros(dense.shape, np.bool_)
    mask[1:, 1:, 1:] = whole
    cubes = package("skimage.measure").marching_cubes
    try:
        points, corners, _, _ = cubes(dense, 0.0, mask=mask)
    except RuntimeError:  # What it raises where no cell that is known has a surface.
        return None
    return points.astype(np.float64), corners.astype(np.int64)


def _welded(
    places: NDArray[np.float64], faces: NDArray[np.int64], span: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the mesh with one vertex for each place on the sides of the parts."""
    shared = np.flatnonzero((places % span == 0.0).any(axis=1))
    _, lead, group = np.unique(places[shared], axis=0, return_index=True, return_inverse=True)
    one = np.arange(len(places))
    one[shared] = shared[lead[group.ravel()]]
    faces = one[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    used, renumbered = np.unique(faces, return_inverse=True)
    return places[used], renumbered.reshape(-1, 3)
