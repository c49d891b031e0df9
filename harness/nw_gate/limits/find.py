"""The search for a limit: it names the next trial, takes results, and knows the bounds so far."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nw_base.errors import UsageError
from nw_gate.limits.curves import Beliefs
from nw_gate.limits.ladder import Ladder, LimitTrial, check_confidence, check_most, check_share
from nw_gate.limits.limit import Limit
from nw_gate.limits.monotone import find_dip
from nw_gate.limits.path import TrialPath
from nw_gate.limits.search import Search
from nw_gate.limits.wealth import Wealth

_CHECKED = 10  # An easier rung is tried at most so many times `check`.


class LimitSearch(TrialPath):
    """The search for one policy's limit on one ladder.

        search = LimitSearch(Ladder(name="step", unit="m", rungs=(0.1, 0.2, 0.3, 0.4)))
        while (trial := search.next) is not None:
            search.tell(trial, my_simulator(search.ladder.rungs[trial.rung], seed=trial.number))
        print(search.limit.sentence)

    Attributes:
        ladder: what is climbed.
        share: q; a rung is cleared where its completion rate is at least that.
    """

    def __init__(
        self,
        ladder: Ladder,
        *,
        share: float = 0.5,
        confidence: float = 0.95,
        width: int = 2,
        most: int = 120,
        check: int = 0,
    ) -> None:
        """Start without trials.

        Args:
            ladder: what is climbed.
            share: q; a rung is cleared where its completion rate is at least that.
            confidence: of each bound by itself, whenever one looks.
            width: rungs that the bounds may be apart where the search ends.
            most: trials after which it ends undecided.
            check: after the search, each rung that is easier than the lower bound is tried until
                so many more trials than the share asks for are completed, to find a curve that is
                not monotone; 0 = none is. These trials come on top of `most`.

        Raises:
            UsageError: an argument cannot be used.
        """
        check_share(share)
        check_confidence(confidence)
        check_most(most)
        if not 1 <= width <= len(ladder.rungs):
            raise UsageError(
                f"width {width} is not from 1 to {len(ladder.rungs)}",
                fix="give the rungs that the bounds may be apart",
            )
        if check < 0:
            raise UsageError(f"check {check} is below 0", fix="give 0 for no check")
        self._most, self._check = most, check
        self._confidence, self._width = confidence, width
        super().__init__(ladder, share, None, [0] * len(ladder.rungs))

    @property
    def limit(self) -> Limit:
        """What the trials so far show."""
        return Limit(
            ladder=self.ladder,
            share=self.share,
            confidence=self._confidence,
            width=self._width,
            trials=self.trials,
            staked=self._staked,
        )

    @property
    def most(self) -> int:
        """Trials, at most, before it ends undecided."""
        return self._most

    @property
    def is_decided(self) -> bool:
        """Whether the bounds are `width` rungs apart, or less."""
        return self.limit.decided

    def _stakes(self, wealth: Wealth) -> bool:
        low, high = wealth.bounds(self._confidence)
        return bool(high[0] - low[0] > self._width)

    def _choose(self, wealth: Wealth, beliefs: Beliefs) -> int | None:
        if self._stakes(wealth):
            if wealth.done.sum() + wealth.missed.sum() >= self._most:
                return None
            search = Search(
                curves=self._curves,
                share=self.share,
                confidence=self._confidence,
                width=self._width,
                most=self._most,
            )
            return int(search.next(wealth, beliefs)[0])
        return self._check_next(wealth)

    def _check_next(self, wealth: Wealth) -> int | None:
        """Return the rung to try next for a dip; None where none is looked for any longer."""
        limit = int(wealth.bounds(self._confidence)[0][0])
        done, missed = wealth.done[0], wealth.missed[0]
        tried = done + missed
        ahead = done - missed * self.share / (1.0 - self.share)
        due = (ahead < self._check) & (tried < _CHECKED * self._check)
        rungs = np.flatnonzero(due[: max(0, limit)])
        if not len(rungs) or find_dip(done, missed) is not None:
            return None
        rung = int(rungs[0])
        # A rung that may be a dip is compared with the hardest one that is cleared.
        return limit if ahead[rung] < 0.0 and tried[limit] < tried[rung] + self._check else rung


def find_limit(
    ladder: Ladder,
    completes: Callable[[LimitTrial], bool],
    *,
    share: float = 0.5,
    confidence: float = 0.95,
    width: int = 2,
    most: int = 120,
    check: int = 0,
) -> Limit:
    """Find a policy's limit, one trial after another.

    Args:
        ladder: what is climbed.
        completes: runs a trial, and returns whether the policy completed it.
        share: as of `LimitSearch`.
        confidence: as of `LimitSearch`.
        width: as of `LimitSearch`.
        most: as of `LimitSearch`.
        check: as of `LimitSearch`.
    """
    search = LimitSearch(
        ladder, share=share, confidence=confidence, width=width, most=most, check=check
    )
    while (trial := search.next) is not None:
        search.tell(trial, completes(trial))
    return search.limit
