"""Which checkpoint of a series is flagged first: a search that asks for few verdicts.

Each verdict is a test of its own against the same baseline, with its own errors: of k that were
asked for, each flags an unharmed checkpoint with at most the gate's false alarm, and passes one
that fell by the gate's max_drop with at most 1 - confidence. So the first that is flagged need not
be the first that is worse: one before it that passed may be worse by less than max_drop.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

Decision = Literal["PASS", "REGRESSED", "INCONCLUSIVE"]
Judge = Callable[[int], Decision]


@dataclass(frozen=True, kw_only=True)
class Bisection:
    """What was asked of a series of n checkpoints, 0 .. n - 1, in order of age."""

    words: Mapping[int, Decision]
    """The verdicts that were asked for, by index, in order of position."""
    length: int

    @property
    def last_good(self) -> int | None:
        """The last checkpoint that passed before the first that was flagged; None if none did."""
        fallen = self.first_fallen
        good = [i for i, word in self.words.items() if word == "PASS"]
        return max((i for i in good if fallen is None or i < fallen), default=None)

    @property
    def first_fallen(self) -> int | None:
        """The first checkpoint that was flagged; None if none was."""
        return min((i for i, word in self.words.items() if word == "REGRESSED"), default=None)

    @property
    def suspects(self) -> range:
        """The first that was flagged, and those before it that did not pass or were not asked."""
        fallen = self.first_fallen
        if fallen is None:
            return range(0)
        return range(0 if self.last_good is None else self.last_good + 1, fallen + 1)

    @property
    def recovered(self) -> tuple[int, ...]:
        """Checkpoints that passed after one that regressed: the series is not monotone."""
        fallen = self.first_fallen
        passed = (i for i, word in self.words.items() if word == "PASS")
        return tuple(i for i in passed if fallen is not None and i > fallen)


def bisect(length: int, judge: Judge, *, everyone: bool = False) -> Bisection:
    """Find the first checkpoint that regressed.

    The last one is asked for first: where it did not fall, nothing has to be found. Then the middle
    of what is open, until a checkpoint that passed stands beside one that regressed; one that is
    left open is passed over for its nearest neighbours. Then the middle of the longest stretch on
    either side that has not been tested, since halving alone never sees that a series is not
    monotone.

    Args:
        length: n, at least 1.
        judge: gives the verdict on a checkpoint, and is asked once for each.
        everyone: whether all of them are asked for, in order, in place of a search.
    """
    words: dict[int, Decision] = {}

    def ask(index: int) -> Decision:
        if index not in words:
            words[index] = judge(index)
        return words[index]

    if everyone:
        for index in range(length):
            ask(index)
    elif ask(length - 1) != "PASS":
        _halve(length, ask, words)
        for stretch in _unseen(length, words):
            ask(stretch[len(stretch) // 2])
    return Bisection(words=dict(sorted(words.items())), length=length)


def _halve(length: int, ask: Judge, words: Mapping[int, Decision]) -> None:
    """Ask until all between the last that passed and the first that regressed is known."""
    good, bad = -1, length - 1
    while opened := [i for i in range(good + 1, bad) if i not in words]:
        place = min(opened, key=lambda i: (abs(2 * i - good - bad), i))
        word = ask(place)
        if word == "PASS":
            good = place
        elif word == "REGRESSED":
            bad = place


def _unseen(length: int, words: Mapping[int, Decision]) -> list[range]:
    """Return the longest stretches not asked about, on both sides of the first that regressed."""
    fallen = min((i for i, word in words.items() if word == "REGRESSED"), default=length)
    seen = [-1, *sorted(words), length]
    gaps = [range(a + 1, b) for a, b in pairwise(seen) if b - a > 1]
    sides = ([g for g in gaps if g.stop <= fallen], [g for g in gaps if g.start > fallen])
    return [max(side, key=len) for side in sides if side]
