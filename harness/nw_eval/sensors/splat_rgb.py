"""Camera images of the scene's splat, as the policy sees them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import PolicyError, nearest
from nw_eval.policies.observations import SplatRgbObservation
from nw_eval.robots import CameraMount, RobotSpec
from nw_eval.scenes import Scene
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.cones import Cones
from nw_eval.sensors.overlay import cone_mask, draw, ray_directions
from nw_eval.sensors.sensor import Moment
from nw_eval.sensors.splat_image import Bytes, arrange, average_blocks, image_shape
from nw_eval.splat.camera import Camera
from nw_eval.splat.composite import composite, paste
from nw_eval.splat.pixels import Pixels
from nw_eval.splat.render import Renderer

# The published image: 80 x 45 from the middles of the 16 x 16 cells of a 1280 x 720 view.
_PUBLISHED_SIZE = (1280, 720)
_PUBLISHED_PIXELS = Pixels(stride=16, block=2, offset=7)


class SplatRgb:
    """Images of the splat from a camera of the robot, with cones and robot where the card asks."""

    unit = "rgb"
    is_image = True

    def __init__(
        self,
        name: str,
        observation: SplatRgbObservation,
        robot: RobotSpec,
        scene: Scene,
        renderer: Renderer,
        rays: Callable[[], RayScene],
    ) -> None:
        """Prepare the camera.

        Args:
            name: of the observation, for errors.
            observation: from the card.
            robot: whose camera it is.
            scene: gives the transform from splat to world.
            renderer: of the scene's splat; sensors of one trial may share it.
            rays: gives the scene's static geometry; called only for published images with cones.

        Raises:
            PolicyError: the robot has no such camera.
        """
        if observation.camera not in robot.cameras:
            raise PolicyError(
                f"`{name}`: {robot.name} has no camera {observation.camera!r}",
                fix=nearest(observation.camera, robot.cameras),
            )
        self._observation = observation
        self._mount: CameraMount = robot.cameras[observation.camera]
        self._renderer = renderer
        self._rays = rays
        self._T_splat_world = np.linalg.inv(scene.T_world_splat)
        self._published = observation.sampling == "published"
        self._pixels = _PUBLISHED_PIXELS if self._published else Pixels()
        self._directions = ray_directions(self._camera(np.eye(4)), self._pixels)
        self._frames: deque[Bytes] = deque(maxlen=observation.stack)
        self._cones: Cones | None = None
        self._trail: NDArray[np.float64] | None = None
        self.coverage: float | None = None
        self.shape: tuple[int, ...] = image_shape(observation)
        self.dtype = np.dtype(observation.dtype)

    def reset(self) -> None:
        """Forget earlier images."""
        self._frames.clear()
        self._cones = None
        self._trail = None
        self.coverage = None

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Render an image and return it with those before it."""
        frame = self.picture(moment)
        if not self._frames:
            self._frames.extend([frame] * self._observation.stack)
        else:
            self._frames.append(frame)
        return arrange(list(self._frames), self._observation)

    def picture(self, moment: Moment) -> Bytes:
        """Return the present image, (H, W, 3) bytes."""
        T_world_camera = moment.world.camera_pose(self._observation.camera)
        # The splat's scale stays in the matrix: the renderer then measures depth in metres.
        image = self._renderer.render(
            self._camera(self._T_splat_world @ T_world_camera), self._pixels
        )
        self.coverage = float(image.alpha.mean())
        if self._published and self._observation.cones:
            seen = cone_mask(
                self._directions,
                T_world_camera,
                cones=self._cones_of(moment),
                static=self._rays(),
                robot=moment.world,
            )
            image = paste(image, *seen)
        elif self._observation.cones or self._observation.robot:
            overlay = draw(
                self._directions,
                T_world_camera,
                cones=self._cones_of(moment) if self._observation.cones else None,
                robot=moment.world if self._observation.robot else None,
            )
            image = composite(image, overlay.rgb, overlay.depth, overlay.coverage)
        return average_blocks(image.bytes()) if self._published else image.bytes()

    def memory(self) -> dict[str, NDArray[Any]]:
        """Return earlier images and the last coverage."""
        if not self._frames:
            return {}
        coverage = np.nan if self.coverage is None else self.coverage
        return {"frames": np.stack(self._frames), "coverage": np.array(coverage)}

    def remember(self, memory: dict[str, NDArray[Any]]) -> None:
        """Go back to earlier images."""
        self.reset()
        if memory:
            self._frames.extend(memory["frames"])
            self.coverage = float(memory["coverage"])

    def _camera(self, T: NDArray[np.float64]) -> Camera:
        width, height = self._observation.width, self._observation.height
        if self._published:
            width, height = _PUBLISHED_SIZE
        return Camera.from_fovy(width=width, height=height, fovy=self._mount.fovy, T_world_camera=T)

    def _cones_of(self, moment: Moment) -> Cones:
        # A trial moves its waypoints once, at the start; a test may move them at any time.
        trail = moment.progress.waypoints
        if self._cones is None or self._trail is not trail:
            self._cones, self._trail = Cones(trail), trail
        return self._cones
