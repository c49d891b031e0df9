"""Logs that came back from a node, written into the run's folder by the head alone."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from nw_eval.errors import StoreError
from nw_eval.files.cache import atomic_path

if TYPE_CHECKING:
    from pathlib import Path

    from nw_eval.engine.workers.ray.station import Answer
    from nw_eval.rollout.job import TrialJob
    from nw_eval.rollout.result import TrialResult


def keep_log(answer: Answer, job: TrialJob) -> TrialResult:
    """Write the log of a job where the head has planned it, and return its result.

    As on one machine, there is then the log of this attempt, or what was written of it until its
    process died, and none of the attempt before.

    Args:
        answer: what came back.
        job: as the head gave it out.

    Returns:
        The result, which says why if the log is lost.
    """
    if job.mcap is None:
        return answer.result
    partial = job.mcap.with_name(f"{job.mcap.name}.partial")
    try:
        _put(job.mcap, answer.log)
        _put(partial, answer.partial)
    except (OSError, StoreError) as error:
        return replace(answer.result, mcap_bytes=0, mcap_error=str(error))
    return answer.result


def _put(path: Path, data: bytes) -> None:
    if not data:
        path.unlink(missing_ok=True)
        return
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
