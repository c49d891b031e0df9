"""What a cell of the perturbation grid does to robot, card, motors and pictures.

Most axes need no code of their own in the loop: a latency is one that the card might have named, a
camera that is mounted askew is another robot's. A neutral value changes no bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards import Card
from nw_eval.cards.observations import (
    AnyObservation,
    DepthObservation,
    SemanticsObservation,
    SplatRgbObservation,
)
from nw_eval.cards.wrappers import Noise
from nw_eval.errors import UsageError, nearest
from nw_eval.robots import RobotSpec
from nw_eval.robots.spec import remounted
from nw_eval.sensors.sensor import CLEAR, Air
from nw_eval.sim import Actuators
from nw_eval.suite.perturb import NEUTRAL

if TYPE_CHECKING:
    from nw_eval.suite.trials import Trial

Array = NDArray[np.float64]
Cell = Mapping[str, float]

_WHITE = 255.0
_CAMERAS = frozenset({"camera_pitch", "camera_height", "field_of_view"})
_COLOURS = frozenset({"exposure", "fog"})
_VIEWS = (SplatRgbObservation, DepthObservation, SemanticsObservation)
EVERY = 150
"""Control steps from one push to the next: 3 s."""
_FIRST = 50
"""Control steps before the first at least."""
_LONGEST = 600 * 50
"""Control steps of the longest trial."""


def cell_of(trial: Trial) -> Cell:
    """Return the axes of a trial's cell and their values.

    Raises:
        UsageError: there is no such axis.
    """
    cell = dict(trial.perturbation)
    for axis in cell:
        if axis not in NEUTRAL:
            raise UsageError(f"unknown perturbation {axis!r}", fix=nearest(axis, list(NEUTRAL)))
    return cell


def unfelt(card: Card, axes: Iterable[str]) -> list[str]:
    """Return which axes change nothing for a policy, since it has no sense for them."""
    senses = card.observations.values()
    views = [each for each in senses if isinstance(each, _VIEWS)]
    return [
        axis
        for axis in axes
        if (axis in _CAMERAS and not views)
        or (axis in _COLOURS and not any(isinstance(v, SplatRgbObservation) for v in views))
        or (axis == "missing_cones" and not any(view.cones for view in views))
    ]


def perturbed_robot(robot: RobotSpec, cell: Cell) -> RobotSpec:
    """Return a robot with its cameras mounted as a cell says."""
    pitch, height = cell.get("camera_pitch", 0.0), cell.get("camera_height", 0.0)
    factor = cell.get("field_of_view", 1.0)
    cameras = {
        name: remounted(mount, pitch=pitch, height=height, factor=factor)
        for name, mount in robot.cameras.items()
    }
    return replace(robot, cameras=cameras)


def perturbed_card(card: Card, cell: Cell) -> Card:
    """Return a card whose observations are as late and as wrong as a cell says."""
    latency, noise = cell.get("latency", 0.0), cell.get("noise", 0.0)
    if latency == 0.0 and noise == 0.0:
        return card
    observations = {
        name: _spoiled(observation, latency, noise)
        for name, observation in card.observations.items()
    }
    return card.model_copy(update={"observations": observations})


def _spoiled(observation: AnyObservation, latency: float, noise: float) -> AnyObservation:
    changes: dict[str, object] = {"latency": observation.latency + latency}
    if noise:
        own = observation.noise or Noise()
        bytes_ = isinstance(observation, SplatRgbObservation)
        added = noise * (_WHITE if bytes_ else 1.0)
        if not isinstance(observation, SemanticsObservation):  # Its numbers are names.
            both = math.hypot(own.gaussian, added)
            changes["noise"] = own.model_copy(update={"gaussian": both})
    return observation.model_copy(update=changes)


def perturbed_motors(robot: RobotSpec, motors: Actuators | None, cell: Cell) -> Actuators | None:
    """Return motors that are as strong as a cell says; None are the robot's own."""
    strength = cell.get("strength", 1.0)
    if strength == 1.0:
        return motors
    return replace(Actuators.of(robot) if motors is None else motors, strength=strength)


def air_of(cell: Cell) -> Air:
    """Return what lies between the cameras and the place."""
    exposure, fog = cell.get("exposure", 1.0), cell.get("fog", 0.0)
    return CLEAR if (exposure, fog) == (1.0, 0.0) else Air(exposure=exposure, fog=fog)


def pushes_of(trial: Trial, cell: Cell) -> Pushes | None:
    """Return the pushes of a trial; None where there are none."""
    speed = cell.get("push", 0.0)
    return Pushes(speed, trial.generator("pushes")) if speed else None


def standing_cones(trial: Trial, cell: Cell, trail: Array) -> Array | None:
    """Return the waypoints (K, 3) that have a cone, drawn for each trial; None = all."""
    share = cell.get("missing_cones", 0.0)
    if share == 0.0:
        return None
    return trail[trial.generator("missing cones").random(len(trail)) >= share]


class Pushes:
    """When and whereto a trial's robot is pushed: known before it begins, so nothing to remember.

    Args:
        speed: that a push adds to the trunk's, m/s.
        generator: draws the first step, then a direction for each push.
    """

    def __init__(self, speed: float, generator: np.random.Generator) -> None:
        self._first = int(generator.integers(_FIRST, EVERY))
        angles = generator.uniform(-math.pi, math.pi, _LONGEST // EVERY + 1)
        self._velocities = speed * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def at(self, step: int) -> NDArray[np.float64] | None:
        """Return the velocity (2,) m/s, world frame, that is added before a step; mostly None."""
        since = step - self._first
        return self._velocities[since // EVERY] if since >= 0 and since % EVERY == 0 else None
