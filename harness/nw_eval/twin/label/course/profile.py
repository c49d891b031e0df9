"""How high the ground is along a course."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.label.course.ground import Ground
from nw_eval.twin.label.placement import Point

SPACING = 0.02
"""Between samples, m: a scan's edges are no sharper."""

_MOST = 5000  # samples of a leg

# A robot's head is lower, and what it steps over too; ceilings are higher.
_CLEARANCE = 1.0


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
