"""A log's numbers over time: joints, commands, actions, and what the policy was given."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from nw_eval.viewing.recording.place import Messages
    from nw_eval.viewing.recording.track import Track

_JOINT = ("position", "velocity", "effort")
_TWIST = ("linear", "angular")
_COMMAND = ("forward", "left", "yaw_rate", "heading_error")
_POLICY = ("action", "applied", "targets")
_MOST = 256
"""Numbers of an observation that are lines; of more than that, one sees none."""


def write_series(track: Track, messages: Messages, elements: Mapping[str, Sequence[str]]) -> None:
    """Write all numbers.

    Raises:
        ValueError: a message has another number of them than the one before.
    """
    _write_robot(track, messages)
    for field in _POLICY:
        steps = messages.get("/nw/policy", ())
        rows = [list(getattr(message, field)) for _, message in steps]
        names = elements.get(f"/nw/policy.{field}", ())
        _write(track, f"/policy/{field}", [time for time, _ in steps], rows, names)
    for topic, samples in messages.items():
        if topic.startswith("/observation/"):
            _write_observation(track, topic, samples, elements.get(topic, ()))


def _write_robot(track: Track, messages: Messages) -> None:
    joints = messages.get("/robot/joints", ())
    times = [time for time, _ in joints]
    for field in _JOINT:
        rows = [[getattr(joint, field) for joint in message.joints] for _, message in joints]
        names = [joint.name for joint in joints[0][1].joints] if joints else ()
        _write(track, f"/joints/{field}", times, rows, names)
    twists = messages.get("/robot/twist", ())
    for part in _TWIST:
        rows = [[getattr(getattr(m, part), axis) for axis in "xyz"] for _, m in twists]
        names = [f"{part} {axis}" for axis in "xyz"]
        _write(track, f"/twist/{part}", [time for time, _ in twists], rows, names)
    commands = messages.get("/robot/command", ())
    rows = [[getattr(message, field) for field in _COMMAND] for _, message in commands]
    _write(track, "/command", [time for time, _ in commands], rows, _COMMAND)


def _write_observation(
    track: Track, topic: str, samples: Sequence[tuple[int, Any]], names: Sequence[str]
) -> None:
    """Write an observation: an entity for each of its terms, or one for all of it."""
    times = [time for time, _ in samples]
    terms = samples[0][1].terms
    first = 0
    for number, entity in enumerate(term_entities(track, topic, [term.name for term in terms])):
        rows = [list(message.terms[number].values) for _, message in samples]
        size = len(rows[0])
        if size <= _MOST:
            _write(track, entity, times, rows, names[first : first + size])
        first += size


def term_entities(track: Track, topic: str, terms: Sequence[str]) -> list[str]:
    """Return the entities of an observation's terms, which may be a stranger's words."""
    parts = topic.strip("/").split("/")
    if len(terms) == 1:
        return [track.entity(*parts)]
    return [track.entity(*parts, f"{number:02d} {name}") for number, name in enumerate(terms)]


def _write(
    track: Track,
    entity: str,
    times: Sequence[int],
    rows: Sequence[Sequence[float]],
    names: Sequence[str],
) -> None:
    if not rows or not rows[0]:
        return
    numbers = np.array(rows, np.float64)  # a ValueError where rows differ in length
    known = names if len(names) == numbers.shape[1] else [str(k) for k in range(len(rows[0]))]
    track.numbers(entity, times, numbers, known)
