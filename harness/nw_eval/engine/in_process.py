"""Trials in this very process, one after the other: for debuggers, notebooks and tests.

The bits are those of worker processes, but nothing stands between a policy and this process. It is
not confined, so this is for policies that one trusts. One that hangs is never `hung`, since no
process could end it, and one that ends its process ends this one. What it prints goes where this
process prints, and a `breakpoint()` in it works.
"""

from __future__ import annotations

import sys
from collections import deque
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Self

from nw_eval.engine.workers import Finished
from nw_eval.policies.apart import trusting
from nw_eval.rollout.library import Library
from nw_eval.rollout.trial import run_trial

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator

    from nw_eval.policies import Bundle
    from nw_eval.rollout.job import TrialJob


class InProcess:
    """Gets workers that are this process itself.

    Args:
        bundle: what the run's jobs call by its `reference`, so that it is not loaded again; a
            policy that is an object of Python's cannot be.
    """

    again = "in this process"

    def __init__(self, bundle: Bundle) -> None:
        self._bundle = bundle

    def __call__(self, count: int, *, fresh: bool) -> InProcessWorkers:  # noqa: ARG002 - one it is.
        """Return workers that share nothing with those before but what Python has imported."""
        return InProcessWorkers(self._bundle)


class InProcessWorkers:
    """Runs a job when its result is waited for; a context manager.

    Ctrl-C and SIGTERM are heard by `engine.session` between two trials; the second one raises
    KeyboardInterrupt in the trial.

    Args:
        bundle: the policy of all jobs.
    """

    def __init__(self, bundle: Bundle) -> None:
        self._bundle = bundle
        self._library = Library(known=(bundle,))
        self._queue: deque[TrialJob] = deque()
        self._cleanup = ExitStack()

    def __enter__(self) -> Self:
        self._cleanup.enter_context(_one_thread())
        self._cleanup.enter_context(trusting())
        if self._bundle.code_sha256:
            self._cleanup.enter_context(_forgotten_afterwards(self._bundle.folder))
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def submit(self, jobs: Iterable[TrialJob]) -> None:
        """Queue jobs, in order."""
        self._queue.extend(jobs)

    def finished(self) -> Iterator[Finished | None]:
        """Run the queued jobs and yield what they come to.

        Raises:
            KeyboardInterrupt: Ctrl-C, where the first one is not handled.
        """
        while self._queue:
            job = self._queue.popleft()
            yield Finished(job=job, result=run_trial(job, library=self._library))

    def stop(self) -> None:
        """Drop the queue; calling it again does nothing."""
        self._queue.clear()
        self._cleanup.close()


@contextmanager
def _one_thread() -> Generator[None]:
    """Let torch compute on one thread, as in a worker, and afterwards on as many as before.

    More threads change the last bits of an action. Where torch is imported later, adapters see to
    it themselves.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def _forgotten_afterwards(folder: Path) -> Generator[None]:
    """Leave no module behind that a policy's folder brought in.

    The next run of it has the files as they are then, and its digest is that of them; and the next
    policy's module may have the same name.
    """
    root, before = folder.resolve(), set(sys.modules)
    try:
        yield
    finally:
        for name in [name for name in sys.modules if name not in before]:
            file = Path(getattr(sys.modules[name], "__file__", None) or "")
            is_own = file.suffix == ".py" and file.is_relative_to(root)
            # A card may lie above an environment: what is installed there is none of its code.
            if is_own and "site-packages" not in file.parts and not name.startswith("nw_eval."):
                del sys.modules[name]
