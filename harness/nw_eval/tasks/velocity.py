"""The task `velocity`: follow a velocity command."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field

from nw_eval.scores import ScoreSpec
from nw_eval.tasks.commanded import Command, Commanded, CommandedSettings, TaskPart, off_command
from nw_eval.tasks.task import Array, Readings, TaskEvent, TaskRules, Velocity
from nw_eval.words import Outcome

WINDOW = 0.5
"""s over which a velocity error is averaged: about a stride, within which a trunk sways."""


class Tolerance(TaskPart):
    """How far the velocity may be from the command, both averaged over `WINDOW`."""

    linear: float = Field(default=0.2, gt=0.0, le=5.0)
    """m/s in the ground plane."""
    angular: float = Field(default=0.3, gt=0.0, le=10.0)
    """rad/s of yaw rate."""


class VelocitySettings(CommandedSettings):
    """`task: {kind: velocity, command: ...}`."""

    kind: Literal["velocity"] = "velocity"
    command: Command
    within: Tolerance = Tolerance()
    share: float = Field(default=0.7, gt=0.0, le=1.0)
    """Of the time, that must be within the tolerance for a trial to be completed."""


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
        self._errors = np.zeros((self._window, 3))
        self._tracked = 0

    def _see(self, readings: Readings, asked: Velocity) -> tuple[TaskEvent, ...]:
        self._errors[(self.step - 1) % self._window] = off_command(readings, asked)
        if self.step >= self._window:
            x, y, turn = (self._errors.sum(axis=0) / self._window).tolist()
            within = self._within
            is_within = math.hypot(x, y) <= within.linear and abs(turn) <= within.angular
            self._tracked += is_within
        return ()

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
