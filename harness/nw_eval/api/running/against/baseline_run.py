"""The baseline's own trials on a class of machine that its bank has not seen.

They are a run of their own, `baseline/` in the folder of the candidate's: the bank's policy from
the bank's starts, as many rounds as show what the bank is worth here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nw_eval.errors import IncomparableError, PolicyError, TrialError
from nw_eval.files.inside import what_is
from nw_eval.gate.baseline.holding.match import renewing
from nw_eval.gate.baseline.holding.sentinel import watch
from nw_eval.gate.baseline.judge import compare
from nw_eval.plural import plural
from nw_eval.protocol import PROTOCOLS
from nw_eval.results.provenance import read_run_info

if TYPE_CHECKING:
    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.policies import Bundle
    from nw_eval.results.bank.against import Against
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder


def run_baseline(
    plan: Plan,
    against: Against,
    folder: RunFolder,
    run: RunInfo,
    *,
    workers: int | None,
    cluster: str | None,
    command: tuple[str, ...],
    listener: Listener,
    cache: bool,
) -> RunInfo:
    """Run the bank's policy until it is known what the bank is worth here.

    Args:
        plan: the candidate's.
        against: the bank.
        folder: of the candidate's run.
        run: its run.json.
        workers: processes; one for each core if None.
        cluster: the address of the Ray cluster that trials run on; None = this machine.
        command: what was typed.
        listener: hears of progress.
        cache: whether results of earlier runs are taken over.

    Returns:
        The candidate's run.json: with what was found, and with no rounds to be run where the bank
        does not hold here; or interrupted.

    Raises:
        IncomparableError: the bank's policy is not here, or the bank has too few starts for a class
            of machine on which bits are others.
        TrialError: a trial of the bank's policy came to no result, or not to what the cache says.
    """
    from nw_eval.api.running.plans import baseline_plan
    from nw_eval.engine import session

    nested = folder.baseline
    is_begun = what_is(nested.run_json) == "file"
    watching = _Watch(plan, against, run)
    session.carry_out(
        baseline_plan(plan, against, _bundle(plan, against, run)),
        workers=workers,
        cluster=cluster,
        out=None if is_begun else nested.path,
        resume=nested.path if is_begun else None,
        command=command,
        listener=listener,
        prelude=watching.begin,
        enough=watching.enough,
        cache=cache,
    )
    own = read_run_info(nested.run_json)
    if own.cache is not None and own.cache.differing:
        raise TrialError(
            f"the baseline's policy {own.policy.name}: {own.cache.differing[0]}",
            fix="start a new run",
        )
    if own.interrupted:
        return run.model_copy(update={"interrupted": True})
    return _with_finding(run, own, _rows(nested, own, folder), against, plan)


class _Watch:
    """Asks after each round whether it is known what the bank is worth."""

    def __init__(self, plan: Plan, against: Against, candidate: RunInfo) -> None:
        self._gate = plan.suite.gate
        self._bank = against.bank
        self._candidate = candidate
        self._run: RunInfo | None = None

    def begin(self, _: RunFolder, run: RunInfo) -> RunInfo:
        self._run = run
        return run

    def enough(self, rows: Sequence[Row]) -> bool:
        assert self._run is not None, "a run begins before its first round ends"
        if any(row.status == "error" for row in rows):
            return True  # What it would have come to decides.
        seen = watch(rows, self._run, self._bank, self._gate)
        if seen.checked != "bits":  # Before more is run: has a mere sample starts enough?
            compare((), self._candidate, self._bank, self._gate, checked="scores")
        return seen.checked is not None or bool(seen.moved)


def _rows(nested: RunFolder, own: RunInfo, folder: RunFolder) -> tuple[Row, ...]:
    """Return the rows of the baseline's run.

    Raises:
        TrialError: one is an error.
    """
    from nw_eval.api.running.saved_run import saved_suite, saved_trials
    from nw_eval.results.ended import read_trials

    rows = read_trials(nested, own, saved_trials(own, saved_suite(own))).rows
    if errors := [row for row in rows if row.status == "error"]:
        raise TrialError(
            f"{plural(len(errors), 'trial')} of the baseline's policy {own.policy.name} ended in "
            f"errors, first {errors[0].trial_id}: {errors[0].error_text or errors[0].error_type}",
            fix=f"--resume {folder.path} tries them again",
        )
    return rows


def _with_finding(
    run: RunInfo, own: RunInfo, rows: Sequence[Row], against: Against, plan: Plan
) -> RunInfo:
    """Return the candidate's run.json with what the baseline's rows show.

    Raises:
        IncomparableError: the bank has too few starts for what it is here.
    """
    seen = watch(rows, own, against.bank, plan.suite.gate)
    moved = seen.moved or seen.open
    known = against.info.model_copy(update={"checked": seen.checked, "moved": moved})
    if moved:
        return run.model_copy(update={"baseline": known, "stopped_after": 0})
    compare((), run, against.bank, plan.suite.gate, checked=seen.checked)
    return run.model_copy(update={"baseline": known})


def _bundle(plan: Plan, against: Against, run: RunInfo) -> Bundle:
    """Return the bank's policy: where the request says, or the bank.

    Raises:
        IncomparableError: it is not there, cannot be used, or is another one.
    """
    from nw_eval.policies import find_card, load_bundle
    from nw_eval.rollout.confined.vetting import vet_bundle

    own = against.bank.manifest.policy
    reference = plan.request.baseline_policy or own.card or own.name
    try:
        bundle = vet_bundle(
            load_bundle(find_card(reference)),
            plan.suite.robot,
            protocol=PROTOCOLS[plan.suite.protocol],
            allow_code=plan.request.allow_code,
        )
    except PolicyError as error:
        fault = error.message
    else:
        ours, theirs = (
            (bundle.checkpoint_digest, bundle.digest),
            (own.checkpoint_digest, own.card_digest),
        )
        if ours == theirs:
            return bundle
        fault = (
            f"{reference} is another one: checkpoint {ours[0][:8]} and card {ours[1][:8]}, the "
            f"bank's {theirs[0][:8]} and {theirs[1][:8]}"
        )
    raise IncomparableError(
        f"bank {against.info.name} has not seen this class of machine, and its policy {own.name} "
        f"cannot be run on it: {fault}",
        fix="say where it lies with --baseline-policy PATH, or save a panel here: "
        f"`{renewing(run, against.bank)}`",
    )
