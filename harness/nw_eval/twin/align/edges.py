"""Up by upright edges: those of houses, doors and windows all point to one vanishing point.

An edge in a picture spans a plane with its camera's centre, and the edge itself lies in that plane.
Edges that are upright in space therefore have plane normals that are all perpendicular to up. The
direction that most length of edges is so found along is up, if it stands out (Kosecka and Zhang,
Video Compass, 2002, for one picture; here for all of them together).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.plural import plural
from nw_eval.twin.align.planes import gram
from nw_eval.twin.capture import Capture, PlacedShot, read_picture

Values = NDArray[np.float64]

_SHOTS = 60
"""That are looked at, evenly spread, at most."""
_SIDE = 800
"""Pixels of the longer side at which edges are looked for, at most."""
_LONG = 0.04
"""Of the longer side: shorter edges know their direction badly."""
_EACH = 120
"""Edges of a picture, the longest ones."""
_NEAR = math.sin(math.radians(0.7))
"""Of the angle between an edge and the plane of its camera and up, for it to count."""
_CONE = math.cos(math.radians(30.0))
_DRAWS = 20_000
_TRIED = 600
_ROUNDS = 6
_LEAST_EDGES, _LEAST_SHOTS = 40, 4
_LEAST_SHARE = 0.08
"""Of the length of all edges. Where edges lie anyhow, the best direction has 0.02."""
_LEAN = math.radians(0.3)
"""By how much houses lean, and lenses bend, in common."""


def upright_edges(
    capture: Capture, folder: Path, like: Values, rng: np.random.Generator
) -> tuple[Values, float, str] | None:
    """Return up by the upright edges in a capture's pictures, its sigma in radians, and a reason.

    Args:
        capture: whose pictures lie in `folder`.
        folder: of the capture.
        like: (3,) unit vector, up to within 30 degrees.
        rng: of the pairs of edges that are tried.

    Returns:
        None where the pictures or OpenCV are not there, or no direction stands out.
    """
    shots = [shot for shot in capture.shots if (folder / shot.file).is_file()]
    if not shots:
        return None
    shots = [shots[i] for i in np.unique(np.linspace(0, len(shots) - 1, _SHOTS).astype(int))]
    try:
        found = [_edges(shot, folder) for shot in shots]
    except ImportError:
        return None
    normals = np.concatenate([normal for normal, _ in found])
    lengths = np.concatenate([length for _, length in found])
    owner = np.repeat(np.arange(len(found)), [len(length) for _, length in found])
    if len(normals) < _LEAST_EDGES:
        return None
    first, second = rng.integers(len(normals), size=(2, _DRAWS))
    tried = np.cross(normals[first], normals[second])
    size = np.linalg.norm(tried, axis=1)
    tried = tried[size > 0.05] / size[size > 0.05, None]
    tried = tried * np.where(np.einsum("ni,i->n", tried, like) < 0, -1.0, 1.0)[:, None]
    tried = tried[np.einsum("ni,i->n", tried, like) > _CONE][:_TRIED]
    if not len(tried):
        return None
    support = [
        float(lengths[np.abs(np.einsum("ni,i->n", normals, u)) < _NEAR].sum()) for u in tried
    ]
    up = tried[int(np.argmax(support))]
    for spread in np.geomspace(2.0, 0.7, _ROUNDS) * _NEAR:
        off = np.einsum("ni,i->n", normals, up)
        weights = lengths * np.exp(-0.5 * (off / spread) ** 2)
        values, vectors = np.linalg.eigh(gram(normals, weights))
        up = vectors[:, 0] if vectors[:, 0] @ like >= 0 else -vectors[:, 0]
    off = np.einsum("ni,i->n", normals, up)
    upright = np.abs(off) < _NEAR
    share = float(lengths[upright].sum() / lengths.sum())
    seen_by = len(np.unique(owner[upright]))
    enough = np.count_nonzero(upright) >= _LEAST_EDGES and share >= _LEAST_SHARE
    if not enough or seen_by < max(_LEAST_SHOTS, len(shots) // 2):
        return None
    # Of the direction that is known least: residuals over what the normals extend along it.
    values = np.linalg.eigvalsh(gram(normals[upright], np.ones(np.count_nonzero(upright))))
    noise = float(np.sqrt((off[upright] ** 2).mean() / max(float(values[1]), 1e-9)))
    reason = (
        f"{plural(int(upright.sum()), 'upright edge')} in {plural(seen_by, 'photograph')}, "
        f"{share:.0%} of the length of all edges"
    )
    return up, math.hypot(_LEAN, noise), reason


def _edges(shot: PlacedShot, folder: Path) -> tuple[Values, Values]:
    """Return normals (E, 3) of the planes of a picture's edges, and lengths of its side (E,)."""
    import cv2

    camera = shot.camera
    grey = cv2.cvtColor(read_picture(shot, folder), cv2.COLOR_RGB2GRAY)
    side = max(camera.width, camera.height)
    share = min(1.0, _SIDE / side)
    if share < 1.0:
        grey = cv2.resize(grey, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    lines: Any = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(grey)[0]
    if lines is None:
        return np.zeros((0, 3)), np.zeros(0)
    # OpenCV has the centre of the first pixel at (0, 0).
    ends = (lines.reshape(-1, 2, 2).astype(np.float64) + 0.5) / share
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / side
    order = np.argsort(-lengths, kind="stable")[:_EACH]
    order = order[lengths[order] > _LONG]
    local = (ends[order] - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    rays = np.concatenate([local, np.ones_like(local[..., :1])], axis=2)
    normals = np.cross(rays[:, 0], rays[:, 1])
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    return np.einsum("ij,nj->ni", camera.T_world_camera[:3, :3], normals), lengths[order]
