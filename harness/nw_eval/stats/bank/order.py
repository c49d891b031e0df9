"""In which order the starts of a scene are drawn from the bank."""

from __future__ import annotations

import json
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
    return list(_ranked(starts, json.dumps([candidate_digest, suite_digest, scene])))


@lru_cache(maxsize=4096)  # Who plans a run, who judges it and who words it ask for the same.
def _ranked(starts: int, drawn_by: str) -> tuple[int, ...]:
    """Return 0 .. M - 1 by the sha256 of the JSON list of what draws them, and the start."""
    beginning = sha256(drawn_by.removesuffix("]").encode())

    def rank(start: int) -> bytes:
        one = beginning.copy()
        one.update(f", {start}]".encode())
        return one.digest()

    return tuple(sorted(range(starts), key=rank))
