"""The tasks `velocity` and `stand`: follow a command, and stay where it is zero."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from nw_base.words import Outcome
from nw_gate.scores import ScoreSpec
from nw_gate.scores.score import lower_better
from nw_sim.tasks.commanded import WINDOW, Command, Commanded, CommandedSettings, off_command
from nw_sim.tasks.targets import HEIGHT
from nw_sim.tasks.task import Array, Readings, TaskEvent, TaskPart, TaskRules, Velocity


class Tolerance(TaskPart):
    """How far the velocity may be from the command, both averaged over `WINDOW`."""

    linear: float = Field(default=0.2, gt=0.0, le=5.0)
    """m/s in the ground plane."""
    angular: float = Field(default=0.3, gt=0.0, le=10.0)
    """rad/s of yaw rate."""
    height: float | None = Field(default=None, gt=0.0, le=10.0)
    """m between the trunk's height over the ground and the one that `targets` ask for; None = it
    does not count."""
    joints: float | None = Field(default=None, gt=0.0, le=10.0)
    """rad, on average, between joints and the angles that `targets` ask for; None as above."""

    @model_serializer(mode="wrap")
    def _without_none(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value is not None}


class VelocitySettings(CommandedSettings):
    """`task: {kind: velocity, command: ...}`."""

    kind: Literal["velocity"] = "velocity"
    command: Command
    within: Tolerance = Tolerance()
    share: float = Field(default=0.7, gt=0.0, le=1.0)
    """Of the time, that must be within the tolerance for a trial to be completed."""

    @model_validator(mode="after")
    def _asked(self) -> Self:
        asked = self.targets.of if self.targets is not None else {}
        if self.within.height is not None and HEIGHT not in asked:
            raise ValueError("within.height: the targets ask for no `height`")
        if self.within.joints is not None and not set(asked) - {HEIGHT}:
            raise ValueError("within.joints: the targets ask for no joint")
        return self


class VelocityTask(Commanded):
    """Follow a velocity command until the time is over.

    A control step counts from `WINDOW` on. It is within the tolerance if the mean of command minus
    velocity over the last `WINDOW` is. The trial is completed if it ran to its end, and the share
    of such steps is at least `share`; `tracked_time` is that share.
    """

    kind = "velocity"
    settings = VelocitySettings
    declared = (
        ScoreSpec(
            name="tracked_time",
            unit="",
            better="higher",
            low=0.0,
            high=1.0,
            undefined=0.0,
            meaning="share of the trial's time in which the velocity was within the tolerance of "
            "the command",
        ),
    )

    def __init__(self, settings: VelocitySettings, rules: TaskRules | None = None) -> None:
        super().__init__(settings, rules)
        self._within, self._share = settings.within, settings.share
        self._window = min(max(1, round(WINDOW / self._rules.control_period)), self.steps)
        self._extra = self._within.height is not None or self._within.joints is not None
        self._errors = np.zeros((self._window, 5 if self._extra else 3))
        self._tracked = 0

    def _see(self, readings: Readings, asked: Velocity) -> tuple[TaskEvent, ...]:
        row = self._errors[(self.step - 1) % self._window]
        row[:3] = off_command(readings, asked)
        if self._extra:
            row[3:] = self._off_targets(readings)
        if self.step >= self._window:
            x, y, turn, *others = (self._errors.sum(axis=0) / self._window).tolist()
            within = self._within
            is_within = math.hypot(x, y) <= within.linear and abs(turn) <= within.angular
            if self._extra:
                limits = within.height or math.inf, within.joints or math.inf
                is_within &= all(
                    abs(off) <= limit for off, limit in zip(others, limits, strict=True)
                )
            self._tracked += is_within
        return ()

    def _off_targets(self, readings: Readings) -> tuple[float, float]:
        """Return how far height, m, and joints, rad on average, are from what was asked for."""
        drawn = self._drawn
        assert drawn is not None
        values = self._asked_at(self.step - 1)
        height = 0.0
        # A policy that took over may be one that cannot be told a height.
        if self._within.height is not None and HEIGHT in drawn.names:
            height = readings.height_over_ground() - float(values[drawn.names.index(HEIGHT)])
        return height, drawn.off(values, readings.joint_positions)

    @property
    def tracked(self) -> float:
        """Share of the whole trial's steps that were within the tolerance so far."""
        return self._tracked / (self.steps - self._window + 1)

    def _judge(self) -> tuple[Outcome, str]:
        return ("completed", "time") if self.tracked >= self._share else ("timeout", "tracking")

    def scores(self) -> dict[str, float]:
        """Return `tracked_time`: what a trial that ended early did not run is not tracked."""
        return {"tracked_time": self.tracked}

    def _memory(self) -> dict[str, Array]:
        return {"errors": self._errors, "tracked": np.array([float(self._tracked)])}

    def _remember(self, arrays: Mapping[str, Any]) -> None:
        self._errors[:] = arrays["errors"]
        self._tracked = int(arrays["tracked"][0])


