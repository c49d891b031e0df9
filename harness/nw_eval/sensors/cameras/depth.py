"""Depth images of the scene's geometry."""

from __future__ import annotations

import math
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations.cameras import DepthObservation
from nw_eval.robots import RobotSpec
from nw_eval.sensors.cameras.view import PixelRays
from nw_eval.sensors.ground.heights import Rays
from nw_eval.sensors.ground.surroundings import Surroundings
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.sensor import Moment
from nw_eval.sensors.wrappers.wrapper import Plain, Sample, Shot

# Nearer than this, m, nothing is told apart: it keeps inverse depth finite.
_NEAREST = 1e-3


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
        self.form = (DepthForm(observation),)
        height, width = self.shape
        self._view = PixelRays(name, observation.camera, robot, width=width, height=height)
        self._around = Surroundings(rays, cones=observation.cones, robot=observation.robot)

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Cast the rays."""
        distance = self._around.distance(moment, *self._view.rays(moment))
        depth = distance * self._view.along_axis
        return depth.astype(np.float32).reshape(self.shape)


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
