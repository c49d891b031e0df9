"""Progress of many robots along their trails, by the rules of `sim.trail` and `sim.termination`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.learn.teacher.courses.lane import WAYPOINTS
from nw_eval.sim.termination import Limits
from nw_eval.sim.trail import REACH_RADIUS, REACH_STEPS

Array = NDArray[np.float64]


class Trails:
    """Waypoints reached, and whether there is still progress: the strict protocol's, N at a time.

    Attributes:
        points: (N, K, 2) waypoints, m; the last is repeated where there are fewer than K.
        counts: (N,) waypoints of each trail.
        index: (N,) the waypoint to go to; the count when all are reached.
    """

    def __init__(self, count: int) -> None:
        self.points = np.zeros((count, WAYPOINTS, 2))
        self.starts = np.zeros((count, 2))
        self.counts = np.ones(count, dtype=np.intp)
        self.index = np.zeros(count, dtype=np.intp)
        self.timer = np.zeros(count, dtype=np.intp)
        self.nearest = np.zeros(count)
        self.waited = np.zeros(count, dtype=np.intp)

    def begin(self, robots: NDArray[np.intp], starts: Array, trails: list[Array]) -> None:
        """Begin new trails for some robots, at (n, 2) m."""
        for robot, trail in zip(robots, trails, strict=True):
            self.points[robot, : len(trail)] = trail
            self.points[robot, len(trail) :] = trail[-1]
            self.counts[robot] = len(trail)
        self.starts[robots] = starts
        self.index[robots] = self.timer[robots] = self.waited[robots] = 0
        self.nearest[robots] = self.remaining(starts, robots)

    def update(self, positions: Array) -> None:
        """Take where the robots are after a control step, (N, 2) m."""
        credited = self.timer >= REACH_STEPS
        self.index[credited] += 1
        self.timer[credited] = 0
        distance = np.linalg.norm(self.targets() - positions, axis=1)
        self.timer = np.where(distance < REACH_RADIUS, self.timer + 1, 0)
        remaining = self.remaining(positions)
        nearer = remaining < self.nearest - Limits().stuck_distance
        self.nearest = np.where(nearer, remaining, self.nearest)
        self.waited = np.where(nearer, 0, self.waited + 1)

    def targets(self, robots: NDArray[np.intp] | slice = slice(None)) -> Array:
        """Return the waypoint to go to, (n, 2) m."""
        points = self.points[robots]
        index = np.minimum(self.index[robots], self.counts[robots] - 1)
        return points[np.arange(len(points)), index]

    def remaining(self, positions: Array, robots: NDArray[np.intp] | slice = slice(None)) -> Array:
        """Return the way that is left from positions (n, 2) to the last waypoint, (n,) m."""
        onward = np.linalg.norm(np.diff(self.points[robots], axis=1), axis=2)
        ahead = np.arange(onward.shape[1]) >= self.index[robots][:, None]
        to_target = np.linalg.norm(self.targets(robots) - positions, axis=1)
        return to_target + np.where(ahead, onward, 0.0).sum(axis=1)

    def aside(self, positions: Array) -> Array:
        """Return the distance of positions (N, 2) from the trails, (N,) m."""
        corners = np.concatenate([self.starts[:, None], self.points], axis=1)
        starts, spans = corners[:, :-1], np.diff(corners, axis=1)
        squared = np.einsum("nki,nki->nk", spans, spans)
        offset = positions[:, None] - starts
        along = np.einsum("nki,nki->nk", offset, spans) / np.where(squared > 0.0, squared, 1.0)
        apart = offset - np.clip(along, 0.0, 1.0)[..., None] * spans
        return np.sqrt(np.einsum("nki,nki->nk", apart, apart).min(axis=1))

    @property
    def is_complete(self) -> NDArray[np.bool_]:
        """Whether all waypoints are reached, (N,)."""
        return self.index >= self.counts

    @property
    def fraction(self) -> Array:
        """Share of the waypoints reached, (N,)."""
        return np.minimum(self.index, self.counts) / self.counts

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return everything that changes, by name."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}
