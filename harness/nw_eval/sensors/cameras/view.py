"""Rays through the pixels of a camera of the robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import PolicyError, nearest
from nw_eval.robots import RobotSpec
from nw_eval.sensors.drawing.overlay import ray_directions
from nw_eval.sensors.sensor import Moment
from nw_eval.splat.camera import Camera, Pixels

Array = NDArray[np.float64]


def require_camera(name: str, camera: str, robot: RobotSpec) -> None:
    """Check that a robot has a camera.

    Args:
        name: of the observation, for the error.
        camera: from the card.
        robot: whose camera it should be.

    Raises:
        PolicyError: it has no such camera.
    """
    if camera not in robot.cameras:
        raise PolicyError(
            f"`{name}`: {robot.name} has no camera {camera!r}", fix=nearest(camera, robot.cameras)
        )


class PixelRays:
    """One ray for each pixel of a pinhole camera, row by row from the top left.

    Args:
        name: of the observation, for errors.
        camera: which of the robot's.
        robot: who carries it.
        width: pixels.
        height: pixels.

    Attributes:
        along_axis: (N,) how far a ray gets along the optical axis in each metre of its own.

    Raises:
        PolicyError: the robot has no such camera.
    """

    def __init__(
        self, name: str, camera: str, robot: RobotSpec, *, width: int, height: int
    ) -> None:
        require_camera(name, camera, robot)
        self._camera = camera
        pinhole = Camera.from_fovy(
            width=width, height=height, fovy=robot.cameras[camera].fovy, T_world_camera=np.eye(4)
        )
        self._directions = ray_directions(pinhole, Pixels()).reshape(-1, 3)
        self.along_axis = self._directions[:, 2].copy()

    def rays(self, moment: Moment) -> tuple[Array, Array]:
        """Return the origin (3,) m and unit directions (N, 3) in the world."""
        T_world_camera = moment.world.camera_pose(self._camera)
        return T_world_camera[:3, 3], self._directions @ T_world_camera[:3, :3].T
