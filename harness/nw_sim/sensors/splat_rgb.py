"""Camera images of the scene's splat, as the policy sees them.

Rendered floats become the array that a checkpoint takes: bytes, averages, axes, stacks.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.memory import Arrays
from nw_policies.cards.observations import SplatRgbObservation
from nw_scenes.robots import RobotSpec
from nw_scenes.scene import Nearness
from nw_sim.sensors.drawing import overlay
from nw_sim.sensors.drawing.overlay import CourseCones, Overlay, insert, ray_directions
from nw_sim.sensors.drawing.props import PropPictures, joined
from nw_sim.sensors.ray_sensors import require_camera
from nw_sim.sensors.sensor import CLEAR, Measurement, SceneView, Shot, StepContext
from nw_sim.sensors.shutter import Band, Shutter, row_poses
from nw_sim.sensors.splat_view import SplatView
from nw_splat.camera import Camera, Pixels
from nw_splat.image import Image, exposed, paste

Bytes = NDArray[np.uint8]

# The published image: 80 x 45 from the middles of the 16 x 16 cells of a 1280 x 720 view.
_PUBLISHED_SIZE = (1280, 720)
_PUBLISHED_PIXELS = Pixels(stride=16, block=2, offset=7)


class SplatRgb(Measurement):
    """Images of the splat from a camera of the robot, with cones and robot where the card asks.

    A measurement is one image (H, W, 3) of bytes; axes, type and stack of the card are a
    wrapper behind it, `Arrange`.
    """

    unit = "rgb"
    is_image = True

    def __init__(self, name: str, observation: SplatRgbObservation, robot: RobotSpec) -> None:
        """Prepare the camera.

        Args:
            name: of the observation, for errors.
            observation: from the card.
            robot: whose camera it is.

        Raises:
            PolicyError: the robot has no such camera.
        """
        require_camera(name, observation.camera, robot)
        self._observation = observation
        self._published = observation.sampling == "published"
        size = _PUBLISHED_SIZE if self._published else (observation.width, observation.height)
        lens = robot.cameras[observation.camera].lens(*size)
        self._pixels = _PUBLISHED_PIXELS if self._published else Pixels()
        camera = Camera.of(lens, np.eye(4))
        self._view = SplatView(observation.camera, lens, self._pixels)
        self._directions = ray_directions(camera, self._pixels)
        self._pitch = (1.0 / camera.fx, 1.0 / camera.fy)
        mount = robot.cameras[observation.camera]
        self._shutter = Shutter(observation.camera, mount, camera, self._pixels)
        self._cones = CourseCones()
        self.shape: tuple[int, ...] = (observation.height, observation.width, 3)
        self.dtype = np.dtype(np.uint8)
        self.form = (Arrange(observation),)

    def attach(self, place: SceneView) -> None:
        """Open the renderer of the scene's splat.

        Raises:
            SceneError: the scene has none.
        """
        self._view.attach(place)
        self._rays = place.rays
        self._air = place.air
        self._captures = place.world.scene.captures
        self._props = PropPictures(place.world.scene)

    def reset(self) -> None:
        """Forget how much the last image was covered, and from where it was taken."""
        self.coverage = None
        self.nearness = None

    def measure(self, moment: StepContext) -> NDArray[Any]:
        """Render an image."""
        draws = self._shutter.draws(moment.world)
        images = self._view.seen(moment, draws)
        self.coverage = sum(float(image.alpha.mean()) for image in images) / len(images)
        if self._captures is not None:
            pose = moment.world.camera_pose(self._observation.camera)
            self.nearness = self._captures.nearest(pose)
        image = exposed(
            [
                self._air.seen(seen) if self._air is not CLEAR else seen
                for seen in map(partial(self._furnished, moment), images, draws)
            ]
        )
        return average_blocks(image.bytes()) if self._published else image.bytes()

    def _furnished(self, moment: StepContext, image: Image, bands: Sequence[Band]) -> Image:
        """Return a picture of the splat with cones, robot and props, as the card asks for them."""
        parts = [self._overlays(moment, band) for band in bands]
        if any(parts):
            drawn = [
                joined(part) if part else overlay.nothing(self._directions[slice(*band.rows)])
                for part, band in zip(parts, bands, strict=True)
            ]
            image = insert(
                image,
                overlay.stacked(drawn),
                directions=self._directions,
                T_world_camera=row_poses(bands),
                static=self._rays(),
            )
        if not (self._published and self._observation.cones):
            return image
        masks = [
            overlay.cone_mask(
                self._directions[slice(*band.rows)],
                band.T_world_camera,
                cones=self._cones.on(moment.cones),
                static=self._rays(),
                robot=band.robot,
            )
            for band in bands
        ]
        colours, seen = (np.concatenate(column) for column in zip(*masks, strict=True))
        return paste(image, colours, seen)

    def _overlays(self, moment: StepContext, band: Band) -> list[Overlay]:
        """Return what is drawn into rows of the picture: cones and robot, then props."""
        card, overlays = self._observation, list[Overlay]()
        directions, T_world_camera = self._directions[slice(*band.rows)], band.T_world_camera
        if not self._published and (card.cones or card.robot):
            overlays.append(
                overlay.draw(
                    directions,
                    T_world_camera,
                    cones=self._cones.on(moment.cones) if card.cones else None,
                    robot=band.robot if card.robot else None,
                    static=self._rays(),
                    pitch=self._pitch,
                )
            )
        if self._props.props:
            overlays += self._props.overlays(
                moment.world.prop_poses(),
                self._view.camera,
                directions=directions,
                T_world_camera=T_world_camera,
                static=self._rays(),
                pixels=self._pixels,
                rows=self._view.part(band),
                pitch=self._pitch,
            )
        return overlays

    def state(self) -> Arrays:
        """Return the last coverage and nearness."""
        state: Arrays = {} if self.coverage is None else {"coverage": np.array(self.coverage)}
        if self.nearness is not None:
            state["nearness"] = np.array(self.nearness)
        return state

    def restore(self, state: Arrays) -> None:
        """Go back to a coverage and a nearness."""
        self.coverage = float(state["coverage"]) if state else None
        near = state.get("nearness")
        self.nearness = None if near is None else Nearness(*near.tolist())


def image_shape(observation: SplatRgbObservation) -> tuple[int, ...]:
    """Return the shape of an observation, stack included."""
    size = (observation.height, observation.width)
    channels = 3 * (observation.stack if observation.stack_axis == "channel" else 1)
    frame = (*size, channels) if observation.axes == "hwc" else (channels, *size)
    if observation.stack > 1 and observation.stack_axis == "new":
        return (observation.stack, *frame)
    return frame


class Arrange:
    """Lays images out as the card says, with those before them."""

    def __init__(self, observation: SplatRgbObservation) -> None:
        self._observation = observation
        self._frames: deque[Bytes] = deque(maxlen=observation.stack)
        # What the next observations share with this one.
        self._laid_out: deque[NDArray[Any]] = deque(maxlen=observation.stack)

    def __call__(self, sample: Bytes, shot: Shot) -> NDArray[Any]:  # noqa: ARG002 - as every wrapper.
        """Add an image (H, W, 3) and return the observation."""
        # The first image stands for those before it.
        self._add([sample] * (1 if self._frames else self._observation.stack))
        return _stacked(self._laid_out, self._observation)

    def reset(self, rng: np.random.Generator) -> None:  # noqa: ARG002 - nothing here is random.
        """Forget earlier images."""
        self._frames.clear()
        self._laid_out.clear()

    def state(self) -> Arrays:
        """Return the images."""
        return {"frames": np.stack(self._frames)} if self._frames else {}

    def restore(self, state: Arrays) -> None:
        """Go back to images."""
        self._frames.clear()
        self._laid_out.clear()
        if state:
            self._add(state["frames"])

    def _add(self, frames: Iterable[Bytes]) -> None:
        for frame in frames:
            self._frames.append(frame)
            self._laid_out.append(_laid_out(frame, self._observation))


def average_blocks(image: Bytes) -> Bytes:
    """Return the mean of each 2 x 2 block, halves up: (2H, 2W, 3) to (H, W, 3) bytes.

    floor((a + b + c + d + 2) / 4) is what OpenCV's bilinear resize by a factor of 16 gives for the
    four pixels at the centre of each cell.
    """
    wide = image.astype(np.uint16)
    total = wide[0::2, 0::2] + wide[0::2, 1::2] + wide[1::2, 0::2] + wide[1::2, 1::2]
    return ((total + 2) // 4).astype(np.uint8)


def arrange(frames: list[Bytes], observation: SplatRgbObservation) -> NDArray[Any]:
    """Return frames (H, W, 3), oldest first, as the card lays them out."""
    return _stacked([_laid_out(frame, observation) for frame in frames], observation)


def _laid_out(frame: Bytes, observation: SplatRgbObservation) -> NDArray[Any]:
    image: NDArray[Any] = frame
    if observation.dtype == "float32":
        image = (frame.astype(np.float32) - np.float32(observation.mean)) / np.float32(
            observation.std
        )
    return image.transpose(2, 0, 1) if observation.axes == "chw" else image


def _stacked(images: Sequence[NDArray[Any]], observation: SplatRgbObservation) -> NDArray[Any]:
    if observation.stack_axis == "channel":
        return np.concatenate(images, axis=-1 if observation.axes == "hwc" else 0)
    return np.stack(images) if observation.stack > 1 else np.ascontiguousarray(images[0])
