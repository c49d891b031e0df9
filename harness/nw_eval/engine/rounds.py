"""Runs all trials of a plan: workers, journal, retries, resume, and an orderly stop.

Attempts at trials are given to workers, written down as they end, and made again after an error. A
trial that ends in an error is run once more, in a process of its own. If the policy itself failed
both times in the same way (`words.PolicyFault`), that is what the policy does, and the trial's
result. Everything else stays an error: a machine's fault is never a failure of the policy. Since it
says nothing about the policy at all, a policy's failure that comes only after one has its second
attempt still to come.
"""

from __future__ import annotations

from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_base.plural import plural
from nw_eval.engine.known import NothingKnown
from nw_eval.engine.listener import Listener, NullListener
from nw_eval.engine.machine import Interrupts, worker_count
from nw_eval.engine.rows import make_row
from nw_sim.rollout.job import as_outcome, policy_fault

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from nw_base.words import Arm
    from nw_eval.engine.known import KnownTrials
    from nw_eval.engine.pool import Finished, StartWorkers, Workers
    from nw_gate.results.journal import Journal
    from nw_gate.results.row import Row
    from nw_gate.results.run_folder import RunFolder
    from nw_sim.rollout.job import TrialJob, TrialResult

    Enough = Callable[[Mapping[int, Row]], "RunStanding"]

_BEFORE = "; the attempt before: "
_NOW, _EARLIER = 600, 300  # Characters of each, so that no later cut loses one of them.


@dataclass(frozen=True, kw_only=True)
class RunStanding:
    """How a run against a baseline stands, by positions in its drawn order."""

    first: int
    """All positions below it are judged."""
    followed: tuple[int, ...] = ()
    """Later positions that are judged for their scenes alone."""
    pending: tuple[int, ...] = ()
    """Positions that come next, those that have ended already not among them; none: it is enough,
    unless a scene is waited for."""
    waits_for: tuple[str, ...] = ()
    """Scenes that hold a PASS back, of which no trial is left to run."""
    lacks: tuple[int, ...] = ()
    """Places of the control's trials that are to run before any further one of the run's own."""
    says: str = ""
    """Why no further trial runs; empty = as of a comparison with a baseline."""


def _ended(standing: RunStanding, ran: int, of: int) -> str:
    """Return why no further trial runs."""
    if standing.says:
        return standing.says
    if standing.waits_for:
        return (
            f"undecided after {plural(ran, 'trial')}: {', '.join(standing.waits_for)} "
            f"{'holds' if len(standing.waits_for) == 1 else 'hold'} a PASS back, and no trial of "
            "it is left; --resume with more --trials runs more"
        )
    return f"decided after {ran} of {plural(of, 'trial')}; the rest were skipped"


