"""Where a trial begins, and where its waypoints lie: the only randomness of the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.protocol import EvaluationProtocol
from nw_eval.suite.trials import Trial

# The published evaluation numbers its episodes from here.
PUBLISHED_FIRST_SEED = 10_000


@dataclass(frozen=True, kw_only=True)
class DrawnStart:
    """A trial's start and its trail, world frame."""

    x: float  # m
    y: float  # m
    yaw: float  # rad
    trail: np.ndarray  # (K, 3) m


def draw_start(
    trial: Trial,
    *,
    protocol: EvaluationProtocol,
    spawn: tuple[float, float, float],
    jitter: tuple[float, float, float],
    trail: np.ndarray,
    waypoint_noise: tuple[float, float],
) -> DrawnStart:
    """Draw one trial's start.

    Args:
        trial: whose streams `spawn` and `waypoints` are drawn from.
        protocol: whether spawn and waypoints are drawn each from its own stream, or all in the
            published order from `RandomState(10000 + index)`: `one_start_for_all_scenes`; and
            whether `waypoint_noise_acts`. Noise that does not act consumes draws all the same.
        spawn: nominal x, y (m) and yaw (rad).
        jitter: half-widths of the uniform draws on x, y (m) and yaw (rad).
        trail: (K, 3) nominal waypoints, m.
        waypoint_noise: half-widths in x and y, m.
    """
    nominal = np.asarray(spawn, dtype=np.float64)
    width = np.asarray(jitter, dtype=np.float64)
    count = len(trail)
    if protocol.one_start_for_all_scenes:
        published = np.random.RandomState(PUBLISHED_FIRST_SEED + trial.index)
        published.uniform()  # The commanded speed, between 0.8 and 0.8 m / s.
        noise = published.uniform(-1.0, 1.0, size=(count, 2))[:, ::-1]  # y before x
        offset = published.uniform(-width, width)
    else:
        offset = trial.generator("spawn").uniform(-width, width)
        noise = trial.generator("waypoints").uniform(-1.0, 1.0, size=(count, 2))
    moved = trail.copy()
    if protocol.waypoint_noise_acts:
        moved[:, :2] += noise * np.asarray(waypoint_noise, dtype=np.float64)
    x, y, yaw = nominal + offset
    return DrawnStart(x=float(x), y=float(y), yaw=float(yaw), trail=moved)
