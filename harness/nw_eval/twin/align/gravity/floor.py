"""Which level plane is the floor, and how high it lies: below all cameras, with little below it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.align.gravity.planes import FittedPlane, fit_plane

Values = NDArray[np.float64]

_ABOVE = 0.95
"""Share of the cameras that are above a floor."""
_BELOW = 0.15
"""Largest share of the points below it: reflections, and what matching got wrong."""
_LOWEST = 0.05
"""Where no plane is a floor, this share of the points below the cameras lies under it."""


@dataclass(frozen=True, kw_only=True)
class FloorLevel:
    """The floor of a capture, in its unit.

    Attributes:
        height: along up.
        plane: of its points; None where none was found, and the height is that of low points.
        share: of the points that lie on it.
    """

    height: float
    plane: FittedPlane | None
    share: float


def doubt(plane: FittedPlane, points: Values, centres: Values, up: Values, far: float) -> float:
    """Return how little a plane looks like a floor: 0 for one with all above it, 2 for a ramp.

    The share of the cameras and of the points below it; what has points of a floor below itself is
    none.

    Args:
        plane: in question.
        points: (N, 3).
        centres: (V, 3) of the cameras.
        up: (3,) roughly.
        far: how far below it a point has to be.
    """
    sense = 1.0 if plane.normal @ up >= 0 else -1.0
    under = float((sense * plane.distances(points) < -far).mean())
    cameras = float((sense * plane.distances(centres) < 0).mean())
    return 15.0 * under + 5.0 * cameras


def find_floor(
    points: Values,
    centres: Values,
    up: Values,
    level: Sequence[FittedPlane],
    tolerance: float,
) -> FloorLevel:
    """Return the floor among level planes; a ceiling is above the cameras, a table has a floor.

    Args:
        points: (N, 3), one at least.
        centres: (V, 3) of the cameras.
        up: (3,) unit vector.
        level: planes, normals upwards.
        tolerance: how far off a point of the floor may be.
    """
    heights = np.einsum("ni,i->n", points, up)
    cameras = np.einsum("ni,i->n", centres, up)
    floors: list[tuple[float, float, FittedPlane]] = []
    for plane in level:
        on_it = np.abs(plane.distances(points)) <= tolerance
        if not on_it.any():
            continue
        height = settled(heights[on_it])
        below = float((heights < height - 3.0 * tolerance).mean())
        if (cameras > height).mean() >= _ABOVE and below <= _BELOW:
            floors.append((plane.share, height, plane))
    if floors:
        share, height, plane = max(floors, key=lambda one: one[0])
        return FloorLevel(height=height, plane=plane, share=share)
    under = heights[heights < cameras.min()]
    lowest = float(np.quantile(under if len(under) else heights, _LOWEST))
    share = float((np.abs(heights - lowest) <= tolerance).mean())
    return FloorLevel(height=lowest, plane=None, share=share)


def floor_of_mesh(
    vertices: Values, faces: NDArray[np.integer], floor: FittedPlane, tolerance: float
) -> FittedPlane | None:
    """Return the floor by the faces of a mesh that lie along it, each by its area.

    Args:
        vertices: (V, 3) in the capture's frame.
        faces: (F, 3).
        floor: by the points.
        tolerance: how far off a face of it may be.

    Returns:
        None where less than a hundredth of the mesh lies there.
    """
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    along = np.abs(np.einsum("ni,i->n", normals, floor.normal)) > np.cos(np.radians(15.0)) * area
    middles = corners.mean(axis=1)
    near = along & (area > 0) & (np.abs(floor.distances(middles)) <= 2.0 * tolerance)
    if area[near].sum() < 0.01 * area.sum() or np.count_nonzero(near) < 3:
        return None
    plane = fit_plane(
        np.repeat(middles[near], 3, axis=0) / 2 + corners[near].reshape(-1, 3) / 2,
        floor.normal,
        floor.offset,
        tolerance,
        np.repeat(area[near], 3),
    )
    share = float(area[near].sum() / area.sum())
    if plane.normal @ floor.normal < 0:
        return replace(plane, normal=-plane.normal, offset=-plane.offset, share=share)
    return replace(plane, share=share)


def settled(heights: Values) -> float:
    """Return the height at which most of some heights lie: a mean that leaves out what is off."""
    height = float(np.median(heights))
    spread = max(1.4826 * float(np.median(np.abs(heights - height))), 1e-12)
    for _ in range(5):
        weights = np.clip(1.0 - ((heights - height) / (4.0 * spread)) ** 2, 0.0, None) ** 2
        height = float((weights * heights).sum() / max(float(weights.sum()), 1e-300))
    return height
