"""Where robots are and how they stand: what follows from positions and velocities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Robots = NDArray[np.intp] | slice


@dataclass(frozen=True, kw_only=True, eq=False)
class Bodies:
    """Some robots at one instant; frames as in `sim.readings.body`.

    Attributes:
        position: (n, 3) of the trunks, world, m.
        rotation: (n, 3, 3) R_world_trunk.
        roll: (n,) rad; pitch and yaw likewise.
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
