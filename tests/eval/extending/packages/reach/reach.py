from math import cos, hypot, sin
from typing import Literal

import numpy as np

from nw_eval import Goal, Task, TaskSettings


class ReachSettings(TaskSettings):
    kind: Literal["reach"] = "reach"
    ahead: float = 1.0  # m from the start
    within: float = 0.5  # m


class Reach(Task):
    """Come within some distance of a point ahead of the start."""

    kind = "reach"
    settings = ReachSettings

    def __init__(self, settings, rules):
        self.ahead, self.within, self.duration = settings.ahead, settings.within, rules.duration
        self.distance, self.time, self.is_upright = settings.ahead, 0.0, True

    def reset(self, streams, scene, robot):
        spawn, random = scene.spawn, streams.generator("spawn")
        x, y, _ = spawn.position
        yaw = spawn.yaw + spawn.yaw_jitter * random.uniform(-1.0, 1.0)
        self.point = np.array([x + self.ahead * cos(yaw), y + self.ahead * sin(yaw), 0.0])
        self.goal = Goal(x=x, y=y, yaw=yaw, waypoints=self.point[None])
        return self.goal

    def update(self, readings):
        self.distance = hypot(*(self.point - readings.trunk_position)[:2])
        self.time, self.is_upright = readings.time, readings.uprightness > 0.5
        return ()

    def end(self):
        if self.distance <= self.within:
            return "completed"
        if not self.is_upright:
            return "fell"
        return "timeout" if self.time >= self.duration else None

    @property
    def end_reason(self):
        return {"completed": "distance", "fell": "tilt", "timeout": "time"}.get(self.end(), "")

    @property
    def success(self):
        return float(self.distance <= self.within)

    @property
    def target(self):
        return self.point

    def state(self):
        return {"reach": np.array([self.distance, self.time, self.is_upright]).tobytes()}

    def restore(self, state):
        self.distance, self.time, upright = np.frombuffer(state["reach"]).tolist()
        self.is_upright = bool(upright)