class StandSettings(CommandedSettings):
    """`task: stand`."""

    kind: Literal["stand"] = "stand"
    drift: float = Field(default=0.2, gt=0.0, le=100.0)
    """m by which the trunk may leave its place."""
    turn: float = Field(default=0.2, gt=0.0, le=3.0)
    """rad by which it may leave its heading."""
    settle: float = Field(default=1.0, ge=0.0, le=60.0)
    """s after the start, after which place and heading are those that count."""


class StandTask(Commanded):
    """Stand still until the time is over: the command is zero.

    The trial is completed if the trunk's origin never was farther than `drift` in the ground plane
    from where it was at `settle`, and its heading never farther than `turn`.
    """

    kind = "stand"
    settings = StandSettings
    declared = (
        lower_better(
            "position_drift",
            "m",
            2.0,
            "largest distance of the trunk in the ground plane from where it stood",
        ),
        lower_better(
            "yaw_drift", "rad", 1.6, "largest angle of the trunk's heading from where it stood"
        ),
    )

    def __init__(self, settings: StandSettings, rules: TaskRules | None = None) -> None:
        super().__init__(settings, rules)
        self._most = (settings.drift, settings.turn)
        self._settled = min(round(settings.settle / self._rules.control_period), self.steps)
        self._from = np.zeros(3)  # x, y, yaw
        self._drift = np.zeros(2)  # m, rad: the largest so far

    def _see(self, readings: Readings, asked: Velocity) -> tuple[TaskEvent, ...]:
        del asked
        x, y, _ = readings.trunk_position.tolist()
        yaw = float(readings.roll_pitch_yaw[2])
        if self.step <= max(1, self._settled):
            self._from[:] = x, y, yaw
            return ()
        from_x, from_y, from_yaw = self._from.tolist()
        turned = abs((yaw - from_yaw + math.pi) % (2.0 * math.pi) - math.pi)
        moved = math.hypot(x - from_x, y - from_y)
        self._drift[:] = max(self._drift[0], moved), max(self._drift[1], turned)
        return ()

    def _judge(self) -> tuple[Outcome, str]:
        moved, turned = self._drift.tolist()
        most_moved, most_turned = self._most
        if moved > most_moved:
            return "timeout", "position drift"
        return ("timeout", "yaw drift") if turned > most_turned else ("completed", "time")

    def scores(self) -> dict[str, float]:
        """Return both drifts; none of a trial that fell or ended otherwise before its time."""
        if self._ended not in {"completed", "timeout"}:
            return {}
        return {"position_drift": float(self._drift[0]), "yaw_drift": float(self._drift[1])}

    def _memory(self) -> dict[str, Array]:
        return {"from": self._from, "drift": self._drift}

    def _remember(self, arrays: Mapping[str, Any]) -> None:
        self._from[:] = arrays["from"]
        self._drift[:] = arrays["drift"]
