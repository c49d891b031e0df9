"""The task `course`: a scene's waypoints in their order.

Here are progress along the course, when a trial ends, and where it begins: `draw_start` is the only
randomness of the world.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from nw_base import same_bits
from nw_base.errors import SceneError
from nw_base.memory import read_only
from nw_base.protocol import STRICT, EvaluationProtocol
from nw_base.words import Outcome
from nw_scenes.finding import SceneFinding
from nw_sim.tasks.task import (
    Goal,
    Place,
    Readings,
    Streams,
    Task,
    TaskEvent,
    TaskRobot,
    TaskRules,
    TaskSettings,
)

if TYPE_CHECKING:
    from nw_scenes.scene import Scene

PUBLISHED_FIRST_SEED = 10_000
"""From where the published evaluation numbers its episodes."""

REACH_RADIUS = 0.3  # m, in the ground plane; the waypoint's height does not matter
REACH_STEPS = 6  # control steps within the radius, of `_STEP` each
_STEP = 0.02  # s


class _Reached(NamedTuple):
    """All that changes in a trial."""

    updates: int  # control steps seen
    waypoint: int  # index of the one to go to
    reached: int  # how many are credited
    timer: int  # steps within reach of it
    times: tuple[float, ...]  # of the credits, s


class CourseProgress:
    """Counts waypoints. Call `update` once after every control step.

    A waypoint is credited on the step after its sixth step within 0.3 m, so a robot that enters at
    step n and stays has it at step n + 6; where control steps are not 0.02 s long, after as many of
    them as 0.12 s have. Waypoints count in order only. The six steps are
    consecutive if the protocol's `reach_timer_forgets`: leaving starts the count again. Otherwise
    it never goes back.

    Args:
        waypoints: (K, 3) world, m; K at least 1.
        protocol: see above.
        control_period: seconds between updates, for `times`.

    Attributes:
        places: x and y of each, m.

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
            raise SceneError("the course has no waypoints", fix="give the scene at least one")
        # Of a few plain numbers a step is computed in a third of the time that NumPy takes.
        self.places: list[list[float]] = self.waypoints[:, :2].tolist()
        self._forgets = protocol.reach_timer_forgets
        self._reach_steps = max(1, round(REACH_STEPS * _STEP / control_period))
        self._control_period = control_period
        self._so_far = _Reached(updates=0, waypoint=0, reached=0, timer=0, times=())

    def update(self, trunk_xy: npt.NDArray[np.float64] | Sequence[float]) -> bool:
        """Take the trunk's position after a control step; say if a waypoint was credited now.

        Args:
            trunk_xy: (2,) or (3,) world, m; only x and y count.
        """
        updates, index, reached, timer, times = self._so_far
        updates += 1
        total = len(self.places)
        credited = timer >= self._reach_steps and reached < total
        if timer >= self._reach_steps:
            index = min(index + 1, total - 1)
            timer = 0
        if credited:
            reached += 1
            times = (*times, updates * self._control_period)
        x, y = self.places[index]
        if math.hypot(x - float(trunk_xy[0]), y - float(trunk_xy[1])) < REACH_RADIUS:
            timer += 1
        elif self._forgets:
            timer = 0
        self._so_far = _Reached(updates, index, reached, timer, times)
        return credited

    @property
    def updates(self) -> int:
        """Control steps that it has seen."""
        return self._so_far.updates

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
        """Go back to a `state` of this course."""
        updates, waypoint, reached, timer, times = json.loads(state)
        self._so_far = _Reached(updates, waypoint, reached, timer, tuple(times))


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a trial may not exceed."""

    tilt: float = 1.2  # rad of roll or pitch; beyond it the robot fell
    height: float | None = None  # m of the trunk above the ground; below it the robot fell
    monitored_force: float = 10.0  # N on a monitored part; beyond it the robot collided
    stuck_after: float = 4.0  # s without getting `stuck_distance` closer to the course's end
    stuck_distance: float = 0.15  # m
    off_course_distance: float = 2.0  # m from the course, in the ground plane
    below_ground: float = 1.0  # m under the ground: fell through or off the scene

    @classmethod
    def of(cls, robot: TaskRobot) -> Self:
        """Return the limits of a robot."""
        return cls(
            tilt=robot.fell_tilt, height=robot.fell_height, monitored_force=robot.collided_force
        )

    @cached_property
    def _surely_upright(self) -> float:
        return math.cos(self.tilt) + 1e-6

    def have_fallen(self, world: Readings) -> bool:
        """Return whether a robot is tilted too far, or lies too low."""
        if world.uprightness < self._surely_upright:  # Neither angle is larger than that to z.
            roll, pitch, _ = world.roll_pitch_yaw
            if abs(roll) > self.tilt or abs(pitch) > self.tilt:
                return True
        return self.height is not None and world.height_over_ground() < self.height


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
    the robot is 2 m away from the course or a metre below the ground. Neither can take a credited
    waypoint away; they only end a trial that has stopped going anywhere.

    `collided` means more than the robot's limit (10 N for Go1 and Go2) on one monitored part at the
    end of a control step. Which parts those are is the robot's and the protocol's to say. A belly
    that hits an obstacle carries hundreds of newtons (the robot weighs 127 N), so the published
    limit, which is the head's, serves for the trunk as well. Without contact termination, as in the
    evaluation of LucidSim's repository, collisions are only counted.

    Args:
        waypoints: (K, 3) world, m, as the trial has them.
        start: (2,) or (3,) where the course begins, world, m: the spawn.
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
        self._onward = [*np.cumsum(lengths[::-1])[::-1].tolist(), 0.0]
        self._protocol = protocol
        self._last_step = round(duration / control_period)
        self._control_period = control_period
        self._contact_termination = contact_termination
        self.limits = Limits() if limits is None else limits
        to_first = same_bits.length(points[0] - corners[0])
        whole = to_first + self._onward[0]
        self._so_far = _SoFar(best_remaining=whole, best_step=0, contact_steps=0)

    @property
    def contact_seconds(self) -> float:
        """Simulated time so far during which head or trunk collided, s."""
        return self._so_far.contact_steps * self._control_period

    def check(self, world: Readings, progress: CourseProgress, step: int) -> Outcome | None:
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
        if limits.have_fallen(world):
            return "fell"
        if has_collided and self._contact_termination:
            return "collided"
        x, y, z = world.trunk_position.tolist()
        ground = world.scene.ground.z
        if self._protocol.ends_off_course and self._is_off_course(x, y, z, ground):
            return "off_course"
        if self._protocol.ends_when_stuck and self._is_stuck(x, y, progress, step):
            return "stuck"
        return "timeout" if step >= self._last_step else None

    def state(self) -> bytes:
        """Return how long it has waited and counted, for `restore`."""
        return repr([*self._so_far]).encode()  # the JSON of finite numbers, as in `CourseProgress`

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of this trial."""
        self._so_far = _SoFar(*json.loads(state))

    def _is_off_course(self, x: float, y: float, z: float, ground: float) -> bool:
        if z < ground - self.limits.below_ground:
            return True
        most, corners = self.limits.off_course_distance, self._corners
        return all(_distance(x, y, *span) > most for span in pairwise(corners))

    def _is_stuck(self, x: float, y: float, progress: CourseProgress, step: int) -> bool:
        goal_x, goal_y = progress.places[progress.index]
        off_x, off_y = goal_x - x, goal_y - y
        remaining = math.sqrt(off_x * off_x + off_y * off_y) + self._onward[progress.index]
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


