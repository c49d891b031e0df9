"""Where a bank's results come from: trials that are run now, or a run that has ended."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import TrialError, UsageError
from nw_eval.plural import plural

if TYPE_CHECKING:
    from nw_eval.api.baselines.here import Here
    from nw_eval.engine.listener import Listener
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row


def new_results(
    place: Here, *, workers: int | None, cache: bool, listener: Listener | None
) -> tuple[RunInfo, tuple[Row, ...]]:
    """Run what has no result yet, and say first how much that is, and after Ctrl-C how to go on.

    Raises:
        KeyboardInterrupt: it was interrupted, and its results stay.
        StoreError: results cannot be written; those that were written stay.
        TrialError: one is not what the cache of trials says.
    """
    from nw_eval.engine import session
    from nw_eval.engine.listener import Silence
    from nw_eval.results.ended import read_trials
    from nw_eval.results.journal import has_begun
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import RunFolder

    listener = listener or Silence()
    listener.message(_ahead(place, workers=workers))
    work = RunFolder(path=place.work)
    is_begun = has_begun(work.journal)
    try:
        folder = session.carry_out(
            place.plan,
            workers=workers,
            out=None if is_begun else work.path,
            resume=work.path if is_begun else None,
            command=tuple(sys.argv),
            listener=listener,
            cache=cache,
        )
    except KeyboardInterrupt:  # Before the trials, or while they were stopped.
        listener.message(_onwards(place))
        raise
    run = read_run_info(folder.run_json)
    if run.cache is not None and run.cache.differing:
        raise TrialError(run.cache.differing[0], fix=f"remove {work.path}, and save again")
    rows = read_trials(folder, run, place.plan.trials).rows
    if run.interrupted and len(rows) < len(place.plan.trials):
        listener.message(_onwards(place))
        raise KeyboardInterrupt
    return run, rows


def _ahead(place: Here, *, workers: int | None) -> str:
    """Return how many trials a save runs at most, and how long they take at most."""
    from nw_eval.engine.forecast import minutes_of
    from nw_eval.engine.machine.cores import worker_count

    total = len(place.plan.trials)
    left = total - _kept(place)
    if not left:
        return f"all {total} trials have results already"
    trials = f"{left} of {total} trials" if left < total else plural(total, "trial")
    minutes = minutes_of(left, place.plan, workers=workers)
    return (
        f"{trials} to run: at most about {minutes:.1f} minutes with --workers "
        f"{worker_count(workers, left)}; Ctrl-C keeps what has ended, and the same command goes on"
    )


def _onwards(place: Here) -> str:
    """Return how a save that was interrupted goes on."""
    kept = _kept(place)
    if not kept:
        return "no trial has ended yet; the same command begins again"
    return f"{kept} of {len(place.plan.trials)} trials are kept; the same command goes on with them"


def _kept(place: Here) -> int:
    """Return how many trials of a save have a result in its work folder.

    Raises:
        StoreError: its journal cannot be read.
    """
    from nw_eval.results.journal import has_begun, read_journal
    from nw_eval.results.run_folder import RunFolder

    journal = RunFolder(path=place.work).journal
    if not has_begun(journal):
        return 0
    planned = {trial.id for trial in place.plan.trials}
    rows = read_journal(journal).rows
    return sum(row.trial_id in planned and row.status == "ok" for row in rows)


def finished_results(folder: Path, suite: str) -> tuple[RunInfo, tuple[Row, ...]]:
    """Return what a run of a suite has.

    Raises:
        UsageError: it is no run, or none of this suite, or a part of one.
        StoreError: it is damaged.
    """
    from nw_eval.api.running.saved_run import check_whole, saved_suite, saved_trials
    from nw_eval.results.ended import read_trials
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.run_folder import open_run_folder

    opened = open_run_folder(folder)
    run = check_whole(read_run_info(opened.run_json))
    if (name := run.suite.get("name")) != suite:
        raise UsageError(
            f"{folder} is a run of suite {name!r}, not {suite!r}", fix="name its suite"
        )
    return run, read_trials(opened, run, saved_trials(run, saved_suite(run))).rows
