"""From trials to jobs: everything that a worker needs to know, decided before the first starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from nw_eval.engine.order import in_order
from nw_eval.engine.prepare import needs_splats
from nw_eval.plugins import SPLAT_FORMATS, code_named, identity_of, key_of
from nw_eval.rollout.job import TrialJob, kernels_of
from nw_eval.rollout.record import attachments
from nw_eval.suite import suite_yaml

if TYPE_CHECKING:
    from pathlib import Path

    from nw_eval.catalogue import FoundScene
    from nw_eval.policies import Bundle
    from nw_eval.request import Request
    from nw_eval.results.bank import Against
    from nw_eval.results.provenance import ShardInfo
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.scenes import Scene
    from nw_eval.suite.model import Suite
    from nw_eval.suite.trials import Trial
    from nw_eval.words import Arm, Backend, Kernels, PanelKind

# Wall seconds for each simulated second, and on top for the first compilation of kernels: many
# times what a trial takes on a slow core with a large camera, so that only what never ends is hung.
_SECONDS_PER_SECOND = 20.0
_SECONDS_MORE = 90.0


@dataclass(frozen=True, kw_only=True)
class DrawnOrder:
    """An order of the starts of a baseline that is not the policy's own.

    Attributes:
        starts: of the baseline, in each scene; None where fresh ones are met.
        candidate: for whom it was drawn, by the `key` of another policy, or `recheck_key`.
    """

    starts: int | None
    candidate: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run is to be: everything resolved and checked, nothing run."""

    request: Request
    suite: Suite  # with the request's changes; with a baseline `trials` is the most of each scene
    bundle: Bundle
    found: tuple[FoundScene, ...]
    trials: tuple[Trial, ...]  # that are to be run here: of a shard, its own
    left_out: tuple[str, ...] = ()
    """Scenes of the suite that are not to be run, by name."""
    own_policy: bool = True
    """Whether the policy is the suite's own: only then its own baseline counts."""
    shard: ShardInfo | None = None
    """Which part of a run it is; None: all of it."""
    against: Against | None = None
    is_baseline: bool = False
    """Whether the policy to be judged is the baseline's own, on the baseline's starts, of which
    only some need run again."""
    again: frozenset[str] = frozenset()
    """Trials that run though the cache of trials has their results."""
    drawn: DrawnOrder | None = None
    """Whose order the trials are in, if not in one of the policy's own."""
    arm: Arm = "candidate"
    robot_folder: Path | None = None
    """Where the suite's robot lies, if that is a folder."""

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The scenes of its trials."""
        return tuple(found.scene for found in self.found)

    @property
    def panel(self) -> PanelKind:
        """Which starts the policy meets."""
        return self.request.panel or "pinned"

    @property
    def drawn_from(self) -> int | None:
        """Starts of the baseline that drew the order of the trials; None if none did."""
        if self.drawn is not None:
            return self.drawn.starts
        if self.against is None or self.panel == "fresh":
            return None
        return self.against.bank.manifest.starts

    @property
    def plugins(self) -> dict[str, str]:
        """What installed packages bring along to its trials: `KEY: package version sha256`.

        Functions of the suite are among them: `scores.NAME: file.py:function sha256`.
        """
        from nw_eval.scenes.folder import FileSplat
        from nw_eval.splat.files import package_format

        of_suite = {
            key: f"{said} {code_named(key)}".strip() for key, said in self.suite.plugins.items()
        }
        of_scenes = {
            key_of(SPLAT_FORMATS, name): identity_of(SPLAT_FORMATS, name)
            for name in (
                package_format(scene.splat.path)
                for scene in self.scenes
                if isinstance(scene.splat, FileSplat)
            )
            if name is not None
        }
        return dict(
            sorted({**self.bundle.plugins, **of_suite, **of_scenes, **self.suite.own_code}.items())
        )

    @property
    def render(self) -> Backend:
        """The splat renderer."""
        return "cpu" if self.request.render is None else self.request.render

    @property
    def renders(self) -> bool:
        """Whether any trial may render."""
        return needs_splats(self.bundle.card, self.suite.record)

    @property
    def kernels(self) -> tuple[Kernels, ...]:
        """Which kernels of the CPU draw its pictures."""
        return kernels_of(self.suite.robot, self.bundle.card, self.suite.render.projection)

    @property
    def time_limit(self) -> float:
        """Wall seconds after which a trial counts as hung."""
        limit = self.request.time_limit
        return default_time_limit(self.suite.episode.duration) if limit is None else limit

    @property
    def memory_limit(self) -> int | None:
        """Bytes that a worker may hold with its children; None = as many as there are."""
        return self.request.memory_bytes


def default_time_limit(duration: float) -> float:
    """Return the wall seconds after which a trial of `duration` simulated s counts as hung."""
    return _SECONDS_MORE + _SECONDS_PER_SECOND * duration


def plan_jobs(plan: Plan, folder: RunFolder) -> tuple[TrialJob, ...]:
    """Return the jobs of a run in the order in which they are to be started.

    Args:
        plan: what is to be run.
        folder: where logs go.
    """
    suite, bundle = plan.suite, plan.bundle
    places = {found.scene.name: found for found in plan.found}
    attached = attachments(bundle.card_text, suite_yaml(suite))
    return tuple(
        TrialJob(
            trial=trial,
            robot=suite.robot,
            robot_folder=plan.robot_folder,
            protocol=suite.protocol,
            task=suite.task,
            scores=suite.measured_by(),
            duration=suite.episode.duration,
            contact_termination=suite.episode.contact_termination,
            scene=places[trial.scene].reference,
            collision=places[trial.scene].collision,
            policy=bundle.reference,
            policy_name=bundle.name,
            checkpoint=plan.request.checkpoint,
            checkpoint_digest=bundle.checkpoint_digest,
            allow_code=plan.request.allow_code,
            record=suite.record,
            mcap=folder.mcap(trial.scene, trial.id).resolve(),
            render=plan.render,
            rendering=suite.render,
            time_limit=plan.time_limit,
            attachments=attached,
        )
        for trial in in_order(plan.trials)
    )
