"""From a trial's result to its row."""

from __future__ import annotations

import platform
from dataclasses import replace
from typing import TYPE_CHECKING

from nw_gate.results.evidence import log_sha256
from nw_gate.results.row import Row
from nw_sim.rollout.job import policy_fault

if TYPE_CHECKING:
    from nw_base.words import Arm
    from nw_gate.results.run_folder import RunFolder
    from nw_sim.rollout.job import TrialJob, TrialResult


def make_row(
    job: TrialJob,
    result: TrialResult,
    *,
    attempt: int,
    policy: str,
    folder: RunFolder,
    arm: Arm = "candidate",
    host: str = "",
) -> Row:
    """Return the row of one attempt at a trial.

    Args:
        job: what was to be run.
        result: what it came to.
        attempt: 1, or more for a trial that was run again after an error.
        policy: the policy's name.
        folder: of the run, which the row's log path starts from.
        arm: whether the policy is the one that is judged.
        host: the machine that it ran on; empty = this one.
    """
    trial = job.trial
    is_ok = result.status == "ok"
    outcome = result.outcome if is_ok else result.error_type
    if outcome is None:
        raise ValueError(f"trial {trial.id}: a result with status {result.status} has no outcome")
    has_log = job.mcap is not None and result.mcap_bytes > 0
    return Row(
        trial_id=trial.id,
        suite=trial.suite,
        scene=trial.scene,
        task=trial.task,
        robot=job.robot,
        tier=trial.tier,
        seed_index=trial.index,
        seed=trial.seed,
        policy=policy,
        arm=arm,
        attempt=attempt,
        perturbation=trial.perturbation,
        status=result.status,
        outcome=outcome,
        end_reason=result.end_reason if is_ok else policy_fault(result) or "error",
        completed=is_ok and result.success == 1.0,
        success=result.success if is_ok else None,
        waypoints_reached=result.waypoints_reached,
        waypoints_total=result.waypoints_total,
        waypoint_times=result.waypoint_times,
        steps=result.steps,
        sim_s=result.sim_seconds,
        physics_s=result.wall.physics,
        render_s=result.wall.render,
        policy_s=result.wall.policy,
        log_s=result.wall.log,
        wall_s=result.wall_seconds,
        contact_s=result.contact_s,
        setup_s=result.wall.setup,
        sense_s=result.wall.sense,
        coverage_min=result.coverage_min,
        coverage_mean=result.coverage_mean,
        capture_distance=result.capture_distance,
        capture_angle=result.capture_angle,
        capture_alpha=result.capture_alpha,
        state_digest=result.state_digest,
        action_digest=result.action_digest,
        task_kind=result.task_kind,
        scores=result.scores if is_ok else (),
        checkpoint_digest=job.checkpoint_digest,
        scene_digest=trial.scene_digest,
        host=host or platform.node(),
        mcap_path=folder.relative(job.mcap) if has_log and job.mcap is not None else "",
        mcap_bytes=result.mcap_bytes,
        mcap_sha256=log_sha256(job.mcap) if has_log and job.mcap is not None else "",
        error_type=result.error_type or "",
        error_text=result.error_text,
    )


def taken_over(row: Row, job: TrialJob, *, policy: str, folder: RunFolder, arm: Arm) -> Row:
    """Return the row that an earlier run has of a trial as this run has it: by its own names.

    Args:
        row: of the earlier run. Its times stay, which are none of this run's.
        job: what need not be run.
        policy: the policy's name.
        folder: of the run, which the row's log path starts from.
        arm: whether the policy is the one that is judged.
    """
    trial = job.trial
    return replace(
        row,
        trial_id=trial.id,
        suite=trial.suite,
        scene=trial.scene,
        tier=trial.tier,
        policy=policy,
        arm=arm,
        cached=True,
        mcap_path=folder.relative(folder.cached_mcap(trial.scene, trial.id)),
    )
