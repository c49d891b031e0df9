"""What a score is: a declared number of a trial, and the readings that it is computed from.

A score is one class: it declares itself (`spec`), is shown the readings of a trial in stretches of
some control steps, and says its value at the end. Arrays over time make that cheap, and a suite
that names none pays nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from nw_base import same_bits
from nw_base.words import Outcome

Array = NDArray[np.float64]
STRETCH = 20
"""Control steps that a score is shown at once; fewer at the end of a trial.

Numpy costs some microseconds a call in the midst of a trial, however few the numbers are. More
steps at once cost less, and make the states in a trial's log larger.
"""

NEAR = 0.01
"""rad; within so much a joint is at the end of its range."""


class ScoreSpec(BaseModel):
    """The declaration of a score: all that gate and reports know of it."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    name: str = Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")
    unit: str
    """In words, such as `W` or `rad/s`; empty for a share or a ratio."""
    better: Literal["higher", "lower"]
    """Which values are good."""
    low: float
    high: float
    """The range: statistics see values clipped to it."""
    undefined: float
    """What a trial counts in which the score has no value, such as a time to finish of a robot that
    fell; in the score's unit."""
    meaning: str
    """One line."""

    @model_validator(mode="after")
    def _has_a_range(self) -> Self:
        if fault := unusable_range(self.low, self.high):
            raise ValueError(fault)
        return self

    @property
    def width(self) -> float:
        """Of the range, in the score's unit."""
        return self.high - self.low

    def counted(self, value: float | None) -> float:
        """Return a value as it is averaged, within the range; None and NaN are `undefined`."""
        if value is None or not math.isfinite(value):
            value = self.undefined
        return min(max(value, self.low), self.high)

    def scaled(self, value: float | None) -> float:
        """Return a value as a number from 0, the worst, to 1, the best."""
        share = (self.counted(value) - self.low) / self.width
        return share if self.better == "higher" else 1.0 - share

    def unscaled(self, share: float) -> float:
        """Return the value in the score's unit of a number that `scaled` gives."""
        return self.low + self.width * (share if self.better == "higher" else 1.0 - share)

    def within(self, low: float, high: float) -> ScoreSpec:
        """Return the declaration with a narrower range."""
        bounded = min(max(self.undefined, low), high)
        return self.model_copy(update={"low": low, "high": high, "undefined": bounded})


def unusable_range(low: float, high: float) -> str | None:
    """Return why values cannot be scaled to a range from 0 to 1, or None.

    A share of a width beyond the largest number is NaN, and one of a width of no normal number has
    no digits.
    """
    if not low < high:
        return f"range {low:g} to {high:g} is empty"
    if high - low > MOST_WIDTH:
        return f"range {low:g} to {high:g} is wider than {MOST_WIDTH:g}"
    if high - low < 1.0 / MOST_WIDTH:
        return f"range {low:g} to {high:g} is narrower than {1.0 / MOST_WIDTH:g}"
    return None


MOST_WIDTH = 1e300
"""Of a score's range; sums and products of shares stay finite numbers."""


