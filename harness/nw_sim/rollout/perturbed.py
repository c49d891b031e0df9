"""What a cell of the perturbation grid does to robot, card, motors and pictures.

Most axes need no code of their own in the loop: a latency is one that the card might have named, a
camera that is mounted askew is another robot's. A neutral value changes no bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import NwEvalError, PluginError, UsageError
from nw_base.plugins import AXES as GROUP
from nw_base.plugins import installed, subject
from nw_policies.cards import Card, actuator_values, motors_follow
from nw_policies.cards.model import CONTROL_RATE
from nw_policies.cards.observations import (
    AnyObservation,
    DepthObservation,
    SemanticsObservation,
    SplatRgbObservation,
)
from nw_policies.cards.wrappers import Noise
from nw_scenes.robots import RobotSpec
from nw_scenes.robots.spec import remounted
from nw_sim.axes import AXES, Felt, axis_named
from nw_sim.physics import Actuators
from nw_sim.sensors.sensor import CLEAR, Air
from nw_sim.tasks.commanded import Asked, is_commanded
from nw_sim.tasks.task import TaskSettings

if TYPE_CHECKING:
    from nw_base.trials import Trial

Array = NDArray[np.float64]
Cell = Mapping[str, float]

_WHITE = 255.0
_VIEWS = (SplatRgbObservation, DepthObservation, SemanticsObservation)
EVERY = 150
"""From one push to the next: 3 s, in steps of 0.02 s."""
_FIRST = 50
"""Before the first at least, in steps of 0.02 s."""
_LONGEST = 600 * 50
"""Of the longest trial, in steps of 0.02 s."""


@dataclass(frozen=True, kw_only=True)
class TrialSetup:
    """What a trial begins with, as far as axes of perturbation may change it.

    An axis returns another setup, made by `replaced` or by one of the methods that follow it.

    Attributes:
        trial: whose it is.
        robot: with its cameras as the card mounts them.
        card: of the policy; its `observations` and `control` count.
        motors: gains, damping, limits, armature and friction of the joints.
        air: between cameras and scene.
        friction: sliding friction of ground and obstacles; None = each solid's own.
        payload: load on the robot's back, kg.
        push: speed that the trunk is given every 3 s, level, in a drawn direction, m/s.
        missing_cones: probability of each cone of the course to be missing in images.
        command: parts of the commanded velocity (`vx`, `vy`, `yaw`) that replace the command of the
            suite's task, m/s and rad/s.
    """

    trial: Trial
    robot: RobotSpec
    card: Card
    motors: Actuators
    air: Air = CLEAR
    friction: float | None = None
    payload: float = 0.0
    push: float = 0.0
    missing_cones: float = 0.0
    command: Mapping[str, float] = field(default_factory=dict[str, float])

    @classmethod
    def of(cls, trial: Trial, robot: RobotSpec, card: Card) -> Self:
        """Return the setup of a trial in which nothing is changed.

        Raises:
            PolicyError: the card's motors do not fit the robot.
        """
        values = actuator_values(card, robot)
        motors = Actuators.of(robot)
        if values is not None:
            motors = replace(motors, follow=motors_follow(card, robot), **values)
        return cls(trial=trial, robot=robot, card=card, motors=motors)

    def generator(self, stream: str) -> np.random.Generator:
        """Return a fresh generator of the trial's own, at the start of a named stream.

        Args:
            stream: a unique name, such as that of the axis.
        """
        return self.trial.generator(stream)

    def replaced(self, **changes: Any) -> Self:
        """Return a setup with other attributes."""
        return replace(self, **changes)

    def commanding(self, **parts: float) -> Self:
        """Return a setup whose task commands parts of a velocity: `vx`, `vy`, `yaw`.

        Raises:
            ValueError: there is no such part, or it is too fast for a command.
        """
        Asked.model_validate(parts)
        return replace(self, command={**self.command, **parts})

    def with_strength(self, strength: float) -> Self:
        """Return a setup whose motors have a share of their gain and of their largest torque."""
        return replace(self, motors=replace(self.motors, strength=strength))

    def with_air(self, **changes: float) -> Self:
        """Return a setup with other attributes of its air: `exposure`, `fog`."""
        return replace(self, air=replace(self.air, **changes))

    def remounted(self, *, pitch: float = 0.0, height: float = 0.0, factor: float = 1.0) -> Self:
        """Return a setup whose cameras are mounted otherwise; figures as `robots.remounted`.

        Raises:
            UsageError: a camera that the policy sees through cannot see so wide an angle.
        """
        cameras = dict(self.robot.cameras)
        seen = {getattr(each, "camera", None) for each in self.card.observations.values()}
        for name, mount in cameras.items():
            try:
                cameras[name] = remounted(mount, pitch=pitch, height=height, factor=factor)
            except ValueError as error:
                if name in seen:
                    raise UsageError(
                        f"field_of_view {factor:g} of camera {name!r}: {error}",
                        fix="name a smaller factor",
                    ) from None
        return replace(self, robot=replace(self.robot, cameras=cameras))

    def later(self, seconds: float) -> Self:
        """Return a setup whose observations are older, s: a whole number of control steps."""
        return self._observing(lambda observation: {"latency": observation.latency + seconds})

    def with_noise(self, deviation: float) -> Self:
        """Return a setup with errors of every number observed, beside the card's own.

        Args:
            deviation: their standard deviation; of colours as a share of white.
        """
        return self._observing(lambda observation: _noisier(observation, deviation))

    def _observing(self, changes: Callable[[AnyObservation], dict[str, Any]]) -> Self:
        observations = {
            name: observation.model_copy(update=changes(observation))
            for name, observation in self.card.observations.items()
        }
        return replace(self, card=self.card.model_copy(update={"observations": observations}))


def _noisier(observation: AnyObservation, deviation: float) -> dict[str, Any]:
    if isinstance(observation, SemanticsObservation):  # Its numbers are names.
        return {}
    own = observation.noise or Noise()
    added = deviation * (_WHITE if isinstance(observation, SplatRgbObservation) else 1.0)
    both = math.hypot(own.gaussian, added)
    return {"noise": own.model_copy(update={"gaussian": both})}


def perturbed(setup: TrialSetup, cell: Cell) -> TrialSetup:
    """Return the setup of a trial with what each axis of a cell changes, in the cell's order.

    Raises:
        UsageError: there is no such axis.
        PluginError: its package is broken, or its `change` raised or returned something else.
    """
    for name, value in cell.items():
        axis = axis_named(name)
        if value == axis.neutral:
            continue
        try:
            changed: object = axis.change(setup, value)
        except NwEvalError:
            raise
        except Exception as error:
            raise PluginError(
                f"{_subject(name)} raised {type(error).__name__} at {value:g}: {error}"
            ) from error
        if not isinstance(changed, TrialSetup):
            raise PluginError(
                f"{_subject(name)} returned a {type(changed).__name__} at {value:g}",
                fix="`change` must return a TrialSetup, such as setup.replaced(...)",
            )
        setup = changed
    return setup


def _subject(name: str) -> str:
    points = installed(GROUP).get(name)
    return f"axis {name!r}" if name in AXES or not points else f"axis {subject(points[0])}"


def unfelt(card: Card, axes: Iterable[str], task: TaskSettings) -> list[str]:
    """Return which axes change nothing: the policy has no sense for them, or the task no command.

    Raises:
        UsageError, PluginError: as `axis_named`.
    """
    views = [each for each in card.observations.values() if isinstance(each, _VIEWS)]
    felt: dict[Felt, bool] = {
        "always": True,
        "camera": bool(views),
        "splat_rgb": any(isinstance(view, SplatRgbObservation) for view in views),
        "cones": any(view.cones for view in views),
        "command": is_commanded(task),
    }
    return [axis for axis in axes if not felt[axis_named(axis).felt_by]]


def pushes_of(setup: TrialSetup) -> Pushes | None:
    """Return the pushes of a trial; None where there are none."""
    if not setup.push:
        return None
    rate = setup.card.control.step_rate
    return Pushes(setup.push, setup.generator("pushes"), control_rate=rate)


def standing_cones(setup: TrialSetup, trail: Array) -> Array | None:
    """Return the waypoints (K, 3) that have a cone, drawn for each trial; None = all."""
    if setup.missing_cones == 0.0:
        return None
    drawn = setup.generator("missing cones").random(len(trail))
    return trail[drawn >= setup.missing_cones]


class Pushes:
    """When and whereto a trial's robot is pushed: known before it begins, so nothing to remember.

    Args:
        speed: that a push adds to the trunk's, m/s.
        generator: draws the first step, then a direction for each push.
        control_rate: control steps per second, Hz.
    """

    def __init__(
        self, speed: float, generator: np.random.Generator, *, control_rate: float = CONTROL_RATE
    ) -> None:
        first = int(generator.integers(_FIRST, EVERY))
        moments = range(first, _LONGEST + 1, EVERY)
        self._numbers = {
            round(moment * control_rate / CONTROL_RATE): number
            for number, moment in enumerate(moments)
        }
        angles = generator.uniform(-math.pi, math.pi, _LONGEST // EVERY + 1)
        self._velocities = speed * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def at(self, step: int) -> NDArray[np.float64] | None:
        """Return the velocity (2,) m/s, world frame, that is added before a step; mostly None."""
        number = self._numbers.get(step)
        return None if number is None else self._velocities[number]
