"""Which camera frames a trial's log shows, and where they come from.

A policy that sees images: the log shows exactly those, as the policy saw them. A policy that does
not: the log has a camera of its own, so that people can look; it never touches the result, and in
a run that keeps images of failures only it renders after the trial, if the trial failed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.policies.observations import SplatRgbObservation

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from nw_eval.policies import Card
    from nw_eval.rollout.clock import StageClock
    from nw_eval.rollout.mcap.trial_log import TrialLog
    from nw_eval.scenes import Scene
    from nw_eval.sensors.sensor import Sensor
    from nw_eval.sim import World
    from nw_eval.splat.render import Renderer

Bytes = NDArray[np.uint8]

LOG_CAMERA = "ego"
LOG_SIZE = (160, 90)  # pixels
LOG_PERIOD = 5  # control steps between two frames: 10 Hz


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """A camera observation of the policy, and the log's name for it."""

    observation: str
    spec: SplatRgbObservation
    camera: str


class Cameras:
    """The cameras of one trial's log.

    Args:
        card: whose camera observations are shown.
        world: carries the cameras.
        scene: what they see.
        sensors: the policy's, by name.
        renderer: makes the renderer of the scene's splat; called only if a frame is rendered.
        log: where the frames go.
        clock: rendering for the log counts as `render`.
    """

    def __init__(
        self,
        *,
        card: Card,
        world: World,
        scene: Scene,
        sensors: Mapping[str, Sensor],
        renderer: Callable[[], Renderer],
        log: TrialLog,
        clock: StageClock,
    ) -> None:
        self._world = world
        self._scene = scene
        self._sensors = sensors
        self._renderer = renderer
        self._log = log
        self._clock = clock
        self._seen = _seen(card)
        can_see = scene.splat is not None and LOG_CAMERA in world.robot.cameras
        self._own = LOG_CAMERA if not self._seen and can_see else None

    @property
    def mounts(self) -> tuple[str, ...]:
        """Cameras of the robot that the log shows frames of, each once."""
        own = () if self._own is None else (self._own,)
        return tuple(dict.fromkeys((*(seen.spec.camera for seen in self._seen), *own)))

    def calibrate(self) -> None:
        """Write every camera's calibration."""
        for seen in self._seen:
            self._calibrate(seen.camera, seen.spec.camera, seen.spec.width, seen.spec.height)
        if self._own is not None and self._log.takes_images:
            self._calibrate(self._own, self._own, *LOG_SIZE)

    def record(self, step: int, observation: Mapping[str, NDArray[Any]]) -> None:
        """Write the frames of a control step: new ones of the policy, or the log's own."""
        if not self._log.takes_images:
            return
        time = self._world.time
        for seen in self._seen:
            if self._sensors[seen.observation].fresh:
                frame = newest_frame(observation[seen.observation], seen.spec)
                self._log.frame(time, seen.camera, frame)
        if self._own is not None and step % LOG_PERIOD == 0:
            T_world_camera = self._world.camera_pose(self._own)
            self._log.later_frame(time, self._own, lambda: self._render(T_world_camera))

    def _calibrate(self, camera: str, mount: str, width: int, height: int) -> None:
        fovy = self._world.robot.cameras[mount].fovy
        self._log.calibration(self._world.time, camera, width=width, height=height, fovy=fovy)

    def _render(self, T_world_camera: NDArray[np.float64]) -> Bytes:
        from nw_eval.splat.camera import Camera

        width, height = LOG_SIZE
        camera = Camera.from_fovy(
            width=width,
            height=height,
            fovy=self._world.robot.cameras[LOG_CAMERA].fovy,
            T_world_camera=np.linalg.inv(self._scene.T_world_splat) @ T_world_camera,
        )
        try:
            with self._clock("render"):
                return self._renderer().render(camera).bytes()
        except Exception as error:
            # The policy never sees these frames, so whatever fails here costs the log alone.
            raise OSError(f"its camera failed: {error}") from error


def newest_frame(array: NDArray[Any], spec: SplatRgbObservation) -> Bytes:
    """Return the newest frame of a camera observation, (H, W, 3) uint8, as the policy sees it.

    Args:
        array: the observation, laid out as the card says.
        spec: what the card says.
    """
    if spec.stack > 1 and spec.stack_axis == "new":
        array = array[-1]
    image = array.transpose(1, 2, 0) if spec.axes == "chw" else array
    image = image[..., -3:]
    if spec.dtype == "uint8":
        return image
    return np.clip(np.rint(image * spec.std + spec.mean), 0.0, 255.0).astype(np.uint8)


def _seen(card: Card) -> tuple[_Seen, ...]:
    found: list[_Seen] = []
    for name, spec in card.observations.items():
        # What a wrapper makes of an image need not be one any more.
        if isinstance(spec, SplatRgbObservation) and not spec.wrap:
            taken = {seen.camera for seen in found}
            camera = spec.camera if spec.camera not in taken else f"{spec.camera}/{name}"
            found.append(_Seen(observation=name, spec=spec, camera=camera))
    return tuple(found)
