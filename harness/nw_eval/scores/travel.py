"""Where the robot gets to and when, and how well it follows a commanded velocity."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from nw_eval.scores.effort import way_after
from nw_eval.scores.score import Figures, Score, ScoreSpec, Stretch, TrialEnd


class TimeToFinish(Score):
    """Simulated time of a trial that was completed, s; undefined for all others."""

    spec = ScoreSpec(
        name="time_to_finish",
        unit="s",
        better="lower",
        low=0.0,
        high=60.0,
        undefined=60.0,
        meaning="simulated time until the task was completed",
    )

    def update(self, stretch: Stretch) -> None:
        """Nothing to add: the clock of the trial counts."""

    def value(self, end: TrialEnd) -> float | None:
        """Return s; None where it was not completed."""
        return end.seconds if end.outcome == "completed" else None


class DistanceBeforeFall(Score):
    """The trunk's way in the ground plane until the trial ended, by a fall or otherwise, m.

    It is sampled each 0.2 s, so that swaying is no way.
    """

    spec = ScoreSpec(
        name="distance_before_fall",
        unit="m",
        better="higher",
        low=0.0,
        high=20.0,
        undefined=0.0,
        meaning="way of the trunk until it fell, or the trial ended",
    )

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.distance, self.x, self.y = 0.0, math.nan, math.nan

    def update(self, stretch: Stretch) -> None:
        """Add way."""
        self.distance, self.x, self.y = way_after(self.distance, self.x, self.y, stretch)

    def value(self, end: TrialEnd) -> float | None:
        """Return m."""
        del end
        return self.distance


class _Tracking(Score):
    """Mean over the control steps with a command of how far the trunk's velocity is from it."""

    angular: ClassVar[bool]

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.total, self.count = 0.0, 0

    def update(self, stretch: Stretch) -> None:
        """Add errors."""
        known = stretch.commanded
        if known is None:
            return
        if self.angular:
            errors = np.abs(stretch.command[:, 2] - stretch.rates[:, 2])
        else:
            apart = stretch.command[:, :2] - stretch.velocity[:, :2]
            errors = np.hypot(apart[:, 0], apart[:, 1])
        self.total += float(errors[known].sum())
        self.count += int(np.count_nonzero(known))

    def value(self, end: TrialEnd) -> float | None:
        """Return the mean error; undefined after a fall, and where nothing was commanded."""
        if not self.count or end.outcome in {"fell", "policy_failed"}:
            return None
        return self.total / self.count


class LinearTracking(_Tracking):
    """1/N sum_t |v*_xy - v_xy|, m/s, in the yaw frame, at control rate.

    v* is what the task commands. Undefined after a fall, and for tasks that command no velocity, as
    `course`.

    Source: the error within the reward `tracking_lin_vel` of N. Rudin et al., "Learning to walk in
    minutes", CoRL 2021.
    """

    angular = False
    spec = ScoreSpec(
        name="tracking_error_linear",
        unit="m/s",
        better="lower",
        low=0.0,
        high=2.0,
        undefined=2.0,
        meaning="mean distance of the trunk's horizontal velocity from the command",
    )


class AngularTracking(_Tracking):
    """1/N sum_t |w*_z - w_z|, rad/s, about the trunk's z axis, at control rate; else as above.

    Source: the error within the reward `tracking_ang_vel` of N. Rudin et al., as above.
    """

    angular = True
    spec = ScoreSpec(
        name="tracking_error_angular",
        unit="rad/s",
        better="lower",
        low=0.0,
        high=2.0,
        undefined=2.0,
        meaning="mean distance of the trunk's yaw rate from the command",
    )
