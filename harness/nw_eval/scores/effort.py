"""What walking costs: power, torque, and how often a motor or a joint is at its limit.

A motor's torque is what its servo gives after clipping, and the damping of the servo, as on a real
robot (kp (q* - q) - kd dq): MuJoCo integrates the second part as damping of the joint. Power is
that torque times the joint's rate at the end of the physics step, the pair with which the
integrator does its work.
"""

from __future__ import annotations

import math

import numpy as np

from nw_eval.scores.score import Figures, Score, ScoreSpec, Stretch, TrialEnd


class _Energy(Score):
    """Positive mechanical work of all motors, J."""

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.energy = 0.0

    def update(self, stretch: Stretch) -> None:
        work = np.maximum(stretch.torques * stretch.joint_rates, 0.0).sum()
        self.energy += float(work) * self.figures.timestep


class MeanPower(_Energy):
    """P = 1/T sum_t dt sum_j max(tau_j dq_j, 0), W, at physics rate.

    Positive mechanical power: a motor that brakes gives nothing back. Heat is not in it.

    Source: J. Lee, J. Hwangbo, L. Wellhausen, V. Koltun and M. Hutter, "Learning quadrupedal
    locomotion over challenging terrain", Science Robotics 5 (2020), the numerator of its
    mechanical cost of transport.
    """

    spec = ScoreSpec(
        name="mean_power",
        unit="W",
        better="lower",
        low=0.0,
        high=1000.0,
        undefined=1000.0,
        meaning="mean positive mechanical power of all motors",
    )

    def value(self, end: TrialEnd) -> float | None:
        """Return W; None of a trial without a step."""
        return self.energy / end.seconds if end.seconds > 0.0 else None


class CostOfTransport(_Energy):
    """COT = E / (m g d): the energy of `mean_power` for each newton of weight and metre of way.

    d is the trunk's way in the ground plane, sampled each 0.2 s, so that swaying is no progress.
    Undefined where d is under 0.1 m.

    Source: as `mean_power`, its mechanical cost of transport sum max(tau dq, 0) / (m g v).
    """

    spec = ScoreSpec(
        name="cost_of_transport",
        unit="",
        better="lower",
        low=0.0,
        high=5.0,
        undefined=5.0,
        meaning="mechanical energy for each newton of weight and metre of way",
    )

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.distance, self.last = 0.0, np.full(2, np.nan)

    def update(self, stretch: Stretch) -> None:
        """Add work and way."""
        super().update(stretch)
        self.distance, self.last = way_after(self.distance, self.last, stretch)

    def value(self, end: TrialEnd) -> float | None:
        """Return the ratio; None where the robot went nowhere."""
        del end
        if self.distance < LEAST_WAY:
            return None
        return self.energy / (self.figures.mass * self.figures.gravity * self.distance)


LEAST_WAY = 0.1
"""m; over less a cost of transport has no meaning."""


def way_after(distance: float, last: np.ndarray, stretch: Stretch) -> tuple[float, np.ndarray]:
    """Return the way in the ground plane, m, and where it ends, (2,), after a stretch.

    Args:
        distance: before it, m.
        last: where that ended, (2,); NaN before the first stretch.
        stretch: of which the last position counts.
    """
    x, y = stretch.position[-1, :2].tolist()
    px, py = last.tolist()
    if math.isnan(px):
        px, py = stretch.position[0, :2].tolist()
    return distance + math.hypot(x - px, y - py), np.array([x, y])


class PeakTorqueShare(Score):
    """max_t,j |tau_j| / limit_j, at physics rate.

    Over 1 where the damping of a servo adds to what it gives at its limit.
    """

    spec = ScoreSpec(
        name="peak_torque_share",
        unit="",
        better="lower",
        low=0.0,
        high=2.0,
        undefined=2.0,
        meaning="largest torque of a motor as a share of its limit",
    )

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.peaks = np.zeros(len(figures.torque_limits))

    def update(self, stretch: Stretch) -> None:
        """Look for larger ones."""
        np.maximum(self.peaks, np.abs(stretch.torques).max(axis=(0, 1)), out=self.peaks)

    def value(self, end: TrialEnd) -> float | None:
        """Return the share."""
        return float((self.peaks / self.figures.torque_limits).max()) if end.seconds else None


class TorqueRmsShare(Score):
    """sqrt(1/(T J) sum_t,j (tau_j / limit_j)^2), at physics rate: what warms the motors."""

    spec = ScoreSpec(
        name="torque_rms_share",
        unit="",
        better="lower",
        low=0.0,
        high=1.0,
        undefined=1.0,
        meaning="root mean square of all motors' torques as a share of their limits",
    )

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.total, self.count = 0.0, 0

    def update(self, stretch: Stretch) -> None:
        """Add squares."""
        shares = stretch.torques / self.figures.torque_limits
        self.total += float((shares * shares).sum())
        self.count += stretch.torques.size

    def value(self, end: TrialEnd) -> float | None:
        """Return the share."""
        del end
        return math.sqrt(self.total / self.count) if self.count else None


_NEAR = 0.01  # rad from the end of a joint's range


class LimitTime(Score):
    """Share of control steps in which any joint is at a limit.

    That is within 0.01 rad of the end of its range, or its motor gives its largest torque or more
    in any physics step of the control step.
    """

    spec = ScoreSpec(
        name="limit_time",
        unit="",
        better="lower",
        low=0.0,
        high=1.0,
        undefined=1.0,
        meaning="share of the time in which a joint is at the end of its range, or its motor at "
        "its largest torque",
    )

    def __init__(self, figures: Figures) -> None:
        super().__init__(figures)
        self.steps, self.at_limit = 0, 0

    def update(self, stretch: Stretch) -> None:
        """Count control steps."""
        low, high = self.figures.joint_ranges[:, 0], self.figures.joint_ranges[:, 1]
        joints = stretch.joint_positions
        ends = ((joints < low + _NEAR) | (joints > high - _NEAR)).any(axis=1)
        full = (np.abs(stretch.torques) >= self.figures.torque_limits).any(axis=(1, 2))
        self.at_limit += int((ends | full).sum())
        self.steps += len(joints)

    def value(self, end: TrialEnd) -> float | None:
        """Return the share."""
        del end
        return self.at_limit / self.steps if self.steps else None
