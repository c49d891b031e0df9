"""Runs all trials of a plan: workers, journal, retries, resume, and an orderly stop."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

from nw_eval.engine.cache.nothing import NothingKnown
from nw_eval.engine.listener import Listener, Silence
from nw_eval.engine.machine.cores import worker_count
from nw_eval.engine.machine.interrupts import Interrupts
from nw_eval.engine.trials.attempts import Attempts
from nw_eval.plural import plural

if TYPE_CHECKING:
    import signal
    from collections.abc import Callable, Mapping, Sequence

    from nw_eval.engine.cache.known import KnownTrials
    from nw_eval.engine.workers.protocol import Hire
    from nw_eval.results.journal import Journal
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder
    from nw_eval.rollout.job import TrialJob
    from nw_eval.words import Arm

    Enough = Callable[[Mapping[int, Row]], "RunStanding"]


@dataclass(frozen=True, kw_only=True)
class RunStanding:
    """How a run against a baseline stands, by places in its drawn order."""

    first: int
    """All places below it are judged."""
    followed: tuple[int, ...] = ()
    """Later places that are judged for their scenes alone."""
    ahead: tuple[int, ...] = ()
    """Places that come next, those that have ended already not among them; none: it is enough,
    unless a scene is waited for."""
    waits_for: tuple[str, ...] = ()
    """Scenes that hold a PASS back, of which no trial is left to run."""


@dataclass(frozen=True, kw_only=True)
class RunOutcome:
    """What became of a run."""

    rows: tuple[Row, ...]  # the latest of every trial that finished, in this run or before
    missing: tuple[str, ...]  # trials that were to be run and have no row, by id
    enough: RunStanding | None  # trials that were; None = no trial of the plan was left out
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
        enough: asked before the first trial and whenever one has ended, with the rows of those that
            have, by place in the drawn order, what comes next. No more trials run ahead than there
            are workers. None = all of them run.
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
        ears.message(_ended(standing, len(wanted), len(jobs)))
    attempts.presence.check()
    names = {row.trial_id for row in journal.rows}
    return RunOutcome(
        rows=journal.rows,
        missing=tuple(job.trial.id for job in wanted if job.trial.id not in names),
        enough=standing,
        interrupted=interrupts.requested,
        wall_seconds=perf_counter() - began,
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
