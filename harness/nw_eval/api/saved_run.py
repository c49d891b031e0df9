"""What a run's folder says that the run is: enough to judge it, and to go on with it elsewhere."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.errors import StoreError, UsageError
from nw_gate.results.request import Shard

if TYPE_CHECKING:
    import pandas as pd

    from nw_base.trials import SceneLike
    from nw_eval.suite import Suite, Trial
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_gate.results.run_folder import RunFolder


@dataclass(frozen=True, kw_only=True)
class _Scene:
    """A scene of a run, as its trials' identities need it."""

    name: str
    task: str
    digest: str


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
        location = ".".join(str(part) for part in ("suite", *first["loc"]))
        raise _damaged(info, f"{location}: {first['msg'].lower()}") from None
    if suite.digest != info.suite_digest:
        raise _damaged(info, f"its suite is {suite.digest[:8]}, not {info.suite_digest[:8]}")
    return suite


def _saved_scenes(info: RunInfo) -> list[SceneLike]:
    """Return the scenes of a run, as far as run.json says what they are."""
    return [
        _Scene(name=name, task=scene.task, digest=scene.digest)
        for name, scene in info.scenes.items()
    ]


def saved_trials(info: RunInfo, suite: Suite) -> tuple[Trial, ...]:
    """Return the trials that a run planned, from its suite and the digests of its scenes.

    Those of a shard are its part alone. Where a part of the trials was enough, it is those.

    Raises:
        StoreError: run.json contradicts itself about them.
    """
    from nw_eval.engine.order import shard_of
    from nw_gate.results.ended import wanted

    trials = whole_plan(info, suite)
    if info.shard is not None:
        shard = Shard(index=info.shard.index, count=info.shard.count)
        try:
            trials, known = shard_of(trials, shard)
        except UsageError as error:
            raise _damaged(info, str(error)) from None
        if known != info.shard:
            raise _damaged(info, f"the plan that it is {info.shard} of is another one")
    trials = wanted(trials, info.stop)
    planned: dict[str, Any] = {name: count for name, count in info.planned.items() if count}
    if Counter(trial.scene for trial in trials) != planned:
        raise _damaged(info, "the numbers of trials of its scenes are not those of its suite")
    return trials


def saved_rows(folder: RunFolder, info: RunInfo) -> tuple[Row, ...]:
    """Return the rows of a run's plan.

    Args:
        folder: the run's folder.
        info: its run.json.

    Raises:
        StoreError: they, or run.json, are damaged.
    """
    from nw_gate.results.ended import read_trials

    return read_trials(folder, info, saved_trials(info, saved_suite(info))).rows


def spare_trials(info: RunInfo, suite: Suite) -> frozenset[str]:
    """Return the trials by id that a run may have run beyond those that were enough.

    Raises:
        StoreError, IncomparableError: as `whole_plan`.
    """
    if info.stop is None:
        return frozenset()
    plan = whole_plan(info, suite)
    return frozenset(trial.id for trial in plan if not info.stop.wants(trial.place))


def whole_plan(info: RunInfo, suite: Suite) -> tuple[Trial, ...]:
    """Return all trials of the run that a run is, or is a part of, in the order of its suite.

    Against a baseline the run says how many starts it drew them from.

    Raises:
        StoreError: run.json contradicts itself about them.
        IncomparableError: an older nw-eval drew them in another way.
    """
    from nw_base.trials import MAX_TRIALS
    from nw_eval.suite import expand
    from nw_gate.baseline.match import drawn_order

    scenes = _saved_scenes(info)
    order = None
    if info.drawn_from is not None or (info.panel == "fresh" and info.baseline is not None):
        strata = [(scene.name, cell) for scene in scenes for cell in suite.perturb.cells]
        starts = suite.trials if info.drawn_from is None else info.drawn_from
        if not suite.trials <= starts <= MAX_TRIALS // max(1, len(strata)):
            raise _damaged(info, f"{suite.trials} trials of each scene of {starts} initial states")
        order = drawn_order(info, strata, suite.trials)
    try:
        return expand(suite, scenes, order)
    except UsageError as error:
        raise _damaged(info, str(error)) from None


def check_whole(info: RunInfo) -> RunInfo:
    """Return the run.json of a run that may be judged, or serve as a measure.

    Raises:
        UsageError: it is of a part of a run.
    """
    if info.is_part:
        raise UsageError(
            f"run {info.id} is {info.shard}, which is not the whole run",
            fix="put all parts together with `nw-eval merge RUN... --out FOLDER`",
        )
    return info


def _damaged(info: RunInfo, fault: str) -> StoreError:
    from nw_base.clean import clean

    return StoreError(
        f"run.json of {clean(info.id, at_most=100)} is damaged: {clean(fault, at_most=300)}",
        fix="run again or restore it",
    )


def read_rows(run: str | Path) -> pd.DataFrame:
    """Return the rows of a run that count: a line for each trial of its plan that has a result.

    Args:
        run: the run's folder; it may go on, or have been interrupted.

    Returns:
        A column for each field of `Row`, sorted by trial. `trial_id` and the start that it names
        are the same for every policy of a suite. `seed` is text, as in the file.
        `success` is missing where a trial ended in an error, which says nothing about the policy.

    Raises:
        UsageError: it is not a run folder.
        StoreError: its rows are damaged.
    """
    import pandas as pd

    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.row import Row, to_dict
    from nw_gate.results.run_folder import open_run_folder

    folder = open_run_folder(Path(run))
    saved = saved_rows(folder, read_run_info(folder.run_json))
    rows = sorted(saved, key=lambda row: row.trial_id)
    values = [{**to_dict(row), "seed": str(row.seed)} for row in rows]
    return pd.DataFrame(values, columns=list(Row.__dataclass_fields__))
