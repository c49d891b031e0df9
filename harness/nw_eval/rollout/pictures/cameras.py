"""The log's own camera, for people, where the policy sees no pictures.

It never touches the result, and in a run that keeps images of failures only it renders after the
trial, if the trial failed. What a policy sees itself is in `seen`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_eval.rollout.clock import StageClock
    from nw_eval.rollout.mcap.trial_log import TrialLog
    from nw_eval.scenes import Scene
    from nw_eval.sim import World
    from nw_eval.splat.render import Renderer

Bytes = NDArray[np.uint8]

LOG_CAMERA = "ego"
LOG_SIZE = (160, 90)  # pixels
LOG_PERIOD = 5  # control steps between two frames: 10 Hz
LOG_TOPIC = f"/camera/{LOG_CAMERA}"


class LogCamera:
    """The camera of one trial's log.

    Args:
        needed: whether nobody else makes pictures.
        world: carries the camera.
        scene: what it sees.
        renderer: makes the renderer of the scene's splat; called only if a frame is rendered.
        log: where the frames go.
        clock: rendering for the log counts as `render`.
    """

    def __init__(
        self,
        *,
        needed: bool,
        world: World,
        scene: Scene,
        renderer: Callable[[], Renderer],
        log: TrialLog,
        clock: StageClock,
    ) -> None:
        self._world = world
        self._scene = scene
        self._renderer = renderer
        self._log = log
        self._clock = clock
        can_see = scene.splat is not None and LOG_CAMERA in world.robot.cameras
        self.is_on = needed and can_see and log.takes_images

    def calibrate(self) -> None:
        """Write the camera's calibration."""
        if self.is_on:
            width, height = LOG_SIZE
            focal = 0.5 * height / float(np.tan(0.5 * self._fovy))
            self._log.calibration(
                self._world.time,
                LOG_TOPIC,
                mount=LOG_CAMERA,
                size=LOG_SIZE,
                focal=(focal, focal),
                center=(0.5 * width, 0.5 * height),
            )

    def record(self, step: int) -> None:
        """Write the frame of a control step, if it has one."""
        if self.is_on and step % LOG_PERIOD == 0:
            T_world_camera = self._world.camera_pose(LOG_CAMERA)
            self._log.later_picture(
                self._world.time, LOG_TOPIC, lambda: self._render(T_world_camera), mount=LOG_CAMERA
            )

    @property
    def _fovy(self) -> float:
        return self._world.robot.cameras[LOG_CAMERA].fovy

    def _render(self, T_world_camera: NDArray[np.float64]) -> Bytes:
        from nw_eval.splat.camera import Camera

        width, height = LOG_SIZE
        camera = Camera.from_fovy(
            width=width,
            height=height,
            fovy=self._fovy,
            T_world_camera=np.linalg.inv(self._scene.T_world_splat) @ T_world_camera,
        )
        try:
            with self._clock("render"):
                return self._renderer().render(camera).bytes()
        except Exception as error:
            # The policy never sees these frames, so whatever fails here costs the log alone.
            raise OSError(f"its camera failed: {error}") from error
