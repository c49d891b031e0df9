"""What a node of the cluster is asked by the head; each function runs there, in a process of Ray's.

What is asked and what is answered are plain values. The first question goes to whatever version of
nw-eval the node has.

`NodeAgent` is a process of Ray's that owns worker processes of ours. They are the local engine's,
with its fence, its limits, its ways to die, and what it shares between them. It only supervises
them, as a run's main process does on one machine, and hands results and logs to the head. Scenes
and policies there go by the names that the head has for them.
"""

from __future__ import annotations

import os
import platform
import shutil
import stat
import tempfile
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from nw_base import __version__
from nw_base.words import BLIND, KERNELS
from nw_eval.engine import ray_file_bundles
from nw_eval.engine.local import LocalProcesses
from nw_eval.engine.worker import clock
from nw_gate.results.run_folder import RunFolder
from nw_sim.rollout.library import Library
from nw_sim.rollout.trial import run_trial
from nw_sim.tasks.track import with_motion

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from nw_base.words import Backend, Collision
    from nw_eval.engine.pool import Finished
    from nw_eval.engine.ray_file_bundles import FileBundle
    from nw_policies import Bundle
    from nw_policies.cards import Card
    from nw_scenes import Scene
    from nw_sim.rollout.job import TrialJob, TrialResult


@dataclass(frozen=True, kw_only=True)
class JobSpec:
    """What a node makes ready for a run."""

    token: str
    """Names the run's folders on nodes: letters and digits."""
    scenes: tuple[tuple[str, Collision], ...]
    """References of the head's, and how meshes collide."""
    file_bundles: tuple[FileBundle, ...]
    render: Backend
    renders: bool
    """Whether any trial may render."""
    memory_limit: int | None
    """Bytes that a worker may hold with its children."""


def facts(render: Backend, *, card: Card, code: bool, plugins: Mapping[str, str]) -> dict[str, str]:
    """Return what must be the same on all machines that one run's rows come from.

    The first line of a journal and run.json say it once, for all of them.

    Args:
        render: the splat renderer.
        card: the policy's.
        code: as for `fence_of`.
        plugins: the run's `Plan.plugins`, of which a node may have others.
    """
    from nw_eval.engine.identity import engine_of
    from nw_eval.engine.provenance import fence_of

    return {
        "nw-eval": __version__,
        "Python": platform.python_version(),
        **engine_of(render, plugins, card),
        "fence": fence_of(card.adapter, code=code, render=render),
    }


def lacking(file_bundles: tuple[FileBundle, ...]) -> tuple[str, ...]:
    """Return the sha256 of the files that this node does not have."""
    return ray_file_bundles.missing(file_bundles)


def make_ready(spec: JobSpec, pieces: Mapping[str, Sequence[Any]]) -> None:
    """Get what is missing, and compile what all workers need, as the head does for its own.

    Args:
        spec: the run's.
        pieces: references of Ray's to the pieces of each file that was missing, by sha256.

    Raises:
        StoreError: what arrived is not what was sent, or it cannot be kept.
        SceneError, PrerequisiteError: as `engine.prepare`.
    """
    import ray

    from nw_eval.engine.listener import NullListener
    from nw_eval.engine.prepare import build_splats, open_backend, ready_scans
    from nw_sim.catalogue import open_scene

    def fetch(sha256: str) -> Iterator[bytes]:
        for piece in pieces.get(sha256, ()):
            yield ray.get(piece)

    ray_file_bundles.receive(spec.file_bundles, fetch)
    places = ray_file_bundles.places(spec.file_bundles)
    scenes = [open_scene(places.get(name, name), collision) for name, collision in spec.scenes]
    ready_scans(scenes, NullListener())
    kernels = KERNELS if spec.renders else BLIND
    open_backend(
        spec.render if spec.renders else "cpu", NullListener(), is_fenced=False, kernels=kernels
    )
    if spec.renders:
        build_splats(scenes, NullListener())


