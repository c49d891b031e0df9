"""Scenes and policy bundles that a process has loaded, kept for its next trials."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from nw_base.words import Collision
from nw_policies import Bundle, load_bundle
from nw_scenes import Scene
from nw_scenes.robots import know_robot
from nw_sim.catalogue import open_scene
from nw_sim.physics import World

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from nw_policies.cards import Card
    from nw_scenes.rays import RayScene
    from nw_sim.rollout.driven import Programs
    from nw_sim.rollout.job import TrialJob
    from nw_sim.tasks import TaskSettings
    from nw_sim.tasks.reference import Reference


class Library:
    """What trials of one process may share: values that no trial can change.

    Worlds, policies and sensors have state, and are made anew for every trial.

    Args:
        scenes: how many are kept loaded.
        bundles: how many are kept loaded.
        known: bundles that are loaded already, with the weights that jobs want. They go by their
            `reference` and are kept for good.
        world: makes the world of each trial, from the arguments of `World`.
        before_drawing: called with a scene before its splat is opened.
    """

    def __init__(
        self,
        *,
        scenes: int = 32,
        bundles: int = 4,
        known: Iterable[Bundle] = (),
        world: Callable[..., World] = World,
        before_drawing: Callable[[Scene], None] | None = None,
    ) -> None:
        self.world = world
        self.before_drawing = before_drawing
        self._scenes = lru_cache(scenes)(open_scene)
        self._rays = lru_cache(scenes)(self._make_rays)
        self._bundles = lru_cache(bundles)(
            lambda reference, checkpoint: load_bundle(reference, checkpoint=checkpoint)
        )
        self._known = {bundle.reference: bundle for bundle in known}

    def scene(self, reference: str, collision: Collision = "terrain") -> Scene:
        """Return the scene of a name or folder, whose mesh collides as told.

        Raises:
            SceneError: as `nw_sim.catalogue.open_scene`.
        """
        return self._scenes(reference, collision)

    def rays(self, reference: str, collision: Collision = "terrain") -> RayScene:
        """Return the ray caster of a scene's static geometry.

        Raises:
            SceneError: as `nw_sim.catalogue.open_scene`.
        """
        return self._rays(reference, collision)

    def bundle(self, reference: str, checkpoint: Path | None) -> Bundle:
        """Return the policy bundle of a name, folder or card, with its own weights or others.

        Raises:
            PolicyError: as `nw_policies.load_bundle`.
        """
        return self._known.get(reference) or self._bundles(reference, checkpoint)

    def bundle_of(self, job: TrialJob) -> Bundle:
        """Return the bundle of a job, whose robot this process knows from then on.

        Raises:
            PolicyError: as `nw_policies.load_bundle`.
        """
        know_robot(job.robot, job.robot_folder)
        return self.bundle(job.policy, job.checkpoint).by_its_own_runtime(job.operator)

    def motion(
        self, bundle: Bundle, world: World, card: Card, task: TaskSettings
    ) -> Reference | None:
        """Return the motion that a policy tracks, on its robot; None if it tracks none.

        Args:
            bundle: of the policy.
            world: of the robot.
            card: the bundle's, as the trial has it.
            task: which may name the motion.

        Raises:
            PolicyError: the motion cannot be used.
        """
        from nw_sim.rollout.referenced import reference_of

        return reference_of(bundle, world, card, getattr(task, "motion", None))

    def motors(self, bundle: Bundle) -> Programs:
        """Return what gives the networks of a bundle's motors."""
        from nw_sim.rollout.driven import programs_of

        return programs_of(bundle)

    def _make_rays(self, reference: str, collision: Collision) -> RayScene:
        from nw_scenes.rays import RayScene

        return RayScene(self.scene(reference, collision).mesh())
