"""What runs inside a worker process."""

from __future__ import annotations

import os
import signal
import threading
from multiprocessing import connection, parent_process
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.rollout.job import TrialJob
    from nw_eval.rollout.library import Library
    from nw_eval.rollout.result import TrialResult

_library: Library | None = None


def start() -> None:
    """Prepare a worker.

    It must not outlive the process that started it, however that died. And SIGTERM must end it at
    once: a handler in Python waits for a policy that hangs in native code, and there is nothing to
    tidy up. Ctrl-C is the parent's business.
    """
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def run_job(job: TrialJob) -> TrialResult:
    """Run one trial with this process's cache of scenes and policies."""
    # Here and not above: a worker that is only being started needs none of it.
    from nw_eval.rollout.library import Library
    from nw_eval.rollout.trial import run_trial

    global _library  # noqa: PLW0603 - one cache a process is the point.
    if _library is None:
        _library = Library()
    return run_trial(job, library=_library)


def _die_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
