"""From a job to a trial that stands at its first control step.

Where it begins and where its waypoints lie is the only randomness of the world: `draw_start`.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Self

import numpy as np

from nw_eval.cards import Card, JointControl, actuator_values, mounted_robot, physics_steps
from nw_eval.errors import PolicyError, UsageError
from nw_eval.policies import ActionFilter, Bundle, Policy, open_policy
from nw_eval.policies.apart import AskedPolicy
from nw_eval.protocol import EvaluationProtocol, protocol_named
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.rollout.episode import Episode
from nw_eval.rollout.fault import is_interrupt, policy_at_fault
from nw_eval.rollout.perturbed import (
    Cell,
    air_of,
    cell_of,
    perturbed_card,
    perturbed_motors,
    perturbed_robot,
    pushes_of,
    standing_cones,
)
from nw_eval.scenes import Scene
from nw_eval.sensors import build_sensors
from nw_eval.sim import Actuators, Limits, Termination, TrailProgress, World
from nw_eval.suite.trials import Trial

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_eval.rollout.job import TrialJob
    from nw_eval.rollout.library import Library
    from nw_eval.rollout.result import StageClock
    from nw_eval.splat.render import Renderer

# The published evaluation numbers its episodes from here.
PUBLISHED_FIRST_SEED = 10_000


@dataclass(frozen=True, kw_only=True)
class OpenTrial:
    """A trial's parts; a context manager that closes world and policy."""

    job: TrialJob
    robot: RobotSpec
    scene: Scene
    bundle: Bundle
    episode: Episode
    renderer: Callable[[], Renderer]  # of the scene's splat, made when first called
    cleanup: ExitStack

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.cleanup.close()


def open_trial(job: TrialJob, library: Library, clock: StageClock) -> OpenTrial:
    """Load what a job names, draw its start and put the robot there.

    Raises:
        SceneError: the scene cannot be loaded, or its splat not made.
        PolicyError: the bundle cannot be loaded, or is not the one that the job was planned with.
        UsageError: no such robot or perturbation; a server serves something else now.
        PolicyFailedError: the policy raised as it was opened or reset.
    """
    trial = job.trial
    cell = cell_of(trial)
    scene = library.scene(job.scene, job.collision)
    bundle = library.bundle_of(job)
    _check_same(job, scene, bundle)
    robot = perturbed_robot(mounted_robot(get_robot(job.robot), bundle.card), cell)
    card = perturbed_card(bundle.card, cell)
    renderer = cache(lambda: _open_renderer(scene, job.render))
    protocol = protocol_named(job.protocol)
    start = draw_start(
        trial,
        protocol=protocol,
        spawn=(*scene.spawn.position[:2], scene.spawn.yaw),
        jitter=(scene.spawn.x_jitter, scene.spawn.y_jitter, scene.spawn.yaw_jitter),
        trail=scene.trail,
        waypoint_noise=scene.waypoint_noise,
    )
    with ExitStack() as cleanup:
        world = cleanup.enter_context(_open_world(robot, scene, card, protocol, cell))
        with policy_at_fault():
            policy: Policy = open_policy(bundle, allow_code=job.allow_code)
            cleanup.callback(_close, policy)
        if isinstance(policy, AskedPolicy) and policy.served is not None:
            _check_served(job, policy.served.digest)
        with policy_at_fault():
            policy.reset(_seed(trial.seed_sequence("policy")))
        height = scene.spawn.position[2] + robot.spawn_height
        world.reset(position=(start.x, start.y, height), yaw=start.yaw)
        sensors = build_sensors(
            card,
            world,
            rays=lambda: library.rays(job.scene, job.collision),
            renderer=lambda _scene: renderer(),
            code_from=bundle.folder if job.allow_code else None,
            air=air_of(cell),
        )
        for name, sensor in sensors.items():
            sensor.reset(_seed(trial.seed_sequence(f"sensor {name}")))
        period = world.control_period
        control = JointControl.from_card(bundle.card, robot)
        episode = Episode(
            world=world,
            sensors=sensors,
            policy=policy,
            control=control,
            delay_steps=bundle.card.control.delay_steps,
            hold=bundle.card.control.hold,
            action_filter=ActionFilter.from_card(bundle.card, control),
            progress=TrailProgress(start.trail, protocol, control_period=period),
            termination=Termination(
                start.trail,
                (start.x, start.y),
                protocol=protocol,
                duration=job.duration,
                control_period=period,
                limits=Limits.of(robot),
                contact_termination=job.contact_termination,
            ),
            clock=clock,
            pushes=pushes_of(trial, cell),
            cones=standing_cones(trial, cell, start.trail),
        )
        return OpenTrial(
            job=job,
            robot=robot,
            scene=scene,
            bundle=bundle,
            episode=episode,
            renderer=renderer,
            cleanup=cleanup.pop_all(),
        )
    raise AssertionError("an ExitStack without suppressing callbacks lets no exception vanish")


def _check_same(job: TrialJob, scene: Scene, bundle: Bundle) -> None:
    """Refuse a scene or checkpoint that is not what the trial's identity and row say."""
    if bundle.card.adapter != "remote" and bundle.checkpoint_digest != job.checkpoint_digest:
        kind = "checkpoint" if bundle.checkpoint is not None else "code"
        raise PolicyError(
            f"the {kind} of {job.policy!r} is {bundle.checkpoint_digest[:12]}, the trial was "
            f"planned with {job.checkpoint_digest[:12]}",
            fix="name the bundle or the --checkpoint that it was planned with",
        )
    if scene.digest != job.trial.scene_digest:
        raise UsageError(
            f"scene {job.scene!r} is {scene.digest[:12]}, the trial was planned with "
            f"{job.trial.scene_digest[:12]}",
            fix="start a new run: the scene has changed",
        )


def _check_served(job: TrialJob, found: str) -> None:
    """Refuse a server that serves something else now; that is no fault of the policy."""
    planned = job.checkpoint_digest
    if planned and found != planned:
        raise UsageError(
            f"the server of {job.policy!r} serves {found[:12]}, the trial was planned with "
            f"{planned[:12]}",
            fix="serve what it was planned with, or start a new run",
        )


def _close(policy: Policy) -> None:
    """Close a policy. Its trial is over, and nothing that it raises now can change that."""
    try:
        policy.close()
    except BaseException as error:
        if is_interrupt(error):
            raise


def _open_world(
    robot: RobotSpec, scene: Scene, card: Card, protocol: EvaluationProtocol, cell: Cell
) -> World:
    values = actuator_values(card, robot)
    follow = "torque" if card.control.action == "joint_torque" else "position"
    own = None if values is None else replace(Actuators.of(robot), follow=follow, **values)
    timestep, substeps = physics_steps(card, protocol)
    return World(
        robot,
        scene,
        protocol=protocol,
        actuators=perturbed_motors(robot, own, cell),
        friction=cell.get("friction"),
        payload=cell.get("payload", 0.0),
        timestep=timestep,
        substeps=substeps,
    )


def _open_renderer(scene: Scene, backend: str) -> Renderer:
    from nw_eval.splat.render import open_renderer
    from nw_eval.splat.store import open_store

    return open_renderer(open_store(scene.splat_store()), "cuda" if backend == "cuda" else "cpu")


def _seed(sequence: np.random.SeedSequence) -> int:
    return int(sequence.generate_state(1, np.uint32)[0])


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
