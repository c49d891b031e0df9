"""What a run's folder says that the run is: enough to judge it, and to go on with it elsewhere."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.errors import StoreError, UsageError

if TYPE_CHECKING:
    from nw_eval.results.provenance import RunInfo
    from nw_eval.rollout.job import Record
    from nw_eval.scenes.terrain.options import Collision
    from nw_eval.suite import Suite, Trial


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What an interrupted run was started with."""

    suite: Suite
    card: Path | None  # where the policy's card lies; None if it is there no more
    checkpoint: Path | None
    scenes: tuple[str, ...]
    record: Record
    collision: Collision


@dataclass(frozen=True, kw_only=True)
class _Scene:
    """A scene of a run, as its trials' identities need it."""

    name: str
    task: str
    digest: str


def settings_of(run: Path) -> Settings:
    """Return what the run of a folder was started with, to go on with it from any directory.

    Raises:
        StoreError: it is no run's folder, or its run.json is damaged.
    """
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import open_run_folder

    info = read_run_info(open_run_folder(run).run_json)
    suite = saved_suite(info)
    card = Path(info.policy.card)
    return Settings(
        suite=suite,
        card=card if info.policy.card and card.is_file() else None,
        checkpoint=Path(info.policy.checkpoint) if info.policy.checkpoint else None,
        scenes=tuple(escape(name) for name in info.scenes),
        record=suite.record,
        collision="triangles" if info.collision == "triangles" else "terrain",
    )


def saved_suite(info: RunInfo) -> Suite:
    """Return the suite of a run, with what was asked of it otherwise.

    Raises:
        StoreError: run.json holds no suite, or another one than it says.
    """
    from pydantic import ValidationError

    from nw_eval.suite import new_suite
    from nw_eval.suite.model import Source

    folder = Path(info.suite_folder) if info.suite_folder else None
    try:
        suite = new_suite(info.suite, Source(file=info.suite_file, folder=folder))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in ("suite", *first["loc"]))
        raise _damaged(info, f"{place}: {first['msg'].lower()}") from None
    if suite.digest != info.suite_digest:
        raise _damaged(info, f"its suite is {suite.digest[:8]}, not {info.suite_digest[:8]}")
    return suite


def saved_trials(info: RunInfo, suite: Suite) -> tuple[Trial, ...]:
    """Return the trials that a run planned, from its suite and the digests of its scenes.

    Raises:
        StoreError: run.json contradicts itself about them.
    """
    from nw_eval.suite import expand

    scenes = [
        _Scene(name=name, task=scene.task, digest=scene.digest)
        for name, scene in info.scenes.items()
    ]
    try:
        trials = expand(suite, scenes)
    except UsageError as error:
        raise _damaged(info, str(error)) from None
    planned: dict[str, Any] = {name: count for name, count in info.planned.items() if count}
    if Counter(trial.scene for trial in trials) != planned:
        raise _damaged(info, "the numbers of trials of its scenes are not those of its suite")
    return trials


def _damaged(info: RunInfo, said: str) -> StoreError:
    from nw_eval.clean import clean

    return StoreError(
        f"run.json of {clean(info.id, at_most=100)} is damaged: {clean(said, at_most=300)}",
        fix="run again or restore it",
    )
