"""Cameras that take time: rows one after the other, and light for as long as a row is open.

A picture is complete at its time stamp. The row at the lower border is read then, one at the upper
border `readout` before, and each has been exposed for `exposure` until it is read: the timing of
rolling shutters (Liang, Chang and Chen, "Analysis and compensation of rolling shutter effect",
2008). Where the camera was at those times follows from its pose and its velocity at the time stamp,
both held constant in the world; no physics is run for it.

Rows are drawn in bands, each from where the camera is for its middle row. There are as many bands
as keep the view on the optical axis, 0.5 m away, within `_STEP` pixels from one band to the next,
up to `MOST_BANDS`: a row is half of that off, at most. There are as many draws of an exposure by
the same rule, up to `MOST_DRAWS`. Beside the axis, where x / z is s, a turn moves a picture by
1 + s^2 times as many pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_scenes.robots.spec import CameraMount
from nw_sim.physics import World
from nw_sim.physics.looks import RobotRays
from nw_sim.sensors.drawing.overlay import RobotView
from nw_splat.camera import Camera, Pixels, Rows

Array = NDArray[np.float64]

MOST_BANDS = 64
MOST_DRAWS = 8

_STEP = 0.5  # pixels
_NEAR = 0.5  # m


@dataclass(frozen=True, kw_only=True)
class Band:
    """Rows of a picture that are drawn from one pose.

    Attributes:
        rows: of the picture, first and end.
        T_world_camera: (4, 4), where the camera is meanwhile.
        robot: its body, which stands to the camera as it does at the time stamp: most of what a
            camera sees of its robot moves with it.
    """

    rows: Rows
    T_world_camera: Array
    robot: RobotView


class Shutter:
    """When the rows of one picture of a robot's camera are exposed, and from where.

    Args:
        name: of the camera.
        mount: of it.
        camera: with its lens and the whole image; its pose does not count.
        pixels: of the image that make the picture.
    """

    def __init__(self, name: str, mount: CameraMount, camera: Camera, pixels: Pixels) -> None:
        self._name = name
        self._readout, self._exposure = mount.readout, mount.exposure
        self._focal = max(camera.fx, camera.fy)
        rows = pixels.indices(camera.height) + 0.5
        self._until_read = -mount.readout * (1.0 - rows / camera.height)  # (H,) s

    def draws(self, world: World) -> list[list[Band]]:
        """Return what is exposed one after the other, each as bands from the top down."""
        count = 1
        if self._exposure:
            count = self._steps(world, self._exposure, MOST_DRAWS)
        return [self.bands(world, (index + 0.5) / count) for index in range(count)]

    def bands(self, world: World, share: float = 0.5) -> list[Band]:
        """Return a picture without blur, as bands from the top down.

        Args:
            world: where the robot is.
            share: how much of its exposure is left for each row, 0 to 1.
        """
        height = len(self._until_read)
        pose = world.camera_pose(self._name)
        if not self._readout and not self._exposure:
            return [Band(rows=(0, height), T_world_camera=pose, robot=world)]
        velocity = world.camera_velocity(self._name)
        if not any(part.any() for part in velocity):
            return [Band(rows=(0, height), T_world_camera=pose, robot=world)]
        count = min(self._steps(world, self._readout, MOST_BANDS), height)
        edges = [height * index // count for index in range(count + 1)]
        bands: list[Band] = []
        for first, end in pairwise(edges):
            time = float(self._until_read[first:end].mean()) - share * self._exposure
            camera = moved(pose, velocity, time)
            bands.append(
                Band(
                    rows=(first, end),
                    T_world_camera=camera,
                    robot=_Carrier(world, pose @ same_bits.inverse(camera)),
                )
            )
        return bands

    def _steps(self, world: World, seconds: float, most: int) -> int:
        """Return a power of two: few counts of bands, so that what is kept for each is found."""
        linear, angular = world.camera_velocity(self._name)
        speed = same_bits.length(angular) + same_bits.length(linear) / _NEAR
        pixels = min(speed * seconds * self._focal / _STEP, float(most))
        return min(1 << max(0, int(np.ceil(pixels)) - 1).bit_length(), most)


def moved(pose: Array, velocity: tuple[Array, Array], time: float) -> Array:
    """Return where something is at another time, at constant velocity.

    Args:
        pose: (4, 4) now, T_world_thing.
        velocity: (3,) m / s of its origin and (3,) rad / s, world frame.
        time: s from now.
    """
    linear, angular = velocity
    rate = same_bits.length(angular)
    angle = rate * time
    x, y, z = angular / rate if rate > 0.0 else angular
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Rodrigues' formula.
    R = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    pose_then = np.eye(4)
    pose_then[:3, :3] = R @ pose[:3, :3]
    pose_then[:3, 3] = pose[:3, 3] + linear * time
    return pose_then


class _Carrier:
    """The robot as rays meet it that start where the camera was at another time."""

    def __init__(self, world: World, T_now_then: Array) -> None:
        self._world = world
        self._R, self._shift = T_now_then[:3, :3], T_now_then[:3, 3]

    @property
    def geom_rgba(self) -> NDArray[np.float32]:
        return self._world.geom_rgba

    def ray_robot(
        self,
        origins: Array,
        directions: Array,
        *,
        exclude: Literal["nothing", "trunk"] = "nothing",
    ) -> RobotRays:
        moved_origins = origins @ self._R.T + self._shift
        return self._world.ray_robot(moved_origins, directions @ self._R.T, exclude=exclude)


def row_poses(bands: Sequence[Band]) -> Array:
    """Return T_world_camera (4, 4) of all rows of a picture, or (H, 4, 4) of each."""
    if len(bands) == 1:
        return bands[0].T_world_camera
    counts = [band.rows[1] - band.rows[0] for band in bands]
    return np.repeat([band.T_world_camera for band in bands], counts, axis=0)


def shutter_words(readout: float, exposure: float) -> str:
    """Return what is said of a camera's times, s; empty where it takes none."""
    parts = [
        f"{verb} {1e3 * seconds:g} ms"
        for verb, seconds in (("rows read in", readout), ("exposed for", exposure))
        if seconds
    ]
    return ", ".join(parts)
