"""The physics of many robots, each in a lane of its own, stepped on a pool of threads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from nw_eval.robots import RobotSpec
from nw_eval.sim.binding import MjModel, mujoco

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
