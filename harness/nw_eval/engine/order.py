"""In which order the trials of a run are started."""

from __future__ import annotations

from hashlib import sha256
from itertools import groupby, takewhile
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Container, Iterable

    from nw_eval.rollout.job import TrialJob
    from nw_eval.suite.trials import Trial


def in_order(trials: Iterable[Trial]) -> tuple[Trial, ...]:
    """Return trials round by round: every scene's first trials, then the second ones, and so on.

    Which trials make a round is the plan's word: those of one index, or those that it draws from a
    bank. Within a round the order is that of a hash of the identity, so that neighbours differ in
    difficulty, and it is the same for every worker count, shard and resume. A run that is cut
    short has met every scene about equally often.
    """
    return tuple(sorted(trials, key=lambda trial: (trial.round, _rank(trial))))


def rounds(jobs: Iterable[TrialJob]) -> list[list[TrialJob]]:
    """Return jobs by round: each has one more start in every scene and perturbation.

    Args:
        jobs: `in_order`.
    """
    return [list(part) for _, part in groupby(jobs, key=lambda job: job.trial.round)]


def next_place(waiting: Iterable[Trial], *, own: Container[str], taken: Container[str]) -> int:
    """Return the place, among waiting trials in order, of the one that a worker takes next.

    It is of the first's round, so that scenes are met as equally as without choice: one in a scene
    that the worker has loaded, or else one in a scene that nobody has, or else the first.

    Args:
        waiting: one trial or more.
        own: scenes that the worker has loaded.
        taken: scenes that any worker has.
    """
    trials = iter(waiting)
    first = next(trials)
    scenes = [first.scene]
    scenes += [trial.scene for trial in takewhile(lambda t: t.round == first.round, trials)]
    return min(
        range(len(scenes)),
        key=lambda place: 0 if scenes[place] in own else 1 + (scenes[place] in taken),
    )


def _rank(trial: Trial) -> bytes:
    return sha256(f"{trial.suite_digest}/{trial.identity}".encode()).digest()
