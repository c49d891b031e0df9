"""How the robot moves: smoothness of what the motors are told, attitude, feet.

And where it gets to and when, and how well it follows a commanded velocity.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from nw_base import same_bits
from nw_gate.scores.effort import way_after
from nw_gate.scores.score import Array, Figures, Score, ScoreSpec, Stretch, TrialEnd, lower_better


class _Differences(Score):
    """Root mean square of the differences of some order of what the motors are told, by time."""

    order: ClassVar[int]
    joined = ("before",)

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        # Fewer until as many have been seen.
        self.before = np.zeros((0, len(figures.torque_limits)))
        self.total, self.count = 0.0, 0

    def update(self, stretch: Stretch) -> None:
        """Add squares."""
        targets = np.concatenate([self.before, stretch.targets])
        self.before = targets[-self.order :]
        for _ in range(self.order):
            targets = targets[1:] - targets[:-1]
        changes = targets.ravel()
        self.total += float(same_bits.dot(changes, changes))
        self.count += changes.size

    def value(self, end: TrialEnd) -> float | None:
        """Return the root mean square; None of a trial with too few steps."""
        del end
        if not self.count:
            return None
        return math.sqrt(self.total / self.count) / self.figures.control_period**self.order


class ActionRate(_Differences):
    """sqrt(1/(N J) sum_t,j ((u_t - u_t-1) / T)^2): how fast joint targets change, rad/s.

    u are the targets that the motors are told, after scale, clip, delay and filter of the card, so
    that policies with other scales can be compared; of a policy that commands torques, N m/s.

    Source: the penalty `action_rate` of N. Rudin, D. Hoeller, P. Reist and M. Hutter, "Learning to
    walk in minutes using massively parallel deep reinforcement learning", CoRL 2021, on targets and
    by time.
    """

    order = 1
    spec = lower_better(
        "action_rate", "rad/s", 50.0, "root mean square of the rate at which joint targets change"
    )


class ActionAcceleration(_Differences):
    """sqrt(1/(N J) sum_t,j ((u_t - 2 u_t-1 + u_t-2) / T^2)^2), rad/s^2; u as for `action_rate`.

    Source: the penalty `action_smoothness_2` of G. B. Margolis and P. Agrawal, "Walk these ways:
    tuning robot control for generalization with multiplicity of behavior", CoRL 2022, on targets
    and by time.
    """

    order = 2
    spec = lower_better(
        "action_acceleration",
        "rad/s^2",
        5000.0,
        "root mean square of the acceleration of joint targets",
    )


class _Angle(Score):
    """Root mean square of an Euler angle of the trunk."""

    def of(self, stretch: Stretch) -> Array:
        """Return the angle, (n,) rad."""
        raise NotImplementedError

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.total, self.count = 0.0, 0

    def update(self, stretch: Stretch) -> None:
        """Add squares."""
        angles = self.of(stretch)
        self.total += float(same_bits.dot(angles, angles))
        self.count += len(angles)

    def value(self, end: TrialEnd) -> float | None:
        """Return rad."""
        del end
        return math.sqrt(self.total / self.count) if self.count else None


class BaseRollRms(_Angle):
    """sqrt(1/N sum_t roll_t^2), rad: how far the trunk leans to its sides."""

    spec = lower_better("base_roll_rms", "rad", 1.0, "root mean square of the trunk's roll")

    def of(self, stretch: Stretch) -> Array:
        """Return the roll."""
        return stretch.roll


class BasePitchRms(_Angle):
    """sqrt(1/N sum_t pitch_t^2), rad: how far the trunk leans forward or back; slopes count too."""

    spec = lower_better("base_pitch_rms", "rad", 1.0, "root mean square of the trunk's pitch")

    def of(self, stretch: Stretch) -> Array:
        """Return the pitch."""
        return stretch.pitch


TOUCHING = 2.0
"""N; a foot with more is in contact, as `foot_contacts` has it."""


class FootSlip(Score):
    """Mean horizontal speed of the feet's centres while they are in contact, m/s.

    1/n sum |p_t - p_t-1|_xy / T over all feet and control steps at whose both ends the foot carries
    more than 2 N. A round foot that rolls without sliding counts a little, too.

    Source: the penalty `feet_slip` of G. B. Margolis and P. Agrawal, "Walk these ways", CoRL 2022,
    as a mean speed.
    """

    joined = ("before", "carried")
    spec = lower_better("foot_slip", "m/s", 1.0, "mean horizontal speed of feet that carry load")

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.before = np.zeros((0, 3))
        self.carried = np.zeros(0, dtype=np.bool_)
        self.way, self.count = 0.0, 0

    def update(self, stretch: Stretch) -> None:
        """Add the ways of feet that stayed in contact."""
        places, carries = stretch.foot_positions, stretch.foot_forces > TOUCHING
        if len(self.before):
            places = np.concatenate([self.before[np.newaxis], places])
            carries = np.concatenate([self.carried[np.newaxis], carries])
        self.before, self.carried = places[-1].copy(), carries[-1].copy()
        held = carries[1:] & carries[:-1]
        if not (count := int(np.count_nonzero(held))):
            return
        moved = (places[1:, :, :2] - places[:-1, :, :2])[held]
        self.way += float(np.hypot(moved[:, 0], moved[:, 1]).sum())
        self.count += count

    def value(self, end: TrialEnd) -> float | None:
        """Return m/s; None where no foot stayed in contact."""
        del end
        return self.way / self.count / self.figures.control_period if self.count else None


class ContactImpulse(Score):
    """max_t,f F_f T: the largest impulse on a foot in one control step, N s.

    F is the contact force at the end of the control step, and T its length.
    """

    spec = lower_better(
        "contact_impulse", "N s", 100.0, "largest contact force on a foot times a control step"
    )

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.largest = -1.0

    def update(self, stretch: Stretch) -> None:
        """Look for a larger force."""
        self.largest = max(self.largest, float(stretch.foot_forces.max()))

    def value(self, end: TrialEnd) -> float | None:
        """Return N s."""
        del end
        return self.largest * self.figures.control_period if self.largest >= 0.0 else None


class TimeToFinish(Score):
    """Simulated time of a trial that was completed, s; undefined for all others."""

    spec = lower_better("time_to_finish", "s", 60.0, "simulated time until the task was completed")

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
    joined = ("x", "y")

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
    spec = lower_better(
        "tracking_error_linear",
        "m/s",
        2.0,
        "mean distance of the trunk's horizontal velocity from the command",
    )


class AngularTracking(_Tracking):
    """1/N sum_t |w*_z - w_z|, rad/s, about the trunk's z axis, at control rate; else as above.

    Source: the error within the reward `tracking_ang_vel` of N. Rudin et al., as above.
    """

    angular = True
    spec = lower_better(
        "tracking_error_angular",
        "rad/s",
        2.0,
        "mean distance of the trunk's yaw rate from the command",
    )
