"""Reads logs in confined processes: one that brings its reader down costs only itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from pydantic import ValidationError

from nw_eval.api.running.evidence.content import ReadLog, ReadLogs
from nw_eval.api.running.evidence.log import read_logs
from nw_eval.confinement import Rules
from nw_eval.errors import NwEvalError
from nw_eval.rollout.confined.isolated import call_isolated

_PROCESSOR_SECONDS = 60
"""For a process; 300 logs take 4."""
_SECONDS = 300.0
"""For all of them, on a machine that is busy with other things."""
_MOST_PROCESSES = 20
"""Nine find the one of 300 logs that ends its reader."""
_UNREAD = "the process that read it ended"


@dataclass(frozen=True, kw_only=True)
class WantedLog:
    """A log, and what of it is wanted besides its path."""

    path: Path
    scene: str
    """Of which the first log that can be read shows the place."""
    clip: bool


def read_apart(
    wanted: Sequence[WantedLog], folder: Path, room: dict[str, int]
) -> list[tuple[WantedLog, ReadLog]]:
    """Return each log with what it shows, in no order.

    Args:
        wanted: logs below the folder.
        folder: the only one that can be read.
        room: bytes that one `picture` of a place and one `clip` may have.
    """
    rules = Rules(reads=(folder.resolve(),), seconds=_PROCESSOR_SECONDS)
    found: list[tuple[WantedLog, ReadLog]] = []
    waiting, started, end = [list(wanted)], 0, monotonic() + _SECONDS
    while waiting:
        batch = waiting.pop()
        left = end - monotonic()
        if started == _MOST_PROCESSES or left <= 0.0:
            found += [(log, ReadLog(fault="reading the logs took too long")) for log in batch]
            continue
        started += 1
        logs = _read(batch, rules, room, left)
        if logs is not None:
            found += zip(batch, logs, strict=True)
        elif len(batch) > 1:  # One of them is to blame.
            half = len(batch) // 2
            waiting += [batch[half:], batch[:half]]
        else:
            found.append((batch[0], ReadLog(fault=_UNREAD)))
    return found


def _read(
    batch: Sequence[WantedLog], rules: Rules, room: dict[str, int], seconds: float
) -> tuple[ReadLog, ...] | None:
    """Return what logs show, or None if the process that read them did not come back."""
    if not batch:
        return ()
    try:
        answer = call_isolated(
            read_logs,
            subject="the logs",
            rules=rules,
            time_limit=seconds,
            wanted=[(str(log.path), log.scene) for log in batch],
            clips=[str(log.path) for log in batch if log.clip],
            room=room,
        )
        logs = ReadLogs.model_validate_json(str(answer)).logs
    except (NwEvalError, OSError, ValidationError, AssertionError):
        return None  # AssertionError: a daemon of multiprocessing may start no process.
    return logs if len(logs) == len(batch) else None
