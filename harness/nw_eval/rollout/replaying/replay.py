"""Runs a recorded trial again, from its start or from a state in its middle, and compares bits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import StoreError
from nw_eval.rollout.library import Library
from nw_eval.rollout.prepare import open_trial
from nw_eval.rollout.record import provenance
from nw_eval.rollout.record import verdict_metadata as as_metadata
from nw_eval.rollout.replaying.logged import LoggedTrial, agreed, check_inside, check_start, step_at
from nw_eval.rollout.replaying.policy_switch import driver, lead_to, run_on, switch_of
from nw_eval.rollout.replaying.reports import Difference, ReplayReport
from nw_eval.rollout.result import StageClock, TrialResult

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from nw_eval.rollout.prepare import OpenTrial
    from nw_eval.rollout.replaying.film import Film


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """A trial that was run again, and its result."""

    logged: LoggedTrial
    result: TrialResult
    report: ReplayReport

    @property
    def is_identical(self) -> bool:
        """Whether the end is the recorded one, bit for bit."""
        return self.report.is_identical

    @property
    def start_step(self) -> int:
        """The control step from which on it was run."""
        return self.report.start_step


def replay(
    path: Path,
    *,
    start: float = 0.0,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    library: Library | None = None,
    film: Film | None = None,
) -> Replayed:
    """Run a recorded trial again and compare its end with the recorded one.

    The log may be untrusted, and so may the card that it names: what it says runs no code, opens
    no connection and writes nothing but caches. Only the caller's `allow_code` lets code run, and
    only a `policy` that the caller names is asked on a server.

    A trial that a policy took over is led there by its own log.

    Args:
        path: the trial's log.
        start: seconds; greater than 0 restores the last recorded state at or before it.
        policy: the bundle, where it has moved since, or is served elsewhere.
        checkpoint: weights that were used instead of the card's.
        allow_code: as for a run.
        library: scenes and bundles that are loaded already.
        film: takes pictures of what is run; None for none.

    Raises:
        StoreError: the log cannot be read, or has no state that early.
        PolicyError: the bundle is missing, is not the one that was recorded, or needs the caller's
            word.
        SceneError, UsageError: the scene is missing, or has changed; `start` is negative, no
            number, or not before the trial's end.
        TrialError: the recorded state does not fit.
    """
    check_start(start)
    library = library or Library()
    logged = agreed(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    check_inside(start, logged)
    job = logged.job
    with open_trial(job, library, StageClock()) as trial:
        earlier = switch_of(logged)
        if earlier is not None and step_at(start, logged.control_rate) < earlier.step:
            lead_to(earlier.step, trial, logged, library)
        elif start > 0.0:
            restore(trial, logged, start)
        start_step = trial.episode.step
        observers = () if film is None else (film.begun(trial, driver=driver(job)),)
        result = run_on(trial, *observers)
        if film is not None:
            film.end(result)
    was, now = logged.verdict, as_metadata(result)
    built, builds = logged.versions, provenance()
    report = ReplayReport(
        trial=job.trial.id,
        start_step=start_step,
        steps=result.steps,
        end=now["outcome"] or now["error_type"],
        differences=_differences((name for name in now if name != "error_text"), was, now),
        versions=_differences(sorted({*built, *builds}), built, builds),
    )
    return Replayed(logged=logged, result=result, report=report)


def restore(trial: OpenTrial, logged: LoggedTrial, time: float) -> None:
    """Bring a trial to the last recorded state at or before `time` (s).

    Raises:
        StoreError: there is none.
        TrialError: the state does not fit the trial.
    """
    last = step_at(time, logged.control_rate)
    states = [state for state in logged.log.states() if state.step <= last]
    if not states:
        raise StoreError(f"{logged.path} has no state at or before {time:g} s", fix="run it all")
    trial.episode.restore(states[-1])


def _differences(
    names: Iterable[str], recorded: Mapping[str, str], now: Mapping[str, str]
) -> tuple[Difference, ...]:
    return tuple(
        Difference(name=name, recorded=recorded.get(name, ""), now=now.get(name, ""))
        for name in names
        if recorded.get(name) != now.get(name)
    )
