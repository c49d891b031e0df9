"""Where the robot's body is, how it moves, where its cameras look, and what rays at it meet."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from nw_eval.errors import UsageError, nearest
from nw_eval.robots.spec import VISUAL_GROUP
from nw_eval.sim.binding import MjData, MjModel, mujoco

if TYPE_CHECKING:
    from nw_eval.robots import RobotSpec


Array = npt.NDArray[np.float64]

JOINTS = slice(7, None)
"""Of qpos, after the free joint's 7 numbers."""
JOINT_RATES = slice(6, None)  # of qvel


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
        return self.data.qvel[JOINT_RATES].copy()

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
        joints = data.qpos[JOINTS], data.qvel[JOINT_RATES]
        return data.xpos, data.xquat, *joints, data.qvel[:6]


_NO_CUTOFF = 1e10


class RobotRays(NamedTuple):
    """What N rays met. A miss has distance inf, geom -1 and normal 0."""

    distance: npt.NDArray[np.float64]  # (N,) m along the ray
    geom: npt.NDArray[np.int32]  # (N,) index into `World.geom_rgba`
    normal: npt.NDArray[np.float64]  # (N, 3) unit, world frame, out of the surface


def cast_at_visuals(
    model: MjModel,
    data: MjData,
    origins: npt.NDArray[np.float64],
    directions: npt.NDArray[np.float64],
    *,
    exclude_body: int = -1,
) -> RobotRays:
    """Cast rays at the visual primitives of the robot.

    Args:
        model: compiled model.
        data: its state, with current geom poses.
        origins: (3,) for a common origin, which is fast, or (N, 3).
        directions: (N, 3) unit vectors, world frame.
        exclude_body: body whose geoms are transparent, or -1.
    """
    count = len(directions)
    distance = np.full(count, -1.0)
    geom = np.full(count, -1, dtype=np.int32)
    normal = np.zeros((count, 3))
    groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
    groups[VISUAL_GROUP] = 1
    rays = np.ascontiguousarray(directions, dtype=np.float64)
    starts = np.asarray(origins, dtype=np.float64)
    # One fan for a common origin, else a fan of one for each ray.
    fans = [slice(0, count)] if starts.ndim == 1 else [slice(i, i + 1) for i in range(count)]
    for fan in fans:
        _cast_fan(
            model,
            data,
            starts if starts.ndim == 1 else starts[fan.start],
            rays[fan],
            groups,
            exclude_body,
            (geom[fan], distance[fan], normal[fan]),
        )
    missed = geom < 0
    distance[missed] = np.inf
    normal[missed] = 0.0
    return RobotRays(distance, geom, normal)


def _cast_fan(
    model: MjModel,
    data: MjData,
    origin: npt.NDArray[np.float64],
    directions: npt.NDArray[np.float64],
    groups: npt.NDArray[np.uint8],
    exclude_body: int,
    out: tuple[npt.NDArray[np.int32], npt.NDArray[np.float64], npt.NDArray[np.float64]],
) -> None:
    if not len(directions):
        return
    geom, distance, normal = out
    mujoco.mj_multiRay(
        m=model,
        d=data,
        pnt=origin,
        vec=directions.reshape(-1),
        geomgroup=groups,
        flg_static=False,
        bodyexclude=exclude_body,
        geomid=geom,
        dist=distance,
        normal=normal.reshape(-1),
        nray=len(directions),
        cutoff=_NO_CUTOFF,
    )
