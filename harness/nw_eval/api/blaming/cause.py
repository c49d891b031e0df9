"""Whether a run is worse than a baseline for what its policy sees, or for what it does about it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from glob import escape
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from nw_eval.engine.listener import Listener
    from nw_eval.engine.plan import Plan
    from nw_eval.gate.cause.two_by_two import Apart, Arm, Cause
    from nw_eval.policies import Bundle
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row
    from nw_eval.suite import Suite


@dataclass(frozen=True, kw_only=True)
class FoundCause:
    """What a run's drop against a baseline is due to.

    Attributes:
        run: the run's folder.
        cause: what came of it.
        out: folder of the four policies' runs, and of `cause.md`.
    """

    run: Path
    cause: Cause
    out: Path


def find_cause(
    run: Path,
    *,
    baseline: str,
    policy: str | None = None,
    checkpoint: Path | None = None,
    trials: int | None = None,
    workers: int | None = None,
    allow_code: bool = False,
    cache: bool = True,
    out: Path | None = None,
    listener: Listener | None = None,
) -> FoundCause:
    """Run old and new control with old and new sight in the trials of a run, and compare.

    Args:
        run: the run's folder; its suite, its starts and its policy.
        baseline: a bank, whose policy is the old one; or a policy.
        policy: where the bank's policy lies, if not where the bank says.
        checkpoint: weights in place of those that its card names.
        trials: in each scene; the run's own number if None. More than it has are those that would
            come next.
        workers: processes; one for each core if None.
        allow_code: whether Python code that cards name may be imported.
        cache: whether results of earlier runs are taken over.
        out: a new folder; `cause` or `cause-<n>` in the run's folder if None.
        listener: hears of progress.

    Raises:
        UsageError, StoreError, IncomparableError: as `blame`; no trial was ended by all four.
        PolicyError: the policies cannot be taken apart, or not put together crosswise.
    """
    from nw_eval.api.blaming.exchange import apart, write_crossed
    from nw_eval.api.blaming.policy import baseline_bundle
    from nw_eval.api.running.plans import check_workers
    from nw_eval.api.running.saved_run import check_whole, continued
    from nw_eval.gate.cause.file import write_cause_file
    from nw_eval.gate.cause.two_by_two import ARMS
    from nw_eval.reporting.markdown import write_cause
    from nw_eval.request import Request
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import open_run_folder
    from nw_eval.rollout.confined.start import prepare

    check_workers(workers)
    if trials is not None and trials < 1:
        raise UsageError(f"--trials {trials}", fix="give at least 1")
    source = open_run_folder(run)
    info = check_whole(read_run_info(source.run_json))
    base = continued(run, Request(allow_code=allow_code, shard=None))
    new = base.bundle
    old = baseline_bundle(baseline, info, policy=policy, checkpoint=checkpoint)
    different = apart(old, new)
    if not allow_code:
        prepare()
    folder = _folder(source.path, out)
    suite = _plain(base.suite, _rounds(info, base.suite, trials))
    bundles = {"old": old, "new": new}
    plans: dict[Arm, Plan] = {}
    for arm in ARMS:
        control, sight = (bundles[side] for side in arm)
        if _same(arm, different) == arm:
            card = control.reference
            if arm[0] != arm[1]:
                name = _name(arm)
                card = str(write_crossed(folder / name / "policy", control, sight, name=name))
            plans[arm] = _planned(base, info, suite, card, control)
    found = {
        arm: _rolled(planned, folder / _name(arm), workers, cache, listener)
        for arm, planned in plans.items()
    }
    rows = {arm: found[_same(arm, different)] for arm in ARMS}
    cause = _caused(rows, different, old=old.name, new=new.name)
    write_cause(cause, source.id, folder / "cause.md")
    write_cause_file(cause, source.cause)
    return FoundCause(run=source.path, cause=cause, out=folder)


def _name(arm: Arm) -> str:
    return f"{arm[0]}-control-{arm[1]}-sight"


def _same(arm: Arm, apart: Apart) -> Arm:
    """Return which policy as it is an exchanged one is; itself where it is none of them."""
    control, sight = arm
    if not apart.sight:
        return control, control
    if not apart.rest and not apart.weights:
        return sight, sight
    return arm


def _caused(rows: Mapping[Arm, Sequence[Row]], apart: Apart, *, old: str, new: str) -> Cause:
    from nw_eval.gate.cause.two_by_two import cause_of

    try:
        return cause_of(rows, apart, old=old, new=new)
    except ValueError as error:
        raise UsageError(str(error), fix="read the reports of the four runs") from None


def _rounds(info: RunInfo, suite: Suite, trials: int | None) -> int:
    """Return how many trials of each scene, on average, the four policies run.

    Raises:
        UsageError: the run has none, or its bank has too few starts for as many.
    """
    rounds = trials or suite.trials
    if trials is None and info.stop is not None:
        cells = max(1, len(info.scenes) * len(suite.perturb.cells))
        rounds = ceil(info.stop.first / cells)
    if not rounds:
        raise UsageError(
            f"run {info.id} ran nothing: its policy is the baseline's",
            fix="name the run of another policy",
        )
    if info.drawn_from is not None and rounds > info.drawn_from:
        raise UsageError(
            f"--trials {rounds}: the run drew its starts from the {info.drawn_from} of a baseline",
            fix=f"give at most {info.drawn_from}",
        )
    return rounds


def _plain(suite: Suite, rounds: int) -> Suite:
    """Return a suite that judges nothing, with so many trials of each scene."""
    from nw_eval.suite.model import Gate

    changes = {"gate": Gate.model_validate({}), "record": "none", "trials": rounds}
    return suite.model_copy(update=changes)


def _planned(base: Plan, info: RunInfo, suite: Suite, card: str, bundle: Bundle) -> Plan:
    """Return the plan of one of the four: the starts of the run, in its order."""
    from nw_eval.api.running.plans import plan
    from nw_eval.api.running.saved_run import whole_plan
    from nw_eval.engine.plan import DrawnOrder

    own = {field.name: getattr(base.request, field.name) for field in fields(base.request)}
    changes = {
        **own,
        "suite": None,
        "policy": card,
        "checkpoint": bundle.checkpoint,
        "baseline": "none",
        "record": "none",
        "shard": None,
        "seed": None,  # The suite has it, also where the run's starts were its policy's own.
        "panel": None,
        "trials": None,
        "scenes": tuple(escape(place.scene.name) for place in base.found),
    }
    planned = plan(suite, **changes)
    if info.drawn_from is None:
        return planned
    drawn = DrawnOrder(starts=info.drawn_from, candidate=info.drawn_by)
    return replace(planned, trials=whole_plan(info, suite), drawn=drawn)


def _rolled(
    planned: Plan, out: Path, workers: int | None, cache: bool, listener: Listener | None
) -> Sequence[Row]:
    from nw_eval.api.running.reports import judge
    from nw_eval.api.running.runs import roll_out

    done = roll_out(
        planned,
        workers=workers,
        out=out / "run",
        resume=None,
        in_process=False,
        listener=listener,
        cache=cache,
    )
    report = judge(done.path, baseline="none")
    if report.interrupted:
        raise UsageError(f"{out} was interrupted: four whole runs are needed", fix="run it again")
    return report.rows


def _folder(run: Path, out: Path | None) -> Path:
    if out is not None:
        if out.exists():
            raise UsageError(f"{out} is there already", fix="name a new folder with --out")
        return out
    number = 1
    while (path := run / ("cause" if number == 1 else f"cause-{number}")).exists():
        number += 1
    return path
