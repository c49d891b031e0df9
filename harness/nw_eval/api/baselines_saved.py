"""Saving a baseline: what is missing is run, and what a renewal moves is shown before it replaces.

Results come from trials that are run now, or from a run that has ended.
"""

from __future__ import annotations

import getpass
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from nw_base.errors import IncomparableError, StoreError, TrialError, UsageError
from nw_base.plural import plural
from nw_eval.api.paths import as_path
from nw_eval.api.renamed import keywords_were
from nw_eval.engine.how import How

if TYPE_CHECKING:
    from os import PathLike

    from nw_eval.api.baselines import BaselineTarget
    from nw_gate.results.baseline import BaselineChange, BaselineResults, SavedLimit
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row

STARTS, _STARTS_IN_ALL = 60, 400
"""M where it is unknown: three times the default `gate.rounds`, so a run draws a third at most."""


@dataclass(frozen=True, kw_only=True)
class SavedBaseline:
    """What became of a baseline."""

    file: Path
    action: Literal["new", "panel", "limits", "unchanged", "renewed", "kept"]
    """new: there was none. panel: it has this machine type now, too. limits: it has the limits on
    ladders now, too. unchanged: it had all of this. renewed: it was replaced. kept: it would hold
    for something else, or say something else, and is unchanged, because no renewal was asked
    for."""
    baseline: BaselineResults
    """The baseline that is there now; for `kept` the one that would be."""
    change: BaselineChange | None = None
    """What differs from the one that was there."""
    run: Path | None = None
    """The folder of the run that its results are from: rows and logs; None where no trial was
    asked for, as the baseline had all of it."""
    may_have_chosen: bool = False
    """Whether that run is one of a training that was watched, and so may have chosen the policy."""


@keywords_were(starts="trials", from_run="run")
def save_baseline(
    suite: str | Path,
    *,
    policy: str | None = None,
    trials: int | None = None,
    name: str | None = None,
    note: str = "",
    run: str | Path | None = None,
    renew: bool = False,
    held_out: bool = False,
    root: str | PathLike[str] | None = None,
    **changes: Any,
) -> SavedBaseline:
    """Save what a policy scores from every start of a panel: the baseline of later gates.

    Trials that are missing are run, into a folder in `reports/` from which an interrupted save goes
    on, and a later one with more starts.

    Args:
        suite: a suite file or the name of a shipped one.
        policy: a shipped policy's name, a policy folder, or a card (default: the suite's policy).
        trials: trials per scene (default: as many as the baseline has; for a new one 60, or 400 in
            all in a suite of few scenes).
        name: the baseline's name (default: the policy's name).
        note: why it is saved (default: the note it has).
        run: save this finished run as the baseline, without running anything.
        renew: replace the existing baseline and its results of all machine types.
        held_out: draw its initial states from a separate seed set. Use it for a policy that was
            chosen by its results on the suite's seed set, such as the best of a training.
        root: the folder of baselines (default: `reports/baselines`).
        changes: of `Request`: scenes, robot, checkpoint, render, time_limit, memory_limit,
            allow_code; of `How`: workers, cache, listener.

    Raises:
        UsageError, SuiteError, PolicyError: nothing was run.
        KeyboardInterrupt: it was interrupted; the trials that have ended are kept.
        TrialError: a trial produced no result, or another one than the cache has; no baseline
            was written.
        StoreError: results cannot be written, or the baseline that is there is damaged.
        IncomparableError: the run makes no baseline.
    """
    from nw_eval.api.baselines import baseline_target, card_reference
    from nw_eval.api.limit_climbs import baseline_limits
    from nw_eval.suite import load_suite
    from nw_gate.results.baseline_file import baseline_of_run

    root = as_path(root)
    if trials is not None and trials < 1:
        raise UsageError(f"--trials {trials} is too low", fix="give at least 1")
    how = How.taken_from(changes, "workers", "cache", "listener")
    target, info, rows = None, None, ()
    if run is None:
        target = baseline_target(suite, policy=policy, **changes)
        target = target.held_out() if held_out else target
        folder, own = target.plan.suite.name, target.policy.name
    else:
        asked = {"policy": policy, "trials": trials, "held_out": held_out, "workers": how.workers}
        _check_decided({**asked, **changes})
        folder = load_suite(suite).name
        info, rows = _finished_results(Path(run), folder)
        own = info.policy.name
    file = _file(root, folder, name or own)
    earlier = _earlier(file, renew=renew)
    if target is not None:
        scenes = len(target.plan.scenes) * len(target.plan.suite.perturb.cells)
        starts = trials or (earlier.manifest.starts if earlier else starts_for(scenes))
        target = target.with_starts(starts)
        if earlier is not None and not renew and target.is_in(earlier, starts):
            limits = baseline_limits(target.plan, how, target.work, earlier.manifest.limits)
            return _with_limits(file, earlier, limits)
        info, rows = _new_results(target, how)
    assert info is not None, "results are of a run, new or finished"
    _check_seen(rows, info)
    found = baseline_of_run(
        rows,
        info,
        name=file.stem,
        card=card_reference(info.policy.card),
        by=author(),
        note=note or (earlier.manifest.note if earlier else ""),
        held_out=held_out,
    )
    if target is not None:
        known = {} if earlier is None or renew else earlier.manifest.limits
        limits = baseline_limits(target.plan, how, target.work, known)
        manifest = found.manifest.model_copy(update={"limits": limits})
        found = replace(found, manifest=manifest)
    ran = Path(run) if run is not None else target.work if target is not None else None
    return replace(
        _written(file, earlier, found, renew=renew),
        run=ran,
        may_have_chosen=run is not None and {"training_run", "step"} <= info.labels.keys(),
    )


