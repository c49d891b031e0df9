"""What networks see of many robots at once, and of the ground under them.

The policy sees the 332 numbers of `policies/go1-parkour`. The critic sees more, which is thrown
away after the training. Heights of the ground are read from the grids of lanes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.machine_code import kernel
from nw_learn.teacher.config import GROUNDS
from nw_learn.teacher.lanes import CELL, ORIGIN
from nw_policies.cards.observations import ScandotsObservation
from nw_sim.sensors.heights import grid

Array = NDArray[np.float64]

SPEED = 0.8
"""Commanded, m / s."""
FRAME, SCANDOTS, JOINTS, PAST = 53, 132, 12, 3
_KEPT = np.r_[0:5, 13:53]
"""Of a frame, once it is history: no angle to the waypoint, no speed, no mask."""
OBSERVED = FRAME + SCANDOTS + JOINTS + PAST * len(_KEPT)

_SCANDOTS = ScandotsObservation(sensor="scandots")
_GRID = grid(_SCANDOTS.x, _SCANDOTS.y, _SCANDOTS.order)

PRIVILEGED = 3 + 5 + 4 + 3 + len(GROUNDS) + 1
_FOOT = 0.02  # m, radius
_MIDDLE = 5.0  # of the levels
Robots = NDArray[np.intp] | slice

_X, _Y, _PER_CELL = ORIGIN[0], ORIGIN[1], 1.0 / CELL


class Senses:
    """Builds observations, and remembers what of earlier ones is in them.

    Args:
        count: robots, N.
        pose: (12,) default joint positions, rad.

    Attributes:
        applied: (N, 12) raw actions that were applied last.
        output: (N, 12) raw actions that were taken last and still wait.
        contacts: (N, 4) feet that push now; `previous_contacts` those of the step before.
        history: (N, 3, 45) earlier frames, newest first.
    """

    def __init__(self, count: int, pose: Array) -> None:
        self._pose = pose
        self.applied = np.zeros((count, JOINTS))
        self.output = np.zeros((count, JOINTS))
        self.contacts = np.zeros((count, 4), dtype=np.bool_)
        self.previous_contacts = np.zeros((count, 4), dtype=np.bool_)
        self.history = np.zeros((count, PAST, len(_KEPT)), dtype=np.float32)
        self.is_new = np.ones(count, dtype=np.bool_)

    def begin(self, robots: NDArray[np.intp]) -> None:
        """Forget what some robots have seen and done."""
        for array in (self.applied, self.output, self.contacts, self.previous_contacts):
            array[robots] = 0
        self.is_new[robots] = True

    def take(self, actions: Array) -> None:
        """Take new actions, (N, 12) raw: the ones before are applied now."""
        self.applied = self.output
        self.output = actions

    def feel(self, contacts: NDArray[np.bool_]) -> None:
        """Take which feet push now, (N, 4)."""
        self.previous_contacts = self.contacts
        self.contacts = contacts

    def see(
        self,
        body: Bodies,
        delta_yaw: Array,
        lanes: NDArray[np.intp],
        grids: NDArray[np.float32],
        robots: Robots = slice(None),
    ) -> NDArray[np.float32]:
        """Return observations, (n, 332), and remember their frames.

        Args:
            body: of the robots, n of them.
            delta_yaw: (n,) angle to the next waypoint, rad.
            lanes: (n,) of the robots.
            grids: (L, X, Y) heights of all lanes, m.
            robots: which of all robots they are.
        """
        out = np.zeros((len(delta_yaw), OBSERVED), dtype=np.float32)
        frame = out[:, :FRAME]
        frame[:, 0:3] = body.rates * 0.25
        frame[:, 3], frame[:, 4] = body.roll, body.pitch
        frame[:, 6] = frame[:, 7] = delta_yaw
        frame[:, 10], frame[:, 11] = SPEED, 1.0
        frame[:, 13:25] = body.joints - self._pose
        frame[:, 25:37] = body.joint_rates * 0.05
        frame[:, 37:49] = self.applied[robots]
        frame[:, 49:53] = (self.contacts[robots] | self.previous_contacts[robots]) - 0.5
        dots = np.empty((len(out), SCANDOTS))
        read_scandots(grids, lanes, body.position, body.yaw, _GRID, _SCANDOTS.offset, dots)
        out[:, FRAME : FRAME + SCANDOTS] = dots
        out[:, FRAME + SCANDOTS : FRAME + SCANDOTS + JOINTS] = self.output[robots]
        kept = frame[:, _KEPT]
        history = np.where(self.is_new[robots][:, None, None], kept[:, None], self.history[robots])
        out[:, FRAME + SCANDOTS + JOINTS :] = history.reshape(len(out), -1)
        self.history[robots] = np.concatenate([kept[:, None], history[:, :-1]], axis=1)
        self.is_new[robots] = False
        return out

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return everything that changes, by name."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}


def privileged_features(
    body: Bodies,
    *,
    clearance: NDArray[np.float64],
    contacts: NDArray[np.bool_],
    grounds: NDArray[np.intp],
    levels: NDArray[np.intp],
) -> NDArray[np.float32]:
    """Return the critic's own numbers, (n, PRIVILEGED), of about one in size.

    Args:
        body: of n robots.
        clearance: (n, 5) heights of trunk and feet above the ground, m.
        contacts: (n, 4) feet that push.
        grounds: (n,) indices into `GROUNDS`.
        levels: (n,).
    """
    above = clearance.copy()
    above[:, 1:] -= _FOOT
    above *= (2.0, 4.0, 4.0, 4.0, 4.0)
    parts = (
        2.0 * body.velocity_in_trunk,
        above,
        contacts - 0.5,
        body.gravity,
        np.eye(len(GROUNDS))[grounds],
        levels[:, None] / _MIDDLE - 1.0,
    )
    return np.concatenate(parts, axis=1).astype(np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class Bodies:
    """Some robots at one instant; frames as in `nw_sim.physics.body`.

    Attributes:
        position: (n, 3) of the trunks, world, m.
        rotation: (n, 3, 3) R_world_trunk.
        roll: (n,) rad; pitch and yaw the same.
        velocity: (n, 3) world, m / s.
        rates: (n, 3) angular velocity, trunk frame, rad / s.
        joints: (n, 12) rad.
        joint_rates: (n, 12) rad / s.
    """

    position: Array
    rotation: Array
    roll: Array
    pitch: Array
    yaw: Array
    velocity: Array
    rates: Array
    joints: Array
    joint_rates: Array

    @property
    def gravity(self) -> Array:
        """Direction of gravity in the trunk frame, (n, 3)."""
        return -self.rotation[:, 2, :]

    @property
    def velocity_in_trunk(self) -> Array:
        """(n, 3) m / s."""
        return np.einsum("nji,nj->ni", self.rotation, self.velocity)

    def at(self, point: tuple[float, float, float]) -> Array:
        """Return a point of the trunk frame in the world, (n, 3) m."""
        return self.position + self.rotation @ np.array(point)


def bodies(qpos: Array, qvel: Array, robots: Robots = slice(None)) -> Bodies:
    """Return the bodies of rows of qpos (N, 19) and qvel (N, 18)."""
    q, v = qpos[robots], qvel[robots]
    w, x, y, z = q[:, 3], q[:, 4], q[:, 5], q[:, 6]
    rotation = np.empty((len(q), 3, 3))
    rotation[:, 0, 0] = 1.0 - 2.0 * (y * y + z * z)
    rotation[:, 0, 1] = 2.0 * (x * y - w * z)
    rotation[:, 0, 2] = 2.0 * (x * z + w * y)
    rotation[:, 1, 0] = 2.0 * (x * y + w * z)
    rotation[:, 1, 1] = 1.0 - 2.0 * (x * x + z * z)
    rotation[:, 1, 2] = 2.0 * (y * z - w * x)
    rotation[:, 2, 0] = 2.0 * (x * z - w * y)
    rotation[:, 2, 1] = 2.0 * (y * z + w * x)
    rotation[:, 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return Bodies(
        position=q[:, :3].copy(),
        rotation=rotation,
        roll=np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2]),
        pitch=np.arcsin(np.clip(-rotation[:, 2, 0], -1.0, 1.0)),
        yaw=np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]),
        velocity=v[:, :3].copy(),
        rates=v[:, 3:6].copy(),
        joints=q[:, 7:].copy(),
        joint_rates=v[:, 6:].copy(),
    )


@kernel
def read_cells(grids: Any, lanes: Any, points: Any, out: Any) -> None:
    """Read the cell under each point.

    Args:
        grids: (L, X, Y) of all lanes.
        lanes: (N,) the lane of each robot.
        points: (N, P, 2) x and y, m.
        out: (N, P) is written.
    """
    across, along = grids.shape[2], grids.shape[1]
    for i in range(points.shape[0]):
        lane = lanes[i]
        for k in range(points.shape[1]):
            a = min(max(int((points[i, k, 0] - _X) * _PER_CELL), 0), along - 1)
            b = min(max(int((points[i, k, 1] - _Y) * _PER_CELL), 0), across - 1)
            out[i, k] = grids[lane, a, b]


@kernel
def read_scandots(
    grids: Any, lanes: Any, positions: Any, yaws: Any, grid: Any, offset: Any, out: Any
) -> None:
    """Read the scandots of robots: clip(z + offset - ground, -1, 1).

    Args:
        grids: (L, X, Y) heights of all lanes, m.
        lanes: (N,) the lane of each robot.
        positions: (N, 3) of the trunks, m.
        yaws: (N,) rad.
        grid: (P, 2) points in the frame that turns with the yaw, m.
        offset: m.
        out: (N, P) is written.
    """
    across, along = grids.shape[2], grids.shape[1]
    for i in range(positions.shape[0]):
        c, s, lane = np.cos(yaws[i]), np.sin(yaws[i]), lanes[i]
        for k in range(grid.shape[0]):
            x = positions[i, 0] + c * grid[k, 0] - s * grid[k, 1]
            y = positions[i, 1] + s * grid[k, 0] + c * grid[k, 1]
            a = min(max(int((x - _X) * _PER_CELL), 0), along - 1)
            b = min(max(int((y - _Y) * _PER_CELL), 0), across - 1)
            value = positions[i, 2] + offset - grids[lane, a, b]
            out[i, k] = min(max(value, -1.0), 1.0)


def heights_under(
    grids: NDArray[np.float32], lanes: NDArray[np.intp], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the heights under points (N, P, 2), (N, P) m."""
    out = np.empty(points.shape[:2])
    read_cells(grids, lanes, points, out)
    return out
