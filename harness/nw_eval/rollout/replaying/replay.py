"""Runs a recorded trial again, from its start or from a state in its middle, and compares bits."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.errors import PolicyError, StoreError, UsageError
from nw_eval.inside import what_is
from nw_eval.policies.instance import was_instance
from nw_eval.rollout.clock import StageClock
from nw_eval.rollout.fault import is_interrupt
from nw_eval.rollout.job import TrialJob
from nw_eval.rollout.library import Library
from nw_eval.rollout.mcap.reader import LogReader
from nw_eval.rollout.prepare import open_trial
from nw_eval.rollout.record import PROVENANCE, TRIAL, VERDICT, job_from_metadata, provenance
from nw_eval.rollout.record import verdict_metadata as as_metadata
from nw_eval.rollout.replaying.report import Difference, ReplayReport
from nw_eval.rollout.result import TrialResult
from nw_eval.rollout.trial import ended, failed

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from nw_eval.rollout.prepare import OpenTrial
    from nw_eval.words import Outcome


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What a log says about its trial, read back; of a replay, with what its caller chose."""

    path: Path
    job: TrialJob
    verdict: Mapping[str, str]
    versions: Mapping[str, str]

    @property
    def log(self) -> LogReader:
        """The log itself, for its states, pictures and poses."""
        return LogReader(self.path)


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """A trial that was run again, and what came of it."""

    recording: Recording
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


def read_recording(path: Path) -> Recording:
    """Return what a log says about its trial.

    Raises:
        StoreError: the file is missing, damaged, or no log of a trial.
    """
    metadata = LogReader(path).metadata()
    if TRIAL not in metadata or VERDICT not in metadata:
        raise StoreError(f"{path} is not the log of a finished trial", fix="name a file of mcap/")
    try:
        job = job_from_metadata(metadata[TRIAL])
    except ValueError as error:
        raise StoreError(f"{path}: {error}", fix="run the trial again") from None
    return Recording(
        path=path, job=job, verdict=metadata[VERDICT], versions=metadata.get(PROVENANCE, {})
    )


def replay(
    path: Path,
    *,
    start: float = 0.0,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    library: Library | None = None,
) -> Replayed:
    """Run a recorded trial again and compare its end with the recorded one.

    The log may be a stranger's, and so may the card that it names: what it says runs no code, opens
    no connection and writes nothing but caches. Only the caller's `allow_code` lets code run, and
    only a `policy` that the caller names is asked on a server.

    Args:
        path: the trial's log.
        start: seconds; greater than 0 restores the last recorded state at or before it.
        policy: the bundle, where it has moved since, or is served elsewhere.
        checkpoint: weights that were used instead of the card's.
        allow_code: as for a run.
        library: scenes and bundles that are loaded already.

    Raises:
        StoreError: the log cannot be read, or has no state that early.
        PolicyError: the bundle is missing, is not the one that was recorded, or needs the caller's
            word.
        SceneError, UsageError: the scene is missing, or has changed; `start` is negative or no
            number.
        TrialError: the recorded state does not fit.
    """
    check_start(start)
    library = library or Library()
    recording = agreed(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    job = recording.job
    with open_trial(job, library, StageClock()) as trial:
        if start > 0.0:
            restore(trial, recording, start)
        start_step = trial.episode.step
        result = run_on(trial)
    was, now = recording.verdict, as_metadata(result)
    built, builds = recording.versions, provenance()
    report = ReplayReport(
        trial=job.trial.id,
        start_step=start_step,
        steps=result.steps,
        end=now["outcome"] or now["error_type"],
        differences=_differences((name for name in now if name != "error_text"), was, now),
        versions=_differences(sorted({*built, *builds}), built, builds),
    )
    return Replayed(recording=recording, result=result, report=report)


def check_start(start: float) -> None:
    """Refuse what is no time in a trial.

    Raises:
        UsageError: it is negative or no number.
    """
    if not 0.0 <= start < math.inf:
        raise UsageError(f"--start {start:g}", fix="give seconds, at least 0")


def agreed(
    path: Path,
    *,
    policy: str | None,
    checkpoint: Path | None,
    allow_code: bool,
    library: Library,
) -> Recording:
    """Return what a log says about its trial, with what its caller chose; arguments as `replay`.

    Raises:
        StoreError: the log cannot be read.
        PolicyError: the bundle is missing, or is on a server that the log alone names.
    """
    recording = read_recording(path)
    recorded = recording.job
    if policy is None and was_instance(recorded.policy):
        name = clean(recorded.policy_name, at_most=100)
        raise PolicyError(
            f"{path}: policy {name!r} was an object of the process that ran it",
            fix="name a bundle that does the same with --policy",
        )
    job = replace(
        recorded,
        policy=policy or _found(recorded),
        checkpoint=checkpoint or (None if policy else recorded.checkpoint),
        allow_code=allow_code,
    )
    recording = replace(recording, job=job)
    if policy is None:
        _refuse_servers(recording, library)
    return recording


def restore(trial: OpenTrial, recording: Recording, time: float) -> None:
    """Bring a trial to the last recorded state at or before `time` (s).

    Raises:
        StoreError: there is none.
        TrialError: the state does not fit the trial.
    """
    limit = round(time / trial.episode.world.control_period)
    states = [state for state in recording.log.states() if state.step <= limit]
    if not states:
        raise StoreError(f"{recording.path} has no state at or before {time:g} s", fix="run it all")
    trial.episode.restore(states[-1])


def run_on(trial: OpenTrial) -> TrialResult:
    """Run a trial from where it stands to its end, without a log."""
    episode = trial.episode
    try:
        outcome: Outcome | None = None
        while outcome is None:
            outcome, _ = episode.advance(episode.decide())
    except BaseException as error:
        if is_interrupt(error):
            raise
        return failed(TrialResult.so_far(trial.episode), error)  # As in a run, it is the result.
    return ended(trial, outcome)


def _refuse_servers(recording: Recording, library: Library) -> None:
    bundle = library.bundle(recording.job.policy, recording.job.checkpoint)
    if bundle.card.adapter == "remote":
        raise PolicyError(
            f"{recording.path}: {bundle.where}, which the log names, asks a policy on a server",
            fix=f"add --policy {bundle.where} if you trust it",
        )


def _found(job: TrialJob) -> str:
    """Return the recorded bundle's path, or its name where the path is of another machine."""
    known = what_is(Path(job.policy)) != "nothing" or not job.policy_name
    return job.policy if known else job.policy_name


def _differences(
    names: Iterable[str], recorded: Mapping[str, str], now: Mapping[str, str]
) -> tuple[Difference, ...]:
    return tuple(
        Difference(name=name, recorded=recorded.get(name, ""), now=now.get(name, ""))
        for name in names
        if recorded.get(name) != now.get(name)
    )
