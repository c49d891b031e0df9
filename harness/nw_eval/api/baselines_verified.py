"""Verifying a baseline: its own policy runs some of its trials again, and what differs shows."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from nw_base.errors import IncomparableError, PolicyError, TrialError
from nw_base.plural import plural
from nw_eval.api.renamed import keywords_were
from nw_eval.engine.how import How

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from nw_eval.api.baselines import BaselineTarget
    from nw_eval.engine.plan import Plan
    from nw_gate.results.baseline import BaselineResults
    from nw_gate.results.row import Row

SHARE = "10%"
"""Of a baseline's starts, where nothing else is asked for."""


@dataclass(frozen=True, kw_only=True)
class VerifiedBaseline:
    """The results of re-running initial states of a baseline with its own policy."""

    file: Path
    baseline: BaselineResults
    seed: int
    """Drew the starts: an int of 48 bits."""
    drawn: int
    """How many were drawn."""
    ran: int
    """How many have a result."""
    has_panel: bool
    """Whether the baseline has been run on this machine type, so that bits must be equal."""
    differing: tuple[str, ...]
    """A sentence for each row that is not as the baseline says, with both values."""
    faults: tuple[str, ...]
    """Trials that had no result this time, and why."""
    interrupted: bool = False
    """Whether a signal ended it before its last trial."""

    @property
    def exit_code(self) -> int:
        """0 all equal, 5 some differ, 4 a trial produced no result and none differs."""
        if self.differing:
            return IncomparableError.exit_code
        return TrialError.exit_code if self.faults or self.ran < self.drawn else 0


@keywords_were(share="trials")
def verify_baseline(
    baseline: str | Path,
    *,
    trials: str | int | None = None,
    seed: int | None = None,
    suite: str | Path | None = None,
    policy: str | None = None,
    **changes: Any,
) -> VerifiedBaseline:
    """Run initial states of a baseline again by its own policy, and compare each with its row.

    Trials of its limits on ladders are drawn by the same share. Of these it is compared whether
    they were completed, which is all that a baseline keeps of them.

    Nothing is reused from the cache of trials, and nothing is written into the project.

    Args:
        baseline: a name, `<suite>/<name>`, or a path.
        trials: how many initial states to re-run, or which share, such as `10%`; at least one
            (default: 10%).
        seed: the seed that an earlier verification printed, to draw the same trials (default:
            random).
        suite: the suite's file, if its name is not enough.
        policy: where the baseline's policy is (default: the path in the baseline).
        changes: of `Request`: checkpoint, render, time_limit, memory_limit, allow_code; of `How`:
            workers, listener.

    Raises:
        UsageError: there is no such baseline or suite, or `trials` is invalid.
        SuiteError, PolicyError: the suite, or the baseline's policy, cannot be used.
        StoreError: the baseline is damaged.
        IncomparableError: it does not hold here, or its policy is another one.
    """
    from nw_eval.api.baselines import baseline_target, show_baseline
    from nw_eval.engine.order import check_sample, draw, unforeseen_seed
    from nw_eval.suite import load_suite

    how = How.taken_from(changes, "workers", "listener")
    sample = SHARE if trials is None else str(trials)
    check_sample(sample)
    shown = show_baseline(baseline, suite=None if suite is None else load_suite(suite).name)
    saved, own = shown.baseline, shown.baseline.manifest.policy
    if policy is None and _is_here(own.card or own.name):
        policy = own.card or own.name
    # Else the suite's own policy is taken: whether it is the baseline's, its digests tell.
    target = baseline_target(suite or saved.manifest.suite, policy=policy, **changes)
    target = target.held_out() if saved.manifest.held_out else target
    target = target.with_starts(saved.manifest.starts)
    _check(saved, target)
    seed = unforeseen_seed() if seed is None else seed
    names = draw([trial.id for trial in target.plan.trials], sample, seed)
    ladders = tuple(_kept_trials(target.plan, saved))  # What does not hold is said before any runs.
    rows, interrupted = _run(target.plan, names, how)
    done = [row for row in rows if row.status == "ok"]
    differing, drawn, ran = list(_differing(done, saved, target.machine)), len(names), len(done)
    for plan, kept in () if interrupted else ladders:
        chosen = draw(list(kept), sample, seed)
        of_ladder, interrupted = _run(plan, chosen, how)
        again = [row for row in of_ladder if row.status == "ok"]
        differing += [
            f"{row.trial_id}: completed {kept[row.trial_id]} -> {row.completed}"
            for row in again
            if row.completed != kept[row.trial_id]
        ]
        rows, drawn, ran = (*rows, *of_ladder), drawn + len(chosen), ran + len(again)
        if interrupted:
            break
    return VerifiedBaseline(
        file=shown.file,
        baseline=saved,
        seed=seed,
        drawn=drawn,
        ran=ran,
        has_panel=saved.panel_of(target.machine) is not None,
        differing=tuple(differing),
        faults=tuple(
            f"{row.trial_id}: {row.error_type}: {row.error_text}"
            for row in rows
            if row.status != "ok"
        ),
        interrupted=interrupted,
    )


