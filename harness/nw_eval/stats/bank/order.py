"""In which order starts are drawn from the bank: in each scene, and of all scenes together."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from hashlib import sha256


def order_of_starts(
    starts: int, *, candidate_digest: str, suite_digest: str, scene: str
) -> list[int]:
    """Return the indexes 0 .. M - 1 in the order in which they are to be drawn.

    The order is random as far as scores go: it follows sha256 of who is judged by what, so that it
    is the same on every machine and in every run, differs between scenes and between candidates,
    and cannot be chosen after the trials have been seen. A bank with more starts keeps the order of
    those that it had.

    Args:
        starts: M.
        candidate_digest: of the policy that is judged.
        suite_digest: of the suite.
        scene: its name.
    """
    ranks = _ranks(starts, json.dumps([candidate_digest, suite_digest, scene]))
    return sorted(range(starts), key=ranks.__getitem__)


def order_of_trials(
    scenes: Sequence[str], starts: int, *, candidate_digest: str, suite_digest: str
) -> list[tuple[int, int]]:
    """Return all S x M pairs of a scene and a start of it in the order in which they are drawn.

    They are one simple random sample without replacement, as far as scores go: whoever has the
    smaller sha256 comes first, whatever its scene. Within a scene the starts come as in
    `order_of_starts`. Scenes that are left out, or starts that are added to a bank, do not change
    the order of the others.

    Args:
        scenes: their names, shape (S,), each once.
        starts: M.
        candidate_digest: of the policy that is judged.
        suite_digest: of the suite.

    Returns:
        Pairs of the place of a scene among `scenes` and the index of a start, shape (S M, 2).
    """
    drawn = [
        (rank, place, start)
        for place, scene in enumerate(scenes)
        for start, rank in enumerate(
            _ranks(starts, json.dumps([candidate_digest, suite_digest, scene]))
        )
    ]
    return [(place, start) for _, place, start in sorted(drawn)]


@lru_cache(maxsize=4096)  # Who plans a run, who judges it and who words it ask for the same.
def _ranks(starts: int, drawn_by: str) -> tuple[bytes, ...]:
    """Return for 0 .. M - 1 the sha256 of the JSON list of what draws them, and the start."""
    beginning = sha256(drawn_by.removesuffix("]").encode())

    def rank(start: int) -> bytes:
        one = beginning.copy()
        one.update(f", {start}]".encode())
        return one.digest()

    return tuple(map(rank, range(starts)))
