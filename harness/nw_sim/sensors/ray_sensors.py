"""Sensors that cast rays at the scene, the cones and the robot: depth, semantics, lidar."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PolicyError, nearest
from nw_base.lens import Intrinsics
from nw_policies.cards.observations import (
    DepthObservation,
    LidarObservation,
    SemanticsObservation,
    Stereo,
)
from nw_scenes.mesh import FACE_KINDS
from nw_scenes.robots import RobotSpec
from nw_sim.sensors.drawing.overlay import CourseCones, RobotView, ray_directions
from nw_sim.sensors.drawing.pictures import CONE, FACE_CLASSES, NOTHING, PALETTE, ROBOT
from nw_sim.sensors.drawing.props import cast_at_prop
from nw_sim.sensors.heights import Rays
from nw_sim.sensors.sensor import Measurement, Plain, Sample, SceneView, Shot, StepContext
from nw_sim.sensors.shutter import Shutter
from nw_sim.sensors.splat_view import SplatScan, SplatView
from nw_splat.camera import Camera, Pixels, Rows

Array = NDArray[np.float64]

# Nearer than this, m, nothing is told apart: it keeps inverse depth finite.
_NEAREST = 1e-3

_SAME = (
    1e-3  # m, and of the distance: what is met so near before a point is the point's own surface
)
_FRACTIONS = 32  # of a pixel of disparity

_HALF_RECTANGLE = 0.6  # rad to each side, unless the card says otherwise


class Surroundings:
    """Geometry around a sensor that the robot carries.

    Embree answers for the static scene and for the cones, MuJoCo for the robot; the nearest
    answer counts.

    Args:
        rays: the scene's static geometry.
        cones: whether a cone stands on each waypoint.
        robot: whether the robot's body is there, but for the trunk, which carries the sensor.
    """

    def __init__(self, rays: Rays, *, cones: bool, robot: bool) -> None:
        self._rays = rays
        self._cones = CourseCones() if cones else None
        self._robot = robot

    def distance(
        self,
        moment: StepContext,
        origin: Array,
        directions: Array,
        robot: RobotView | None = None,
        place: Array | None = None,
    ) -> Array:
        """Return distances along rays, (N,) m, inf for a miss.

        Args:
            moment: where robot, cones and props stand.
            origin: (3,) of all rays, world, m.
            directions: (N, 3) unit vectors, world.
            robot: met in place of the moment's.
            place: (N,) m, how far the scene is, instead of its geometry.
        """
        if place is None:
            starts = np.broadcast_to(origin, directions.shape)
            distance = self._rays().distance(starts, directions)
        else:
            distance = place
        if self._cones is not None:
            cones = self._cones.on(moment.cones)
            distance = np.minimum(distance, cones.distance(origin, directions))
        if self._robot:
            body = moment.world if robot is None else robot
            hit = body.ray_robot(origin, directions, exclude="trunk")
            distance = np.minimum(distance, hit.distance)
        for _, other in _at_props(moment, origin, directions):
            distance = np.minimum(distance, other)
        return distance

    def classes(
        self, moment: StepContext, origin: Array, directions: Array, robot: RobotView | None = None
    ) -> tuple[Array, NDArray[np.uint8]]:
        """Return distances as `distance` does, and what was met: indices into `CLASSES`, (N,)."""
        rays = self._rays()
        starts = np.broadcast_to(origin, directions.shape)
        distance, face = rays.cast(starts, directions)
        kinds = rays.mesh.kinds
        met = np.full(len(directions), NOTHING, dtype=np.uint8)
        seen = np.flatnonzero(face >= 0)
        met[seen] = FACE_CLASSES[kinds[face[seen]]]
        others: list[tuple[int, Array]] = []
        if self._cones is not None:
            cones = self._cones.on(moment.cones)
            others.append((CONE, cones.distance(origin, directions)))
        if self._robot:
            body = moment.world if robot is None else robot
            hit = body.ray_robot(origin, directions, exclude="trunk")
            others.append((ROBOT, hit.distance))
        others += _at_props(moment, origin, directions)
        for number, other in others:
            nearer = other < distance
            met[nearer] = number
            distance = np.where(nearer, other, distance)
        return distance, met


def _at_props(moment: StepContext, origin: Array, directions: Array) -> Iterator[tuple[int, Array]]:
    """Yield the class of each prop of the scene, and how far it is along rays, (N,) m."""
    world = moment.world
    if world.scene.props:
        for prop, pose in zip(world.scene.props, world.prop_poses(), strict=True):
            kind = int(FACE_CLASSES[FACE_KINDS.index(prop.kind)])
            yield kind, cast_at_prop(prop, pose, origin, directions)[0]


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


@dataclass(frozen=True, kw_only=True)
class RayBand:
    """The rays of some rows of a picture, which start where the camera is meanwhile.

    Attributes:
        rows: of the picture, first and end.
        T_world_camera: (4, 4).
        directions: (N, 3) unit vectors, world, row by row.
        along_axis: (N,) how far a ray gets along the optical axis in each metre of its own.
        robot: the robot, as rays from there meet it.
    """

    rows: Rows
    T_world_camera: Array
    directions: Array
    along_axis: Array
    robot: RobotView

    @property
    def origin(self) -> Array:
        """Where they start, (3,) m, world."""
        return self.T_world_camera[:3, 3]


class PixelRays:
    """One ray for each pixel of a camera, row by row from the top left.

    A camera that takes time is asked in the middle of each row's exposure: geometry has no blur.

    Args:
        name: of the observation, for errors.
        camera: which of the robot's.
        robot: who carries it.
        width: pixels.
        height: pixels.

    Attributes:
        lens: of the image.

    Raises:
        PolicyError: the robot has no such camera.
    """

    def __init__(
        self, name: str, camera: str, robot: RobotSpec, *, width: int, height: int
    ) -> None:
        require_camera(name, camera, robot)
        mount = robot.cameras[camera]
        self.lens = mount.lens(width, height)
        seen = Camera.of(self.lens, np.eye(4))
        self._shutter = Shutter(camera, mount, seen, Pixels())
        self._directions = ray_directions(seen, Pixels())

    def bands(self, moment: StepContext) -> Iterator[RayBand]:
        """Yield the rays of all rows, from the top down."""
        for band in self._shutter.bands(moment.world):
            T_world_camera = band.T_world_camera
            directions = self._directions[slice(*band.rows)].reshape(-1, 3)
            yield RayBand(
                rows=band.rows,
                T_world_camera=T_world_camera,
                directions=directions @ T_world_camera[:3, :3].T,
                along_axis=directions[:, 2],
                robot=band.robot,
            )


class Depth(Measurement):
    """Metres along the optical axis, (H, W) float32, inf where a ray meets nothing.

    `DepthForm` makes of them what the card asks for, so that noise is that of the measured metres.
    """

    unit = "m"
    is_image = True
    nothing = math.inf

    def __init__(
        self, name: str, observation: DepthObservation, robot: RobotSpec, rays: Rays
    ) -> None:
        """Prepare the rays.

        Raises:
            PolicyError: the robot has no such camera.
        """
        fine = observation.supersample
        self.shape: tuple[int, ...] = (observation.height * fine, observation.width * fine)
        self.dtype = np.dtype(np.float32)
        height, width = self.shape
        self._view = PixelRays(name, observation.camera, robot, width=width, height=height)
        self.form = (DepthForm(observation),)
        self._baseline = 0.0
        if observation.stereo is not None:
            lens = self._view.lens
            if lens.distortion is not None:
                raise PolicyError(
                    f"`{name}`: stereo depth is of rectified images, and the camera "
                    f"{observation.camera!r} has distortion",
                    fix="give the intrinsics of the rectified image, without `distortion`",
                )
            self._baseline = observation.stereo.baseline
            self.form = (StereoDepth(observation.stereo, lens), *self.form)
        self._around = Surroundings(rays, cones=observation.cones, robot=observation.robot)
        self._splat: SplatView | None = None
        if observation.source == "splat":
            self._splat = SplatView(observation.camera, self._view.lens, Pixels())

    def attach(self, place: SceneView) -> None:
        """Open the renderer of the scene's splat, where the card asks for it.

        Raises:
            SceneError: the scene has none.
        """
        if self._splat is not None:
            self._splat.attach(place)

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Cast the rays."""
        image = np.empty(self.shape, dtype=np.float32)
        for band in self._view.bands(moment):
            place = None
            if self._splat is not None:
                seen = self._splat.depth(band.T_world_camera, band.rows)
                place = seen.reshape(-1) / band.along_axis
            distance = self._around.distance(
                moment, band.origin, band.directions, band.robot, place
            )
            depth = distance * band.along_axis
            if self._baseline:
                depth[self._in_shadow(moment, band, distance)] = np.nan
            image[slice(*band.rows)] = depth.reshape(-1, self.shape[1])
        return image

    def _in_shadow(self, moment: StepContext, band: RayBand, distance: Array) -> NDArray[np.intp]:
        """Return the rays whose points something hides from the right imager."""
        right = band.origin + band.T_world_camera[:3, 0] * self._baseline
        met = np.flatnonzero(np.isfinite(distance))
        back = band.origin + distance[met, np.newaxis] * band.directions[met] - right
        length = np.linalg.norm(back, axis=1)
        towards = back / np.maximum(length, 1e-9)[:, np.newaxis]
        seen = self._around.distance(moment, right, towards, band.robot)
        return met[seen < length - _SAME * (1.0 + length)]


