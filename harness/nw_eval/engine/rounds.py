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
from dataclasses import dataclass, replace
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
    import signal
    from collections.abc import Callable, Iterable, Mapping, Sequence

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
    ahead: tuple[int, ...] = ()
    """Places that come next, those that have ended already not among them; none: it is enough,
    unless a scene is waited for."""
    waits_for: tuple[str, ...] = ()
    """Scenes that hold a PASS back, of which no trial is left to run."""


@dataclass(frozen=True, kw_only=True)
class RunOutcome:
    """What became of a run."""

    rows: Sequence[Row]  # the latest of every trial that finished, in this run or before
    missing: tuple[str, ...]  # trials that were to be run and have no row, by id
    enough: RunStanding | None  # trials that were; None = no trial of the plan was left out
    interrupted: signal.Signals | None  # which signal stopped it


def run_trials(
    jobs: Sequence[TrialJob],
    *,
    journal: Journal,
    folder: RunFolder,
    policy: str,
    start_workers: StartWorkers,
    arm: Arm = "candidate",
    workers: int | None = None,
    enough: Enough | None = None,
    listener: Listener | None = None,
    known: KnownTrials | NothingKnown | None = None,
) -> RunOutcome:
    """Run every job that the journal has no result of, and write each result to it at once.

    A trial that ends in an error is run again in a process of its own (`engine.rounds`). The
    first Ctrl-C or SIGTERM stops the workers and returns what is finished; the journal can be
    resumed. A second one raises KeyboardInterrupt.

    Args:
        jobs: in the order in which to start them; their trials' ids differ.
        journal: open; its rows with a result are not run again.
        folder: of the run.
        policy: the policy's name, for rows.
        start_workers: gets workers.
        arm: whether the policy is the one that is judged, for rows.
        workers: how many; one for each core if None.
        enough: asked before the first trial and whenever one has ended, with the rows of those that
            have, by index in the drawn order, what comes next. No more trials run ahead than there
            are workers. None = all of them run.
        listener: told of progress.
        known: what of it need not be run, because an earlier run has its result; nothing if None.

    Raises:
        StoreError: the journal cannot be written, and what it holds stays; or it was removed.
        TrialError: workers cannot be kept alive.
        KeyboardInterrupt: a second signal came before the first was obeyed.
    """
    told = listener or NullListener()
    attempts = Attempts(
        journal=journal,
        folder=folder,
        policy=policy,
        arm=arm,
        listener=told,
        start_workers=start_workers,
        workers=worker_count(workers, len(jobs)),
        known=known or NothingKnown(),
    )
    told.planned(total=len(jobs), finished=attempts.finished_of(jobs))
    standing = None
    with Interrupts() as interrupts, attempts:
        if enough is None:
            attempts.settle(jobs, interrupts)
        else:
            standing = _ahead(jobs, attempts, interrupts, enough)
    wanted = jobs
    if standing is not None:
        judged = {*range(standing.first), *standing.followed}
        wanted = [job for job in jobs if job.trial.place in judged]
        told.message(_ended(standing, len(wanted), len(jobs)))
    attempts.presence.check()
    names = {row.trial_id for row in journal.rows}
    return RunOutcome(
        rows=journal.rows,
        missing=tuple(job.trial.id for job in wanted if job.trial.id not in names),
        enough=standing,
        interrupted=interrupts.requested,
    )


def _ended(standing: RunStanding, ran: int, of: int) -> str:
    """Return why no further trial runs."""
    if standing.waits_for:
        return (
            f"undecided after {plural(ran, 'trial')}: {', '.join(standing.waits_for)} "
            f"{'holds' if len(standing.waits_for) == 1 else 'hold'} a PASS back, and no trial of "
            "it is left; --resume with more --trials runs more"
        )
    return f"decided after {plural(ran, 'trial')}: {of - ran} of {of} trials need not run"


