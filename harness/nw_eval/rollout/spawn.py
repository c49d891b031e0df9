"""Where a trial begins, and where its waypoints lie: the only randomness of the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.rollout.job import Protocol
from nw_eval.suite.trials import Trial

# The published evaluation numbers its episodes from here.
PUBLISHED_FIRST_SEED = 10_000


@dataclass(frozen=True, kw_only=True)
class Start:
    """A trial's start and its trail, world frame."""

    x: float  # m
    y: float  # m
    yaw: float  # rad
    trail: np.ndarray  # (K, 3) m


def draw_start(
    trial: Trial,
    *,
    protocol: Protocol,
    spawn: tuple[float, float, float],
    jitter: tuple[float, float, float],
    trail: np.ndarray,
    waypoint_noise: tuple[float, float],
) -> Start:
    """Draw one trial's start.

    Args:
        trial: whose streams `spawn` and `waypoints` are drawn from.
        protocol: `strict` moves spawn and waypoints, each from its own stream. `neverwhere-2026`
            draws in the published order from `RandomState(10000 + index)`, where waypoint noise
            consumes draws and moves nothing (reference: the published task, whose waypoints are
            mocap bodies that are placed before the noise is written).
        spawn: nominal x, y (m) and yaw (rad).
        jitter: half-widths of the uniform draws on x, y (m) and yaw (rad).
        trail: (K, 3) nominal waypoints, m.
        waypoint_noise: half-widths in x and y, m.
    """
    nominal = np.asarray(spawn, dtype=np.float64)
    width = np.asarray(jitter, dtype=np.float64)
    if protocol == "neverwhere-2026":
        published = np.random.RandomState(PUBLISHED_FIRST_SEED + trial.index)
        published.uniform(size=1 + 2 * len(trail))  # speed; y, x of waypoints
        offset = published.uniform(-width, width)
        moved = trail.copy()
    else:
        offset = trial.generator("spawn").uniform(-width, width)
        noise = trial.generator("waypoints").uniform(-1.0, 1.0, size=(len(trail), 2))
        moved = trail.copy()
        moved[:, :2] += noise * np.asarray(waypoint_noise, dtype=np.float64)
    x, y, yaw = nominal + offset
    return Start(x=float(x), y=float(y), yaw=float(yaw), trail=moved)