@dataclass(kw_only=True, eq=False)
class Attempts:
    """All attempts of one run; a context manager that stops its workers.

    A trial that ends in an error is run again in a process of its own. The first Ctrl-C or SIGTERM
    stops the workers; the journal can be resumed. A second one raises KeyboardInterrupt.
    """

    jobs: Sequence[TrialJob]
    """In the order in which to start them; their trials' ids differ."""
    journal: Journal
    """Open; its rows with a result are not run again."""
    folder: RunFolder
    policy: str
    """The policy's name, for rows."""
    start_workers: StartWorkers
    arm: Arm = "candidate"
    """Whether the policy is the one that is judged, for rows."""
    wanted_workers: int | None = None
    """How many (default: one for each core)."""
    listener: Listener = field(default_factory=NullListener)
    """Hears of progress."""
    known: KnownTrials | NothingKnown = field(default_factory=NothingKnown)
    """What need not be run, because an earlier run has its result."""
    interrupts: Interrupts = field(default_factory=Interrupts)
    """Hears signals while trials run."""

    def __post_init__(self) -> None:
        journal = self.journal
        self.by_place = {j.trial.place: j for j in self.jobs if j.trial.place is not None}
        self.workers = worker_count(self.wanted_workers, len(self.jobs))
        self.presence = Presence(journal.path)
        self._pool: Workers | None = None  # They make first attempts, one round after the other.
        self._cleanup = ExitStack()
        latest = {row.trial_id: row for row in journal.rows}
        self._errors = {name: row for name, row in latest.items() if row.status == "error"}
        self._finished = {name for name, row in latest.items() if row.status == "ok"}
        self._lost = {name: row for name, row in latest.items() if row.lost_its_log}
        self._latest = {name: latest[name] for name in self._finished}
        self._ended: dict[str, Row] = {}  # In this session.
        self._is_enough = False
        self._is_held = False  # A trial is to run again before any further one begins.

    def __enter__(self) -> Self:
        with suppress(OSError):  # Each trial says that its log cannot be written.
            self.folder.logs.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(self, *_: object) -> None:
        self.stop_workers()

    def run(self, enough: Enough | None = None) -> RunStanding | None:
        """Run every job that has no result, or those that are needed; write each result at once.

        Workers run ahead in the drawn order, at most one trial each beyond what is known to be
        judged. Which trials are judged does not depend on their number, their speed, or a resume.

        Args:
            enough: asked before the first trial and whenever one has ended, with the rows of those
                that have, by place in the drawn order, what comes next; None = all run.

        Returns:
            How it stands once no trial is needed, or the control is to run first; None if no trial
            was left out, or a signal came first.

        Raises:
            StoreError: the journal cannot be written, and what it holds stays; or it was removed.
            TrialError: workers cannot be kept alive.
            KeyboardInterrupt: a second signal came before the first was obeyed.
        """
        with self.interrupts:
            if enough is None:
                self.settle(self.jobs)
            standing = None if enough is None else self._run_ahead(enough)
        self.presence.check()
        return standing

    def _run_ahead(self, enough: Enough) -> RunStanding | None:
        started = set[int]()

        def more() -> list[TrialJob] | None:
            now = enough(self.ended())
            if now.lacks:
                return []  # What runs ends, and nothing more begins.
            if not now.pending:
                return None
            places = [place for place in now.pending[: self.workers] if place not in started]
            started.update(places)
            return [self.by_place[place] for place in places]

        while self.interrupts.requested is None and (jobs := more()):
            self.settle(jobs, more)
            started.clear()
        if self.interrupts.requested is not None:
            return None
        now = enough(self.ended())
        return now if now.lacks else self._left_out(now)

    def _left_out(self, now: RunStanding) -> RunStanding | None:
        """Say what is not run, and leave no beginning of it; None if all trials have run."""
        for job in self.jobs:
            if job.mcap is not None and self.ended_row(job) is None:
                # A worker may have ended a trial just before it was stopped.
                job.mcap.unlink(missing_ok=True)
                job.mcap.with_name(f"{job.mcap.name}.partial").unlink(missing_ok=True)
        judged = now.first + len(now.followed)
        if judged == len(self.jobs):
            return None
        self.listener.message(_ended(now, judged, len(self.jobs)))
        return now

    def ended(self) -> dict[int, Row]:
        """Return the rows of trials that have ended, by place in the drawn order."""
        rows = {place: self.ended_row(job) for place, job in self.by_place.items()}
        return {place: row for place, row in rows.items() if row is not None}

    @property
    def finished(self) -> int:
        """How many of the jobs had a result when the run began."""
        return sum(self._is_finished(job) for job in self.jobs)

    def ended_row(self, job: TrialJob) -> Row | None:
        """Return the row of a trial that needs no further attempt; None of one that does."""
        name = job.trial.id
        if (row := self._ended.get(name)) is not None:
            return row
        return self._latest[name] if self._is_finished(job) else None

    def settle(
        self, jobs: Sequence[TrialJob], more: Callable[[], list[TrialJob] | None] | None = None
    ) -> None:
        """Run jobs that have no result until none deserves another attempt, or a signal came.

        What the cache knows is written down as soon as what it was compared with has agreed.

        Args:
            jobs: any.
            more: asked whenever one has ended which others are to run as well; None: nothing that
                runs is needed any more. What it says is dropped once a trial is to run again.
        """
        self._is_held = False
        todo = [job for job in jobs if not self._is_finished(job)]
        # An error deserves to be run again, whatever the cache knows.
        new = self.known.to_run([job for job in todo if job.trial.id not in self._errors])
        portion = [job for job in todo if job.trial.id in self._errors] + new
        for is_last in (False, True):
            # Where a policy failed before a run was cut, what is missing is the attempt in a fresh
            # process.
            again = [job for job in portion if self._awaits_repeat(job)]
            first = [job for job in portion if not self._awaits_repeat(job)]
            self._is_held |= bool(again)
            if first and self.interrupts.requested is None:
                if self._pool is None:
                    self._pool = self._cleanup.enter_context(
                        self.start_workers(self.workers, fresh=False)
                    )
                again += self._attempt(self._pool, first, more, fresh=False)
            while again and self.interrupts.requested is None and not self._is_enough:
                self.stop_workers()  # What they hold in memory may be what the others lack.
                repeated = [_with_evidence(job) for job in again]
                with self.start_workers(min(self.workers, len(again)), fresh=True) as workers:
                    again = self._attempt(workers, repeated, None, fresh=True)
            if self._is_enough:
                self.known.unconfirmed()
            if is_last or self._is_enough or self.interrupts.requested is not None:
                return
            self._take_over(at_last=True)
            portion = self.known.unconfirmed()

    def _is_finished(self, job: TrialJob) -> bool:
        """Whether a trial had a result when the run began, and the log that it is to have."""
        name = job.trial.id
        return name in self._finished and not (name in self._lost and job.mcap is not None)

    def _take_over(self, *, at_last: bool = False) -> None:
        """Write down what the cache knows, unless that has yet to be compared."""
        if rows := self.known.agreed(at_last=at_last):
            self.journal.extend(rows)
        for row in rows:
            self._ended[row.trial_id] = row
            self.listener.trial(row)

    def stop_workers(self) -> None:
        """End the workers; more are had when more trials run."""
        self._pool = None
        self._cleanup.close()

    def _awaits_repeat(self, job: TrialJob) -> bool:
        """Whether the policy failed in a trial's latest attempt."""
        row = self._errors.get(job.trial.id)
        return row is not None and policy_fault(row) is not None

    def _attempt(
        self,
        workers: Workers,
        jobs: Sequence[TrialJob],
        more: Callable[[], list[TrialJob] | None] | None,
        *,
        fresh: bool,
    ) -> list[TrialJob]:
        """Make one attempt at each job; return those that are to run again.

        Args:
            workers: idle.
            jobs: any.
            more: as for `settle`.
            fresh: these are further attempts, each in a process of its own.
        """
        again: list[TrialJob] = []
        workers.submit(jobs)
        for ended in workers.finished():
            if ended is not None:
                before = self._errors.get(ended.job.trial.id)
                row = self._keep(ended, before)
                if is_open(row, before if fresh else None):
                    again.append(ended.job)
                    self._is_held = True
                    self._announce_retry(row)
                else:
                    self._announce_failure(row)
                    self._ended[row.trial_id] = row
                    self.listener.trial(row)
                    self._take_over()
                if more is not None and not self._go_on(workers, more):
                    self.stop_workers()  # What runs was given ahead of what is judged.
                    return []
            self.presence.check()
            if self.interrupts.requested is not None:
                break
        return again

    def _go_on(self, workers: Workers, more: Callable[[], list[TrialJob] | None]) -> bool:
        """Give the workers what comes next; return whether anything is needed any more.

        Nothing is given once a trial is to run again after an error: its position in the order
        counts only when it has, and what ran meanwhile might not be needed. `settle` is to be
        called anew.
        """
        while (jobs := more()) is not None:
            self._is_held |= any(job.trial.id in self._errors for job in jobs)
            if self._is_held:
                return True
            todo = [job for job in jobs if not self._is_finished(job)]
            run = self.known.to_run(todo)
            workers.submit(run)
            self._take_over()
            if all(self.ended_row(job) is None for job in jobs):
                return True
        self._is_enough = True
        return False

    def _keep(self, ended: Finished, before: Row | None) -> Row:
        """Write an attempt down."""
        name = ended.job.trial.id
        row = make_row(
            ended.job,
            settled(ended.result, before),
            attempt=1 if before is None else before.attempt + 1,
            policy=self.policy,
            arm=self.arm,
            folder=self.folder,
            host=ended.host,
        )
        lost = self._lost.pop(name, None)
        if lost is not None and row.status == "ok" and lost.digest != row.digest:
            return self._as_before(ended.job, lost)
        self.journal.append(row)
        self.known.ended(ended.job, row)
        if row.status == "error":
            self._errors[name] = row
        if ended.result.mcap_error:
            self.listener.message(f"trial {name}: the log is lost: {ended.result.mcap_error}")
        return row

    def _as_before(self, job: TrialJob, lost: Row) -> Row:
        """Return the result that a trial had when its log was lost: a later one does not count."""
        if job.mcap is not None:
            job.mcap.unlink(missing_ok=True)  # It is of the other result.
        self.listener.message(
            f"trial {lost.trial_id} was re-run because its log was lost, and gave another "
            "result: its first result is kept, without a log"
        )
        return lost

    def _announce_retry(self, row: Row) -> None:
        self.listener.message(
            f"trial {row.trial_id}: {row.error_type}: {row.error_text}; it will run again "
            f"{self.start_workers.again}"
        )

    def _announce_failure(self, row: Row) -> None:
        if row.outcome == "policy_failed":
            self.listener.message(
                f"trial {row.trial_id}: the policy failed again ({row.end_reason}): that is its "
                "result"
            )


