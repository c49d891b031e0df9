"""The stage: a policy in a scene, one control step after another, and what is done to it meanwhile.

Friction, payload and all other axes are those of a suite's `perturb`: a change opens the trial of
that cell and goes on there from the same state. So what is saved is what a run then meets.

The scene is changed, too: boxes stand in it, solid to feet, seen by rays and painted for cameras,
and its course ends elsewhere.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import NwEvalError
from nw_policies.line import line_to
from nw_scenes.mesh import box_mesh, merge, rotation_matrix
from nw_scenes.rays import RayScene
from nw_scenes.scene import Box, Progress, Scene, SplatSource
from nw_sim.axes import axis_named, usable_axes
from nw_sim.rollout.confined.access import policy_rules
from nw_sim.rollout.confined.start import PolicyProcess
from nw_sim.rollout.episode import carry_over
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.library import Library
from nw_sim.rollout.opening import OpenTrial, open_trial
from nw_sim.rollout.perturbed import unfelt
from nw_splat.files import read_splat
from nw_splat.gaussians import ARRAYS, SH0, Gaussians, quaternions, transformed
from nw_splat.store import FORMAT, compile_store

if TYPE_CHECKING:
    from nw_base.words import Collision, Outcome
    from nw_policies import Bundle
    from nw_scenes.mesh import TriangleMesh
    from nw_sim.physics import World
    from nw_sim.rollout.job import TrialJob


def open_stage(
    policy: str, scene: str, *, checkpoint: Path | None = None, allow_code: bool = False
) -> Stage:
    """Open a policy in a scene, checked as a run would check both.

    Raises:
        NwEvalError: either cannot be used.
    """
    from nw_eval.api.plans import plan
    from nw_eval.engine.plan import plan_jobs
    from nw_eval.suite import new_suite
    from nw_gate.results.run_folder import RunFolder
    from nw_policies import load_bundle
    from nw_sim.rendering import DRAFTED

    card = load_bundle(policy, checkpoint=checkpoint).card
    task = {} if card.reference is None else {"task": {"kind": "track", "start": 0.0}}
    suite = new_suite(
        {"nw-eval": 1, "name": "play", "robot": card.robot, "policy": policy, "trials": 1,
         "seed": 1, "scenes": [scene], "render": DRAFTED.model_dump(), **task}
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
    """Return whether a scene or policy goes by a name here, and not by the path of a file."""
    return not Path(reference).exists()


GOES_ON = frozenset({"timeout", "stuck", "off_course", "collided"})
"""Outcomes that end a trial of a run, and not one that somebody plays with."""
_LONG = 36_000.0  # s


class Stage:
    """A trial that goes on while its place and its robot are changed; a context manager.

    Args:
        job: of the trial; its duration is not kept to.
        bundle: of its policy.
        scene: of its place.
        reference: that names the scene in a suite.
        policy: that names the policy there.

    Attributes:
        original: the scene as it was.
        trial: as it stands.
        place: with what was done to it.
        cell: the axes of perturbation that were set, and their values.
        pushed: the hardest push, m/s.
        run_end: when a run's trial would have ended, s, and how; None while it would go on.

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
        self.place = ChangedScene(scene=still, folder=Path(self._folder.name))
        self.cell: dict[str, float] = {}
        self.pushed = 0.0
        self.run_end: tuple[float, Outcome, str] | None = None
        self._limit = job.duration
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

    def __exit__(self, *_: object) -> None:
        self.trial.__exit__()
        self._policy_process.__exit__()
        self._folder.cleanup()

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes of perturbation that the policy can feel."""
        axes = usable_axes()
        left = unfelt(self._bundle.card, axes, self._job.task)
        return tuple(axis for axis in axes if axis not in left)

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
        if self.run_end is None:
            self._note_end(outcome)
        return decision, None if outcome in GOES_ON else outcome

    def _note_end(self, outcome: Outcome | None) -> None:
        episode = self.trial.episode
        time, reason = episode.world.time, episode.task.end_reason
        if outcome is None:
            if episode.step < round(self._limit / episode.world.control_period):
                return
            outcome, reason = "timeout", f"{self._limit:g} s"
        self.run_end = time, outcome, reason

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
        cell = {
            axis: value for axis, value in sorted(cell.items()) if value != axis_named(axis).neutral
        }
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
        self.run_end = None

    def _go_on(self, place: ChangedScene, cell: dict[str, float]) -> None:
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

    def _open(self, place: ChangedScene, cell: dict[str, float]) -> OpenTrial:
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
        """Return the scene, whatever it is called."""
        return self._place

    def rays(self, reference: str, collision: Collision = "terrain") -> RayScene:  # noqa: ARG002
        """Return its ray caster."""
        self._cast = self._cast or RayScene(self._place.mesh())
        return self._cast


@dataclass(frozen=True, kw_only=True)
class ChangedScene:
    """What was done to a scene.

    Attributes:
        scene: as it was.
        folder: in which its Gaussians are put together; the changed scene needs it.
        boxes: that stand in it.
        goal: x, y of the last waypoint, m; None where it was.
    """

    from nw_eval.api.plans import plan
    from nw_eval.engine.plan import plan_jobs
    from nw_eval.suite import new_suite
    from nw_gate.results.run_folder import RunFolder
    from nw_policies import load_bundle

    scene: Scene
    folder: Path
    boxes: tuple[Box, ...] = ()
    goal: tuple[float, float] | None = None

    @property
    def is_changed(self) -> bool:
        """Whether anything was."""
        return bool(self.boxes) or self.goal is not None

    def changed(self) -> Scene:
        """Return the scene as it is now."""
        scene = self.scene
        if self.goal is not None:
            trail = scene.trail.copy()
            trail[-1, :2] = self.goal
            scene = replace(scene, trail=trail)
        if not self.boxes:
            return scene
        mesh = merge([scene.static_mesh, *map(mesh_of, self.boxes)])
        splat = scene.splat
        return replace(
            scene,
            solids=(*scene.solids, *self.boxes),
            static_mesh=mesh,
            splat=None if splat is None else SplatWithBoxes(scene, splat, self.boxes, self.folder),
        )


@dataclass(frozen=True)
class SplatWithBoxes:
    """The Gaussians of a scene, and those of boxes in it."""

    scene: Scene
    source: SplatSource
    boxes: tuple[Box, ...]
    folder: Path

    @property
    def key(self) -> str:
        """Hex digest of everything that can change the Gaussians."""
        return self._key

    @cached_property
    def _key(self) -> str:
        words = [[*box.center, *box.half_size, *box.quat] for box in self.boxes]
        return hashlib.sha256(f"{self.source.key}{json.dumps(words)}".encode()).hexdigest()

    def store(self, progress: Progress | None = None) -> Path:
        """Return the compiled store, in the folder and not in the cache."""
        path = self.folder / f"{self.key[:32]}.nwsplat"
        if not path.exists():
            compile_store(self.gaussians(progress), path, key=f"{FORMAT}:{self.key}")
        return path

    def gaussians(self, progress: Progress | None = None) -> Gaussians:
        """Return them, in the splat's own frame."""
        place = read_splat(self.source.store(progress))
        own = np.linalg.inv(self.scene.T_world_splat).astype(np.float64)
        boxes = transformed(painted(self.boxes, place.sh.shape[1]), own)
        return Gaussians(
            **{
                name: np.concatenate([getattr(place, name), getattr(boxes, name)])
                for name in ARRAYS
            },
            rasterize_mode=place.rasterize_mode,
            projection=place.projection,
            notes=place.notes,
        )