def _check_decided(wanted: dict[str, Any]) -> None:
    """Refuse what is asked for besides a run that has decided it.

    Raises:
        UsageError: something is.
    """
    if decided := [option for option, value in wanted.items() if value]:
        raise UsageError(
            f"--run and --{decided[0].replace('_', '-')}: the run has decided that",
            fix="drop one of them",
        )


def _check_seen(rows: Sequence[Row], run: RunInfo) -> None:
    """Refuse a baseline that mostly shows what its policy does in fog.

    Raises:
        IncomparableError: more of its trials left the captured volume than the suite allows.
    """
    from nw_eval.api.saved_run import saved_suite
    from nw_gate.validity import over_the_cap, that_left

    gate = saved_suite(run).gate
    if capped := over_the_cap(rows, that_left(rows, gate), gate):
        raise IncomparableError(
            f"run {run.id} makes no baseline: {capped}", fix="photograph the scenes again"
        )


def _file(root: Path | None, suite: str, name: str) -> Path:
    """Return where a baseline belongs.

    Raises:
        UsageError: its name is none.
    """
    from nw_gate.results.baseline_file import BASELINES_FOLDER, SUFFIX, fault_of_name

    if fault := fault_of_name(name):
        raise UsageError(f"a baseline's name: {fault}", fix="give another with --name")
    return (root or BASELINES_FOLDER) / suite / (name + SUFFIX)


def _earlier(file: Path, *, renew: bool) -> BaselineResults | None:
    """Return the baseline that is there; None if there is none, or an unreadable one is replaced.

    Raises:
        StoreError, IncomparableError: it cannot be read, and is not to be replaced.
    """
    from nw_gate.results.baseline_file import read_baseline

    try:
        return read_baseline(file) if file.exists() else None
    except (StoreError, IncomparableError):
        if not renew:
            raise
        return None


