"""Trackers of experiments: a judged run shown on the run of its checkpoint.

`tracked_run` says once what all of them get; a module each says how one gets it. Each is imported
when it is asked for, and none is needed for anything else.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from importlib.util import find_spec
from typing import get_args

from nw_eval.errors import PrerequisiteError, UsageError, nearest
from nw_eval.reporting.trackers.tracked import TrackedRun, tracked_run
from nw_eval.words import Tracker

__all__ = ["TRACKERS", "TrackedRun", "check_trackers", "track", "tracked_run"]

TRACKERS: tuple[Tracker, ...] = get_args(Tracker)


def check_trackers(names: Iterable[str]) -> None:
    """Check, without importing them, that trackers are known and installed.

    Raises:
        UsageError: there is none of that name.
        PrerequisiteError: its library is not installed.
    """
    for name in names:
        if name not in TRACKERS:
            raise UsageError(f"--track {name}: no such tracker", fix=nearest(name, TRACKERS))
        if find_spec(name) is None:
            raise PrerequisiteError(
                f"--track {name} needs {name}, which is not installed",
                fix=f"pip install 'nw-eval[{name}]'",
            )


def track(name: Tracker, run: TrackedRun) -> None:
    """Show a run in a tracker; a second time, what is there is replaced.

    Raises:
        Exception: whatever the tracker's library raises.
    """
    import_module(f"nw_eval.reporting.trackers.{name}").track(run)
