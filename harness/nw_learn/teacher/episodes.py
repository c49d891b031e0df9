"""Episodes of many robots: physics, trails, senses and rewards, stepped together.

Rewards are the reference recipe's, and two for clearance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_learn.teacher.config import GROUNDS, RewardWeights, TrainingPhase
from nw_learn.teacher.curriculum import Curriculum
from nw_learn.teacher.lanes import Lanes
from nw_learn.teacher.senses import (
    SPEED,
    Bodies,
    Senses,
    bodies,
    heights_under,
    privileged_features,
    read_cells,
)
from nw_learn.teacher.simulation import Trails
from nw_scenes.robots import RobotSpec
from nw_sim.physics.batch import CONTROL_PERIOD, Simulation
from nw_sim.physics.forces import CONTACT_THRESHOLD
from nw_sim.tasks.course import Limits

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Flags = NDArray[np.bool_]

LONGEST = 600
"""Control steps of an episode, as evaluation has them."""
_SCALE, _CLIP = 0.25, 4.8
"""Of actions, as on the card of `go1-parkour`."""
_TOUCH = 0.1
"""N on a part that should not touch."""
_SUNK = -0.1
"""Height of a trunk that has fallen between two platforms, m; their tops are at 0."""
_JITTER = np.array([0.2, 0.2])  # m
_YAW, _FLAT_YAW, _POSE = 0.4, 1.5, 0.15  # rad
_DROP = (0.33, 0.41)  # m, the trunk above the ground at the start
_FLAT, _RAMPS = GROUNDS.index("flat"), GROUNDS.index("ramps")

_LOWEST = -0.4
"""A second. Without a bound falling early would pay; with 0, turning would be unlearnt."""
_HIPS = np.array([0, 3, 6, 9])
_FACE, _FACE_CLEARANCE = (0.32, 0.0, -0.035), 0.09
"""The lower front edge of the head, trunk frame, m; and the height that it should keep, m."""
_BELLY, _BELLY_CLEARANCE = ((0.13, 0.0, -0.057), (0.0, 0.0, -0.057), (-0.13, 0.0, -0.057)), 0.05
_LOOK_AHEAD = 0.1
"""Metres ahead of the face that must be cleared as well."""

POINTS = 2 + len(_BELLY)


class Sights(NamedTuple):
    """What actor and critic see: observations (n, 332), and what the critic alone may know."""

    observation: Single
    privileged: Single


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcomes:
    """How episodes ended in one control step; all (N,)."""

    complete: Flags
    fell: Flags
    collided: Flags
    stuck: Flags
    timeout: Flags

    @property
    def failed(self) -> Flags:
        """Which of them is the robot's failure."""
        return (self.fell | self.collided | self.stuck) & ~self.complete

    @property
    def over(self) -> Flags:
        """Which are over."""
        return self.failed | self.complete | self.timeout


@dataclass(frozen=True, kw_only=True, eq=False)
class Stepped:
    """One control step of all robots.

    Attributes:
        seen: after it, and after new episodes began.
        last: before new episodes began.
        rewards: (N,).
        outcomes: of episodes.
    """

    seen: Sights
    last: Sights
    rewards: Single
    outcomes: Outcomes


