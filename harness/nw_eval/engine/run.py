"""Runs all trials of a plan: workers, journal, retries, resume, and an orderly stop."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING

from nw_eval.engine.interrupts import Interrupts
from nw_eval.engine.listener import Listener, Silence
from nw_eval.engine.local import RECYCLE_AFTER, Finished, LocalWorkers
from nw_eval.engine.output import WorkerOutput
from nw_eval.engine.prepare import worker_start
from nw_eval.engine.rows import make_row

if TYPE_CHECKING:
    import signal
    from collections.abc import Sequence

    from nw_eval.engine.worker import WorkerStart
    from nw_eval.results.journal import Journal
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.rollout.job import TrialJob


@dataclass(frozen=True, kw_only=True)
class RunOutcome:
    """What became of a run."""

    rows: tuple[Row, ...]  # the latest of every trial that finished, in this run or before
    missing: tuple[str, ...]  # trials of the plan without a row, by id
    interrupted: signal.Signals | None  # which signal stopped it
    wall_seconds: float

    @property
    def errors(self) -> tuple[Row, ...]:
        """Trials that did not run to a result."""
        return tuple(row for row in self.rows if row.status == "error")


def default_workers() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_trials(
    jobs: Sequence[TrialJob],
    *,
    journal: Journal,
    folder: RunFolder,
    policy: str,
    workers: int | None = None,
    listener: Listener | None = None,
) -> RunOutcome:
    """Run every job that the journal has no result of, and write each result to it at once.

    A trial that ends in an error is run once more in a process of its own. The first Ctrl-C or
    SIGTERM kills the trials in flight and returns what is finished; the journal can be resumed.
    A second one raises KeyboardInterrupt.

    Args:
        jobs: in the order in which to start them; their trials' ids differ.
        journal: open; its rows with a result are not run again.
        folder: of the run.
        policy: the policy's name, for rows.
        workers: processes; one for each core if None.
        listener: told of progress.

    Raises:
        StoreError: the journal cannot be written. What it holds stays.
        TrialError: worker processes cannot be kept alive.
        KeyboardInterrupt: a second signal came before the first was obeyed.
    """
    began = perf_counter()
    latest = {row.trial_id: row for row in journal.rows}
    finished = {name for name, row in latest.items() if row.status == "ok"}
    todo = [job for job in jobs if job.trial.id not in finished]
    run = _Run(
        journal=journal,
        folder=folder,
        policy=policy,
        listener=listener or Silence(),
        start=worker_start(jobs, folder),
        attempts={name: row.attempt for name, row in latest.items() if row.status == "error"},
    )
    run.listener.planned(total=len(jobs), finished=len(jobs) - len(todo))
    count = max(1, min(workers or default_workers(), len(todo)))
    with Interrupts() as interrupts:
        failed = run.work(todo, interrupts, workers=count, is_last=False)
        if failed:
            again = [_with_evidence(job) for job in failed]
            run.work(again, interrupts, workers=min(count, len(again)), is_last=True)
    names = {row.trial_id for row in journal.rows}
    return RunOutcome(
        rows=journal.rows,
        missing=tuple(job.trial.id for job in jobs if job.trial.id not in names),
        interrupted=interrupts.requested,
        wall_seconds=perf_counter() - began,
    )


def _with_evidence(job: TrialJob) -> TrialJob:
    """Return a job whose log is written as it goes, and not held back until the trial's end.

    If the trial kills its process again, what it did until then is on disk.
    """
    return replace(job, record="all") if job.record == "failures" else job


@dataclass(kw_only=True)
class _Run:
    """What both passes over the jobs share."""

    journal: Journal
    folder: RunFolder
    policy: str
    listener: Listener
    start: WorkerStart
    attempts: dict[str, int]  # made so far, by trial id

    def work(
        self, jobs: Sequence[TrialJob], interrupts: Interrupts, *, workers: int, is_last: bool
    ) -> list[TrialJob]:
        """Run jobs until they are done or a signal came; return those that ended in an error."""
        failed: list[TrialJob] = []
        if not jobs or interrupts.requested is not None:
            return failed
        recycle = 1 if is_last else RECYCLE_AFTER
        with (
            WorkerOutput(self.folder.workers_log) as output,
            LocalWorkers(workers, start=self.start, output=output, recycle_after=recycle) as pool,
        ):
            pool.submit(jobs)
            for ended in pool.finished():
                if ended is not None:
                    row = self._keep(ended)
                    if row.status == "ok" or is_last:
                        self.listener.trial(row)
                    else:
                        failed.append(ended.job)
                        self._announce_retry(row)
                if interrupts.requested is not None:
                    break
        return failed

    def _keep(self, ended: Finished) -> Row:
        """Write a result down."""
        name = ended.job.trial.id
        self.attempts[name] = self.attempts.get(name, 0) + 1
        row = make_row(
            ended.job,
            ended.result,
            attempt=self.attempts[name],
            policy=self.policy,
            folder=self.folder,
        )
        self.journal.append(row)
        if ended.result.mcap_error:
            self.listener.message(f"trial {name}: the log is lost: {ended.result.mcap_error}")
        return row

    def _announce_retry(self, row: Row) -> None:
        said = f"{row.error_type}: {row.error_text}"
        self.listener.message(f"trial {row.trial_id}: {said}; it will run again in a fresh process")
