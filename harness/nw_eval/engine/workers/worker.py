"""What runs inside a worker process."""

from __future__ import annotations

import signal
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nw_eval.confinement import Rules, confine

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from nw_eval.rollout.job import TrialJob
    from nw_eval.rollout.library import Library
    from nw_eval.rollout.result import TrialResult

_library: Library | None = None


@dataclass(frozen=True, kw_only=True)
class WorkerStart:
    """What a worker starts with, before it has a job."""

    rules: Rules
    """What it may do."""
    renders: bool
    """Whether it draws splats: it loads kernels before their cache is out of its reach."""
    policy: Rules | None = None
    """What the process may do that opens its policies; None = it opens them."""


def start(settings: WorkerStart, output: Connection) -> None:
    """Prepare and confine a worker; what it prints goes to `output`.

    It must not outlive the process that started it, however that died. And SIGTERM must end it at
    once: a handler in Python waits for a policy that hangs in native code, and there is nothing to
    tidy up. Ctrl-C is the parent's business.
    """
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if settings.renders:
        with suppress(Exception):  # The trial that wants them says what is wrong.
            from nw_eval.splat.warmup import warmup

            warmup()
    confine(settings.rules, output=output.fileno())
    output.close()


def run_job(job: TrialJob) -> TrialResult:
    """Run one trial with this process's cache of scenes and policies."""
    # Here and not above: a worker that is only being started needs none of it.
    from nw_eval.rollout.library import Library
    from nw_eval.rollout.trial import run_trial

    global _library  # noqa: PLW0603 - one cache a process is the point.
    if _library is None:
        _library = Library()
    return run_trial(job, library=_library)
