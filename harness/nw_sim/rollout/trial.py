"""One trial from seed to result."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING

from nw_base.errors import PolicyError, ServerError, TrialError, is_interrupt
from nw_sim.rollout.episode import Episode
from nw_sim.rollout.fault import fault_of, one_line
from nw_sim.rollout.job import StageClock, TrialResult
from nw_sim.rollout.library import Library
from nw_sim.rollout.mcap.trial_log import TrialLog
from nw_sim.rollout.opening import OpenTrial, open_trial
from nw_sim.rollout.recorder import Recorder

if TYPE_CHECKING:
    from nw_base.words import Fault, Outcome
    from nw_sim.rollout.job import TrialJob

_ROUNDING = 1e-6
"""s that the sum of a trial's physics steps may be off."""


def run_trial(
    job: TrialJob, *, library: Library | None = None, clock: StageClock | None = None
) -> TrialResult:
    """Run one trial and write its log.

    Args:
        job: which trial, and where its log goes.
        library: scenes and bundles that this process has loaded already.
        clock: for its stages (default: one of wall seconds).

    Returns:
        The result. A fault of policy, physics or of this program is a result with status `error`,
        which says whether the policy itself failed. Nothing is raised, whatever a policy throws,
        but the user's Ctrl-C.
    """
    began = perf_counter()
    clock = clock or StageClock()
    try:
        with clock("setup"):
            trial = open_trial(job, library or Library(), clock)
    except BaseException as error:
        if is_interrupt(error):
            raise
        return _timed(failed(TrialResult(status="error"), error), clock, began)
    with trial:
        with clock("log"):
            log = TrialLog(trial.job.mcap, record=trial.job.record)
            recorder = Recorder(trial, log, clock)
        try:
            with clock("log"):
                recorder.start()
            result = ended(trial, trial.episode.run(recorder))
        except BaseException as error:
            if is_interrupt(error):
                raise
            result = failed(so_far(trial.episode), error)
        try:
            with clock("log"):
                recorder.end(result)
        except BaseException as error:
            if is_interrupt(error):
                raise
            # The trial is over: only its log can be lost now.
            log.lose(OSError(f"its end could not be written: {one_line(error)}"))
        result = replace(result, mcap_bytes=log.bytes, mcap_error=log.error)
    return _timed(result, clock, began)


def _timed(result: TrialResult, clock: StageClock, began: float) -> TrialResult:
    return replace(result, wall=clock.stages, wall_seconds=perf_counter() - began)


def _whole_seconds(episode: Episode) -> float:
    """Return the simulated time of the control steps that are whole, s.

    Physics that diverges does so in the middle of one.
    """
    whole, now = episode.step / episode.world.control_rate, episode.world.time
    return now if now - whole < _ROUNDING else whole


def so_far(episode: Episode) -> TrialResult:
    """Return what an episode has come to, with status `error` until it has an outcome."""
    return TrialResult(
        status="error",
        task_kind=episode.task.kind,
        task_success=episode.task.success,
        waypoints_reached=episode.task.reached,
        waypoints_total=episode.task.total,
        waypoint_times=episode.task.times,
        steps=episode.step,
        control_rate=episode.world.control_rate,
        sim_seconds=_whole_seconds(episode),
        contact_s=episode.task.contact_seconds,
        coverage_min=episode.coverage.smallest,
        coverage_mean=episode.coverage.mean,
        capture_distance=tuple(episode.captured.distance),
        capture_angle=tuple(episode.captured.angle),
        capture_alpha=tuple(episode.captured.alpha),
        state_digest=episode.state_digest.hex,
        action_digest=episode.action_digest.hex,
    )


def ended(trial: OpenTrial, outcome: Outcome) -> TrialResult:
    """Return the result of a trial that ran to an outcome."""
    result, reason = so_far(trial.episode), trial.episode.task.end_reason
    scores = trial.episode.scores(outcome)
    return replace(result, status="ok", outcome=outcome, end_reason=reason, scores=scores)


def failed(reached: TrialResult, error: BaseException) -> TrialResult:
    """Return the result of a trial that an exception ended."""
    fault = fault_of(error)
    kind: Fault = "crashed"
    if fault in {"exception", "action"} or isinstance(error, PolicyError | ServerError):
        kind = "policy_error"
    elif isinstance(error, TrialError):
        kind = "physics_error"
    return replace(
        reached, status="error", end_reason=fault or "", error_type=kind, error_text=one_line(error)
    )
