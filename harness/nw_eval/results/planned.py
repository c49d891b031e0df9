"""Which rows count: those of the trials that a run planned, if they are what they say."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, TypeVar

from nw_eval.errors import StoreError
from nw_eval.results.provenance import StopInfo
from nw_eval.results.row import Row


class PlannedTrial(Protocol):
    """What a row must agree with; a `suite.Trial`."""

    @property
    def id(self) -> str: ...  # noqa: D102
    @property
    def scene(self) -> str: ...  # noqa: D102
    @property
    def task(self) -> str: ...  # noqa: D102
    @property
    def index(self) -> int: ...  # noqa: D102
    @property
    def seed(self) -> int: ...  # noqa: D102
    @property
    def scene_digest(self) -> str: ...  # noqa: D102
    @property
    def place(self) -> int | None: ...  # noqa: D102
    @property
    def perturbation(self) -> tuple[tuple[str, float], ...]: ...  # noqa: D102


_Planned = TypeVar("_Planned", bound=PlannedTrial)


def wanted(trials: Iterable[_Planned], stop: StopInfo | None) -> tuple[_Planned, ...]:
    """Return the trials of a plan that are judged: all where no trial was left out."""
    return tuple(trial for trial in trials if stop is None or stop.wants(trial.place))


def of_plan(
    rows: Iterable[Row], trials: Iterable[PlannedTrial], *, checkpoint: str
) -> tuple[list[Row], list[Row]]:
    """Return the rows of planned trials, and all others, which no verdict may count.

    Args:
        rows: in any order.
        trials: the plan.
        checkpoint: the digest of the policy that the plan is for, as rows have it.

    Raises:
        StoreError: a row has the name of a planned trial, but another scene, seed or policy.
    """
    plan = {trial.id: trial for trial in trials}
    mine: list[Row] = []
    others: list[Row] = []
    for row in rows:
        trial = plan.get(row.trial_id)
        if trial is None:
            others.append(row)
            continue
        if difference := _difference(row, trial, checkpoint):
            raise StoreError(
                f"the row of trial {row.trial_id} is not of this run: {difference}",
                fix="start a new run",
            )
        mine.append(row)
    return mine, others


def _difference(row: Row, trial: PlannedTrial, checkpoint: str) -> str | None:
    """Return in what a row contradicts its trial, or None."""
    pairs = {
        "scene": (row.scene, trial.scene),
        "task": (row.task, trial.task),
        "index": (row.seed_index, trial.index),
        "perturbation": (row.perturbation, trial.perturbation),
        "scene digest": (row.scene_digest, trial.scene_digest),
        "checkpoint digest": (row.checkpoint_digest, checkpoint),
        "seed": (row.seed, trial.seed),
    }
    for name, (found, planned) in pairs.items():
        if found != planned:
            return f"its {name} is {found!r}, planned was {planned!r}"
    return None