class StereoDepth(Plain):
    """Depth from noisy disparities of limited range; see `cards.observations.Stereo`.

    Args:
        settings: from the card.
        lens: of the depth image.
    """

    def __init__(self, settings: Stereo, lens: Intrinsics) -> None:
        self._settings = settings
        self._to_matched = settings.matched_width / lens.width
        self._focal_baseline = lens.fx * self._to_matched * settings.baseline
        self._columns = (np.arange(lens.width) + 0.5) * self._to_matched

    def __call__(self, sample: Sample, shot: Shot) -> Sample:
        """Return metres, `invalid` where there is none; NaN is what the right imager misses."""
        settings = self._settings
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = self._focal_baseline / sample.astype(np.float64)
            noise = settings.subpixel * shot.rng.standard_normal(sample.shape)
            disparity = np.rint((exact + noise) * _FRACTIONS) / _FRACTIONS
            depth = np.rint(self._focal_baseline / disparity / settings.units) * settings.units
            valid = (
                np.isfinite(sample)
                & (disparity > 0.0)
                & (disparity <= settings.disparities)
                & (exact <= self._columns)
                & (depth <= settings.max_range)
            )
        return np.where(valid, depth, settings.invalid).astype(np.float32)


class DepthForm(Plain):
    """Metres, a share of a clipping distance, or stretched inverse depth."""

    def __init__(self, observation: DepthObservation) -> None:
        self._observation = observation

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (height, width) float32."""
        seen = self._observation
        depth = np.clip(np.nan_to_num(sample, nan=seen.far, posinf=seen.far), 0.0, seen.far)
        match seen.mode:
            case "metres":
                pass
            case "linear":
                depth = np.minimum(depth, np.float32(seen.clip)) / np.float32(seen.clip)
            case "midas":
                depth = stretched_inverse(depth)
            case _:
                assert_never(seen.mode)
        fine = seen.supersample
        if fine > 1:
            # In float64: the mean of pixels must not depend on the order in which they are added.
            blocks = depth.astype(np.float64).reshape(seen.height, fine, seen.width, fine)
            depth = blocks.mean(axis=(1, 3))
        return depth.astype(np.float32)


def stretched_inverse(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return 1 / depth stretched to 0..1 over the image; zeros for an image without relief."""
    inverse = 1.0 / np.maximum(depth, np.float32(_NEAREST))
    low, high = inverse.min(), inverse.max()
    if high <= low:
        return np.zeros_like(depth)
    return ((inverse - low) / (high - low)).astype(np.float32)


