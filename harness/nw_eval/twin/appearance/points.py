"""Points to begin with: on a mesh with its colours, or those that calibration found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.twin.capture import Capture

Rows = NDArray[np.float64]

_FIX = "reconstruct again: `nw-eval twin reconstruct`"


def points_on(path: Path, count: int, *, seed: int) -> tuple[Rows, Rows]:
    """Return points on a mesh, as many on each square metre, and their colours from its corners.

    Args:
        path: a PLY file with colours of vertices.
        count: how many.
        seed: of where they lie.

    Returns:
        (count, 3) in the mesh's frame, and (count, 3) from 0 to 1.

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
    areas = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    if not (np.isfinite(areas).all() and areas.sum() > 0.0):
        raise SceneError(f"{path} has no faces, or some are not finite", fix=_FIX)
    draw = np.random.default_rng(seed)
    # Sorted places along the summed area: each face gets its share, and no more by chance.
    along = (np.arange(count) + draw.random(count)) / count * areas.sum()
    chosen = np.searchsorted(np.cumsum(areas), along).clip(max=len(areas) - 1)
    root, other = np.sqrt(draw.random(count)), draw.random(count)
    weights = np.stack([1.0 - root, root * (1.0 - other), root * other], axis=1)[..., None]
    return (weights * corners[chosen]).sum(1), (weights * tints[chosen]).sum(1)


def points_of(capture: Capture) -> tuple[Rows, Rows]:
    """Return the points that calibration found, (N, 3), and their colours from 0 to 1."""
    return capture.points, capture.colours / 255.0