def starts_for(scenes: int) -> int:
    """Return M of a new baseline: of few scenes more, twice the 200 trials of a gate in all."""
    return max(STARTS, -(-_STARTS_IN_ALL // max(1, scenes)))


def _written(
    file: Path, earlier: BaselineResults | None, found: BaselineResults, *, renew: bool
) -> SavedBaseline:
    """Write a baseline unless it would silently become another one."""
    from nw_base.files.cache import followed
    from nw_gate.results.baseline import baseline_change
    from nw_gate.results.baseline_file import with_panel, write_baseline

    if earlier is None:
        write_baseline(followed(file), found)
        return SavedBaseline(file=file, action="new", baseline=found)
    change = baseline_change(earlier, found)
    known = earlier.panel_of(found.panels[0].machine)
    if not change.fields and known == found.panels[0]:
        limits = {**earlier.manifest.limits, **found.manifest.limits}
        return _with_limits(file, earlier, limits)
    if not renew and not change.fields and known is None:
        whole = with_panel(earlier, found)
        write_baseline(followed(file), whole)
        return SavedBaseline(file=file, action="panel", baseline=whole, change=change)
    if not renew:
        return SavedBaseline(file=file, action="kept", baseline=found, change=change)
    write_baseline(followed(file), found)
    return SavedBaseline(file=file, action="renewed", baseline=found, change=change)


def _with_limits(
    file: Path, earlier: BaselineResults, limits: dict[str, SavedLimit]
) -> SavedBaseline:
    """Write the limits of a baseline that has all the results of its scenes."""
    from nw_base.files.cache import followed
    from nw_gate.results.baseline_file import write_baseline

    if limits == earlier.manifest.limits:
        return SavedBaseline(file=file, action="unchanged", baseline=earlier)
    manifest = earlier.manifest.model_copy(update={"limits": limits})
    found = replace(earlier, manifest=manifest)
    write_baseline(followed(file), found)
    return SavedBaseline(file=file, action="limits", baseline=found)


def _new_results(target: BaselineTarget, how: How) -> tuple[RunInfo, tuple[Row, ...]]:
    """Run what has no result yet, and say first how much that is, and after Ctrl-C how to go on.

    Raises:
        KeyboardInterrupt: it was interrupted, and its results stay.
        StoreError: results cannot be written; those that were written stay.
        TrialError: one is not what the cache of trials says.
    """
    from nw_eval.engine import session
    from nw_gate.results.ended import read_trials
    from nw_gate.results.journal import has_begun
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import RunFolder

    how.told.message(_estimate_message(target, workers=how.workers))
    work = RunFolder(path=target.work)
    is_begun = has_begun(work.journal)
    try:
        folder = session.carry_out(
            target.plan,
            how,
            out=None if is_begun else work.path,
            resume=work.path if is_begun else None,
        )
    except KeyboardInterrupt:  # Before the trials, or while they were stopped.
        how.told.message(_resume_message(target))
        raise
    run = read_run_info(folder.run_json)
    if run.cache is not None and run.cache.differing:
        raise TrialError(run.cache.differing[0], fix=f"remove {work.path}, and save again")
    rows = read_trials(folder, run, target.plan.trials).rows
    if run.interrupted and len(rows) < len(target.plan.trials):
        how.told.message(_resume_message(target))
        raise KeyboardInterrupt
    return run, rows


def _estimate_message(target: BaselineTarget, *, workers: int | None) -> str:
    """Return how many trials a save runs at most, and how long they take at most."""
    from nw_eval.engine.machine import worker_count
    from nw_eval.engine.plan import minutes_of

    total = len(target.plan.trials)
    left = total - _kept_trials(target)
    if not left:
        return f"all {total} trials have results already"
    trials = f"{left} of {total} trials" if left < total else plural(total, "trial")
    minutes = minutes_of(left, target.plan, workers=workers)
    return (
        f"{trials} to run: about {minutes:.1f} minutes with --workers "
        f"{worker_count(workers, left)}; Ctrl-C keeps finished trials; the same command resumes"
    )


def _resume_message(target: BaselineTarget) -> str:
    """Return how a save that was interrupted goes on."""
    kept = _kept_trials(target)
    if not kept:
        return "no trial has ended yet; the same command begins again"
    return (
        f"{kept} of {len(target.plan.trials)} trials are kept; run the same command again to resume"
    )


def _kept_trials(target: BaselineTarget) -> int:
    """Return how many trials of a save have a result in its work folder.

    Raises:
        StoreError: its journal cannot be read.
    """
    from nw_gate.results.journal import has_begun, read_journal
    from nw_gate.results.run_folder import RunFolder

    journal = RunFolder(path=target.work).journal
    if not has_begun(journal):
        return 0
    planned = {trial.id for trial in target.plan.trials}
    rows = read_journal(journal).rows
    return sum(row.trial_id in planned and row.status == "ok" for row in rows)


def _finished_results(folder: Path, suite: str) -> tuple[RunInfo, tuple[Row, ...]]:
    """Return what a run of a suite has.

    Raises:
        UsageError: it is no run, or none of this suite, or a part of one.
        StoreError: it is damaged.
    """
    from nw_eval.api.saved_run import check_whole, saved_rows
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.run_folder import open_run_folder

    opened = open_run_folder(folder)
    run = check_whole(read_run_info(opened.run_json))
    if (name := run.suite.get("name")) != suite:
        raise UsageError(
            f"{folder} is a run of suite {name!r}, not {suite!r}", fix="name its suite"
        )
    return run, saved_rows(opened, run)


def author() -> str:
    """Return the name that Git would write into a commit here, or else the user's; or nothing."""
    try:
        done = subprocess.run(
            ["git", "config", "user.name"],  # noqa: S607  # Whichever git the user has.
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        try:
            return getpass.getuser()
        except (OSError, KeyError):  # A container's user may have no name.
            return ""
    return done.stdout.strip()
