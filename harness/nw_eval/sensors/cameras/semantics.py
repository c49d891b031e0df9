"""What each pixel shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations.cameras import SemanticsObservation
from nw_eval.robots import RobotSpec
from nw_eval.sensors.cameras.view import PixelRays
from nw_eval.sensors.drawing.palette import PALETTE
from nw_eval.sensors.ground.heights import Rays
from nw_eval.sensors.ground.surroundings import Surroundings
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.sensor import Moment


class Semantics(Measurement):
    """Class ids (H, W) uint8, or colours (H, W, 3); see `sensors.palette`."""

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

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Cast the rays."""
        _, met = self._around.classes(moment, *self._view.rays(moment))
        return (PALETTE[met] if self._in_colour else met).reshape(self.shape)