def _ahead(
    jobs: Sequence[TrialJob], attempts: Attempts, interrupts: Interrupts, enough: Enough
) -> RunStanding | None:
    """Run trials in their drawn order until there are enough.

    Workers run ahead in the order, at most one trial each beyond what is known to be judged. Which
    trials are judged does not depend on their number, their speed, or a resume.

    Returns:
        How it stands; None if no trial was left out, or a signal came first.
    """
    by_place = {job.trial.place: job for job in jobs}
    started = set[int]()

    def standing() -> RunStanding:
        ended = {
            place: row
            for place, job in by_place.items()
            if place is not None and (row := attempts.ended_row(job)) is not None
        }
        return enough(ended)

    def more() -> list[TrialJob] | None:
        now = standing()
        if not now.ahead:
            return None
        places = [place for place in now.ahead[: attempts.workers] if place not in started]
        started.update(places)
        return [by_place[place] for place in places]

    while interrupts.requested is None:
        started.clear()
        if not (first := more()):
            break
        attempts.settle(first, interrupts, more)
    if interrupts.requested is not None:
        return None
    for job in by_place.values():
        if job.mcap is not None and attempts.ended_row(job) is None:
            job.mcap.with_name(f"{job.mcap.name}.partial").unlink(missing_ok=True)
    now = standing()
    judged = now.first + len(now.followed)
    return now if judged < len(jobs) else None


@dataclass(kw_only=True, eq=False)
class Attempts:
    """All attempts of one run; a context manager that stops its workers."""

    journal: Journal
    """Open."""
    folder: RunFolder
    policy: str
    """The policy's name, for rows."""
    arm: Arm
    """Whether it is the one that is judged, for rows."""
    listener: Listener
    start_workers: StartWorkers
    workers: int
    """How many."""
    known: KnownTrials | NothingKnown
    """What need not be run, because an earlier run has its result."""

    def __post_init__(self) -> None:
        journal = self.journal
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
        self._stop_workers()

    def finished_of(self, jobs: Iterable[TrialJob]) -> int:
        """Return how many of the jobs had a result when the run began."""
        return sum(self._is_finished(job) for job in jobs)

    def ended_row(self, job: TrialJob) -> Row | None:
        """Return the row of a trial that needs no further attempt; None of one that does."""
        name = job.trial.id
        if (row := self._ended.get(name)) is not None:
            return row
        return self._latest[name] if self._is_finished(job) else None

    def settle(
        self,
        jobs: Sequence[TrialJob],
        interrupts: Interrupts,
        more: Callable[[], list[TrialJob] | None] | None = None,
    ) -> None:
        """Run jobs that have no result until none deserves another attempt, or a signal came.

        What the cache knows is written down as soon as what it was compared with has agreed.

        Args:
            jobs: any.
            interrupts: heard whenever workers say something, and some ten times a second.
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
            if first and interrupts.requested is None:
                if self._pool is None:
                    self._pool = self._cleanup.enter_context(
                        self.start_workers(self.workers, fresh=False)
                    )
                again += self._attempt(self._pool, first, interrupts, more, fresh=False)
            while again and interrupts.requested is None and not self._is_enough:
                self._stop_workers()  # What they hold in memory may be what the others lack.
                repeated = [_with_evidence(job) for job in again]
                with self.start_workers(min(self.workers, len(again)), fresh=True) as workers:
                    again = self._attempt(workers, repeated, interrupts, None, fresh=True)
            if self._is_enough:
                self.known.unconfirmed()
            if is_last or self._is_enough or interrupts.requested is not None:
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

    def _stop_workers(self) -> None:
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
        interrupts: Interrupts,
        more: Callable[[], list[TrialJob] | None] | None,
        *,
        fresh: bool,
    ) -> list[TrialJob]:
        """Make one attempt at each job; return those that are to run again.

        Args:
            workers: idle.
            jobs: any.
            interrupts: after the first of them, the rest is left.
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
                    self._stop_workers()  # What runs was given ahead of what is judged.
                    return []
            self.presence.check()
            if interrupts.requested is not None:
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
            f"trial {lost.trial_id} came out otherwise than before, when its log was lost: its "
            "first result stands, without a log"
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
