"""Progress along a trail, which waypoints the robot has reached in order; and when a trial ends."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from nw_eval.arrays import read_only
from nw_eval.errors import SceneError
from nw_eval.protocol import STRICT, EvaluationProtocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.robots import RobotSpec
    from nw_eval.sim.world import World
    from nw_eval.words import Outcome


REACH_RADIUS = 0.3  # m, in the ground plane; the waypoint's height does not matter
REACH_STEPS = 6  # control steps within the radius


class _Reached(NamedTuple):
    """All that changes in a trial."""

    updates: int  # control steps seen
    waypoint: int  # index of the one to go to
    reached: int  # how many are credited
    timer: int  # steps within reach of it
    times: tuple[float, ...]  # of the credits, s


class TrailProgress:
    """Counts waypoints. Call `update` once after every control step.

    A waypoint is credited on the step after its sixth step within 0.3 m, so a robot that enters at
    step n and stays has it at step n + 6. Waypoints count in order only. The six steps are
    consecutive if the protocol's `reach_timer_forgets`: leaving starts the count again. Otherwise
    it never goes back.

    Args:
        waypoints: (K, 3) world, m; K at least 1.
        protocol: see above.
        control_period: seconds between updates, for `times`.

    Raises:
        SceneError: there is no waypoint.
    """

    def __init__(
        self,
        waypoints: npt.NDArray[np.float64],
        protocol: EvaluationProtocol = STRICT,
        *,
        control_period: float = 0.02,
    ) -> None:
        self.waypoints = read_only(np.array(waypoints, dtype=np.float64).reshape(-1, 3))
        if not len(self.waypoints):
            raise SceneError("a trail without waypoints", fix="give the scene at least one")
        self._forgets = protocol.reach_timer_forgets
        self._control_period = control_period
        self._so_far = _Reached(updates=0, waypoint=0, reached=0, timer=0, times=())

    def update(self, trunk_xy: npt.NDArray[np.float64] | Sequence[float]) -> bool:
        """Take the trunk's position after a control step; say if a waypoint was credited now.

        Args:
            trunk_xy: (2,) or (3,) world, m; only x and y count.
        """
        updates, index, reached, timer, times = self._so_far
        updates += 1
        credited = timer >= REACH_STEPS and reached < self.total
        if timer >= REACH_STEPS:
            index = min(index + 1, self.total - 1)
            timer = 0
        if credited:
            reached += 1
            times = (*times, updates * self._control_period)
        offset = self.waypoints[index, :2] - np.asarray(trunk_xy, dtype=np.float64)[:2]
        if np.hypot(offset[0], offset[1]) < REACH_RADIUS:
            timer += 1
        elif self._forgets:
            timer = 0
        self._so_far = _Reached(updates, index, reached, timer, times)
        return credited

    @property
    def index(self) -> int:
        """Index of the waypoint to go to; stays at the last one when all are reached."""
        return self._so_far.waypoint

    @property
    def reached(self) -> int:
        """How many waypoints have been credited."""
        return self._so_far.reached

    @property
    def total(self) -> int:
        """How many waypoints there are."""
        return len(self.waypoints)

    @property
    def fraction(self) -> float:
        """Share of the waypoints credited, 0 to 1: the success rate of the trial."""
        return self.reached / self.total

    @property
    def target(self) -> npt.NDArray[np.float64]:
        """The waypoint to go to, (3,) world, m."""
        return self.waypoints[self.index].copy()

    @property
    def times(self) -> tuple[float, ...]:
        """When each waypoint was credited, seconds since the reset."""
        return self._so_far.times

    def state(self) -> bytes:
        """Return how far it is, for `restore`."""
        *counts, times = self._so_far
        # The JSON of finite numbers, whose encoder takes ten times as long.
        return repr([*counts, [*times]]).encode()

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of this trail."""
        updates, waypoint, reached, timer, times = json.loads(state)
        self._so_far = _Reached(updates, waypoint, reached, timer, tuple(times))


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a trial may not exceed."""

    tilt: float = 1.2  # rad of roll or pitch; beyond it the robot fell
    height: float | None = None  # m of the trunk above the ground; below it the robot fell
    monitored_force: float = 10.0  # N on a monitored part; beyond it the robot collided
    stuck_after: float = 4.0  # s without getting `stuck_distance` closer to the trail's end
    stuck_distance: float = 0.15  # m
    off_course_distance: float = 2.0  # m from the trail, in the ground plane
    below_ground: float = 1.0  # m under the ground: fell through or off the scene

    @classmethod
    def of(cls, robot: RobotSpec) -> Self:
        """Return the limits of a robot."""
        return cls(
            tilt=robot.fell_tilt, height=robot.fell_height, monitored_force=robot.collided_force
        )


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

    `collided` means more than the robot's limit (10 N for Go1 and Go2) on one monitored part at the
    end of a control step. Which parts those are is the robot's and the protocol's to say. A belly
    that hits an obstacle carries hundreds of newtons (the robot weighs 127 N), so the published
    limit, which is the head's, serves for the trunk as well. Without contact termination, as in the
    evaluation of LucidSim's repository, collisions are only counted.

    Args:
        waypoints: (K, 3) world, m, as the trial has them.
        start: (2,) or (3,) where the trail begins, world, m: the spawn.
        protocol: whether it `ends_when_stuck` and `ends_off_course`.
        duration: of the trial, s.
        control_period: seconds of one control step.
        limits: thresholds, the robot's (`Limits.of`); None = those of Go1 and Go2.
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
        self.limits = Limits() if limits is None else limits
        self._surely_upright = math.cos(self.limits.tilt) + 1e-6
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
        limits = self.limits
        has_collided = world.monitored_force() > limits.monitored_force
        if has_collided:
            self._so_far = self._so_far._replace(contact_steps=self._so_far.contact_steps + 1)
        if progress.reached == progress.total:
            return "completed"
        if self._has_fallen(world):
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

    def _has_fallen(self, world: World) -> bool:
        limits = self.limits
        if world.uprightness < self._surely_upright:  # Neither angle is larger than that to z.
            roll, pitch, _ = world.roll_pitch_yaw
            if abs(roll) > limits.tilt or abs(pitch) > limits.tilt:
                return True
        return limits.height is not None and world.height_over_ground() < limits.height

    def _is_off_course(self, position: npt.NDArray[np.float64], ground: float) -> bool:
        if position[2] < ground - self.limits.below_ground:
            return True
        x, y = position[:2].tolist()
        most, corners = self.limits.off_course_distance, self._corners
        return all(_distance(x, y, *span) > most for span in pairwise(corners))

    def _is_stuck(
        self, position: npt.NDArray[np.float64], progress: TrailProgress, step: int
    ) -> bool:
        offset = progress.target[:2] - position
        remaining = math.sqrt(offset.dot(offset)) + float(self._onward[progress.index])
        if remaining < self._so_far.best_remaining - self.limits.stuck_distance:
            self._so_far = self._so_far._replace(best_remaining=remaining, best_step=step)
        waited = (step - self._so_far.best_step) * self._control_period
        return waited >= self.limits.stuck_after


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