COLOUR = (0.62, 0.45, 0.28)
"""Of cardboard, red, green and blue, 0 to 1, lit from above."""
_HALF_SIZE = (0.15, 0.3, 0.1)
_AHEAD = 0.8
"""Metres from the trunk's middle to a new box's."""
_SPACING = 0.02
"""Metres between two Gaussians of a face."""
_FLAT = 0.001  # m
_OPACITY_LOGIT = 5.0
_SIDE_LIGHT = 0.7
_BELOW_LIGHT = 0.4


def box_ahead(world: World, rays: RayScene) -> Box:
    """Return a box in the way of a robot, across it, on what is under there."""
    yaw = float(world.roll_pitch_yaw[2])
    x, y, z = world.trunk_position
    x, y = x + _AHEAD * np.cos(yaw), y + _AHEAD * np.sin(yaw)
    under = float(rays.height(np.array([[x, y]]), np.array([z + 0.5]))[0])
    ground = under if np.isfinite(under) else world.scene.ground.z
    return Box(
        center=(float(x), float(y), ground + _HALF_SIZE[2]),
        half_size=_HALF_SIZE,
        quat=(float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))),
        material="cardboard",
    )


def mesh_of(box: Box) -> TriangleMesh:
    """Return what rays meet of a box."""
    return box_mesh(box.center, box.half_size, box.quat, box.kind)


def painted(boxes: Sequence[Box], harmonics: int) -> Gaussians:
    """Return boxes as Gaussians in the world, with so many harmonics, all but the first of them 0.

    Args:
        boxes: one or more.
        harmonics: 1, 4, 9 or 16.
    """
    faces = [_face(box, axis, sign) for box, axis, sign in product(boxes, range(3), (-1.0, 1.0))]
    means, scales, quats, colours = (np.concatenate(parts) for parts in zip(*faces, strict=True))
    sh = np.zeros((len(means), harmonics, 3), np.float32)
    sh[:, 0] = (colours - 0.5) / SH0
    return Gaussians(
        means=means.astype(np.float32),
        log_scales=np.log(scales).astype(np.float32),
        quats=quats.astype(np.float32),
        opacity_logits=np.full(len(means), _OPACITY_LOGIT, np.float32),
        sh=sh,
    )


def _face(box: Box, axis: int, sign: float) -> tuple[NDArray[np.float64], ...]:
    """Return centres, deviations, quaternions and colours of a face's Gaussians."""
    half = np.array(box.half_size)
    across = [other for other in range(3) if other != axis]
    counts = [max(2, round(2.0 * half[other] / _SPACING)) for other in across]
    steps = [
        (np.arange(count) + 0.5) / count * 2.0 - 1.0 for count in counts
    ]  # From edge to edge, none over it.
    grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    local = np.empty((len(grid), 3))
    local[:, axis], local[:, across] = sign * half[axis], grid * half[across]
    R = rotation_matrix(box.quat)
    spread = np.full((len(grid), 3), _FLAT)
    spread[:, across] = half[across] / np.array(counts)  # Half of a cell's width.
    up = float((R[:, axis] * sign)[2])
    light = 1.0 if up > 0.5 else _BELOW_LIGHT if up < -0.5 else _SIDE_LIGHT
    return (
        local @ R.T + np.array(box.center),
        spread,
        np.tile(quaternions(R), (len(grid), 1)),
        np.tile(light * np.array(COLOUR), (len(grid), 1)),
    )
