"""Weights & Biases: on the run that `WANDB_RUN_ID` names, or on one of its own.

Scores are the run's summary, not its history: who tracks a run again replaces them, and the
steps of a training are left alone. Those of a watched training are history, over a step of their
own. The report is an artifact, of which equal versions are one.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

from nw_base.errors import PrerequisiteError
from nw_eval.reporting.trackers.tracked import PROJECT, TrackedRun


def track(run: TrackedRun) -> None:
    """Show a run; `WANDB_MODE`, `WANDB_PROJECT`, `WANDB_ENTITY` and the like are W&B's own.

    Raises:
        PrerequisiteError: no user is logged in. The key is not asked for: a CI job cannot answer.
        wandb.Error: W&B cannot be reached, or refuses.
    """
    wandb: Any = import_module("wandb")
    mode = wandb.setup().settings.mode
    if mode in {"online", "shared"} and not wandb.login(prompt=False):
        raise PrerequisiteError(
            "no user is logged in to W&B",
            fix="set WANDB_API_KEY, run `wandb login`, or set WANDB_MODE=offline",
        )
    with wandb.init(**_own(run), settings=_quiet(wandb)) as session:
        session.config.update(dict(run.words), allow_val_change=True)
        if run.step is None:
            session.summary.update({**run.numbers, f"{run.place}/verdict": run.verdict})
        else:  # W&B's own step only grows, and the latest checkpoint comes first.
            step = f"{run.place}/training_step"
            session.define_metric(f"{run.place}/*", step_metric=step)
            session.log({**run.numbers, step: run.step})
        artifact = wandb.Artifact(f"report-{run.id}", type="nw-eval-report")
        for file in run.files:
            artifact.add_file(str(file))
        for name, clip in run.clips.items():
            with artifact.new_file(f"clips/{name}", mode="wb") as file:
                file.write(clip.data)
        session.log_artifact(artifact)


def _own(run: TrackedRun) -> dict[str, Any]:
    """Return which run it is, as far as W&B's variables do not say it; arguments would win."""
    wanted = {"WANDB_PROJECT": ("project", PROJECT), "WANDB_RESUME": ("resume", "allow")}
    if not os.environ.get("WANDB_RUN_ID"):
        wanted |= {"WANDB_RUN_ID": ("id", run.id), "WANDB_NAME": ("name", run.title)}
    return dict(own for variable, own in wanted.items() if not os.environ.get(variable))


def _quiet(wandb: Any) -> Any:
    """Return settings by which W&B neither prints nor looks at what else runs here."""
    return wandb.Settings(
        silent=True,
        console="off",
        save_code=False,
        disable_git=True,
        x_disable_stats=True,
    )
