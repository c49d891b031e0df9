"""When a trial ends, and how."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from nw_eval.protocol import STRICT, EvaluationProtocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.sim.trail import TrailProgress
    from nw_eval.sim.world import World
    from nw_eval.words import Outcome


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a trial may not exceed."""

    tilt: float = 1.2  # rad of roll or pitch; beyond it the robot fell
    monitored_force: float = 10.0  # N on a monitored geom; beyond it the robot collided
    stuck_after: float = 4.0  # s without getting `stuck_distance` closer to the trail's end
    stuck_distance: float = 0.15  # m
    off_course_distance: float = 2.0  # m from the trail, in the ground plane
    below_ground: float = 1.0  # m under the ground: fell through or off the scene


class _SoFar(NamedTuple):
    """All that changes in a trial."""

    best_remaining: float  # m, the shortest way to the last waypoint so far
    best_step: int  # when that was
    contact_steps: int  # control steps with a collision so far


class Termination:
    """Decides after each control step whether the trial is over.

    Published outcomes, in this order: `completed` (all waypoints), `fell`, `collided`, `timeout`.
    A protocol may add two that the published evaluation lets run to the timeout: `stuck`, when for
    4 s the way that is left to the last waypoint has not shrunk by 0.15 m, and `off_course`, when
    the robot is 2 m away from the trail or a metre below the ground. Neither can take a credited
    waypoint away; they only end a trial that has stopped going anywhere.

    `collided` means more than 10 N on one monitored geom at the end of a control step. Which geoms
    those are is the robot's and the protocol's to say. A belly that hits an obstacle carries
    hundreds of newtons (the robot weighs 127 N), so the published limit, which is the head's,
    serves for the trunk as well. Without contact termination, as in the evaluation of LucidSim's
    repository, collisions are only counted.

    Args:
        waypoints: (K, 3) world, m, as the trial has them.
        start: (2,) or (3,) where the trail begins, world, m: the spawn.
        protocol: whether it `ends_when_stuck` and `ends_off_course`.
        duration: of the trial, s.
        control_period: seconds of one control step.
        limits: thresholds.
        contact_termination: whether a collision ends the trial.
    """

    def __init__(
        self,
        waypoints: npt.NDArray[np.float64],
        start: npt.NDArray[np.float64] | Sequence[float],
        *,
        protocol: EvaluationProtocol = STRICT,
        duration: float = 12.0,
        control_period: float = 0.02,
        limits: Limits | None = None,
        contact_termination: bool = True,
    ) -> None:
        points = np.asarray(waypoints, dtype=np.float64).reshape(-1, 3)[:, :2]
        corners = np.vstack([np.asarray(start, dtype=np.float64)[:2], points])
        self._corners = corners.tolist()
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        # Way from each waypoint to the last one.
        self._onward = np.concatenate([np.cumsum(lengths[::-1])[::-1], [0.0]])
        self._protocol = protocol
        self._last_step = round(duration / control_period)
        self._control_period = control_period
        self._contact_termination = contact_termination
        self._limits = Limits() if limits is None else limits
        self._surely_upright = math.cos(self._limits.tilt) + 1e-6
        to_first = float(np.linalg.norm(points[0] - corners[0]))
        whole = to_first + float(self._onward[0])
        self._so_far = _SoFar(best_remaining=whole, best_step=0, contact_steps=0)

    @property
    def contact_seconds(self) -> float:
        """Simulated time so far during which head or trunk collided, s."""
        return self._so_far.contact_steps * self._control_period

    def check(self, world: World, progress: TrailProgress, step: int) -> Outcome | None:
        """Return how the trial ends now, or None if it goes on.

        Args:
            world: after its control step.
            progress: after its update for that step.
            step: control steps done, 1 after the first.
        """
        limits = self._limits
        has_collided = world.monitored_force() > limits.monitored_force
        if has_collided:
            self._so_far = self._so_far._replace(contact_steps=self._so_far.contact_steps + 1)
        if progress.reached == progress.total:
            return "completed"
        if world.uprightness < self._surely_upright:  # Neither angle is larger than that to z.
            roll, pitch, _ = world.roll_pitch_yaw
            if abs(roll) > limits.tilt or abs(pitch) > limits.tilt:
                return "fell"
        if has_collided and self._contact_termination:
            return "collided"
        position = world.trunk_position
        ground = world.scene.ground.z
        if self._protocol.ends_off_course and self._is_off_course(position, ground):
            return "off_course"
        if self._protocol.ends_when_stuck and self._is_stuck(position[:2], progress, step):
            return "stuck"
        return "timeout" if step >= self._last_step else None

    def state(self) -> bytes:
        """Return how long it has waited and counted, for `restore`."""
        return repr([*self._so_far]).encode()  # the JSON of finite numbers, as in `TrailProgress`

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of this trial."""
        self._so_far = _SoFar(*json.loads(state))

    def _is_off_course(self, position: npt.NDArray[np.float64], ground: float) -> bool:
        if position[2] < ground - self._limits.below_ground:
            return True
        x, y = position[:2].tolist()
        most, corners = self._limits.off_course_distance, self._corners
        return all(_distance(x, y, *span) > most for span in pairwise(corners))

    def _is_stuck(
        self, position: npt.NDArray[np.float64], progress: TrailProgress, step: int
    ) -> bool:
        offset = progress.target[:2] - position
        remaining = math.sqrt(offset.dot(offset)) + float(self._onward[progress.index])
        if remaining < self._so_far.best_remaining - self._limits.stuck_distance:
            self._so_far = self._so_far._replace(best_remaining=remaining, best_step=step)
        waited = (step - self._so_far.best_step) * self._control_period
        return waited >= self._limits.stuck_after


def distance_to_polyline(point: npt.NDArray[np.float64], corners: npt.NDArray[np.float64]) -> float:
    """Return the distance of a point (2,) from the polyline through corners (C, 2), C >= 2."""
    x, y = point.tolist()
    return min(_distance(x, y, *span) for span in pairwise(corners.tolist()))


def _distance(x: float, y: float, start: Sequence[float], end: Sequence[float]) -> float:
    """Return the distance of (x, y) from the line between two points; all in m."""
    from_x, from_y = x - start[0], y - start[1]
    span_x, span_y = end[0] - start[0], end[1] - start[1]
    squared = span_x * span_x + span_y * span_y
    along = (from_x * span_x + from_y * span_y) / squared if squared > 0.0 else 0.0
    along = min(max(along, 0.0), 1.0)
    return math.hypot(from_x - along * span_x, from_y - along * span_y)
