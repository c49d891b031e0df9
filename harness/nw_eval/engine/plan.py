"""From trials to jobs: everything that a worker needs to know, decided before the first starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from nw_eval.engine.order import in_order
from nw_eval.rollout.job import TrialJob
from nw_eval.rollout.record import attachments

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from nw_eval.policies import Bundle
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.rollout.job import Backend
    from nw_eval.scenes import Scene
    from nw_eval.suite.model import Suite
    from nw_eval.suite.trials import Trial

# Wall seconds for each simulated second, and on top for the first compilation of kernels: many
# times what a trial takes on a slow core with a large camera, so that only what never ends is hung.
_SECONDS_PER_SECOND = 20.0
_SECONDS_MORE = 90.0


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run is to be: everything resolved and checked, nothing run."""

    suite: Suite  # with what was asked of it otherwise
    bundle: Bundle
    scenes: tuple[Scene, ...]
    references: Mapping[str, str]
    """What `scenes.get_scene` understands for a scene's name, where it is not the name itself: the
    folders of scenes that are not built in."""
    trials: tuple[Trial, ...]
    checkpoint: Path | None = None  # weights that were given instead of the card's
    allow_code: bool = False  # whether `python:` adapters may import code


def default_time_limit(duration: float) -> float:
    """Return the wall seconds after which a trial of `duration` simulated s counts as hung."""
    return _SECONDS_MORE + _SECONDS_PER_SECOND * duration


def plan_jobs(
    plan: Plan,
    folder: RunFolder,
    *,
    render: Backend = "cpu",
    time_limit: float | None = None,
    suite_text: str = "",
) -> tuple[TrialJob, ...]:
    """Return the jobs of a run in the order in which they are to be started.

    Args:
        plan: what is to be run.
        folder: where logs go.
        render: the splat backend.
        time_limit: wall seconds after which a trial counts as hung.
        suite_text: the resolved suite, attached to every log.
    """
    suite, bundle = plan.suite, plan.bundle
    limit = default_time_limit(suite.episode.duration) if time_limit is None else time_limit
    attached = attachments(bundle.card_text, suite_text)
    return tuple(
        TrialJob(
            trial=trial,
            robot=suite.robot,
            protocol=suite.protocol,
            duration=suite.episode.duration,
            contact_termination=suite.episode.contact_termination,
            scene=plan.references.get(trial.scene, trial.scene),
            policy=bundle.reference,
            policy_name=bundle.name,
            checkpoint=None if plan.checkpoint is None else plan.checkpoint.resolve(),
            checkpoint_digest=bundle.checkpoint_digest,
            allow_code=plan.allow_code,
            record=suite.record,
            mcap=folder.mcap(trial.scene, trial.id).resolve(),
            render=render,
            time_limit=limit,
            attachments=attached,
        )
        for trial in in_order(plan.trials)
    )