class Semantics(Measurement):
    """Class ids (H, W) uint8, or colours (H, W, 3); see `drawing.pictures`."""

    is_image = True

    def __init__(
        self, name: str, observation: SemanticsObservation, robot: RobotSpec, rays: Rays
    ) -> None:
        """Prepare the rays.

        Raises:
            PolicyError: the robot has no such camera.
        """
        size = (observation.height, observation.width)
        self._in_colour = observation.values == "colors"
        self.unit = "rgb" if self._in_colour else "class"
        self.shape: tuple[int, ...] = (*size, 3) if self._in_colour else size
        self.dtype = np.dtype(np.uint8)
        self._view = PixelRays(name, observation.camera, robot, width=size[1], height=size[0])
        self._around = Surroundings(rays, cones=observation.cones, robot=observation.robot)

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Cast the rays."""
        image = np.empty(self.shape, dtype=np.uint8)
        for band in self._view.bands(moment):
            _, met = self._around.classes(moment, band.origin, band.directions, band.robot)
            part = image[slice(*band.rows)]
            part[...] = (PALETTE[met] if self._in_colour else met).reshape(part.shape)
        return image


class Lidar(Measurement):
    """Distances along the rays, (channels, columns) float32 m, inf where there is no return.

    Points are made of them by `LidarForm`, so that noise acts along the rays.
    """

    unit = "m"
    nothing = math.inf

    def __init__(self, observation: LidarObservation, rays: Rays) -> None:
        self.shape: tuple[int, ...] = (observation.channels, observation.columns)
        self.dtype = np.dtype(np.float32)
        self.form = (LidarForm(observation),)
        mount = observation.mount
        self._position = np.array(mount.position)
        self._directions = pattern(observation).reshape(-1, 3) @ rotation(*mount.rpy).T
        self._around = Surroundings(rays, cones=observation.cones, robot=observation.robot)
        self._splat: SplatScan | None = None
        if observation.source == "splat":
            rays_of_card = pattern(observation)
            apart = np.linalg.norm(np.diff(rays_of_card, axis=1), axis=-1)
            step = float(apart.max()) if apart.size else 1.0
            self._R_trunk_sensor = rotation(*mount.rpy)
            self._splat = SplatScan("a scan", rays_of_card.reshape(-1, 3), step)

    def attach(self, place: SceneView) -> None:
        """Open the renderer of the scene's splat, where the card asks for it.

        Raises:
            SceneError: the scene has none.
        """
        if self._splat is not None:
            self._splat.attach(place)

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Cast the rays."""
        origin = moment.position + moment.rotation @ self._position
        place = None
        if self._splat is not None:
            place = self._splat.distance(origin, moment.rotation @ self._R_trunk_sensor)
        directions = self._directions @ moment.rotation.T
        distance = self._around.distance(moment, origin, directions, place=place)
        return distance.astype(np.float32).reshape(self.shape)


