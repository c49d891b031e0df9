"""The plan that goes on with the run of a folder."""

from __future__ import annotations

from dataclasses import replace
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.errors import IncomparableError
from nw_eval.api.saved_run import saved_suite

if TYPE_CHECKING:
    from nw_eval.engine.plan import Plan
    from nw_eval.suite import Suite
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.request import Request
    from nw_gate.results.run_folder import RunFolder


def continued(run: Path, request: Request, *, again: bool = False) -> Plan:
    """Return the plan that goes on with the run of a folder, from any directory.

    Args:
        run: the folder.
        request: what is asked for now; what it leaves out is as the run was begun.
        again: whether trials that it has are to run again, and none of those that it lacks. This
            can be done with the trials of a search, too.

    Raises:
        StoreError: it is not a run folder, or its run.json is damaged.
        IncomparableError: its run.json does not say what was asked for.
        UsageError, SuiteError, PolicyError: as `plan_of`.
    """
    from nw_eval.api.loaded_baselines import resumed_baseline
    from nw_eval.api.plans import plan_of
    from nw_eval.suite import draft_of, draft_suite
    from nw_gate.results.journal import has_begun
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import open_run_folder

    folder = open_run_folder(run)
    info = read_run_info(folder.run_json)
    suite = saved_suite(info)
    if info.request is None:
        raise IncomparableError(
            f"cannot resume {run}: an older version of nw-eval started it, and its run.json "
            "holds no request",
            fix="start a new run without --resume",
        )
    is_planned = info.is_recheck or info.goes_by_rounds or (again and info.is_search)
    if info.drawn_for is not None and not is_planned:
        raise IncomparableError(
            f"cannot resume {run}: `nw-eval attribute` or `nw-eval limits` chose its trials",
            fix="run that command again; finished trials come from the cache",
        )
    if request.shard is not None and request.shard != info.request.shard:
        was = "all of its trials" if info.shard is None else str(info.shard)
        raise IncomparableError(
            f"cannot resume {run} as --shard {request.shard}: it was started as {was}",
            fix="start a new run without --resume",
        )
    whole = request.over(info.request)
    draft = None if request.suite is None else draft_suite(request.suite)
    if draft is not None and draft.suite is not None and has_begun(folder.journal):
        _check_gate(run, suite, draft.suite)
    against = resumed_baseline(folder, info, suite, request)
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
    return _restore_draw(plan, folder, info)


def _check_gate(run: Path, begun: Suite, current: Suite) -> None:
    """Refuse to judge a run by other rules than it was started with.

    More trials are no other rules: what is claimed holds at any look.

    Raises:
        IncomparableError: a setting of the gate is another one; naming each, then and now.
    """
    recorded, today = (
        suite.gate.model_dump(mode="json", exclude={"rounds"}) for suite in (begun, current)
    )
    changed = [
        f"gate.{name} is {today.get(name)}, it was started with {recorded.get(name)}"
        for name in sorted({*recorded, *today})
        if recorded.get(name) != today.get(name)
    ]
    if changed:
        raise IncomparableError(
            f"cannot resume {run} with another gate: {'; '.join(changed)}",
            fix="resume it without naming a suite, or start a new run, which takes its trials from "
            "the cache",
        )


def _restore_draw(plan: Plan, folder: RunFolder, info: RunInfo) -> Plan:
    """Return a plan that meets the starts that its run was begun with."""
    from nw_eval.api.plans import rechecked
    from nw_gate.results.journal import has_begun, read_journal

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