def lower_better(name: str, unit: str, high: float, meaning: str) -> ScoreSpec:
    """Return the declaration of a score from 0 to `high`, which counts where it is undefined."""
    return ScoreSpec(
        name=name, unit=unit, better="lower", low=0.0, high=high, undefined=high, meaning=meaning
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Figures:
    """What of robot and simulation does not change in a trial.

    Attributes:
        control_period: of a control step, s.
        timestep: of a physics step, s.
        mass: of the robot with its payload, kg.
        gravity: m/s^2.
        torque_limits: of the motors, (J,) N m.
        joint_ranges: (J, 2) rad.
    """

    control_period: float
    timestep: float
    mass: float
    gravity: float
    torque_limits: Array
    joint_ranges: Array

    @cached_property
    def inner_ranges(self) -> tuple[Array, Array]:
        """Where the ends of the joints' ranges begin, low and high, (J,) rad each."""
        return self.joint_ranges[:, 0] + NEAR, self.joint_ranges[:, 1] - NEAR


class MissingReadingError(LookupError):
    """A score asks for a reading that a log does not have.

    Attributes:
        reading: its name, an attribute of `Stretch`.
    """

    def __init__(self, reading: str) -> None:
        super().__init__(reading)
        self.reading = reading


class Stretch:
    """The readings of n consecutive control steps, 1 to `STRETCH`, each after its step.

    Frames: world z up; the yaw frame is the world turned by the trunk's heading. J joints in the
    order of `robot.joints`, F feet in that of `robot.feet`, S physics steps in each control step.

    Args:
        figures: of robot and simulation.
        **readings: arrays by name. A log may lack some: they raise `MissingReadingError`.

    Attributes:
        torques: of the motors in each physics step, damping of the servo included, (n, S, J) N m.
        joint_rates: at the end of each physics step, (n, S, J) rad/s.
        joint_positions: (n, J) rad.
        targets: what the motors were told, (n, J) rad, or N m.
        position: origin of the trunk, (n, 3) world, m.
        rotation: R_world_trunk, (n, 9) row by row.
        world_velocity: of the trunk's origin, (n, 3) world, m/s.
        rates: angular velocity of the trunk, (n, 3) trunk frame, rad/s.
        foot_positions: centres of the feet, (n, F, 3) world, m.
        foot_forces: contact forces on the feet, (n, F) N.
        command: velocity that the task asks for, (n, 3): forward, left m/s, yaw rate rad/s; NaN
            where it asks for none.
    """

    torques: Array
    joint_rates: Array
    joint_positions: Array
    targets: Array
    position: Array
    rotation: Array
    world_velocity: Array
    rates: Array
    foot_positions: Array
    foot_forces: Array
    command: Array

    def __init__(self, figures: Figures, **readings: Array) -> None:
        self.figures = figures
        self.__dict__.update(readings)

    def __getattr__(self, name: str) -> Any:
        if name in READINGS:
            raise MissingReadingError(name)
        raise AttributeError(name)

    # Several scores ask for these: they are computed once, and only where one does.

    @cached_property
    def torque_shares(self) -> Array:
        """Size of each torque as a share of its motor's limit, (n, S, J)."""
        return np.abs(self.torques) / self.figures.torque_limits

    @cached_property
    def peak_shares(self) -> Array:
        """The largest of `torque_shares` in each control step, (n,)."""
        return self.torque_shares.reshape(len(self.torques), -1).max(axis=1)

    @cached_property
    def work(self) -> float:
        """Positive mechanical work of all motors in all of the stretch, J."""
        power = np.maximum(self.torques * self.joint_rates, 0.0)
        return float(power.sum()) * self.figures.timestep

    @cached_property
    def power(self) -> Array:
        """Positive mechanical power of all motors in each physics step, (n, S, 1) W."""
        return np.maximum(self.torques * self.joint_rates, 0.0).sum(axis=2, keepdims=True)

    @cached_property
    def yaw(self) -> Array:
        """Of the trunk, (n,) rad."""
        return same_bits.arctan2(self.rotation[:, 3], self.rotation[:, 0])

    @cached_property
    def roll(self) -> Array:
        """Of the trunk, (n,) rad."""
        return same_bits.arctan2(self.rotation[:, 7], self.rotation[:, 8])

    @cached_property
    def pitch(self) -> Array:
        """Of the trunk, (n,) rad."""
        return -same_bits.arcsin(np.minimum(np.maximum(self.rotation[:, 6], -1.0), 1.0))

    @cached_property
    def roll_pitch_yaw(self) -> Array:
        """Euler angles of the trunk, (n, 3) rad."""
        return np.stack([self.roll, self.pitch, self.yaw], axis=1)

    @cached_property
    def velocity(self) -> Array:
        """Velocity of the trunk's origin, (n, 3) yaw frame, m/s."""
        vx, vy, vz = self.world_velocity.T
        cosine, sine = np.cos(self.yaw), np.sin(self.yaw)
        return np.stack([cosine * vx + sine * vy, cosine * vy - sine * vx, vz], axis=1)

    @cached_property
    def commanded(self) -> NDArray[np.bool_] | None:
        """In which control steps the task asks for a velocity, (n,); None in none of them."""
        known = self.command[:, 0] == self.command[:, 0]  # NaN is not itself.
        return known if known.any() else None


READINGS = frozenset(Stretch.__annotations__)
"""Names of the readings that a `Stretch` is made of."""


@dataclass(frozen=True, kw_only=True)
class TrialEnd:
    """How a trial ended.

    Attributes:
        outcome: None where it has no result.
        seconds: simulated time, s.
        success: 0 to 1.
    """

    outcome: Outcome | None
    seconds: float
    success: float


class Score:
    """One score of one trial. A subclass declares `spec`, and has `update` and `value`.

    What it remembers are numbers and arrays, each an attribute that `__init__` sets: those are what
    a trial is saved by and continued from.

    Args:
        figures: of robot and simulation.
    """

    spec: ClassVar[ScoreSpec]
    joined: ClassVar[tuple[str, ...]] = ()
    """Attributes that join a stretch to the one before: they are as new after a pause of a log."""

    def __init__(self, figures: Figures) -> None:
        self.figures = figures

    def update(self, stretch: Stretch) -> None:
        """Take the readings of the next control steps."""
        raise NotImplementedError

    def value(self, end: TrialEnd) -> float | None:
        """Return the score, in its unit, or None where it is undefined."""
        raise NotImplementedError

    def moment(self) -> float | None:
        """Return when in the trial a limit was first passed, s; None for never, or for no limit."""
        return None

    def state(self) -> dict[str, NDArray[Any]]:
        """Return what it remembers."""
        return {name: np.asarray(value) for name, value in vars(self).items() if name != "figures"}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go back, or on, to a `state`.

        Raises:
            KeyError: it is of another score.
        """
        for name in [name for name in vars(self) if name != "figures"]:
            array = state[name]
            setattr(self, name, array.item() if array.ndim == 0 else array.copy())
