"""The surface where the distance is zero, by marching cubes (Lewiner et al. 2003)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.twin.reconstruct.kernels.voxels import SIDE, colours_at, cut
from nw_eval.twin.reconstruct.mesh_file import ColourMesh
from nw_eval.twin.reconstruct.packages import package
from nw_eval.twin.reconstruct.surface.volume import Volume

_BATCH = 8
"""Blocks along the edge of a part of the volume that is cut at once."""


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
