"""Runs all trials of a plan: rounds, workers, journal, retries, resume, and an orderly stop."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

from nw_eval.engine.cache.nothing import NothingKnown
from nw_eval.engine.listener import Listener, Silence
from nw_eval.engine.machine.cores import worker_count
from nw_eval.engine.machine.interrupts import Interrupts
from nw_eval.engine.order import rounds
from nw_eval.engine.trials.attempts import Attempts

if TYPE_CHECKING:
    import signal
    from collections.abc import Callable, Sequence

    from nw_eval.engine.cache.known import KnownTrials
    from nw_eval.engine.workers.protocol import Hire
    from nw_eval.results.journal import Journal
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.rollout.job import TrialJob
    from nw_eval.words import Arm

    Enough = Callable[[Sequence[Row]], bool]


@dataclass(frozen=True, kw_only=True)
class RunOutcome:
    """What became of a run."""

    rows: tuple[Row, ...]  # the latest of every trial that finished, in this run or before
    missing: tuple[str, ...]  # trials that were to be run and have no row, by id
    stopped_after: int | None  # rounds that were enough; None = no trial of the plan was left out
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
    arm: Arm = "candidate",
    workers: int | None = None,
    enough: Enough | None = None,
    listener: Listener | None = None,
    known: KnownTrials | NothingKnown | None = None,
) -> RunOutcome:
    """Run every job that the journal has no result of, and write each result to it at once.

    A trial that ends in an error is run again in a process of its own (`engine.trials.repeat`). The
    first Ctrl-C or SIGTERM stops the workers and returns what is finished; the journal can be
    resumed. A second one raises KeyboardInterrupt.

    Args:
        jobs: in the order in which to start them; their trials' ids differ.
        journal: open; its rows with a result are not run again.
        folder: of the run.
        policy: the policy's name, for rows.
        hire: gets workers.
        arm: whether the policy is the one that is judged, for rows.
        workers: how many; one for each core if None.
        enough: asked after each round but the last, with the rows of all rounds so far in the order
            of their jobs, whether the rest need not run; None = all of them run, without rounds.
        listener: told of progress.
        known: what of it need not be run, because an earlier run has its result; nothing if None.

    Raises:
        StoreError: the journal cannot be written, and what it holds stays; or it was removed.
        TrialError: workers cannot be kept alive.
        KeyboardInterrupt: a second signal came before the first was obeyed.
    """
    began = perf_counter()
    ears = listener or Silence()
    attempts = Attempts(
        journal=journal,
        folder=folder,
        policy=policy,
        arm=arm,
        listener=ears,
        hire=hire,
        workers=worker_count(workers, len(jobs)),
        known=known or NothingKnown(),
    )
    ears.planned(total=len(jobs), finished=attempts.finished_of(jobs))
    wanted, stopped_after = list(jobs), None
    with Interrupts() as interrupts, attempts:
        if enough is None:
            attempts.settle(jobs, interrupts)
        else:
            wanted, stopped_after = _by_rounds(jobs, attempts, interrupts, enough)
    if stopped_after is not None:
        saved = f"{len(jobs) - len(wanted)} of {len(jobs)} trials need not run"
        ears.message(f"enough after round {stopped_after}: {saved}")
    attempts.presence.check()
    names = {row.trial_id for row in journal.rows}
    return RunOutcome(
        rows=journal.rows,
        missing=tuple(job.trial.id for job in wanted if job.trial.id not in names),
        stopped_after=stopped_after,
        interrupted=interrupts.requested,
        wall_seconds=perf_counter() - began,
    )


def _by_rounds(
    jobs: Sequence[TrialJob], attempts: Attempts, interrupts: Interrupts, enough: Enough
) -> tuple[list[TrialJob], int | None]:
    """Run round after round until there are enough.

    No trial starts before all of the round before have ended, those that are run again included. So
    what has run does not depend on the number of workers, their speed, or a resume.

    Returns:
        The jobs that were to be run, and the number of rounds that were enough: all jobs and None
        if they were not, or if a signal came first.
    """
    wanted: list[TrialJob] = []
    for number, part in enumerate(rounds(jobs), 1):
        attempts.settle(part, interrupts)
        wanted += part
        if interrupts.requested is not None or len(wanted) == len(jobs):
            break
        if enough(attempts.rows_of(wanted)):
            return wanted, number
    return list(jobs), None
