"""Two logs of one trial: what of them differs, and from which control step on."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from hashlib import sha256
from itertools import zip_longest
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from nw_eval.api.verifying.result import Kind
from nw_eval.cards.model import CONTROL_RATE
from nw_eval.confinement import Rules
from nw_eval.errors import NwEvalError
from nw_eval.rollout.confined.isolated import call_isolated
from nw_eval.rollout.mcap.reader import LogReader

_Entry = tuple[int, bytes]
"""Time in ns, and a digest of what was logged then."""
_PROCESSOR_SECONDS = 60
"""For two logs, which take less than one."""
_KEPT_AT_WILL = ("/camera/", "/observation/")
"""Topics whose messages are in a log only if its images were kept."""


def partings_apart(recorded: Path, now: Path) -> dict[Kind, int] | None:
    """As `partings`, in a confined process: the recorded log may be anybody's. None if it cannot.

    Args:
        recorded: the log of the run.
        now: the log of the same trial run again.
    """
    rules = Rules(reads=(recorded.resolve(), now.resolve()), seconds=_PROCESSOR_SECONDS)
    try:
        answer = call_isolated(
            _partings, subject=str(recorded), rules=rules, recorded=str(recorded), now=str(now)
        )
        return TypeAdapter(dict[Kind, int]).validate_python(answer)
    except (NwEvalError, OSError, ValidationError):
        return None


def _partings(*, recorded: str, now: str) -> dict[Kind, int]:
    return partings(Path(recorded), Path(now))


def partings(recorded: Path, now: Path) -> dict[Kind, int]:
    """Return the first control step, from 0, at which two logs differ, for each kind of content.

    Images that only one of them has kept are not compared: that is the recording's choice.

    Raises:
        StoreError: one of them cannot be read.
    """
    was, is_ = _entries(recorded), _entries(now)
    found: dict[Kind, int] = {}
    for key in {*was, *is_}:
        kind, topic = key
        if not (key in was and key in is_) and topic.startswith(_KEPT_AT_WILL):
            continue
        if (time_ns := _first_difference(was[key], is_[key])) is not None:
            step = round(time_ns * 1e-9 * CONTROL_RATE)
            found[kind] = min(step, found.get(kind, step))
    return found


def _first_difference(was: list[_Entry], is_: list[_Entry]) -> int | None:
    for one, other in zip_longest(was, is_):
        if one != other:
            return min(entry[0] for entry in (one, other) if entry is not None)
    return None


def _entries(log: Path) -> defaultdict[tuple[Kind, str], list[_Entry]]:
    """Return digests of all messages, by kind and topic."""
    found: defaultdict[tuple[Kind, str], list[_Entry]] = defaultdict(list)
    for topic, time_ns, message in LogReader(log).messages():
        for kind, content in _contents(topic, message):
            found[kind, topic].append((time_ns, sha256(content).digest()))
    return found


def _contents(topic: str, message: Any) -> Iterator[tuple[Kind, bytes]]:
    """Yield what a message holds, by kind; `/nw/policy` holds two."""
    if topic == "/nw/policy":
        yield "observation", message.observation_digest
        message.ClearField("observation_digest")
        yield "action", message.SerializeToString(deterministic=True)
    else:
        yield _kind(topic), message.SerializeToString(deterministic=True)


def _kind(topic: str) -> Kind:
    if topic.startswith("/camera/"):
        return "image"
    if topic.startswith("/observation/"):
        return "observation"
    return "state" if topic in {"/nw/state", "/tf"} or topic.startswith("/robot/") else "other"
