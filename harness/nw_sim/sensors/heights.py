"""Heights of the ground on a grid that goes along with the robot: as a map, as scandots.

The tops of the scene's props are ground, too, wherever they are now.

The published evaluation reads scandots from a height image seen 25 m above.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_policies.cards.observations import (
    Axis,
    GridOrder,
    HeightmapObservation,
    ScandotsObservation,
)
from nw_scenes.rays import RayScene
from nw_sim.sensors.drawing.props import height_of_prop
from nw_sim.sensors.sensor import Measurement, StepContext

Array = NDArray[np.float64]
Rays = Callable[[], RayScene]
"""Gives the scene's static geometry, made when it is first asked for."""

_ALTITUDE = 25.0  # m above the centre of mass, about
_PIXELS = 480  # along each side of the image
PIXELS_PER_METRE = _PIXELS / (2.0 * _ALTITUDE * math.tan(math.radians(3.0)))  # at 25 m

# How far the camera of a Go1 stands from 25 m above the trunk in the default stance. It is part of
# a card's `offset`, and here part of the camera's own height.
_STANCE = 0.0143


def grid(x: Axis, y: Axis, order: GridOrder = "y_fastest") -> Array:
    """Return the points of a grid, (N, 2) m: x forward, y left, both ascending."""
    rows = np.meshgrid(
        np.linspace(*x), np.linspace(*y), indexing="ij" if order == "y_fastest" else "xy"
    )
    return np.stack(rows, axis=-1).reshape(-1, 2)


def ground_under(rays: Rays, moment: StepContext, xy: Array) -> Array:
    """Return the height of the scene and of its props at points, (N,) m, -inf where nothing is.

    Args:
        rays: of the scene's static geometry.
        moment: where props are.
        xy: (N, 2) world, m.
    """
    heights = rays().height(xy)
    world = moment.world
    if world.scene.props:
        for prop, pose in zip(world.scene.props, world.prop_poses(), strict=True):
            np.maximum(heights, height_of_prop(prop, pose, xy), out=heights)
    return heights


class HeightGrid:
    """Points around the trunk that turn with its yaw, and the ground under them.

    One ray goes straight down through each exact point.
    """

    def __init__(self, x: Axis, y: Axis, rays: Rays, order: GridOrder = "y_fastest") -> None:
        self._points = grid(x, y, order)
        # The points turned by a quarter: any other turn is a sum of the two.
        self._quarter = np.stack([-self._points[:, 1], self._points[:, 0]], axis=1)
        self._rays = rays

    def __len__(self) -> int:
        return len(self._points)

    def ground(self, moment: StepContext) -> Array:
        """Return the heights, (N,) m in the world, -inf where there is no ground."""
        yaw = moment.roll_pitch_yaw[2]
        turned = math.cos(yaw) * self._points
        turned += math.sin(yaw) * self._quarter
        turned += moment.position[:2]
        return ground_under(self._rays, moment, turned)


def limited(values: Array, low: float, high: float) -> NDArray[np.float32]:
    """Return values within limits as float32; `np.clip` takes several times as long."""
    np.maximum(values, low, out=values)
    np.minimum(values, high, out=values)
    return values.astype(np.float32)


class Heightmap(Measurement):
    """Ground heights above a reference, (x, y) float32 m, in a frame that turns with the yaw."""

    unit = "m"

    def __init__(self, observation: HeightmapObservation, rays: Rays) -> None:
        self._grid = HeightGrid(observation.x, observation.y, rays)
        self._observation = observation
        self._low, self._high = observation.clip
        self._rays = rays
        self.shape: tuple[int, ...] = (observation.x[2], observation.y[2])
        self.dtype = np.dtype(np.float32)

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Cast the rays."""
        heights = self._grid.ground(moment) - self._reference(moment)
        return limited(heights, self._low, self._high).reshape(self.shape)

    def _reference(self, moment: StepContext) -> float:
        match self._observation.relative_to:
            case "trunk":
                return float(moment.position[2])
            case "world":
                return 0.0
            case "ground":
                at = moment.position[np.newaxis, :2]
                below = float(ground_under(self._rays, moment, at)[0])
                # Over a hole in the scan, the plane that everything stands on serves.
                return below if np.isfinite(below) else moment.world.scene.ground.z
            case _:
                assert_never(self._observation.relative_to)


class Scandots(Measurement):
    """clip(trunk_z + offset - ground_z) under the points of the grid, (N,) m.

    A view of the same grid as `Heightmap`, counted downwards. The published evaluation reads a
    rendered height image instead (`published_scandots`). Points with no ground under them read as
    far below.
    """

    unit = "m"

    def __init__(self, observation: ScandotsObservation, rays: Rays) -> None:
        self._grid = HeightGrid(observation.x, observation.y, rays, observation.order)
        self._offset = observation.offset
        self._low, self._high = observation.clip
        self.shape: tuple[int, ...] = (len(self._grid),)
        self.sum_of = f"{observation.x[2]} x {observation.y[2]}"
        self.dtype = np.dtype(np.float32)

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Cast the rays."""
        top = float(moment.position[2]) + self._offset
        return limited(top - self._grid.ground(moment), self._low, self._high)


class PublishedScandots(Measurement):
    """The heights of `Scandots`, with the published camera, its pixels and its clipping.

    The camera follows the centre of mass. A point falls on the pixel that truncation toward zero
    gives it, and is read at that pixel's centre; points beyond the image (they are, when the robot
    walks diagonally) are read at its border. Ground lower than 25 m below the camera is seen a
    little farther out. Source: the published task, described in its section on scandots.
    """

    unit = "m"

    def __init__(
        self,
        observation: ScandotsObservation,
        rays: Rays,
        camera_offset: tuple[float, float, float],
    ) -> None:
        """Prepare the grid.

        Args:
            observation: from the card.
            rays: of the scene's static geometry.
            camera_offset: the camera minus the centre of mass, m.
        """
        self._points = grid(observation.x, observation.y, observation.order)
        self._offset = observation.offset - _STANCE
        self._low, self._high = observation.clip
        self._rays = rays
        self._camera_offset = np.array(camera_offset)
        self.shape: tuple[int, ...] = (len(self._points),)
        self.dtype = np.dtype(np.float32)

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Read the image at the points."""
        camera = moment.world.center_of_mass + self._camera_offset
        at_altitude = (self._pixels(moment) - 0.5) / PIXELS_PER_METRE
        depth = np.full(len(at_altitude), _ALTITUDE)
        # A pixel's ray is nearly vertical: where it meets the ground settles at once.
        for _ in range(2):
            points = camera[:2] + at_altitude * (depth / _ALTITUDE)[:, np.newaxis]
            ground = ground_under(self._rays, moment, points)
            depth = camera[2] - ground
            depth[~np.isfinite(depth)] = 2.0 * _ALTITUDE  # The image's far plane.
        values = depth - _ALTITUDE + self._offset
        return np.clip(values, self._low, self._high).astype(np.float32)

    def _pixels(self, moment: StepContext) -> NDArray[np.float64]:
        """Return the pixel of each point, counted from the middle of the image, (N, 2)."""
        # The published heading: the trunk's quaternion without its x and y parts.
        w, _, _, z = moment.world.trunk_quat.tolist()
        norm = math.hypot(w, z)
        c, s = (w * w - z * z) / norm**2, 2.0 * w * z / norm**2
        forward, left = self._points[:, 0], self._points[:, 1]
        turned = np.stack([c * forward - s * left, s * forward + c * left], axis=1)
        half = _PIXELS // 2
        return np.clip(np.trunc(turned * PIXELS_PER_METRE), 1 - half, half)
