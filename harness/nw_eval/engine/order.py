"""In which order the trials of a run are started."""

from __future__ import annotations

from hashlib import sha256
from itertools import takewhile
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Container, Iterable

    from nw_eval.suite.trials import Trial


_NEAR = 16
"""Trials of a drawn order among which a worker may choose."""


def in_order(trials: Iterable[Trial]) -> tuple[Trial, ...]:
    """Return trials in the order in which they are started.

    Those that were drawn for a run against a baseline keep their places. Others go round by round:
    every scene's first trials, then the second ones, and so on. Within a round the order is that
    of a hash of the identity, so that neighbours differ in difficulty, and it is the same for every
    worker count, shard and resume. A run that is cut short has met every scene about equally often.
    """

    def key(trial: Trial) -> tuple[int, bytes]:
        if trial.place is None:
            return trial.index, _rank(trial)
        return trial.place, b""

    return tuple(sorted(trials, key=key))


def next_place(waiting: Iterable[Trial], *, own: Container[str], taken: Container[str]) -> int:
    """Return the place, among waiting trials in order, of the one that a worker takes next.

    It is of the first's round, or among the next `_NEAR` of a drawn order, so that scenes are met
    as equally as without choice: one in a scene that the worker has loaded, or else one in a scene
    that nobody has, or else the first.

    Args:
        waiting: one trial or more.
        own: scenes that the worker has loaded.
        taken: scenes that any worker has.
    """
    trials = iter(waiting)
    first = next(trials)

    def is_near(trial: Trial) -> bool:
        if first.place is None or trial.place is None:
            return trial.index == first.index
        return trial.place < first.place + _NEAR

    scenes = [first.scene, *(trial.scene for trial in takewhile(is_near, trials))]
    return min(
        range(len(scenes)),
        key=lambda place: 0 if scenes[place] in own else 1 + (scenes[place] in taken),
    )


def _rank(trial: Trial) -> bytes:
    return sha256(f"{trial.suite_digest}/{trial.identity}".encode()).digest()
