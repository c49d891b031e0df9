"""The robot that is trained, and the progress of many along their trails.

Progress goes by the rules of `tasks.course`.
"""

from __future__ import annotations

from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

import numpy as np
from numpy.typing import NDArray

from nw_learn.teacher.lanes import WAYPOINTS
from nw_scenes.robots import RobotSpec
from nw_scenes.robots.spec import VISUAL_GROUP
from nw_sim.tasks.course import REACH_RADIUS, REACH_STEPS, Limits

Array = NDArray[np.float64]


def training_robot(robot: RobotSpec) -> RobotSpec:
    """Return the same body without visuals and cameras, with touch sensors and sites at its feet.

    The sensors are named as the geoms whose net contact force they give, (3,) N in the world, and
    come in the order of `touch_names`; so do the sites of the feet.
    """
    root = fromstring(robot.mjcf)  # noqa: S314 - our own text.
    for body in root.iter("body"):
        for part in [*body.findall("geom"), *body.findall("camera")]:
            if part.tag == "camera" or part.get("group") == str(VISUAL_GROUP):
                body.remove(part)
        for geom in body.findall("geom"):
            if geom.get("name") in robot.feet:
                name, place = geom.get("name", ""), geom.get("pos", "0 0 0")
                SubElement(body, "site", name=name, pos=place)
    sensors = SubElement(root, "sensor")
    for name in touch_names(robot):
        SubElement(
            sensors, "contact", name=name, geom1=name, data="force", reduce="netforce", num="1"
        )
    return replace(robot, mjcf=tostring(root, encoding="unicode"))


def touch_names(robot: RobotSpec) -> tuple[str, ...]:
    """Return the geoms that feel: the feet, what ends a trial, then all others that collide."""
    geoms = [name for geom in _solid_geoms(fromstring(robot.mjcf)) if (name := geom.get("name"))]  # noqa: S314
    first = (*robot.feet, *robot.monitored)
    return (*first, *(name for name in geoms if name not in first))


def _solid_geoms(root: Element) -> list[Element]:
    return [geom for geom in root.iter("geom") if geom.get("group") != str(VISUAL_GROUP)]


class Trails:
    """Waypoints reached, and whether there is still progress: the strict protocol's, N at a time.

    Attributes:
        points: (N, K, 2) waypoints, m; the last is repeated where there are fewer than K.
        counts: (N,) waypoints of each trail.
        index: (N,) the waypoint to go to; the count when all are reached.
    """

    def __init__(self, count: int) -> None:
        self.points = np.zeros((count, WAYPOINTS, 2))
        self.initial_positions = np.zeros((count, 2))
        self.counts = np.ones(count, dtype=np.intp)
        self.index = np.zeros(count, dtype=np.intp)
        self.timer = np.zeros(count, dtype=np.intp)
        self.nearest = np.zeros(count)
        self.waited = np.zeros(count, dtype=np.intp)

    def begin(self, robots: NDArray[np.intp], positions: Array, trails: list[Array]) -> None:
        """Begin new trails for some robots, at (n, 2) m."""
        for robot, trail in zip(robots, trails, strict=True):
            self.points[robot, : len(trail)] = trail
            self.points[robot, len(trail) :] = trail[-1]
            self.counts[robot] = len(trail)
        self.initial_positions[robots] = positions
        self.index[robots] = self.timer[robots] = self.waited[robots] = 0
        self.nearest[robots] = self.remaining(positions, robots)

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
        """Return the distance of positions (N, 2) from the courses, (N,) m."""
        corners = np.concatenate([self.initial_positions[:, None], self.points], axis=1)
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