class CourseSettings(TaskSettings):
    """`task: course`: it has no keys of its own, the scene has the waypoints."""

    kind: Literal["course"] = "course"


COURSE = CourseSettings()
"""The task where a suite names none."""


class Course(Task):
    """Waypoints in their order: `CourseProgress` counts them, `Termination` ends the trial."""

    kind = "course"
    settings = CourseSettings

    def __init__(
        self, settings: CourseSettings | None = None, rules: TaskRules | None = None
    ) -> None:
        del settings
        self._rules = TaskRules() if rules is None else rules
        self._limits = Limits()
        self._ended: Outcome | None = None
        self._readings: Readings | None = None
        self._progress: CourseProgress
        self._termination: Termination

    @classmethod
    def along(
        cls,
        waypoints: npt.NDArray[np.float64],
        start: npt.NDArray[np.float64] | Sequence[float] = (0.0, 0.0),
        rules: TaskRules | None = None,
    ) -> Course:
        """Return a course that has begun, along given waypoints.

        Args:
            waypoints: (K, 3) world, m.
            start: (2,) or (3,) where the course begins, world, m.
            rules: of the trial (default: the usual ones).
        """
        course = cls(rules=rules)
        x, y = (float(each) for each in start[:2])
        course._begin(x, y, 0.0, waypoints)
        return course

    def reset(self, streams: Streams, scene: Place, robot: TaskRobot) -> Goal:
        """Draw start and waypoints."""
        self._limits = Limits.of(robot)
        spawn = scene.spawn
        drawn = draw_start(
            streams,
            protocol=self._rules.protocol,
            spawn=(*spawn.position[:2], spawn.yaw),
            jitter=(spawn.x_jitter, spawn.y_jitter, spawn.yaw_jitter),
            trail=scene.trail,
            waypoint_noise=scene.waypoint_noise,
        )
        return self._begin(drawn.x, drawn.y, drawn.yaw, drawn.waypoints)

    def _begin(self, x: float, y: float, yaw: float, waypoints: npt.NDArray[np.float64]) -> Goal:
        rules = self._rules
        self._progress = CourseProgress(
            waypoints, rules.protocol, control_period=rules.control_period
        )
        self._termination = Termination(
            waypoints,
            (x, y),
            protocol=rules.protocol,
            duration=rules.duration,
            control_period=rules.control_period,
            limits=self._limits,
            contact_termination=rules.contact_termination,
        )
        self._ended, self._readings = None, None
        self.goal = Goal(x=x, y=y, yaw=yaw, waypoints=self._progress.waypoints)
        return self.goal

    def update(self, readings: Readings) -> tuple[TaskEvent, ...]:
        """Count a waypoint, and look whether the trial is over."""
        progress = self._progress
        credited = progress.update(readings.trunk_position)
        self._readings = readings
        self._ended = self._termination.check(readings, progress, progress.updates)
        if not credited:
            return ()
        number = progress.reached - 1
        text = f"waypoint {number + 1} of {progress.total}"
        return (TaskEvent("waypoint", text, number),)

    def end(self) -> Outcome | None:
        """Return what `Termination` says of the last control step."""
        return self._ended

    @property
    def end_reason(self) -> str:
        """Say what decided the outcome: the angle, the geom, the clock."""
        if self._ended is None or self._readings is None:
            return ""
        if self._ended == "fell":
            return fallen_by(self._readings, self._limits)
        if self._ended == "collided":
            return touched_by(self._readings)
        reasons: dict[Outcome, str] = {
            "completed": "all waypoints",
            "timeout": "time",
            "stuck": "no progress",
            "off_course": "distance to the course",
        }
        return reasons[self._ended]

    @property
    def reached(self) -> int:
        """How many waypoints have been credited."""
        return self._progress.reached

    @property
    def total(self) -> int:
        """How many waypoints there are."""
        return self._progress.total

    @property
    def times(self) -> tuple[float, ...]:
        """When each was credited, s since the reset."""
        return self._progress.times

    @property
    def contact_seconds(self) -> float:
        """Simulated time so far during which a monitored geom collided, s."""
        return self._termination.contact_seconds

    @property
    def target(self) -> npt.NDArray[np.float64]:
        """The waypoint to go to, (3,) world, m."""
        return self._progress.target

    def state(self) -> dict[str, bytes]:
        """Return progress and waiting."""
        return {"trail": self._progress.state(), "termination": self._termination.state()}

    def restore(self, state: Mapping[str, bytes]) -> None:
        """Go back, or on, to a `state`."""
        self._progress.restore(state["trail"])
        self._termination.restore(state["termination"])