def scratch(token: str) -> Path:
    """Return the folder in which a run's node agent on this node writes, until the head has it."""
    return Path(tempfile.gettempdir()) / f"nw-eval-{token}"


def tidy(token: str) -> None:
    """Remove what a run's node agents have left: logs of trials that were killed."""
    shutil.rmtree(scratch(token), ignore_errors=True)


LARGEST_LOG = 2**28
"""Bytes of a log that travels; one of a minute with images has 20 MB. The head holds it whole."""

_TURN = 1.0  # s after which the head is heard again, at the latest
_library: Library | None = None


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


class NodeAgent:
    """Runs jobs on a node; an actor of Ray's.

    Args:
        spec: the run's.
        jobs: one of each scene, for what workers may read.
        workers: how many jobs run at a time.
        fresh: whether each job has a process of its own.

    Raises:
        PolicyError, SceneError: policy or scenes are not what the head has sent.
    """

    def __init__(
        self, spec: JobSpec, jobs: Sequence[TrialJob], workers: int, *, fresh: bool
    ) -> None:
        places = ray_file_bundles.places(spec.file_bundles)
        root = scratch(spec.token)
        root.mkdir(mode=0o700, exist_ok=True)
        self._folder = RunFolder(path=Path(tempfile.mkdtemp(dir=root)))
        self._folder.logs.mkdir()
        start_workers = LocalProcesses(
            [_at_home(job, places) for job in jobs],
            self._folder,
            run=partial(run_job, places),
            memory_limit=spec.memory_limit,
        )
        self._workers = start_workers(workers, fresh=fresh).__enter__()
        self._finished: Iterator[Finished | None] = iter(())
        self._read = 0  # Bytes of what workers printed.

    def open(self) -> None:
        """Say that it is."""

    def work(self, jobs: Sequence[TrialJob]) -> Answer | None:
        """Begin jobs; return what one came to, of these or of those before, or None in a moment.

        Raises:
            TrialError: no worker processes can be kept alive on this node.
        """
        log = self._folder.mcap
        self._workers.submit(
            replace(job, mcap=job.mcap and log(job.trial.scene, job.trial.id)) for job in jobs
        )
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
    checkpoint = None if job.checkpoint is None else local_path(job.checkpoint, places)
    return replace(
        job,
        scene=places.get(job.scene, job.scene),
        policy=places.get(job.policy, job.policy),
        checkpoint=checkpoint,
        robot_folder=None if job.robot_folder is None else local_path(job.robot_folder, places),
        task=with_motion(job.task, lambda file: places.get(file, file)),
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


class LibraryHere(Library):
    """A library whose references are those of another machine.

    Jobs stay as the head wrote them, so that a trial's log names scene and policy as they are found
    by whoever replays it there, and has the bytes that it would have there.

    Args:
        places: where on this machine lies what jobs refer to; what is not in it is the same
            everywhere, such as the name of a built-in scene.
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        super().__init__()
        self._places = places

    def scene(self, reference: str, collision: Collision = "terrain") -> Scene:
        """Return the scene of a reference; errors are those of `Library.scene`."""
        return super().scene(self._places.get(reference, reference), collision)

    def bundle(self, reference: str, checkpoint: Path | None) -> Bundle:
        """Return the bundle of a reference; errors are those of `Library.bundle`."""
        weights = None if checkpoint is None else local_path(checkpoint, self._places)
        return super().bundle(self._places.get(reference, reference), weights)


def local_path(path: Path, places: Mapping[str, str]) -> Path:
    """Return where on this machine lies what the head calls by a path."""
    return Path(places.get(str(path), path))


def run_job(places: Mapping[str, str], job: TrialJob) -> TrialResult:
    """Run one trial with this process's cache of scenes and policies."""
    global _library  # noqa: PLW0603 - one cache a process is the point.
    if _library is None:
        _library = LibraryHere(places)
    return run_trial(job, library=_library, clock=clock())
