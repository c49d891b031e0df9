"""Points to begin with: on a mesh with its colours, or those that calibration found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.twin.capture import Capture
from nw_eval.twin.gaussians.nearest import distances

Rows = NDArray[np.float64]

_NEAREST = 0.1
"""Share of a mesh that is nearest to photographs, and counts as equally near."""
_CLEAR = 0.05
"""Distance from a surface, as a share of that to the nearest camera, at which a point is off it."""
_FIX = "reconstruct again: `nw-eval twin reconstruct`"


def points_on(path: Path, count: int, eyes: Rows, *, seed: int) -> tuple[Rows, Rows, Rows]:
    """Return points on a mesh, about as many for each pixel of the nearest photograph.

    Args:
        path: a PLY file with colours of vertices.
        count: how many.
        eyes: (M, 3) where photographs were taken from, in the mesh's frame.
        seed: of where they lie.

    Returns:
        (count, 3) in the mesh's frame, (count, 3) colours from the mesh's corners, from 0 to 1, and
        (count, 3) unit normals of the faces that they lie on.

    Raises:
        SceneError: the mesh cannot be read, or has no faces.
    """
    import trimesh

    try:
        mesh = trimesh.load_mesh(path, process=False)
        faces = np.asarray(mesh.faces, np.int64)
        tints = np.asarray(getattr(mesh.visual, "vertex_colors"), np.float64)[:, :3] / 255.0  # noqa: B009 - of one of the two kinds.
        corners, tints = np.asarray(mesh.vertices, np.float64)[faces], tints[faces]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise SceneError(f"{path} is no mesh with colours: {error}", fix=_FIX) from None
    sides = corners[:, 1:] - corners[:, :1]
    normals = np.cross(sides[:, 0], sides[:, 1])
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    if not (np.isfinite(areas).all() and areas.sum() > 0.0):
        raise SceneError(f"{path} has no faces, or some are not finite", fix=_FIX)
    draw = np.random.default_rng(seed)
    # Sorted places along the summed area: each face gets its share, and no more by chance.
    shares = areas * _nearness(corners.mean(axis=1), eyes)
    along = (np.arange(count) + draw.random(count)) / count * shares.sum()
    chosen = np.searchsorted(np.cumsum(shares), along).clip(max=len(areas) - 1)
    root, other = np.sqrt(draw.random(count)), draw.random(count)
    weights = np.stack([1.0 - root, root * (1.0 - other), root * other], axis=1)[..., None]
    points, colours = (weights * corners[chosen]).sum(1), (weights * tints[chosen]).sum(1)
    return points, colours, normals[chosen] / (2.0 * areas[chosen, None])


def _nearness(places: Rows, eyes: Rows) -> Rows:
    """Return (N,) about how large a surface at (N, 3) is in the nearest photograph."""
    away = distances(places, eyes)
    # What a camera all but touches gets no more than the rest of what is near.
    return 1.0 / np.maximum(away, np.quantile(away, _NEAREST)) ** 2


def points_of(capture: Capture, *, off: Rows | None = None) -> tuple[Rows, Rows]:
    """Return the points that calibration found, (N, 3), and their colours from 0 to 1.

    Args:
        capture: with the points.
        off: (M, 3) points of a surface: only those count that clearly lie off it, as what is too
            far away for a mesh does.
    """
    points, colours = capture.points, capture.colours / 255.0
    if off is None or not len(points):
        return points, colours
    clear = distances(points, off) > _CLEAR * distances(points, capture.centres)
    return points[clear], colours[clear]
