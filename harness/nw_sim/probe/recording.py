"""Some seconds of a policy in a scene, through the same parts as every trial, and what was seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_base.trials import Trial
from nw_base.words import Collision, Outcome
from nw_policies import Bundle
from nw_policies.asked import ApartPolicy
from nw_policies.cards import Card
from nw_policies.cards.feeding import InputSpec
from nw_policies.drawing import DrawingPolicy
from nw_policies.fed_policy import FedPolicy
from nw_policies.planned import PlannedPolicy
from nw_scenes.scene import Scene
from nw_sim.catalogue import parse_reference
from nw_sim.physics import World
from nw_sim.rollout.episode import Episode, Observer, Step
from nw_sim.rollout.job import StageClock, TrialJob
from nw_sim.rollout.library import Library
from nw_sim.rollout.opening import open_trial
from nw_sim.sensors.proprio import commanded_speed
from nw_sim.tasks import COURSE, TrackSettings

Array = NDArray[np.float64]
STUMBLES = 0.3
"""Roll or pitch that a policy on flat ground does not reach under its own card, rad. Measured on
three policies: 0.07 to 0.14 with the right card, 0.28 to 1.3 with any other order of joints."""


_FEEDS = (FedPolicy, ApartPolicy, DrawingPolicy, PlannedPolicy)
"""Policies that say what the networks gave that feed them."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What happened, by control step: T steps, joints in the robot's order."""

    observations: dict[str, NDArray[Any]]
    """(T, ...) by name."""
    actions: Array
    """(T, 12) raw, in the policy's order."""
    targets: Array
    """(T, 12) what the motors were told, rad or N m."""
    positions: Array
    """(T + 1, 12) rad, before the first step and after each."""
    torques: Array
    """(T, 12) N m."""
    torque_limits: Array
    """(12,) N m."""
    tilt: Array
    """(T,) larger one of roll and pitch, rad."""
    velocity: Array
    """(T, 3) vx, vy in the yaw frame, m/s, and yaw rate, rad/s: what a command is about."""
    period: float
    """Seconds of a control step."""
    travelled: float
    """Metres over ground from start to end."""
    seconds: float
    outcome: Outcome | None
    """How the trial ended before its time; None if it did not."""
    inputs: tuple[InputSpec, ...]
    """What the checkpoint declares to take; empty where its format does not say."""
    sees_images: bool
    """Whether images were rendered for the policy, which takes far longer than all else."""
    fed: dict[str, NDArray[Any]] = field(default_factory=dict[str, NDArray[Any]])
    """(T, ...) what the networks gave that feed the policy, by name."""
    fed_inputs: dict[str, tuple[InputSpec, ...]] = field(
        default_factory=dict[str, tuple[InputSpec, ...]]
    )
    """What the file of each network declares to take."""

    @property
    def stumbles(self) -> bool:
        """Whether it falls, bumps or leans as no policy does under its own card on flat ground."""
        return self.outcome is not None or float(self.tilt.max()) > STUMBLES


