"""The ground of a place: what a click meets, and how high it is along a course and at its start."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.twin.label.state import Point, StartPose, as_point

SPACING = 0.02
"""Between samples, m: a scan's edges are no sharper."""

_MOST = 5000  # samples of a leg

# A robot's head is lower, and what it steps over too; ceilings are higher.
_CLEARANCE = 1.0

_BEFORE = 1.0  # m from the start to the first waypoint


class Ground:
    """The mesh of a place, as rays meet it.

    Attributes:
        mesh: world, m.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh
        self._rays = RayScene(mesh)

    def hit(self, origin: Point, direction: Point) -> Point | None:
        """Return where a ray meets the mesh first; None where it does not.

        Args:
            origin: world, m.
            direction: of any length but 0.
        """
        start = np.asarray(origin, dtype=np.float64)[None]
        along = np.asarray(direction, dtype=np.float64)[None]
        length = float(np.linalg.norm(along))
        if not np.isfinite(start).all() or not 0 < length < np.inf:
            return None
        along = along / length
        distance, face = self._rays.cast(start, along)
        if face[0] < 0:
            return None
        # Embree counts in float32; the face's own plane puts the point back on it.
        a, b, c = self.mesh.vertices[self.mesh.faces[face[0]]]
        normal = np.cross(b - a, c - a)
        slope = float(normal @ along[0])
        exact = float(normal @ (a - start[0])) / slope if slope else float(distance[0])
        near = abs(exact - distance[0]) < 1e-3 * (1 + distance[0])
        return as_point(start[0] + along[0] * (exact if near else float(distance[0])))

    def heights(self, xy: NDArray[np.float64], below: float) -> NDArray[np.float64]:
        """Return the ground's height (N,) under points xy (N, 2), m, -inf where there is none.

        Args:
            xy: world, m.
            below: height to look down from, so that ceilings and upper floors do not count.
        """
        return self._rays.height(xy, z_from=below)

    def dropped(self, x: float, y: float, near: float, *, clearance: float = 0.6) -> Point | None:
        """Return the point of the ground at x, y, seen from `clearance` above the height `near`."""
        height = float(self.heights(np.array([[x, y]]), near + clearance)[0])
        return (x, y, height) if np.isfinite(height) else None


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightProfile:
    """The ground along the straight legs from the start over all waypoints.

    Attributes:
        distance: (N,) from the start, over the ground plan, m; it never falls.
        height: (N,) of the ground, world, m; -inf where there is none.
        stops: (K,) distances of the start and of each waypoint, m.
        levels: (K,) their own heights, m.
    """

    distance: NDArray[np.float64]
    height: NDArray[np.float64]
    stops: NDArray[np.float64]
    levels: NDArray[np.float64]


def height_profile(ground: Ground, stops: Sequence[Point]) -> HeightProfile:
    """Return the profile along `stops`: the start and the waypoints; none are needed."""
    points = np.array(stops, dtype=np.float64).reshape(-1, 3)
    lengths = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    reached = np.concatenate([[0.0], np.cumsum(lengths)])[: len(points)]
    distances, heights = [np.zeros(0)], [np.zeros(0)]
    for i, length in enumerate(lengths):
        count = 1 + min(max(int(np.ceil(length / SPACING)), 1), _MOST)
        share = np.linspace(0.0, 1.0, count)
        xy = points[i, :2] + share[:, None] * (points[i + 1, :2] - points[i, :2])
        top = float(points[i : i + 2, 2].max())
        distances.append(reached[i] + share * length)
        heights.append(ground.heights(xy, top + _CLEARANCE))
    return HeightProfile(
        distance=np.concatenate(distances),
        height=np.concatenate(heights),
        stops=reached,
        levels=points[:, 2],
    )


def start_before(waypoints: Sequence[Point], ground: Ground) -> StartPose:
    """Return the start 1 m before the first waypoint, on the ground; without one, the origin."""
    if not waypoints:
        return StartPose(position=(0.0, 0.0, 0.0), yaw=0.0)
    first = np.array(waypoints[0])
    ahead = np.array(waypoints[1] if len(waypoints) > 1 else first)[:2] - first[:2]
    yaw = math.atan2(ahead[1], ahead[0])
    x, y = first[:2] - _BEFORE * np.array([math.cos(yaw), math.sin(yaw)])
    level = float(first[2])
    position = ground.dropped(float(x), float(y), level)
    return StartPose(position=position or (float(x), float(y), level), yaw=yaw)