def _with_evidence(job: TrialJob) -> TrialJob:
    """Return a job whose log is written as it goes, and not held back until the trial's end.

    If the trial kills its process again, what it did until then is on disk.
    """
    return replace(job, record="all") if job.record == "failures" else job


def settled(result: TrialResult, before: Row | None) -> TrialResult:
    """Return what an attempt comes to in the light of the one before.

    Args:
        result: of this attempt.
        before: the row of the attempt before, an error; None if there was none.
    """
    if result.status == "ok" or before is None:
        return result
    fault = policy_fault(result)
    if fault is not None and fault == policy_fault(before):
        return as_outcome(result)
    if (result.error_type, fault) == (before.error_type, policy_fault(before)):
        return result
    earlier = clean(before.error_text.partition(_BEFORE)[0], at_most=_EARLIER)
    return replace(result, error_text=f"{clean(result.error_text, at_most=_NOW)}{_BEFORE}{earlier}")


def is_open(row: Row, before: Row | None) -> bool:
    """Whether a trial deserves another attempt after the one of this row.

    Args:
        row: of an attempt.
        before: the row of the attempt before it in the same run; None if this was the first.
    """
    if row.status == "ok":
        return False
    return before is None or (policy_fault(row) is not None and policy_fault(before) is None)


class Presence:
    """Remembers which file a journal is, to find out whether it still lies where it did.

    A process may go on writing to a file that has been removed; what it writes is lost.
    """

    def __init__(self, journal: Path) -> None:
        self._journal = journal
        self._known = _identity(journal)

    def check(self) -> None:
        """Do nothing while the file is there.

        Raises:
            StoreError: it is not.
        """
        if self._known is None or _identity(self._journal) != self._known:
            raise StoreError(
                f"{self._journal.parent} was removed or replaced while the run went on",
                fix="put it back and continue with --resume, or run again",
            )


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino
