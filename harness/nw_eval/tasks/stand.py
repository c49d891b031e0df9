"""The task `stand`: keep still."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field

from nw_eval.scores import ScoreSpec
from nw_eval.tasks.commanded import Commanded, CommandedSettings
from nw_eval.tasks.task import Array, Readings, TaskEvent, TaskRules, Velocity
from nw_eval.words import Outcome


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
        ScoreSpec(
            name="position_drift",
            unit="m",
            better="lower",
            low=0.0,
            high=2.0,
            undefined=2.0,
            meaning="largest distance of the trunk in the ground plane from where it stood",
        ),
        ScoreSpec(
            name="yaw_drift",
            unit="rad",
            better="lower",
            low=0.0,
            high=1.6,
            undefined=1.6,
            meaning="largest angle of the trunk's heading from where it stood",
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
