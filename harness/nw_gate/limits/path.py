"""Trials in an order that the results alone decide, however many workers run them.

The n-th trial of a rung has one result, whenever it is run. Which trial comes next is a function of
the results before it on the path; so the path is the same for one worker and for many. Workers run
ahead of it: `ahead` names the trials that the path probably needs. A result is kept until the path
reaches it, and one that the path never reaches counts for nothing, since nothing was staked on it.

Of a limit that 19 trials find, two workers run 22 trials in 11 turns, and four 24 in 6.

Many ladders at once need no trials ahead: each worker takes the next trial of another ladder.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from copy import deepcopy
from heapq import heappop, heappush

import numpy as np

from nw_base.errors import UsageError
from nw_gate.limits.curves import Beliefs, Curves
from nw_gate.limits.ladder import Ladder, LimitTrial
from nw_gate.limits.limit import Limit
from nw_gate.limits.wealth import Wealth

_LOOKS = 8  # Steps that `ahead` follows for each trial that it names.


class TrialPath(ABC):
    """Trials of one ladder, asked for one after another."""

    def __init__(
        self, ladder: Ladder, share: float, expected: float | None, first: Sequence[int]
    ) -> None:
        """Start without trials.

        Args:
            ladder: what is climbed.
            share: q.
            expected: rung that is probably the limit, as `Curves.over` has it.
            first: numbers of each rung's first trial.
        """
        self.ladder = ladder
        self.share = share
        self._expected = expected
        self._curves = Curves.over(len(ladder.rungs), share, expected)
        self._wealth = Wealth.at_start(1, len(ladder.rungs))
        self._first = tuple(first)
        self._results: dict[LimitTrial, bool] = {}
        self._path: list[tuple[int, bool]] = []
        self._staked = 0
        self._next: LimitTrial | None = None
        self._follow()

    @property
    def next(self) -> LimitTrial | None:
        """The trial whose result is needed now; None where all is decided or spent."""
        return self._next

    @property
    def trials(self) -> tuple[tuple[int, bool], ...]:
        """Rung and result of each trial that counts, in the order in which they count."""
        return tuple(self._path)

    @property
    @abstractmethod
    def limit(self) -> Limit:
        """What the trials so far show."""

    @property
    @abstractmethod
    def most(self) -> int:
        """Trials, at most, before it ends undecided."""

    @property
    @abstractmethod
    def is_decided(self) -> bool:
        """Whether what is asked is shown; else the trials are spent, or one is needed."""

    @property
    def counted(self) -> tuple[LimitTrial, ...]:
        """The trials that count, in the order in which they count."""
        tried, counted = list(self._first), list[LimitTrial]()
        for rung, _ in self._path:
            counted.append(LimitTrial(rung, tried[rung]))
            tried[rung] += 1
        return tuple(counted)

    def follow(self, results: Mapping[LimitTrial, bool]) -> bool:
        """Take the results that are needed, in their order; return whether none is missing."""
        while (trial := self.next) is not None:
            if trial not in results:
                return False
            self.tell(trial, results[trial])
        return True

    def takes(self, trial: LimitTrial) -> bool:
        """Whether a trial may be one of this path: its number is not below the rung's first."""
        return 0 <= trial.rung < len(self._first) and trial.number >= self._first[trial.rung]

    def tell(self, trial: LimitTrial, completed: bool) -> None:
        """Take the result of a trial, in any order.

        Raises:
            UsageError: there is no such trial, or it had another result.
        """
        rung, number = trial
        if not self.takes(LimitTrial(*trial)):
            raise UsageError(
                f"trial {number} of rung {rung} was not asked for",
                fix="give a trial of `next` or `ahead`",
            )
        if self._results.setdefault(LimitTrial(*trial), completed) != completed:
            raise UsageError(
                f"trial {number} of rung {rung} has two results",
                fix="make a trial depend on its rung and number alone",
            )
        self._follow()

    def ahead(self, count: int) -> tuple[LimitTrial, ...]:
        """Return the trials without a result that are needed first, the likeliest first.

        Args:
            count: how many, at most; trials that are running are among them.
        """
        trials: list[LimitTrial] = []
        heap: list[tuple[float, int, Wealth]] = [(-1.0, 0, self._wealth)]
        looks = 0
        while heap and len(trials) < count and looks < _LOOKS * count:
            chance, _, wealth = heappop(heap)
            beliefs = self._beliefs(wealth)
            rung = self._choose(wealth, beliefs)
            if rung is None:
                continue
            trial, looks = self._trial(wealth, rung), looks + 1
            known = self._results.get(trial)
            if known is None and trial not in trials:
                trials.append(trial)
            rate = float(beliefs.rate[0, rung])
            for done, share in ((True, rate), (False, 1.0 - rate)):
                if known is None or known == done:
                    after = deepcopy(wealth)
                    self._take(after, beliefs, rung, done)
                    weight = chance * (share if known is None else 1.0)
                    heappush(heap, (weight, 2 * looks + done, after))
        return tuple(trials)

    @abstractmethod
    def _choose(self, wealth: Wealth, beliefs: Beliefs) -> int | None:
        """Return the rung to try next; None where all is decided or spent."""

    @abstractmethod
    def _stakes(self, wealth: Wealth) -> bool:
        """Return whether the next trial is bet on, or counts for the curve alone."""

    def _beliefs(self, wealth: Wealth) -> Beliefs:
        return self._curves.beliefs(wealth.done, wealth.missed)

    def _trial(self, wealth: Wealth, rung: int) -> LimitTrial:
        tried = int(wealth.done[0, rung] + wealth.missed[0, rung])
        return LimitTrial(rung, self._first[rung] + tried)

    def _take(self, wealth: Wealth, beliefs: Beliefs, rung: int, done: bool) -> None:
        if self._stakes(wealth):
            wealth.bet(np.array([rung]), np.array([done]), beliefs, self.share)
        else:
            wealth.count(rung, done)

    def _follow(self) -> None:
        """Follow the path as far as results are known."""
        while True:
            beliefs = self._beliefs(self._wealth)
            rung = self._choose(self._wealth, beliefs)
            self._next = None if rung is None else self._trial(self._wealth, rung)
            done = None if self._next is None else self._results.get(self._next)
            if rung is None or done is None:
                return
            self._staked += self._stakes(self._wealth)
            self._take(self._wealth, beliefs, rung, done)
            self._path.append((rung, done))
