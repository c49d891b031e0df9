"""The stage: a policy in a place, one control step after another, and what is done to it meanwhile.

Friction, payload and all other axes are those of a suite's `perturb`: a change opens the trial of
that cell and goes on there from the same state. So what is saved is what a run then meets.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from nw_eval.errors import NwEvalError
from nw_eval.policies.apart import line_to
from nw_eval.rollout.carry import carry_over
from nw_eval.rollout.clock import StageClock
from nw_eval.rollout.confined.access import policy_rules
from nw_eval.rollout.confined.start import PolicyProcess
from nw_eval.rollout.library import Library
from nw_eval.rollout.perturbed import unfelt
from nw_eval.rollout.prepare import OpenTrial, open_trial
from nw_eval.scenes.rays import RayScene
from nw_eval.suite.perturb import NEUTRAL
from nw_eval.view.live.boxes import box_ahead
from nw_eval.view.live.place import ChangedPlace

if TYPE_CHECKING:
    from nw_eval.policies import Bundle
    from nw_eval.rollout.job import TrialJob
    from nw_eval.scenes.scene import Scene
    from nw_eval.words import Collision, Outcome

GOES_ON = frozenset({"timeout", "stuck", "off_course", "collided"})
"""Outcomes that end a trial of a run, and not one that somebody plays with."""
_LONG = 36_000.0  # s


class Stage:
    """A trial that goes on while its place and its robot are changed; a context manager.

    Args:
        job: of the trial; its duration is not kept to.
        bundle: of its policy.
        scene: of its place.
        reference: that names the place in a suite.
        policy: that names the policy there.

    Attributes:
        reference: as given.
        policy: as given.
        original: the place as it was.
        trial: as it stands.
        place: with what was done to it.
        cell: the axes of perturbation that were set, and their values.
        pushed: the hardest push, m/s.

    Raises:
        NwEvalError: place or policy cannot be opened.
    """

    def __init__(
        self, job: TrialJob, bundle: Bundle, scene: Scene, *, reference: str, policy: str
    ) -> None:
        self._folder = TemporaryDirectory(prefix="nw-eval-view-")
        # A start of its own in each cell would put the robot elsewhere.
        spawn = replace(scene.spawn, x_jitter=0.0, y_jitter=0.0, yaw_jitter=0.0)
        still = replace(scene, spawn=spawn, waypoint_noise=(0.0, 0.0))
        self.original, self.reference, self.policy = scene, reference, policy
        self.place = ChangedPlace(scene=still, folder=Path(self._folder.name))
        self.cell: dict[str, float] = {}
        self.pushed = 0.0
        self._job = replace(job, duration=_LONG, mcap=None, record="none")
        self._bundle = bundle
        self._policy_process = PolicyProcess(policy_rules(bundle))
        try:
            self.trial = self._open(self.place, {})
        except BaseException:
            self._policy_process.__exit__()
            self._folder.cleanup()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.trial.__exit__()
        self._policy_process.__exit__()
        self._folder.cleanup()

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes of perturbation that the policy can feel."""
        left = unfelt(self._bundle.card, NEUTRAL)
        return tuple(axis for axis in NEUTRAL if axis not in left)

    def step(self) -> tuple[Any, Outcome | None]:
        """Make a control step.

        Returns:
            What the policy was shown, and how the trial ended; None while it goes on.

        Raises:
            NwEvalError: the policy failed, or the physics.
        """
        episode = self.trial.episode
        decision = episode.decide()
        outcome = episode.advance(decision).outcome
        return decision, None if outcome in GOES_ON else outcome

    def push(self, ahead: float, left: float) -> None:
        """Add a velocity to the trunk's, m/s, in the robot's heading."""
        world = self.trial.episode.world
        yaw = float(world.roll_pitch_yaw[2])
        cosine, sine = np.cos(yaw), np.sin(yaw)
        world.push(np.array([cosine * ahead - sine * left, sine * ahead + cosine * left]))
        self.pushed = max(self.pushed, float(np.hypot(ahead, left)))

    def perturb(self, values: dict[str, float]) -> None:
        """Go on under other values of some axes; a neutral value is none."""
        cell = {**self.cell, **values}
        cell = {axis: value for axis, value in sorted(cell.items()) if value != NEUTRAL[axis]}
        self._go_on(self.place, cell)

    def move_goal(self, x: float, y: float) -> None:
        """Go on with the last waypoint elsewhere, m."""
        self._go_on(replace(self.place, goal=(x, y)), self.cell)

    def drop_box(self) -> None:
        """Go on with a box ahead of the robot."""
        box = box_ahead(self.trial.episode.world, RayScene(self.trial.scene.mesh()))
        self._go_on(replace(self.place, boxes=(*self.place.boxes, box)), self.cell)

    def clear_boxes(self) -> None:
        """Go on without boxes."""
        self._go_on(replace(self.place, boxes=()), self.cell)

    def restart(self) -> None:
        """Begin again, with all that was changed."""
        self._replace(self._open(self.place, self.cell))

    def _go_on(self, place: ChangedPlace, cell: dict[str, float]) -> None:
        trial = self._open(place, cell)
        try:
            carry_over(self.trial.episode, trial.episode)
        except NwEvalError:
            trial.__exit__()
            raise
        self.place, self.cell = place, cell
        self._replace(trial)

    def _replace(self, trial: OpenTrial) -> None:
        self.trial.__exit__()
        self.trial = trial

    def _open(self, place: ChangedPlace, cell: dict[str, float]) -> OpenTrial:
        scene = place.changed()
        trial = replace(
            self._job.trial, scene_digest=scene.digest, perturbation=tuple(sorted(cell.items()))
        )
        library = _OfStage(scene, self._bundle)
        with line_to(self._policy_process.line):
            return open_trial(replace(self._job, trial=trial), library, StageClock())


class _OfStage(Library):
    """Knows the stage's place and policy."""

    def __init__(self, scene: Scene, bundle: Bundle) -> None:
        super().__init__(known=[bundle])
        self._place, self._cast = scene, None

    def scene(self, reference: str, collision: Collision = "terrain") -> Scene:  # noqa: ARG002
        """Return the place, whatever it is called."""
        return self._place

    def rays(self, reference: str, collision: Collision = "terrain") -> RayScene:  # noqa: ARG002
        """Return its ray caster."""
        self._cast = self._cast or RayScene(self._place.mesh())
        return self._cast


def open_stage(
    policy: str, scene: str, *, checkpoint: Path | None = None, allow_code: bool = False
) -> Stage:
    """Open a policy in a place, checked as a run would check both.

    Raises:
        NwEvalError: either cannot be used.
    """
    from nw_eval.api.plans import plan
    from nw_eval.engine.plan import plan_jobs
    from nw_eval.policies import load_bundle
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.suite import new_suite

    robot = load_bundle(policy, checkpoint=checkpoint).card.robot
    suite = new_suite(
        {"nw-eval": 1, "name": "play", "robot": robot, "policy": policy, "trials": 1, "seed": 1,
         "scenes": [scene]}
    )  # fmt: skip
    planned = plan(suite, checkpoint=checkpoint, allow_code=allow_code)
    (job,) = plan_jobs(planned, RunFolder(path=Path()))
    (place,) = planned.scenes
    return Stage(
        job,
        planned.bundle,
        place,
        reference=scene if is_named(scene) else str(Path(scene).resolve()),
        policy=policy if is_named(policy) else str(Path(policy).resolve()),
    )


def is_named(reference: str) -> bool:
    """Return whether a place or policy goes by a name here, and not by the path of a file."""
    return not Path(reference).exists()
