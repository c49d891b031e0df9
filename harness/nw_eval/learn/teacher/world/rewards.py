"""What a control step is worth: the reference recipe's rewards, and two for clearance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.learn.teacher.config import RewardWeights
from nw_eval.learn.teacher.world.body import Bodies
from nw_eval.learn.teacher.world.senses import SPEED

Array = NDArray[np.float64]

_LOWEST = -0.4
"""A second. Without a bound falling early would pay; with 0, turning would be unlearnt."""
_HIPS = np.array([0, 3, 6, 9])
_FACE, _FACE_CLEARANCE = (0.32, 0.0, -0.035), 0.09
"""The lower front edge of the head, trunk frame, m; and the height that it should keep, m."""
_BELLY, _BELLY_CLEARANCE = ((0.13, 0.0, -0.057), (0.0, 0.0, -0.057), (-0.13, 0.0, -0.057)), 0.05
_LOOK_AHEAD = 0.1
"""Metres ahead of the face that must be cleared as well."""

POINTS = 2 + len(_BELLY)


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotMoments:
    """What rewards look at: robots after a control step.

    Attributes:
        body: of N robots.
        direction: (N, 2) unit vectors to the waypoints.
        delta_yaw: (N,) angle to them, rad.
        joint_rates_before: (N, 12) rad / s, one step earlier.
        torques: (N, 12) N m.
        change: (N,) norm of the raw actions' change.
        touching: (N,) parts that touch something and should not.
        on_edge: (N,) feet that push next to an edge.
        beneath: (N, POINTS) heights of the ground under `clearance_points`, m.
        is_flat: (N,) whether nothing is in the way.
        is_sloped: (N,) whether the course leans itself.
    """

    body: Bodies
    direction: Array
    delta_yaw: Array
    joint_rates_before: Array
    torques: Array
    change: Array
    touching: Array
    on_edge: Array
    beneath: Array
    is_flat: NDArray[np.bool_]
    is_sloped: NDArray[np.bool_]


def clearance_points(body: Bodies) -> Array:
    """Return the points that should stay clear of the ground, (N, POINTS, 3) world, m."""
    face = body.at(_FACE)
    ahead = face.copy()
    ahead[:, 0] += _LOOK_AHEAD * np.cos(body.yaw)
    ahead[:, 1] += _LOOK_AHEAD * np.sin(body.yaw)
    return np.stack([face, ahead, *(body.at(point) for point in _BELLY)], axis=1)


def rewards(now: RobotMoments, weights: RewardWeights, pose: Array, period: float) -> Array:
    """Return the rewards of one control step, (N,); a failure's is not among them.

    Args:
        now: the robots.
        weights: of the terms.
        pose: (12,) default joint positions, rad.
        period: of a control step, s.
    """
    body, gravity = now.body, now.body.gravity
    speed = np.einsum("ni,ni->n", now.direction, body.velocity[:, :2])
    turn = np.clip(1.5 * now.delta_yaw, -1.2, 1.2)
    offset = body.joints - pose
    jerk = (body.joint_rates - now.joint_rates_before) / period
    height = clearance_points(body)[:, :, 2] - now.beneath
    face = height[:, :2].min(axis=1)
    belly = height[:, 2:].min(axis=1)
    leaning = gravity[:, 1] ** 2 * ~now.is_sloped + gravity[:, 0] ** 2 * now.is_flat
    total = (
        weights.progress * np.maximum(np.minimum(speed, SPEED) / SPEED, -1.0)
        + weights.heading * np.exp(-np.abs(now.delta_yaw))
        + weights.turning * np.exp(-((body.rates[:, 2] - turn) ** 2) / 0.25)
        - weights.bouncing * np.minimum(body.velocity[:, 2] ** 2, 4.0)
        - weights.wobbling * np.minimum((body.rates[:, :2] ** 2).sum(axis=1), 40.0)
        - weights.leaning * leaning
        - weights.jerking * (jerk**2).sum(axis=1)
        - weights.touching * np.minimum(now.touching, 3)
        - weights.changing * now.change
        - weights.straining * (now.torques**2).sum(axis=1)
        - weights.spreading * (offset[:, _HIPS] ** 2).sum(axis=1)
        - weights.posing * (offset**2).sum(axis=1)
        - weights.edges * now.on_edge
        - weights.face * np.clip(1.0 - face / _FACE_CLEARANCE, 0.0, 1.5)
        - weights.belly * np.clip(1.0 - belly / _BELLY_CLEARANCE, 0.0, 1.5)
    )
    return np.maximum(total, _LOWEST) * period
