"""Runs all trials of a plan: workers, journal, retries, resume, and an orderly stop."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING

from nw_eval.engine.listener import Listener, Silence
from nw_eval.engine.machine.cores import worker_count
from nw_eval.engine.machine.interrupts import Interrupts
from nw_eval.engine.repeat import is_open, settled
from nw_eval.engine.rows import make_row
from nw_eval.engine.workers.presence import Presence
from nw_eval.rollout.result import policy_fault

if TYPE_CHECKING:
    import signal
    from collections.abc import Sequence

    from nw_eval.engine.workers.protocol import Finished, Hire
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


def run_trials(
    jobs: Sequence[TrialJob],
    *,
    journal: Journal,
    folder: RunFolder,
    policy: str,
    hire: Hire,
    workers: int | None = None,
    listener: Listener | None = None,
) -> RunOutcome:
    """Run every job that the journal has no result of, and write each result to it at once.

    A trial that ends in an error is run again in a process of its own (`engine.repeat`). The first
    Ctrl-C or SIGTERM stops the workers and returns what is finished; the journal can be resumed. A
    second one raises KeyboardInterrupt.

    Args:
        jobs: in the order in which to start them; their trials' ids differ.
        journal: open; its rows with a result are not run again.
        folder: of the run.
        policy: the policy's name, for rows.
        hire: gets workers.
        workers: how many; one for each core if None.
        listener: told of progress.

    Raises:
        StoreError: the journal cannot be written, and what it holds stays; or it was removed.
        TrialError: workers cannot be kept alive.
        KeyboardInterrupt: a second signal came before the first was obeyed.
    """
    began = perf_counter()
    latest = {row.trial_id: row for row in journal.rows}
    finished = {name for name, row in latest.items() if row.status == "ok"}
    todo = [job for job in jobs if job.trial.id not in finished]
    with suppress(OSError):  # Each trial says that its log cannot be written.
        folder.logs.mkdir(parents=True, exist_ok=True)
    run = _Run(
        journal=journal,
        folder=folder,
        policy=policy,
        listener=listener or Silence(),
        hire=hire,
        presence=Presence(journal.path),
        errors={name: row for name, row in latest.items() if row.status == "error"},
    )
    run.listener.planned(total=len(jobs), finished=len(jobs) - len(todo))
    count = worker_count(workers, len(todo))
    # Where a policy failed before a run was cut, what is missing is the attempt in a fresh process.
    first = [job for job in todo if not run.awaits_repeat(job)]
    again = [job for job in todo if run.awaits_repeat(job)]
    with Interrupts() as interrupts:
        again += run.work(first, interrupts, workers=count, fresh=False)
        while again:
            repeated = [_with_evidence(job) for job in again]
            again = run.work(repeated, interrupts, workers=min(count, len(again)), fresh=True)
    run.presence.check()
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
    """What all passes over the jobs share."""

    journal: Journal
    folder: RunFolder
    policy: str
    listener: Listener
    hire: Hire
    presence: Presence
    errors: dict[str, Row]  # the latest attempt that ended in an error, by trial id

    def awaits_repeat(self, job: TrialJob) -> bool:
        """Whether the policy failed in a trial's latest attempt."""
        row = self.errors.get(job.trial.id)
        return row is not None and policy_fault(row) is not None

    def work(
        self, jobs: Sequence[TrialJob], interrupts: Interrupts, *, workers: int, fresh: bool
    ) -> list[TrialJob]:
        """Run jobs until they are done or a signal came; return those that are to run again.

        Args:
            jobs: any.
            interrupts: heard ten times a second.
            workers: how many.
            fresh: these are further attempts, each in a process of its own.
        """
        again: list[TrialJob] = []
        if not jobs or interrupts.requested is not None:
            return again
        with self.hire(workers, fresh=fresh) as pool:
            pool.submit(jobs)
            for ended in pool.finished():
                if ended is not None:
                    before = self.errors.get(ended.job.trial.id)
                    row = self._keep(ended, before)
                    if is_open(row, before if fresh else None):
                        again.append(ended.job)
                        self._announce_retry(row)
                    else:
                        self._announce_failure(row)
                        self.listener.trial(row)
                self.presence.check()
                if interrupts.requested is not None:
                    break
        return again

    def _keep(self, ended: Finished, before: Row | None) -> Row:
        """Write an attempt down."""
        name = ended.job.trial.id
        row = make_row(
            ended.job,
            settled(ended.result, before),
            attempt=1 if before is None else before.attempt + 1,
            policy=self.policy,
            folder=self.folder,
        )
        self.journal.append(row)
        if row.status == "error":
            self.errors[name] = row
        if ended.result.mcap_error:
            self.listener.message(f"trial {name}: the log is lost: {ended.result.mcap_error}")
        return row

    def _announce_retry(self, row: Row) -> None:
        said = f"{row.error_type}: {row.error_text}"
        self.listener.message(f"trial {row.trial_id}: {said}; it will run again {self.hire.again}")

    def _announce_failure(self, row: Row) -> None:
        if row.outcome == "policy_failed":
            self.listener.message(
                f"trial {row.trial_id}: the policy failed again ({row.end_reason}): that is its "
                "result"
            )
