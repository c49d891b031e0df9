"""Jobs run to their end by the engine's attempts, without a session around them."""

from dataclasses import dataclass

from nw_eval.engine.rounds import Attempts


@dataclass
class RunOutcome:
    """What became of some jobs."""

    rows: tuple
    missing: tuple
    """Ids of trials that were to be run and have no row."""
    enough: object
    """How the run stood; None if no trial was left out."""
    interrupted: object
    """The signal that ended it."""


def run_trials(jobs, *, workers=None, enough=None, listener=None, **names):
    """Run jobs: arguments are those of `Attempts`, and how many workers, and what is enough."""
    heard = {} if listener is None else {"listener": listener}
    attempts = Attempts(jobs=jobs, wanted_workers=workers, **heard, **names)
    attempts.listener.planned(total=len(jobs), finished=attempts.finished)
    with attempts:
        standing = attempts.run(enough)
    judged = jobs
    if standing is not None:
        places = {*range(standing.first), *standing.followed}
        judged = [job for job in jobs if job.trial.place in places]
    rows = tuple(attempts.journal.rows)
    ended = {row.trial_id for row in rows}
    return RunOutcome(
        rows=rows,
        missing=tuple(job.trial.id for job in judged if job.trial.id not in ended),
        enough=standing,
        interrupted=attempts.interrupts.requested,
    )