class LidarForm(Plain):
    """Returns within range as points or ranges, and something for all others."""

    def __init__(self, observation: LidarObservation) -> None:
        self._range = (observation.min_range, observation.max_range)
        self._miss = np.nan if observation.miss == "nan" else observation.max_range
        self._in_points = observation.values == "points"
        self._pattern = pattern(observation).astype(np.float32)

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Return (channels, columns, 3) or (channels, columns) float32."""
        nearest, farthest = self._range
        in_range = (sample >= nearest) & (sample <= farthest)
        ranges = np.where(in_range, sample, np.float32(self._miss))
        return self._pattern * ranges[..., np.newaxis] if self._in_points else ranges


def pattern(observation: LidarObservation) -> Array:
    """Return the unit directions of all rays in the sensor's frame, (channels, columns, 3)."""
    spins = observation.pattern == "spinning"
    low, high = observation.elevation
    if observation.azimuth is not None:
        right, left = observation.azimuth
        whole = left - right >= 2.0 * math.pi
    else:
        right, left = (-math.pi, math.pi) if spins else (-_HALF_RECTANGLE, _HALF_RECTANGLE)
        whole = spins
    rows, columns = observation.channels, observation.columns
    if spins:
        elevation = _spaced(low, high, rows)[:, np.newaxis]
        # A whole turn ends where it begins, so its last column is left out.
        azimuth = np.linspace(right, left, columns, endpoint=not whole)
        x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
        return np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], axis=-1)
    left_right = _spaced(math.tan(right), math.tan(left), columns)
    up = _spaced(math.tan(low), math.tan(high), rows)[:, np.newaxis]
    ahead = np.ones((rows, columns))
    directions = np.stack([ahead, ahead * left_right, ahead * up], axis=-1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def rotation(roll: float, pitch: float, yaw: float) -> Array:
    """Return R_trunk_sensor (3, 3) = Rz(yaw) Ry(pitch) Rx(roll); angles in rad."""
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _spaced(first: float, last: float, count: int) -> Array:
    """Return equally spaced numbers; a single one stands in the middle."""
    return np.linspace(first, last, count) if count > 1 else np.array([0.5 * (first + last)])
