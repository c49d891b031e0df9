"""Where a robot starts, while nobody says so: a little before the trail, looking along it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nw_eval.twin.label.course.ground import Ground
from nw_eval.twin.label.placement import Point
from nw_eval.twin.label.state import StartPose

_BEFORE = 1.0  # m from the start to the first waypoint


def start_before(waypoints: Sequence[Point], ground: Ground) -> StartPose:
    """Return the start 1 m before the first waypoint, on the ground; without one, the origin."""
    if not waypoints:
        return StartPose(position=(0.0, 0.0, 0.0), yaw=0.0)
    first = np.array(waypoints[0])
    ahead = np.array(waypoints[1] if len(waypoints) > 1 else first)[:2] - first[:2]
    yaw = math.atan2(ahead[1], ahead[0])
    x, y = first[:2] - _BEFORE * np.array([math.cos(yaw), math.sin(yaw)])
    level = float(first[2])
    position = ground.dropped(float(x), float(y), level)
    return StartPose(position=position or (float(x), float(y), level), yaw=yaw)
