"""Many robots at once: their physics, and their progress along the trails.

Each robot is in a lane of its own, and all are stepped on a pool of threads. Progress goes by the
rules of `tasks.course`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from nw_eval.learn.teacher.lanes import WAYPOINTS
from nw_eval.robots import RobotSpec
from nw_eval.robots.spec import VISUAL_GROUP
from nw_eval.sim.binding import MjModel, mujoco
from nw_eval.tasks.course import REACH_RADIUS, REACH_STEPS, Limits

Array = NDArray[np.float64]

_VELOCITIES = int(mujoco.mjtStage.mjSTAGE_VEL)
_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)
CONTROL_PERIOD = 0.02
"""s."""


class Simulation:
    """Robots in `mujoco.batch`: each keeps the model of its lane and its own solver's memory.

    Positions and velocities are current after a step; forces are those of the last physics step's
    solve, as no solver runs twice.

    Args:
        robot: a `training_robot`.
        models: of the lanes, of equal sizes.
        count: robots, N.
        threads: of the pool.

    Attributes:
        qpos: (N, 19), qvel: (N, 18); live: what is written is the state of the next step.
        torques: (N, 12) of the servos, N m.
        feet: (N, 4, 3) middles of the feet, world, m.
        lanes: (N,) the lane of each robot.
    """

    def __init__(
        self, robot: RobotSpec, models: Sequence[MjModel], count: int, *, threads: int
    ) -> None:
        self._models = list(models)
        self._batch: Any = Batch(self._models[0], count, nthread=threads, persistent=True)
        self._batch.reset(stage=_NOTHING)
        self.lanes = np.zeros(count, dtype=np.intp)
        self._substeps = 1
        self._pose = np.array(robot.default_pose)
        self.qpos: Array = self._batch.bind("qpos")
        self.qvel: Array = self._batch.bind("qvel")
        self._ctrl: Array = self._batch.bind("ctrl")
        self._sensors: Array = self._batch.bind("sensordata")
        self.torques: Array = self._batch.bind("actuator_force")
        self.feet: Array = self._batch.bind("site_xpos")

    def set_timestep(self, timestep: float) -> None:
        """Take physics steps of a length in seconds that divides the control period."""
        self._substeps = round(CONTROL_PERIOD / timestep)
        for model in self._models:
            model.opt.timestep = timestep
        self._assign()

    def replace(self, lane: int, model: MjModel) -> None:
        """Exchange the model of a lane, in which no robot is."""
        model.opt.timestep = self._models[lane].opt.timestep
        self._models[lane] = model

    def put(self, robots: NDArray[np.intp], lanes: NDArray[np.intp], poses: Array) -> None:
        """Put robots at rest into lanes; poses are (n, 19) as qpos."""
        self.lanes[robots] = lanes
        self._batch.reset(robots, stage=_NOTHING)
        self._assign()
        self.qpos[robots] = poses
        self._ctrl[robots] = self._pose
        self._batch.forward(robots, stage=_VELOCITIES)

    def step(self, targets: Array) -> None:
        """Run one control step with joint targets, (N, 12) rad."""
        self._ctrl[:] = targets
        self._batch.step(nstep=self._substeps, stage=_VELOCITIES)

    def touches(self) -> Array:
        """Return the net contact force on each geom of `touch_names`, (N, G) N."""
        forces = self._sensors.reshape(len(self._sensors), -1, 3)
        return np.sqrt(np.einsum("ngk,ngk->ng", forces, forces))

    def broken(self) -> NDArray[np.bool_]:
        """Return whose physics has left all bounds, (N,)."""
        rows = np.concatenate([self.qpos, self.qvel], axis=1)
        return np.asarray(~np.isfinite(rows).all(axis=1))

    def state(self) -> dict[str, NDArray[Any]]:
        """Return all that the future depends on, besides the lanes' models."""
        return {"rows": self._batch.state.copy(), "lanes": self.lanes.copy()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Go back to a state, with the models and the time step that it was taken with."""
        self.lanes[:] = state["lanes"]
        self._assign()
        self._batch.state[:] = state["rows"]
        self._batch.forward(stage=_VELOCITIES)

    def _assign(self) -> None:
        self._batch.set_models([self._models[lane] for lane in self.lanes])


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
    first = (*robot.feet, *robot.monitored_geoms)
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