class Episodes:
    """N robots, each in an episode of its own; a new one begins where one ends.

    Args:
        robot: a `training_robot`.
        lanes: that there are.
        curriculum: what each robot does next.
        weights: of the rewards.
        rng: of starts.
        threads: of the physics.
    """

    def __init__(
        self,
        robot: RobotSpec,
        lanes: Lanes,
        curriculum: Curriculum,
        weights: RewardWeights,
        rng: np.random.Generator,
        *,
        threads: int,
    ) -> None:
        count = len(curriculum.tasks)
        self._pose = np.array(robot.default_pose)
        self._feet = len(robot.feet)
        self._monitored = slice(self._feet, self._feet + len(robot.monitored))
        self._lanes, self._curriculum, self._weights, self._rng = lanes, curriculum, weights, rng
        self._simulation = Simulation(robot, lanes.models, count, threads=threads)
        self._trails = Trails(count)
        self._senses = Senses(count, self._pose)
        self._steps = np.zeros(count, dtype=np.intp)
        self._everybody = np.arange(count)

    def begin(self, phase: TrainingPhase) -> Sights:
        """Begin the first episodes; later phases call `enter`."""
        self.enter(phase)
        self._start(self._everybody)
        # Robots that began together would all time out together.
        self._steps = self._rng.integers(0, LONGEST // 2, len(self._everybody))
        return self._see(self._everybody, self._bodies(self._everybody))

    def enter(self, phase: TrainingPhase) -> None:
        """Take tasks and time step of a phase."""
        self._simulation.set_timestep(phase.timestep)
        self._curriculum.begin(phase)

    def redraw(self) -> None:
        """Draw one random course anew, one in which no robot is."""
        empty = np.ones(self._lanes.random_count, dtype=np.bool_)
        taken = self._simulation.lanes
        empty[taken[taken < len(empty)]] = False
        if empty.any():
            number = int(self._rng.choice(np.flatnonzero(empty)))
            self._simulation.replace(number, self._lanes.redraw(number))

    def step(self, actions: Single) -> Stepped:
        """Run one control step with raw actions, (N, 12)."""
        senses, simulation = self._senses, self._simulation
        change = np.linalg.norm(actions - senses.output, axis=1)
        rates_before = simulation.qvel[:, 6:].copy()
        senses.take(actions.astype(np.float64))
        simulation.step(self._pose + _SCALE * np.clip(senses.applied, -_CLIP, _CLIP))
        self._steps += 1
        broken = simulation.broken()
        if broken.any():
            simulation.qpos[broken], simulation.qvel[broken] = 0.0, 0.0
            simulation.qpos[broken, 3] = 1.0
        body, touches = self._bodies(self._everybody), simulation.touches()
        touches[broken] = 0.0
        contacts = touches[:, : self._feet] > CONTACT_THRESHOLD
        senses.feel(contacts)
        self._trails.update(body.position[:, :2])
        outcomes = self._outcomes(body, touches, broken)
        value = self._rewards(body, touches, contacts, change, rates_before)
        value -= self._weights.failing * outcomes.failed
        last = seen = self._see(self._everybody, body)
        over = np.flatnonzero(outcomes.over)
        if len(over):
            self._curriculum.judge(over, simulation.lanes[over], self._trails.fraction[over])
            self._start(over)
            seen = Sights(last.observation.copy(), last.privileged.copy())
            first = self._see(over, self._bodies(over))
            seen.observation[over], seen.privileged[over] = first
        return Stepped(seen=seen, last=last, rewards=value.astype(np.float32), outcomes=outcomes)

    def _start(self, robots: NDArray[np.intp]) -> None:
        """Begin new episodes for some robots."""
        rng, count = self._rng, len(robots)
        lanes = self._curriculum.choose(robots)
        poses = np.zeros((count, 19))
        poses[:, :2] = rng.uniform(-_JITTER, _JITTER, (count, 2))
        poses[:, 2] = rng.uniform(*_DROP, count)
        flat = self._lanes.grounds[lanes] == _FLAT
        yaw = rng.uniform(-1.0, 1.0, count) * np.where(flat, _FLAT_YAW, _YAW)
        poses[:, 3], poses[:, 6] = np.cos(yaw / 2.0), np.sin(yaw / 2.0)
        poses[:, 7:] = self._pose + rng.uniform(-_POSE, _POSE, (count, 12))
        trails = [
            trail + rng.uniform(-1.0, 1.0, trail.shape) * self._lanes.noises[lane]
            for lane, trail in ((lane, self._lanes.trails[lane]) for lane in lanes)
        ]
        self._simulation.put(robots, lanes, poses)
        self._trails.begin(robots, poses[:, :2], trails)
        self._senses.begin(robots)
        self._steps[robots] = 0

    def _bodies(self, robots: NDArray[np.intp]) -> Bodies:
        return bodies(self._simulation.qpos, self._simulation.qvel, robots)

    def _see(self, robots: NDArray[np.intp], body: Bodies) -> Sights:
        lanes = self._simulation.lanes[robots]
        bearing = self._bearing(robots, body)
        feet = self._simulation.feet[robots]
        under = np.concatenate([body.position[:, None], feet], axis=1)
        ground = heights_under(self._lanes.heights, lanes, under)
        known = privileged_features(
            body,
            clearance=under[:, :, 2] - ground,
            contacts=self._senses.contacts[robots],
            grounds=self._lanes.grounds[lanes],
            levels=self._lanes.levels[lanes],
        )
        return Sights(self._senses.see(body, bearing, lanes, self._lanes.heights, robots), known)

    def _bearing(self, robots: NDArray[np.intp], body: Bodies) -> Array:
        """Return the angle to the next waypoint, (n,) rad in [-pi, pi)."""
        to_target = self._trails.targets(robots) - body.position[:, :2]
        angle = np.arctan2(to_target[:, 1], to_target[:, 0]) - body.yaw
        return (angle + np.pi) % (2.0 * np.pi) - np.pi

    def _outcomes(self, body: Bodies, touches: Array, broken: Flags) -> Outcomes:
        limits, trails = Limits(), self._trails
        tilted = np.maximum(np.abs(body.roll), np.abs(body.pitch)) > limits.tilt
        sunk = (self._lanes.floors[self._simulation.lanes] < 2 * _SUNK) & (
            (body.position[:, 2] < _SUNK) & (trails.index < trails.counts - 1)
        )
        waited = trails.waited * CONTROL_PERIOD >= limits.stuck_after
        lost = trails.aside(body.position[:, :2]) > limits.off_course_distance
        return Outcomes(
            complete=trails.is_complete & ~broken,
            fell=tilted | sunk | broken,
            collided=touches[:, self._monitored].max(axis=1) > limits.monitored_force,
            stuck=waited | lost,
            timeout=self._steps >= LONGEST,
        )

    def _rewards(
        self, body: Bodies, touches: Array, contacts: Flags, change: Array, rates_before: Array
    ) -> Array:
        lanes = self._simulation.lanes
        to_target = self._trails.targets() - body.position[:, :2]
        distance = np.linalg.norm(to_target, axis=1, keepdims=True)
        edges = np.empty(contacts.shape)
        read_cells(self._lanes.edges, lanes, self._simulation.feet, edges)
        grounds = self._lanes.grounds[lanes]
        moments = RobotMoments(
            body=body,
            direction=to_target / (distance + 1e-5),
            delta_yaw=self._bearing(self._everybody, body),
            joint_rates_before=rates_before,
            torques=self._simulation.torques,
            change=change,
            touching=(touches[:, self._feet :] > _TOUCH).sum(axis=1),
            on_edge=((edges > 0) & contacts).sum(axis=1) * (self._lanes.levels[lanes] > 3),
            beneath=heights_under(self._lanes.heights, lanes, clearance_points(body)),
            is_flat=grounds == _FLAT,
            is_sloped=grounds == _RAMPS,
        )
        return rewards(moments, self._weights, self._pose, CONTROL_PERIOD)

    def state(self) -> dict[str, Any]:
        """Return all that the future depends on, besides lanes and curriculum."""
        return {
            "steps": self._steps.copy(),
            "simulation": self._simulation.state(),
            "trails": {name: array.copy() for name, array in self._trails.arrays().items()},
            "senses": {name: array.copy() for name, array in self._senses.arrays().items()},
        }

    def restore(self, state: dict[str, Any], phase: TrainingPhase) -> None:
        """Go back to a state, in the phase that it was taken in."""
        self._simulation.set_timestep(phase.timestep)
        self._simulation.restore(state["simulation"])
        self._steps = state["steps"]
        for part, name in ((self._trails, "trails"), (self._senses, "senses")):
            for key, array in state[name].items():
                setattr(part, key, array)


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


def rewards(moments: RobotMoments, weights: RewardWeights, pose: Array, period: float) -> Array:
    """Return the rewards of one control step, (N,); a failure's is not among them.

    Args:
        moments: the robots.
        weights: of the terms.
        pose: (12,) default joint positions, rad.
        period: of a control step, s.
    """
    body, gravity = moments.body, moments.body.gravity
    speed = np.einsum("ni,ni->n", moments.direction, body.velocity[:, :2])
    turn = np.clip(1.5 * moments.delta_yaw, -1.2, 1.2)
    offset = body.joints - pose
    jerk = (body.joint_rates - moments.joint_rates_before) / period
    height = clearance_points(body)[:, :, 2] - moments.beneath
    face = height[:, :2].min(axis=1)
    belly = height[:, 2:].min(axis=1)
    leaning = gravity[:, 1] ** 2 * ~moments.is_sloped + gravity[:, 0] ** 2 * moments.is_flat
    total = (
        weights.progress * np.maximum(np.minimum(speed, SPEED) / SPEED, -1.0)
        + weights.heading * np.exp(-np.abs(moments.delta_yaw))
        + weights.turning * np.exp(-((body.rates[:, 2] - turn) ** 2) / 0.25)
        - weights.bouncing * np.minimum(body.velocity[:, 2] ** 2, 4.0)
        - weights.wobbling * np.minimum((body.rates[:, :2] ** 2).sum(axis=1), 40.0)
        - weights.leaning * leaning
        - weights.jerking * (jerk**2).sum(axis=1)
        - weights.touching * np.minimum(moments.touching, 3)
        - weights.changing * moments.change
        - weights.straining * (moments.torques**2).sum(axis=1)
        - weights.spreading * (offset[:, _HIPS] ** 2).sum(axis=1)
        - weights.posing * (offset**2).sum(axis=1)
        - weights.edges * moments.on_edge
        - weights.face * np.clip(1.0 - face / _FACE_CLEARANCE, 0.0, 1.5)
        - weights.belly * np.clip(1.0 - belly / _BELLY_CLEARANCE, 0.0, 1.5)
    )
    return np.maximum(total, _LOWEST) * period
