"""Points along a trail, evenly spaced, with the way ahead at each."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.scene import Scene

Values = NDArray[np.float64]

_REACH = 0.6  # m above the higher end of a leg, from where one looks down on it


@dataclass(frozen=True, kw_only=True, eq=False)
class TrailSamples:
    """Points on the line from the start through the waypoints.

    Attributes:
        along: (S,) m from the start, negative behind it.
        points: (S, 3) m, world, on that line.
        ahead: (S, 2) unit vectors along it, seen from above.
        above: (S,) z from where the ground there is looked for, m: over every obstacle of the
            trail, and under ceilings.
    """

    along: Values
    points: Values
    ahead: Values
    above: Values

    @property
    def left(self) -> Values:
        """(S, 2) unit vectors to the left of the way."""
        return np.column_stack([-self.ahead[:, 1], self.ahead[:, 0]])


def trail_samples(
    scene: Scene, spacing: float, *, behind: float = 0.0, most: int = 100_000
) -> TrailSamples:
    """Return points on a scene's trail, its start and its last waypoint included.

    Args:
        scene: whose trail.
        spacing: between neighbours, m; a longer trail than `most` of them gets fewer a metre.
        behind: how far before the start the line begins, m.
        most: points at most, about.
    """
    yaw = scene.spawn.yaw
    path = np.vstack([[scene.spawn.position], scene.trail])
    legs = [(a, b) for a, b in pairwise(path) if np.linalg.norm((b - a)[:2]) > 1e-6]
    if not legs:
        start = path[0]
        legs = [(start, start + 1e-3 * np.array([np.cos(yaw), np.sin(yaw), 0.0]))]
    length = sum(float(np.linalg.norm((b - a)[:2])) for a, b in legs)
    spacing = max(spacing, length / most)
    rows: list[Values] = []
    gone = 0.0
    for index, (a, b) in enumerate(legs):
        across = float(np.linalg.norm((b - a)[:2]))
        first = -behind if index == 0 else 0.0
        stations = np.arange(first, across, spacing)
        if index == len(legs) - 1:
            stations = np.append(stations, across)
        points = a + np.maximum(stations, 0.0)[:, None] / across * (b - a)
        ahead = (b - a)[:2] / across
        points[:, :2] += np.minimum(stations, 0.0)[:, None] * ahead
        above = np.full(len(stations), max(a[2], b[2]) + _REACH)
        ways = np.broadcast_to(ahead, (len(stations), 2))
        rows.append(np.column_stack([gone + stations, points, ways, above]))
        gone += across
    table = np.concatenate(rows)
    return TrailSamples(
        along=table[:, 0], points=table[:, 1:4], ahead=table[:, 4:6], above=table[:, 6]
    )
