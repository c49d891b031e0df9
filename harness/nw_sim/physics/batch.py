"""Many at once: robots that are trained, and what physics of a scene alone is asked."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from mujoco.batch import Batch

from nw_scenes.scene import Box
from nw_sim.physics.binding import mujoco
from nw_sim.physics.model import Model, add_geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_scenes.robots import RobotSpec
    from nw_scenes.scene import Scene

Array = npt.NDArray[np.float64]

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
        self, robot: RobotSpec, models: Sequence[Model], count: int, *, threads: int
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

    def replace(self, lane: int, model: Model) -> None:
        """Exchange the model of a lane, in which no robot is."""
        model.opt.timestep = self._models[lane].opt.timestep
        self._models[lane] = model

    def put(self, robots: npt.NDArray[np.intp], lanes: npt.NDArray[np.intp], poses: Array) -> None:
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

    def broken(self) -> npt.NDArray[np.bool_]:
        """Return whose physics has left all bounds, (N,)."""
        rows = np.concatenate([self.qpos, self.qvel], axis=1)
        return np.asarray(~np.isfinite(rows).all(axis=1))

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """Return all that the future depends on, besides the lanes' models."""
        return {"rows": self._batch.state.copy(), "lanes": self.lanes.copy()}

    def restore(self, state: dict[str, npt.NDArray[Any]]) -> None:
        """Go back to a state, with the models and the time step that it was taken with."""
        self.lanes[:] = state["lanes"]
        self._assign()
        self._batch.state[:] = state["rows"]
        self._batch.forward(stage=_VELOCITIES)

    def _assign(self) -> None:
        self._batch.set_models([self._models[lane] for lane in self.lanes])


def drop_balls(
    scene: Scene,
    starts: Array,
    *,
    radius: float,
    mass: float,
    speed: float,
    timestep: float,
    steps: int,
) -> Array:
    """Return where balls come to rest that are thrown down in a scene, (N, 3) m.

    They fall through each other and do not turn.

    Args:
        scene: its ground and solids collide.
        starts: (N, 3) middles of the balls, world, m.
        radius: m.
        mass: kg.
        speed: downwards, m/s.
        timestep: of the physics, s.
        steps: physics steps until they lie still.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = timestep
    add_geometry(spec, scene, friction=None)
    for x, y, z in starts.tolist():
        body = spec.worldbody.add_body(pos=[x, y, z])
        for axis in np.eye(3).tolist():
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0.0, 0.0],
            mass=mass,
            contype=2,
            conaffinity=1,
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel.reshape(-1, 3)[:, 2] = -speed
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return starts + data.qpos.reshape(-1, 3)


def solid_heights(scene: Scene, xy: Array, z_from: Array) -> Array:
    """Return where rays straight down first meet what collides in a scene, (N,) m; nan = nothing.

    Args:
        scene: its ground and solids collide.
        xy: (N, 2) world, m.
        z_from: (N,) heights where the rays begin, m.
    """
    down = np.tile([0.0, 0.0, -1.0], (len(xy), 1))
    distance = solid_distances(scene, np.column_stack([xy, z_from]), down)
    return np.where(np.isfinite(distance), z_from - distance, np.nan)


def solid_distances(scene: Scene, origins: Array, directions: Array) -> Array:
    """Return how far rays go until they meet what collides in a scene, (N,) m; inf = nothing.

    Args:
        scene: its ground and solids collide. What hangs overhead is looked through, as by rays
            that meet the mesh.
        origins: (N, 3) where the rays begin, world, m.
        directions: (N, 3) unit vectors, world.
    """
    spec = mujoco.MjSpec()
    below = tuple(x for x in scene.solids if not (isinstance(x, Box) and x.kind == "overhead"))
    add_geometry(spec, replace(scene, solids=below), friction=None)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    met = np.zeros(1, dtype=np.int32)
    distances = [
        mujoco.mj_ray(model, data, origin, direction, None, 1, -1, met, None)
        for origin, direction in zip(origins, directions, strict=True)
    ]
    distance = np.array(distances)
    return np.where(distance >= 0, distance, np.inf)