def fallen_by(readings: Readings, limits: Limits) -> str:
    """Return what makes a fall: `roll`, `pitch` or `height`."""
    roll, pitch, _ = np.abs(readings.roll_pitch_yaw)
    if max(roll, pitch) <= limits.tilt:
        return "height"
    return "roll" if roll > limits.tilt and roll >= pitch else "pitch"


def touched_by(readings: Readings) -> str:
    """Return the monitored geom with the largest contact force: `contact face`."""
    forces = readings.monitored_forces()
    return f"contact {max(forces, key=forces.__getitem__)}"


def draw_start(
    streams: Streams,
    *,
    protocol: EvaluationProtocol,
    spawn: tuple[float, float, float],
    jitter: tuple[float, float, float],
    trail: npt.NDArray[np.float64],
    waypoint_noise: tuple[float, float],
) -> Goal:
    """Draw one trial's start and its waypoints.

    Args:
        streams: of which `spawn` and `waypoints` are drawn from.
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
        published = np.random.RandomState(PUBLISHED_FIRST_SEED + streams.index)
        published.uniform()  # The commanded speed, between 0.8 and 0.8 m / s.
        noise = published.uniform(-1.0, 1.0, size=(count, 2))[:, ::-1]  # y before x
        offset = published.uniform(-width, width)
    else:
        offset = streams.generator("spawn").uniform(-width, width)
        noise = streams.generator("waypoints").uniform(-1.0, 1.0, size=(count, 2))
    moved = trail.copy()
    if protocol.waypoint_noise_acts:
        moved[:, :2] += noise * np.asarray(waypoint_noise, dtype=np.float64)
    x, y, yaw = nominal + offset
    return Goal(x=float(x), y=float(y), yaw=float(yaw), waypoints=moved)


def waypoints_at_start(scene: Scene) -> int:
    """Return how many waypoints a robot that stays at its start can be credited with.

    They count in order, each within `REACH_RADIUS` of the trunk, seen from above. A trial may begin
    anywhere within the jitter of the spawn, and move a waypoint by its noise.
    """
    spawn = scene.spawn
    play = np.array([spawn.x_jitter, spawn.y_jitter]) + np.array(scene.waypoint_noise)
    away = np.abs(scene.trail[:, :2] - np.array(spawn.position[:2]))
    nearest = np.hypot(*np.maximum(away - play, 0.0).T)
    beyond = np.flatnonzero(~(nearest < REACH_RADIUS))
    return int(beyond[0]) if len(beyond) else len(scene.trail)


def start_finding(scene: Scene) -> SceneFinding | None:
    """Return that a robot which stays at the start reaches waypoints; None if it does not.

    Success would not be earned: `nw-eval run` refuses such a scene.
    """
    count = waypoints_at_start(scene)
    if not count:
        return None
    x, y, z = scene.trail[0].tolist()
    which = "waypoint 0 is" if count == 1 else f"waypoints 0 to {count - 1} are"
    return SceneFinding(
        code="waypoint_at_start",
        severity="error",
        message=f"{which} reached at the start: ({x:.2f}, {y:.2f}) is within {REACH_RADIUS:g} m of "
        "where a trial may begin, so a robot that stands still is credited",
        fix="remove what the robot need not walk to, or move the spawn back",
        value=float(np.hypot(x - scene.spawn.position[0], y - scene.spawn.position[1])),
        place=(x, y, z),
    )
