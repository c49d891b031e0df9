"""One worker's place on a node: a process of Ray's that owns a worker process of ours.

The worker is the local engine's, with its fence, its limits, and its ways to die. This process only
supervises it, as a run's main process does on one machine, and hands results and logs to the head.
"""

from __future__ import annotations

import os
import platform
import stat
import tempfile
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.engine.workers.local import LocalProcesses
from nw_eval.engine.workers.ray import library, node, received
from nw_eval.results.run_folder import RunFolder
from nw_eval.rollout.result import TrialResult

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from nw_eval.engine.workers.ray.node import Orders
    from nw_eval.rollout.job import TrialJob

LARGEST_LOG = 2**28
"""Bytes of a log that travels; one of a minute with images has 20 MB. The head holds it whole."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a job came to, and what it left on the node."""

    result: TrialResult
    host: str
    """The node's own name."""
    log: bytes = b""
    partial: bytes = b""
    """What was written of a log whose trial did not live to finish it."""
    printed: bytes = b""
    """What the worker printed since the job before."""


class Seat:
    """Runs one job at a time; an actor of Ray's.

    Args:
        orders: of the run.
        jobs: one of each scene, for what the worker may read.
        fresh: whether each job has a process of its own.

    Raises:
        PolicyError, SceneError: policy or scenes are not what the head has sent.
    """

    def __init__(self, orders: Orders, jobs: Sequence[TrialJob], *, fresh: bool) -> None:
        places = received.places(orders.parcels)
        root = node.scratch(orders.token)
        root.mkdir(mode=0o700, exist_ok=True)
        self._folder = RunFolder(path=Path(tempfile.mkdtemp(dir=root)))
        self._folder.logs.mkdir()
        hire = LocalProcesses(
            [_at_home(job, places) for job in jobs],
            self._folder,
            run=partial(library.run_job, places),
        )
        self._workers = hire(1, fresh=fresh).__enter__()
        self._read = 0  # Bytes of what the worker printed.

    def open(self) -> bool:
        """Return that it is."""
        return True

    def run(self, job: TrialJob) -> Answer:
        """Run a trial, and bring back what it left.

        Raises:
            TrialError: no worker process can be kept alive on this node.
        """
        path = None if job.mcap is None else self._folder.mcap(job.trial.scene, job.trial.id)
        self._workers.submit([replace(job, mcap=path)])
        (ended,) = (done for done in self._workers.finished() if done is not None)
        answer = Answer(result=ended.result, host=platform.node(), printed=self._printed())
        if path is None:
            return answer
        partial = path.with_name(f"{path.name}.partial")
        answer = replace(answer, log=_taken(path), partial=_taken(partial))
        if len(answer.log) == answer.result.mcap_bytes:
            return answer
        why = f"a log of {answer.result.mcap_bytes} bytes does not travel: {LARGEST_LOG} at most"
        result = replace(answer.result, mcap_bytes=0, mcap_error=why)
        return replace(answer, log=b"", result=result)

    def _printed(self) -> bytes:
        with suppress(OSError), self._folder.workers_log.open("rb") as file:
            file.seek(self._read)
            text = file.read(LARGEST_LOG)
            self._read += len(text)
            return text
        return b""


def _at_home(job: TrialJob, places: Mapping[str, str]) -> TrialJob:
    """Return a job whose references are paths of this node."""
    checkpoint = None if job.checkpoint is None else library.here(job.checkpoint, places)
    return replace(
        job,
        scene=places.get(job.scene, job.scene),
        policy=places.get(job.policy, job.policy),
        checkpoint=checkpoint,
    )


def _taken(path: Path) -> bytes:
    """Return what is in a file, which is gone afterwards; nothing where it is too large."""
    data = b""
    with suppress(OSError):
        # A link would be the policy's doing, and could lead anywhere on the node.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            facts = os.fstat(file.fileno())
            if stat.S_ISREG(facts.st_mode) and facts.st_size <= LARGEST_LOG:
                data = file.read(LARGEST_LOG)
        path.unlink()
    return data