class Collector(Observer):
    """Looks on as an episode runs, and collects its steps.

    Args:
        episode: stands at its start.
    """

    def __init__(self, episode: Episode) -> None:
        self.tilt = 0.0
        """Larger one of roll and pitch now, rad."""
        self._episode = episode
        policy = episode.policy
        self._fed = policy if isinstance(policy, _FEEDS) else None
        self._start = episode.world.trunk_position
        self._first = episode.world.joint_positions
        self._rows: list[tuple[Array, Array, Array, Array, float, Array]] = []
        self.outcome: Outcome | None = None
        """How the trial has ended; None while it goes on."""
        self._seen: dict[str, list[NDArray[Any]]] = {name: [] for name in episode.sensors}
        self._gave: dict[str, list[NDArray[Any]]] = {}

    def advanced(self, step: Step) -> None:
        """Collect a control step."""
        decision, world = step.decision, self._episode.world
        self.outcome = step.outcome
        self.tilt = float(np.abs(world.roll_pitch_yaw[:2]).max())
        body = (world.joint_positions, world.torques, self.tilt, _velocity(world))
        self._rows.append((decision.action, decision.targets, *body))
        for name, value in decision.observation.items():
            self._seen[name].append(np.array(value))
        for name, value in self._fed.held.items() if self._fed else ():
            self._gave.setdefault(name, []).append(value)

    def recording(self) -> Recording:
        """Return what was collected; at least one step."""
        episode, world = self._episode, self._episode.world
        actions, targets, positions, torques, tilts, velocities = zip(*self._rows, strict=True)
        return Recording(
            observations={name: np.stack(values) for name, values in self._seen.items()},
            fed={name: np.stack(values) for name, values in self._gave.items()},
            actions=np.stack(actions),
            targets=np.stack(targets),
            positions=np.stack([self._first, *positions]),
            torques=np.stack(torques),
            torque_limits=world.torque_limits,
            tilt=np.array(tilts),
            velocity=np.stack(velocities),
            period=world.control_period,
            travelled=float(np.linalg.norm((world.trunk_position - self._start)[:2])),
            seconds=world.time,
            outcome=None if self.outcome in {"timeout", "completed"} else self.outcome,
            inputs=episode.policy.inputs,
            sees_images=any(sensor.is_image for sensor in episode.sensors.values()),
            fed_inputs=self._fed.network_inputs if self._fed else {},
        )


def _velocity(world: World) -> Array:
    """Return vx, vy in the yaw frame, m/s, and the yaw rate, rad/s."""
    yaw = world.roll_pitch_yaw[2]
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y, _ = world.trunk_linear_velocity
    turning = world.trunk_rotation[2] @ world.trunk_angular_velocity
    return np.array([cos * x + sin * y, cos * y - sin * x, turning])


_IDENTITY = "0" * 64  # The suite digest of a trial that is part of no suite.


_BENDS = ((1.5, 0.0, 0.0), (2.7, 0.9, 0.0), (3.0, 2.2, 0.0), (4.2, 2.6, 0.0), (5.2, 1.8, 0.0))
"""Waypoints with bends to both sides, m: 37, 77, 18 and -39 degrees from where the robot starts."""
_FIELD = "open/field"
_PATIENCE = 3.0  # Times what the card's speed takes along the waypoints.


@dataclass(frozen=True, kw_only=True)
class Walk:
    """How a trial on the flat ended."""

    completed: bool
    seconds: float

    def is_worse_than(self, other: Walk) -> bool:
        """Whether the other trial was completed, and this one was not or took far longer."""
        return other.completed and not (self.completed and self.seconds <= 1.25 * other.seconds)


class ThisBundle(Library):
    """A library whose every bundle is the one that is looked at."""

    def __init__(self, bundle: Bundle) -> None:
        super().__init__(scenes=1)
        self.own = bundle

    def bundle(self, reference: str, checkpoint: Path | None) -> Bundle:  # noqa: ARG002 - see above.
        """Return it."""
        return self.own


class _Bends(ThisBundle):
    """The same, whose every scene has the waypoints `_BENDS`."""

    def scene(self, reference: str, collision: Collision = "terrain") -> Scene:
        """Return it."""
        return replace(super().scene(reference, collision), trail=np.array(_BENDS))


class Rig(Protocol):
    """Records a checkpoint under one card after another."""

    def walk(self, card: Card) -> Walk:
        """Run a trial under a card: waypoints with bends on level ground."""
        ...

    def record(self, card: Card, *, seconds: float, level: float = math.inf) -> Recording:
        """Run the checkpoint under a card, while it leans less than `level`."""
        ...


