"""In which order the trials of a run are started."""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from nw_eval.suite.trials import Trial


def in_order(trials: Iterable[Trial]) -> tuple[Trial, ...]:
    """Return trials round by round: every scene's first trials, then the second ones, and so on.

    Within a round the order is that of a hash of the identity, so that neighbours differ in
    difficulty, and it is the same for every worker count, shard and resume. A run that is cut
    short has met every scene about equally often.
    """
    return tuple(sorted(trials, key=lambda trial: (trial.index, _rank(trial))))


def _rank(trial: Trial) -> bytes:
    return sha256(f"{trial.suite_digest}/{trial.identity}".encode()).digest()
