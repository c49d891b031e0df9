"""The workers of one node: a process of Ray's that owns worker processes of ours.

They are the local engine's, with its fence, its limits, its ways to die, and what it shares between
them. This process only supervises them, as a run's main process does on one machine, and hands
results and logs to the head.
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
from time import monotonic
from typing import TYPE_CHECKING

from nw_eval.engine.workers.local import LocalProcesses
from nw_eval.engine.workers.ray import library, node, received
from nw_eval.results.run_folder import RunFolder
from nw_eval.rollout.result import TrialResult

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from nw_eval.engine.workers.protocol import Finished
    from nw_eval.engine.workers.ray.node import Orders
    from nw_eval.rollout.job import TrialJob

LARGEST_LOG = 2**28
"""Bytes of a log that travels; one of a minute with images has 20 MB. The head holds it whole."""

_TURN = 1.0  # s after which the head is heard again, at the latest


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a job came to, and what it left on the node."""

    trial: str
    """Its id."""
    result: TrialResult
    host: str
    """The node's own name."""
    log: bytes = b""
    partial: bytes = b""
    """What was written of a log whose trial did not live to finish it."""
    printed: bytes = b""
    """What workers printed since the answer before."""


class Station:
    """Runs jobs on a node; an actor of Ray's.

    Args:
        orders: of the run.
        jobs: one of each scene, for what workers may read.
        workers: how many jobs run at a time.
        fresh: whether each job has a process of its own.

    Raises:
        PolicyError, SceneError: policy or scenes are not what the head has sent.
    """

    def __init__(
        self, orders: Orders, jobs: Sequence[TrialJob], workers: int, *, fresh: bool
    ) -> None:
        places = received.places(orders.parcels)
        root = node.scratch(orders.token)
        root.mkdir(mode=0o700, exist_ok=True)
        self._folder = RunFolder(path=Path(tempfile.mkdtemp(dir=root)))
        self._folder.logs.mkdir()
        hire = LocalProcesses(
            [_at_home(job, places) for job in jobs],
            self._folder,
            run=partial(library.run_job, places),
            memory_limit=orders.memory_limit,
        )
        self._workers = hire(workers, fresh=fresh).__enter__()
        self._finished: Iterator[Finished | None] = iter(())
        self._read = 0  # Bytes of what workers printed.

    def open(self) -> None:
        """Say that it is."""

    def work(self, jobs: Sequence[TrialJob]) -> Answer | None:
        """Begin jobs; return what one came to, of these or of those before, or None in a moment.

        Raises:
            TrialError: no worker processes can be kept alive on this node.
        """
        self._workers.submit(replace(job, mcap=self._log_of(job)) for job in jobs)
        end = monotonic() + _TURN
        while monotonic() < end:
            try:
                ended = next(self._finished)
            except StopIteration:
                self._finished = self._workers.finished()
                continue
            if ended is not None:
                return self._answer(ended)
        return None

    def _log_of(self, job: TrialJob) -> Path | None:
        return None if job.mcap is None else self._folder.mcap(job.trial.scene, job.trial.id)

    def _answer(self, ended: Finished) -> Answer:
        """Return what a job came to, with what it left, which is gone from here afterwards."""
        answer = Answer(
            trial=ended.job.trial.id,
            result=ended.result,
            host=platform.node(),
            printed=self._printed(),
        )
        path = ended.job.mcap
        if path is None:
            return answer
        partial_path = path.with_name(f"{path.name}.partial")
        answer = replace(answer, log=_taken(path), partial=_taken(partial_path))
        if len(answer.log) == answer.result.mcap_bytes:
            return answer
        why = f"a log of {answer.result.mcap_bytes} bytes does not travel: {LARGEST_LOG} at most"
        result = replace(answer.result, mcap_bytes=0, mcap_error=why)
        return replace(answer, log=b"", result=result)

    def _printed(self) -> bytes:
        with suppress(OSError), self._folder.workers_log.open("rb") as file:
            file.seek(self._read)
            text = file.read()
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