def _kept_trials(plan: Plan, saved: BaselineResults) -> Iterator[tuple[Plan, dict[str, bool]]]:
    """Yield the plan of each ladder's trials, and which of those that were kept were completed.

    Raises:
        IncomparableError: a limit is not one on this ladder, or of this suite.
    """
    from nw_eval.api.ladder_runs import ladder_plan_of_run, rung_cells
    from nw_eval.api.limit_gates import MOST_SAVED, is_of
    from nw_gate.limits.limit import Limit
    from nw_sim.ladders import ladder_named

    for name, limit in saved.manifest.limits.items():
        if name not in plan.suite.gate.limits:  # The suite no longer asks for it.
            continue
        family = ladder_named(name, plan.suite.base)
        own = ladder_plan_of_run(family, plan, MOST_SAVED)
        scenes = {scene.name: scene.digest for scene in own.scenes}
        if not is_of(limit, own.suite, scenes, name, plan.suite.gate):
            raise IncomparableError(
                f"the limit of {name} in baseline {saved.manifest.name} is of another ladder or of "
                "other rules than the suite has now",
                fix=f"nw-eval baseline save {plan.suite.name} --renew",
            )
        cells, tried = rung_cells(own, family), Counter[int]()
        names = {(trial.scene, trial.perturbation, trial.index): trial.id for trial in own.trials}
        kept: dict[str, bool] = {}
        for rung, completed in Limit.from_dict(limit.limit).trials:
            kept[names[(*cells[rung], tried[rung])]] = completed
            tried[rung] += 1
        yield own, kept


def _check(baseline: BaselineResults, target: BaselineTarget) -> None:
    """Refuse a baseline of something else.

    Raises:
        IncomparableError: suite, scenes, simulator or policy are others.
    """
    from nw_gate.results.baseline import key_changes, policy_changes

    changes = (
        *key_changes(baseline.manifest.key, target.key),
        *policy_changes(baseline.manifest.policy, target.policy),
    )
    if changes:
        named = ", ".join(f"{each.part} {each.name} {each.then} -> {each.now}" for each in changes)
        raise IncomparableError(
            f"baseline {baseline.manifest.name} cannot be verified here: {named}",
            fix="name its suite with --suite and its policy with --policy, or renew it",
        )


def _run(plan: Plan, names: Sequence[str], how: How) -> tuple[tuple[Row, ...], bool]:
    """Run some trials of a plan in a folder of their own; return rows, and if it was cut."""
    from nw_eval.engine import session
    from nw_gate.results.journal import read_journal
    from nw_gate.results.provenance import read_run_info

    chosen = set(names)
    trials = tuple(trial for trial in plan.trials if trial.id in chosen)
    scenes = {trial.scene for trial in trials}
    found = tuple(each for each in plan.found if each.scene.name in scenes)
    how.told.message(f"{plural(len(trials), 'trial')} of {plan.suite.name} re-run")
    with TemporaryDirectory(prefix="nw-eval-baseline-") as temporary:
        folder = session.carry_out(
            replace(plan, trials=trials, found=found, arm="baseline"),
            replace(how, cache=False),  # It may hold the very results that are to be verified.
            out=Path(temporary) / "run",
        )
        latest = {row.trial_id: row for row in read_journal(folder.journal).rows}
        return tuple(latest.values()), read_run_info(folder.run_json).interrupted


def _is_here(reference: str) -> bool:
    """Whether a policy's card is where a reference says."""
    from nw_policies import find_card

    try:
        find_card(reference)
    except PolicyError:
        return False
    return True


def _differing(
    rows: Sequence[Row], baseline: BaselineResults, machine: dict[str, str]
) -> tuple[str, ...]:
    """Return what differs from the results that a run on a machine type is compared with."""
    from nw_gate.baseline.match import differences

    return differences(rows, baseline.panel_of(machine) or baseline.panels[0])
