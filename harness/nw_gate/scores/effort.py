"""What walking costs: power, torque, and how often a motor or a joint is at its limit.

A motor's torque is what its servo gives after clipping, and the damping of the servo, as on a real
robot (kp (q* - q) - kd dq): MuJoCo integrates the second part as damping of the joint. Power is
that torque times the joint's rate at the end of the physics step, the pair with which the
integrator does its work.
"""

from __future__ import annotations

import math

import numpy as np

from nw_base import same_bits
from nw_gate.scores.score import Figures, Score, Stretch, TrialEnd, lower_better


class _Energy(Score):
    """Positive mechanical work of all motors, J."""

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.energy = 0.0

    def update(self, stretch: Stretch) -> None:
        """Add work."""
        self.energy += stretch.work


class MeanPower(_Energy):
    """P = 1/T sum_t dt sum_j max(tau_j dq_j, 0), W, at physics rate.

    Positive mechanical power: a motor that brakes gives nothing back. Heat is not in it.

    Source: J. Lee, J. Hwangbo, L. Wellhausen, V. Koltun and M. Hutter, "Learning quadrupedal
    locomotion over challenging terrain", Science Robotics 5 (2020), the numerator of its
    mechanical cost of transport.
    """

    spec = lower_better("mean_power", "W", 1000.0, "mean positive mechanical power of all motors")

    def value(self, end: TrialEnd) -> float | None:
        """Return W; None of a trial without a step."""
        return self.energy / end.seconds if end.seconds > 0.0 else None


class CostOfTransport(_Energy):
    """COT = E / (m g d): the energy of `mean_power` for each newton of weight and metre of way.

    d is the trunk's way in the ground plane, sampled each 0.2 s, so that swaying is no progress.
    Undefined where d is under 0.1 m.

    Source: as `mean_power`, its mechanical cost of transport sum max(tau dq, 0) / (m g v).
    """

    spec = lower_better(
        "cost_of_transport", "", 5.0, "mechanical energy for each newton of weight and metre of way"
    )
    joined = ("x", "y")

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.distance, self.x, self.y = 0.0, math.nan, math.nan

    def update(self, stretch: Stretch) -> None:
        """Add work and way."""
        super().update(stretch)
        self.distance, self.x, self.y = way_after(self.distance, self.x, self.y, stretch)

    def value(self, end: TrialEnd) -> float | None:
        """Return the ratio; None where the robot went nowhere."""
        del end
        if self.distance < LEAST_WAY:
            return None
        return self.energy / (self.figures.mass * self.figures.gravity * self.distance)


LEAST_WAY = 0.1
"""m; over less a cost of transport has no meaning."""


def way_after(distance: float, x: float, y: float, stretch: Stretch) -> tuple[float, float, float]:
    """Return the way in the ground plane and where it ends after a stretch, (3,) m.

    Args:
        distance: before it, m.
        x: where that ended, m; NaN before the first stretch.
        y: of the same point, m.
        stretch: whose position each 0.2 s counts, and its last.
    """
    every = max(1, round(WAY_PERIOD / stretch.figures.control_period))
    places = stretch.position[:, :2]
    if math.isnan(x):
        x, y = places[0].tolist()
    points = places[every - 1 :: every].tolist()
    if len(places) % every:
        points.append(places[-1].tolist())
    for now_x, now_y in points:
        distance += math.hypot(now_x - x, now_y - y)
        x, y = now_x, now_y
    return distance, x, y


WAY_PERIOD = 0.2
"""s between two samples of the trunk's way; stretches, but for the last, are multiples of it."""


class PeakTorqueShare(Score):
    """max_t,j |tau_j| / limit_j, at physics rate.

    Over 1 where the damping of a servo adds to what it gives at its limit.
    """

    spec = lower_better(
        "peak_torque_share", "", 2.0, "largest torque of a motor as a share of its limit"
    )

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.peak = 0.0

    def update(self, stretch: Stretch) -> None:
        """Look for larger ones."""
        self.peak = max(self.peak, float(stretch.peak_shares.max()))

    def value(self, end: TrialEnd) -> float | None:
        """Return the share."""
        return self.peak if end.seconds else None


class TorqueRmsShare(Score):
    """sqrt(1/(T J) sum_t,j (tau_j / limit_j)^2), at physics rate: what warms the motors."""

    spec = lower_better(
        "torque_rms_share",
        "",
        1.0,
        "root mean square of all motors' torques as a share of their limits",
    )

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.total, self.count = 0.0, 0

    def update(self, stretch: Stretch) -> None:
        """Add squares."""
        shares = stretch.torque_shares.ravel()
        self.total += float(same_bits.dot(shares, shares))
        self.count += shares.size

    def value(self, end: TrialEnd) -> float | None:
        """Return the share."""
        del end
        return math.sqrt(self.total / self.count) if self.count else None


class LimitTime(Score):
    """Share of control steps in which any joint is at a limit.

    That is within 0.01 rad of the end of its range, or its motor gives its largest torque or more
    in any physics step of the control step.
    """

    spec = lower_better(
        "limit_time",
        "",
        1.0,
        "share of the time in which a joint is at the end of its range, or its motor at "
        "its largest torque",
    )

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.steps, self.at_limit, self.first = 0, 0, -1

    def update(self, stretch: Stretch) -> None:
        """Count control steps."""
        joints, (low, high) = stretch.joint_positions, self.figures.inner_ranges
        ends = ((joints < low) | (joints > high)).any(axis=1)
        # |tau| / limit rounds to 1 only where |tau| is the limit or more.
        at_limit = ends | (stretch.peak_shares >= 1.0)
        if count := int(np.count_nonzero(at_limit)):
            self.at_limit += count
            if self.first < 0:
                self.first = self.steps + int(at_limit.argmax()) + 1
        self.steps += len(joints)

    def value(self, end: TrialEnd) -> float | None:
        """Return the share."""
        del end
        return self.at_limit / self.steps if self.steps else None

    def moment(self) -> float | None:
        """Return the end of the first control step at a limit, s."""
        return None if self.first < 0 else self.first * self.figures.control_period