class SceneRig:
    """A checkpoint in a scene, under one card after another.

    Args:
        bundle: checkpoint, and the card that is looked at.
        scene: its name.
        allow_code: whether Python code that the card names may be imported.
    """

    def __init__(self, bundle: Bundle, *, scene: str, allow_code: bool) -> None:
        self._bundle = bundle
        self._scene = scene
        self._allow_code = allow_code
        self._library = ThisBundle(bundle)

    def record(self, card: Card, *, seconds: float, level: float = math.inf) -> Recording:
        """Run the checkpoint under a card, while it leans less than `level`.

        Raises:
            NwEvalError: it cannot be run.
        """
        return record(
            replace(self._bundle, card=card),
            scene=self._scene,
            seconds=seconds,
            level=level,
            allow_code=self._allow_code,
            library=self._library,
        )

    def walk(self, card: Card) -> Walk:
        """Run a trial under a card: waypoints with bends on level ground.

        Raises:
            NwEvalError: it cannot be run.
        """
        length = float(np.linalg.norm(np.diff(_BENDS, axis=0, prepend=0.0), axis=1).sum())
        seconds = _PATIENCE * length / max(abs(commanded_speed(card.command)), 0.4)
        bundle = replace(self._bundle, card=card)
        job = _job(bundle, _Bends(bundle), _FIELD, seconds, allow_code=self._allow_code)
        with open_trial(*job, StageClock()) as opened:
            collector = Collector(opened.episode)
            for _ in opened.episode.steps(collector):
                pass
            return Walk(
                completed=collector.outcome == "completed", seconds=opened.episode.world.time
            )


def record(
    bundle: Bundle,
    *,
    scene: str,
    seconds: float = 1.0,
    level: float = math.inf,
    allow_code: bool = False,
    library: ThisBundle | None = None,
) -> Recording:
    """Run a policy for a while, from the first start of a scene.

    Args:
        bundle: card and checkpoint.
        scene: its name.
        seconds: how long at most.
        level: roll or pitch with which the recording ends, rad.
        allow_code: whether Python code that the card names may be imported.
        library: keeps the scene from one recording to the next.

    Raises:
        NwEvalError: it cannot be run.
    """
    library = library or ThisBundle(bundle)
    library.own = bundle
    job = _job(bundle, library, scene, seconds, allow_code=allow_code)
    with open_trial(*job, StageClock()) as opened:
        collector = Collector(opened.episode)
        for _ in opened.episode.steps(collector):
            if collector.tilt >= level:
                break
        return collector.recording()


def _job(
    bundle: Bundle, library: ThisBundle, scene: str, seconds: float, *, allow_code: bool
) -> tuple[TrialJob, ThisBundle]:
    """Return a trial from the first start of a scene, and the library that opens it."""
    reference, collision = parse_reference(scene)
    place = library.scene(reference, collision)
    trial = Trial(
        suite="check",
        suite_digest=_IDENTITY,
        suite_seed=0,
        scene=scene,
        scene_digest=place.digest,
        task=place.task,
        index=0,
    )
    job = TrialJob(
        trial=trial,
        robot=bundle.card.robot,
        # A policy that tracks a motion is told nothing else.
        task=COURSE if bundle.card.reference is None else TrackSettings(start=0.0),
        duration=seconds,
        scene=reference,
        collision=collision,
        policy=bundle.reference,
        checkpoint=bundle.checkpoint,
        checkpoint_digest=bundle.checkpoint_digest,
        allow_code=allow_code,
    )
    return job, library


class SpentError(Exception):
    """The budget is used up."""


class Metered:
    """A rig that records until a budget is used up.

    Args:
        rig: what records.
        simulated: seconds of simulation, which come to the same on every machine.
        deadline: on the monotonic clock. Only policies that are far slower than a robot needs
            reach it, and on another machine elsewhere.
    """

    def __init__(self, rig: Rig, *, simulated: float, deadline: float = math.inf) -> None:
        self.spent = 0.0
        self._rig = rig
        self._simulated = simulated
        self._deadline = deadline

    def record(self, card: Card, *, seconds: float, level: float = math.inf) -> Recording:
        """Run the checkpoint under a card, while it leans less than `level`.

        Raises:
            SpentError: the budget is used up.
            NwEvalError: it cannot be run.
        """
        if self.spent >= self._simulated or monotonic() >= self._deadline:
            raise SpentError
        recording = self._rig.record(card, seconds=seconds, level=level)
        self.spent += recording.seconds
        return recording

    def walk(self, card: Card) -> Walk:
        """Run a trial under a card: waypoints with bends on level ground.

        Raises:
            SpentError: the budget is used up.
            NwEvalError: it cannot be run.
        """
        if self.spent >= self._simulated or monotonic() >= self._deadline:
            raise SpentError
        walk = self._rig.walk(card)
        self.spent += walk.seconds
        return walk
