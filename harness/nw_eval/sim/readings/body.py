"""Where the robot's body is, how it moves, and where its cameras look."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nw_eval.errors import UsageError, nearest
from nw_eval.sim.binding import MjData, MjModel

if TYPE_CHECKING:
    from nw_eval.robots import RobotSpec

Array = npt.NDArray[np.float64]

JOINTS = slice(7, None)
"""Of qpos, after the free joint's 7 numbers."""
_JOINT_RATES = slice(6, None)  # of qvel


class Body:
    """Reads poses, velocities and joints out of a simulation, as they are at this instant.

    Frames: world z up; the trunk frame x forward, y left, z up; quaternions w x y z; joints in the
    order of `robot.joints`. Every property returns a fresh array.

    Args:
        robot: which robot.
        model: compiled model.
        data: its state.

    Attributes:
        robot: as given.
        model: compiled model. Read it; changing it makes trials incomparable.
        data: state of the simulation, for sensors that need more than the properties here.
        bodies: numbers of `robot.bodies` in the model.
    """

    def __init__(self, robot: RobotSpec, model: MjModel, data: MjData) -> None:
        self.robot = robot
        self.model: MjModel = model
        self.data: MjData = data
        self._trunk = int(model.body("trunk").id)
        self.bodies = tuple(int(model.body(name).id) for name in robot.bodies)

    @property
    def trunk_position(self) -> Array:
        """Origin of the trunk in the world, (3,) m."""
        return self.data.xpos[self._trunk].copy()

    @property
    def trunk_quat(self) -> Array:
        """Orientation of the trunk in the world, (4,) w x y z, normalised."""
        return self.data.xquat[self._trunk].copy()

    @property
    def trunk_rotation(self) -> Array:
        """R_world_trunk, (3, 3)."""
        return self.data.xmat[self._trunk].reshape(3, 3).copy()

    @property
    def trunk_linear_velocity(self) -> Array:
        """Velocity of the trunk's origin, world frame, (3,) m / s."""
        return self.data.qvel[:3].copy()

    @property
    def trunk_angular_velocity(self) -> Array:
        """Angular velocity of the trunk, trunk frame, (3,) rad / s."""
        return self.data.qvel[3:6].copy()

    @property
    def roll_pitch_yaw(self) -> Array:
        """Euler angles of the trunk, (3,) rad; yaw in (-pi, pi]."""
        w, x, y, z = self.data.xquat[self._trunk]
        return np.array(
            [
                np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
                np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            ]
        )

    @property
    def uprightness(self) -> float:
        """Cosine of the angle between the trunk's z axis and the world's."""
        return float(self.data.xmat[self._trunk, 8])

    @property
    def center_of_mass(self) -> Array:
        """Centre of mass of the whole robot in the world, (3,) m."""
        return self.data.subtree_com[self._trunk].copy()

    @property
    def joint_positions(self) -> Array:
        """(12,) rad."""
        return self.data.qpos[JOINTS].copy()

    @property
    def joint_velocities(self) -> Array:
        """(12,) rad / s."""
        return self.data.qvel[_JOINT_RATES].copy()

    @property
    def geom_rgba(self) -> npt.NDArray[np.float32]:
        """Colour of every geom, (G, 4), for the geom numbers of `World.ray_robot`."""
        return self.model.geom_rgba.copy()

    def camera_pose(self, name: str) -> Array:
        """Return T_world_camera, (4, 4), of a camera of the robot; OpenCV axes.

        Raises:
            UsageError: the robot has no such camera.
        """
        mount = self.robot.cameras.get(name)
        if mount is None:
            raise UsageError(
                f"{self.robot.name} has no camera {name!r}", fix=nearest(name, self.robot.cameras)
            )
        T_world_trunk = np.eye(4)
        T_world_trunk[:3, :3] = self.trunk_rotation
        T_world_trunk[:3, 3] = self.trunk_position
        return T_world_trunk @ mount.T_trunk_camera

    def moving(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return what moves, in the simulation's own memory, which changes with it: look, or copy.

        Returns:
            Positions (N, 3) and quaternions (N, 4) in the world of all bodies of the model, joint
            positions, joint velocities (12,) each, and of the trunk linear velocity (world frame),
            then angular velocity (trunk frame), (6,).
        """
        data = self.data
        joints = data.qpos[JOINTS], data.qvel[_JOINT_RATES]
        return data.xpos, data.xquat, *joints, data.qvel[:6]
