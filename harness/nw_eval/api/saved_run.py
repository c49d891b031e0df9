"""What a run's folder says that the run is: enough to judge it, and to go on with it elsewhere."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.errors import IncomparableError, StoreError, UsageError
from nw_eval.request import Shard

if TYPE_CHECKING:
    import pandas as pd

    from nw_eval.engine.plan import Plan
    from nw_eval.request import Request
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.suite import Suite, Trial
    from nw_eval.suite.trials import SceneLike


@dataclass(frozen=True, kw_only=True)
class _Scene:
    """A scene of a run, as its trials' identities need it."""

    name: str
    task: str
    digest: str


def continued(run: Path, request: Request) -> Plan:
    """Return the plan that goes on with the run of a folder, from any directory.

    Args:
        run: the folder.
        request: what is asked for now; what it leaves out is as the run was begun.

    Raises:
        StoreError: it is no run's folder, or its run.json is damaged.
        IncomparableError: its run.json does not say what was asked for.
        UsageError, SuiteError, PolicyError: as `plan_of`.
    """
    from nw_eval.api.banks import resumed_bank
    from nw_eval.api.plans import plan_of
    from nw_eval.results.journal import has_begun
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import open_run_folder
    from nw_eval.suite import draft_of, draft_suite

    folder = open_run_folder(run)
    info = read_run_info(folder.run_json)
    suite = saved_suite(info)
    if info.request is None:
        raise IncomparableError(
            f"cannot resume {run}: an older version of nw-eval started it, and its run.json "
            "holds no request",
            fix="start a new run without --resume",
        )
    if info.drawn_for is not None and not (info.is_recheck or info.goes_by_rounds):
        raise IncomparableError(
            f"cannot resume {run}: `nw-eval attribute` chose its initial states from another run",
            fix="run `nw-eval attribute --cause` again; finished trials come from the cache",
        )
    if request.shard is not None and request.shard != info.request.shard:
        was = "all of its trials" if info.shard is None else str(info.shard)
        raise IncomparableError(
            f"cannot resume {run} as --shard {request.shard}: it was begun as {was}",
            fix="start a new run without --resume",
        )
    whole = request.over(info.request)
    draft = None if request.suite is None else draft_suite(request.suite)
    if draft is not None and draft.suite is not None and has_begun(folder.journal):
        _check_gate(run, suite, draft.suite)
    against = resumed_bank(folder, info, suite, request)
    if draft is not None:
        card = None if whole.policy is None or request.policy is not None else _card(info)
        own = info.own_policy if request.policy is None else None
        plan = plan_of(whole, draft, card=card, against=against, own_policy=own)
    else:
        plan = plan_of(
            whole,
            draft_of(suite),
            card=None if request.policy is not None else _card(info),
            # A scene that the suite's patterns match only now is none of the run's.
            scenes=[escape(name) for name in info.scenes] if request.scenes is None else None,
            against=against,
            # Its suite as it was kept names the policy that was asked for.
            own_policy=info.own_policy,
        )
    return _as_drawn(plan, folder, info)


def _check_gate(run: Path, begun: Suite, now: Suite) -> None:
    """Refuse to judge a run by other rules than it was begun with.

    More trials are no other rules: what is claimed holds at any look.

    Raises:
        IncomparableError: a setting of the gate is another one; naming each, then and now.
    """
    then, today = (suite.gate.model_dump(mode="json", exclude={"rounds"}) for suite in (begun, now))
    changed = [
        f"gate.{name} is {today.get(name)}, it was begun with {then.get(name)}"
        for name in sorted({*then, *today})
        if then.get(name) != today.get(name)
    ]
    if changed:
        raise IncomparableError(
            f"cannot resume {run} with another gate: {'; '.join(changed)}",
            fix="resume it without naming a suite, or start a new run, which takes its trials from "
            "the cache",
        )


def _as_drawn(plan: Plan, folder: RunFolder, info: RunInfo) -> Plan:
    """Return a plan that meets the starts that its run was begun with."""
    from nw_eval.api.plans import rechecked
    from nw_eval.results.journal import has_begun, read_journal

    if not plan.is_baseline:
        return plan
    if info.is_recheck and info.drawn_for is not None:
        return rechecked(plan, int(info.drawn_for.rpartition("/")[2]))
    if info.goes_by_rounds:
        return rechecked(plan, 0, all_rounds=True)
    if has_begun(folder.journal) and read_journal(folder.journal).rows:  # A part of a run.
        return replace(plan, is_baseline=False)
    return plan


def _card(info: RunInfo) -> Path | None:
    """Return where the card of a run's policy lies; None if it is there no more."""
    card = Path(info.policy.card)
    return card if info.policy.card and card.is_file() else None


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
    from nw_eval.results.ended import wanted

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
        folder: of the run.
        info: its run.json.

    Raises:
        StoreError: they, or run.json, are damaged.
    """
    from nw_eval.results.ended import read_trials

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
    from nw_eval.gate.baseline.match import drawn_order
    from nw_eval.suite import expand
    from nw_eval.suite.trials import MAX_TRIALS

    scenes = _saved_scenes(info)
    order = None
    if info.drawn_from is not None or (info.panel == "fresh" and info.baseline is not None):
        strata = [(scene.name, cell) for scene in scenes for cell in suite.perturb.cells]
        starts = suite.trials if info.drawn_from is None else info.drawn_from
        if not suite.trials <= starts <= MAX_TRIALS // max(1, len(strata)):
            raise _damaged(info, f"{suite.trials} trials of each scene of {starts} starts")
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
    from nw_eval.clean import clean

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
        UsageError: it is no run's folder.
        StoreError: its rows are damaged.
    """
    import pandas as pd

    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.row import Row, to_dict
    from nw_eval.results.run_folder import open_run_folder

    folder = open_run_folder(Path(run))
    found = saved_rows(folder, read_run_info(folder.run_json))
    rows = sorted(found, key=lambda row: row.trial_id)
    values = [{**to_dict(row), "seed": str(row.seed)} for row in rows]
    return pd.DataFrame(values, columns=list(Row.__dataclass_fields__))
