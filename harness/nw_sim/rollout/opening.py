"""A trial opened from its job: its parts are loaded, and the robot stands at its start.

Where it begins and what is to be done there the task draws: `tasks.Task.reset`.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Self

import numpy as np

from nw_base.errors import PolicyError, UsageError, is_interrupt
from nw_base.protocol import EvaluationProtocol, protocol_named
from nw_policies import ActionFilter, Bundle, Policy, open_policy
from nw_policies.asked import AskedPolicy
from nw_policies.cards import JointControl, mounted_robot, physics_steps
from nw_scenes import Scene
from nw_scenes.robots import RobotSpec, get_robot
from nw_sim.physics import World
from nw_sim.rendering import SHOWN
from nw_sim.rollout.asked_for import own_targets
from nw_sim.rollout.driven import driven
from nw_sim.rollout.episode import Episode
from nw_sim.rollout.fault import extension_at_fault, policy_at_fault
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.library import Library
from nw_sim.rollout.perturbed import TrialSetup, perturbed, pushes_of, standing_cones
from nw_sim.rollout.scored import ScoreMeter
from nw_sim.sensors import build_sensors
from nw_sim.tasks import TaskRules, open_task
from nw_sim.tasks.commanded import with_command

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_base.words import Backend
    from nw_sim.rendering import Rendering
    from nw_sim.rollout.job import TrialJob
    from nw_splat.render import Renderer


@dataclass(frozen=True, kw_only=True)
class OpenTrial:
    """A trial's parts; a context manager that closes world and policy."""

    job: TrialJob
    robot: RobotSpec
    scene: Scene
    bundle: Bundle
    episode: Episode
    renderer: Callable[[], Renderer]  # of the scene's splat, made when first called
    shown: Callable[[], Renderer]  # As above, for pictures that no policy sees
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
        PluginError: the package of a perturbation is broken.
        PolicyFailedError: the policy raised as it was opened or reset.
    """
    trial = job.trial
    scene = library.scene(job.scene, job.collision)
    bundle = library.bundle_of(job)
    _check_same(job, scene, bundle)
    robot = mounted_robot(get_robot(job.robot), bundle.card)
    with extension_at_fault():
        setup = perturbed(TrialSetup.of(trial, robot, bundle.card), dict(trial.perturbation))
    robot, card = setup.robot, setup.card

    def opened(rendering: Rendering) -> Renderer:
        if library.before_drawing is not None:
            library.before_drawing(scene)
        return _open_renderer(scene, job.render, rendering)

    renderer = cache(lambda: opened(job.rendering))
    # The cuda backend draws as published only.
    how = SHOWN if job.render == "cpu" else job.rendering
    shown = cache(lambda: opened(how))
    protocol = protocol_named(job.protocol)
    with ExitStack() as cleanup:
        setup = setup.replaced(motors=driven(setup.motors, card, robot, library.motors(bundle)))
        world = cleanup.enter_context(_open_world(setup, scene, protocol, library.world))
        rules = TaskRules(
            protocol=protocol,
            duration=job.duration,
            control_period=world.control_period,
            contact_termination=job.contact_termination,
            reference=library.motion(bundle, world, card, job.task),
            own=own_targets(card, robot) if getattr(job.task, "targets", None) else None,
        )
        with extension_at_fault():
            task = open_task(with_command(job.task, setup.command), rules)
            start = task.reset(trial, scene, robot)
        with policy_at_fault():
            policy: Policy = open_policy(bundle, allow_code=job.allow_code)
            cleanup.callback(_close, policy)
        if isinstance(policy, AskedPolicy) and policy.served is not None:
            _check_served(job, policy.served.digest)
        with policy_at_fault():
            policy.reset(_seed(trial.seed_sequence("policy")))
        height = scene.spawn.position[2] + robot.spawn_height
        world.reset(position=(start.x, start.y, height), yaw=start.yaw)
        if start.pose is not None:
            world.begin(start.pose)
        sensors = build_sensors(
            card,
            world,
            rays=lambda: library.rays(job.scene, job.collision),
            renderer=lambda _scene: renderer(),
            code_from=bundle.folder if job.allow_code else None,
            air=setup.air,
        )
        for name, sensor in sensors.items():
            sensor.reset(_seed(trial.seed_sequence(f"sensor {name}")))
        control = JointControl.from_card(card, robot)
        with extension_at_fault():
            scores = (
                ScoreMeter(job.scores, world, task, allow_code=job.allow_code)
                if job.scores
                else None
            )
        episode = Episode(
            world=world,
            sensors=sensors,
            policy=policy,
            control=control,
            delay_steps=card.control.delay_steps,
            hold=card.control.hold,
            action_filter=ActionFilter.from_card(card, control),
            task=task,
            clock=clock,
            pushes=pushes_of(setup),
            cones=standing_cones(setup, start.waypoints),
            scores=scores,
        )
        return OpenTrial(
            job=job,
            robot=robot,
            scene=scene,
            bundle=bundle,
            episode=episode,
            renderer=renderer,
            shown=shown,
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
            fix="give the policy or the --checkpoint that it was planned with",
        )
    if scene.digest != job.trial.scene_digest:
        raise UsageError(
            f"scene {job.scene!r} is {scene.digest[:12]}, the trial was planned with "
            f"{job.trial.scene_digest[:12]}",
            fix="start a new run: the scene has changed",
        )


def _check_served(job: TrialJob, served: str) -> None:
    """Refuse a server that serves something else now; that is no fault of the policy."""
    planned = job.checkpoint_digest
    if planned and served != planned:
        raise UsageError(
            f"the server of {job.policy!r} serves {served[:12]}, the trial was planned with "
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
    setup: TrialSetup, scene: Scene, protocol: EvaluationProtocol, make: Callable[..., World]
) -> World:
    timestep, substeps = physics_steps(setup.card, protocol)
    return make(
        setup.robot,
        scene,
        protocol=protocol,
        actuators=setup.motors,
        friction=setup.friction,
        payload=setup.payload,
        timestep=timestep,
        substeps=substeps,
    )


def _open_renderer(scene: Scene, backend: Backend, rendering: Rendering) -> Renderer:
    from nw_splat.render import open_renderer
    from nw_splat.store import open_store

    return open_renderer(open_store(scene.splat_store()), backend, **rendering.model_dump())


def _seed(sequence: np.random.SeedSequence) -> int:
    return int(sequence.generate_state(1, np.uint32)[0])
