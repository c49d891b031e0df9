"""The limit of a policy on a ladder: what its trials show, and the trials with which they show it.

A limit is kept as its trials in order. All else follows from them: bounds, evidence, curve. The
bounds hold for any trials whose rung and order do not depend on later results.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from nw_base.errors import StoreError, UsageError
from nw_base.plural import plural
from nw_gate.limits.curves import Curves
from nw_gate.limits.ladder import Ladder, check_confidence, check_share
from nw_gate.limits.monotone import Dip, find_dip
from nw_gate.limits.wealth import Wealth

_BAND = 0.9
_MOST_TRIALS = 100_000


class Bound(NamedTuple):
    """A rung that bounds a limit."""

    rung: int
    """Its index, from the easiest."""
    value: float
    """Its value, in the ladder's unit."""


class CurvePoint(NamedTuple):
    """One rung of the curve that trials suggest: for a picture, no claim rests on it."""

    value: float
    """Of the rung, in the ladder's unit."""
    tried: int
    """Trials there."""
    completed: int
    """Of these, such as were completed."""
    rate: float
    """Posterior mean of the completion rate."""
    low: float
    """The rate is above this with posterior probability 0.95."""
    high: float
    """The rate is below this with posterior probability 0.95."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """Up to which rung a policy completes at least a share of its trials.

    Attributes:
        ladder: what was climbed.
        share: q; a rung is cleared where its completion rate is at least that.
        confidence: of each bound by itself, at any number of trials.
        width: rungs that the bounds may be apart where the limit counts as decided.
        trials: rung and result of each trial, in order.
        staked: the bounds rest on so many trials from the first; later ones look for a dip.
        expected: rung that was expected to be the limit, which made stakes; None = none.
    """

    ladder: Ladder
    share: float
    confidence: float
    width: int
    trials: tuple[tuple[int, bool], ...]
    staked: int
    expected: float | None = None

    @cached_property
    def wealth(self) -> Wealth:
        """What the trials have won against each claim."""
        curves = Curves.over(len(self.ladder.rungs), self.share, self.expected)
        wealth = Wealth.at_start(1, len(self.ladder.rungs))
        for rung, done in self.trials[: self.staked]:
            beliefs = curves.beliefs(wealth.done, wealth.missed)
            wealth.bet(np.array([rung]), np.array([done]), beliefs, self.share)
        for rung, done in self.trials[self.staked :]:
            wealth.count(rung, done)
        return wealth

    @property
    def tried(self) -> tuple[int, ...]:
        """Trials by rung."""
        return tuple(int(n) for n in (self.wealth.done + self.wealth.missed)[0])

    @property
    def completed(self) -> tuple[int, ...]:
        """Completed trials by rung."""
        return tuple(int(n) for n in self.wealth.done[0])

    @cached_property
    def ends(self) -> tuple[int, int]:
        """The hardest rung shown to be cleared, -1 for none, and the easiest shown not to be.

        The second is the number of rungs where none was shown.
        """
        low, high = self.wealth.bounds(self.confidence)
        return int(low[0]), int(high[0])

    @property
    def lower(self) -> Bound | None:
        """The hardest rung shown to be cleared; None where not even the easiest one was."""
        return self._bound(self.ends[0])

    @property
    def upper(self) -> Bound | None:
        """The easiest rung shown not to be cleared; None where not even the hardest one was."""
        return self._bound(self.ends[1])

    @property
    def decided(self) -> bool:
        """Whether the bounds are at most `width` rungs apart."""
        return self.ends[1] - self.ends[0] <= self.width

    @property
    def estimate(self) -> Bound | None:
        """The limit with as much posterior probability above as below; None for below all rungs."""
        curves = Curves.over(len(self.ladder.rungs), self.share)
        mass = curves.beliefs(self.wealth.done, self.wealth.missed).cleared[0]
        return self._bound(int((np.cumsum(mass) < 0.5 * mass.sum()).sum()) - 1)

    @property
    def curve(self) -> tuple[CurvePoint, ...]:
        """Each rung's completion rate, as all trials suggest it."""
        curves = Curves.over(len(self.ladder.rungs), self.share)
        band = curves.band(self.wealth.done[0], self.wealth.missed[0], _BAND)
        rows = zip(self.ladder.rungs, self.tried, self.completed, *band, strict=True)
        return tuple(CurvePoint(v, n, k, float(r), float(a), float(b)) for v, n, k, r, a, b in rows)

    @cached_property
    def dip(self) -> Dip | None:
        """Where the curve is not monotone; None if that is not shown, at 95 %."""
        return find_dip(self.wealth.done[0], self.wealth.missed[0])

    @property
    def bound_texts(self) -> tuple[str, str]:
        """Both bounds with their unit; `none` for one that lies off the ladder."""
        low, high = (None if each is None else each.value for each in (self.lower, self.upper))
        says = self.ladder.says
        return "none" if low is None else says(low), "none" if high is None else says(high)

    @property
    def range_text(self) -> str:
        """Both bounds in words, such as `0.26 m, not 0.34 m`."""
        says, (low, high) = self.ladder.says, (self.lower, self.upper)
        cleared = [says(low.value)] if low is not None else []
        return ", ".join([*cleared, *([f"not {says(high.value)}"] if high else [])]) or "unknown"

    @property
    def sentence(self) -> str:
        """What the trials show, in words."""
        says, (low, high) = self.ladder.says, (self.lower, self.upper)
        share = f"{100.0 * self.share:.4g} % of trials"
        to = f"at least {share} {'up' if self.ladder.rises else 'down'} to"
        if low is not None and high is not None:
            text = f"{to} {says(low.value)}, fewer at {says(high.value)}"
        elif low is not None:
            what = (
                "the last rung" if self.ends[0] == len(self.ladder.rungs) - 1 else "no upper bound"
            )
            text = f"{to} {says(low.value)} ({what})"
        elif high is not None:
            text = f"fewer than {share} at {says(high.value)}, no lower bound"
        else:
            text = f"no rung is shown to be over or under {share}"
        sentence = f"{self.ladder.name}: {text}; {plural(len(self.trials), 'trial')}"
        if not self.decided:
            sentence += f", undecided at a width of {plural(self.width, 'rung')}"
        return f"{sentence}. {self.dip_sentence}".rstrip()

    @property
    def dip_sentence(self) -> str:
        """Which rungs contradict a falling curve, in words; empty if none do."""
        if self.dip is None:
            return ""
        easier, harder = (
            f"{self.completed[i]} of {self.tried[i]} at {self.ladder.says(self.ladder.rungs[i])}"
            for i in (self.dip.easier, self.dip.harder)
        )
        return f"The curve is not monotone: {easier}, {harder}."

    def as_dict(self) -> dict[str, Any]:
        """Return what `from_dict` reads, of numbers, texts, lists and None alone."""
        return {
            "ladder": self.ladder.name,
            "unit": self.ladder.unit,
            "rungs": list(self.ladder.rungs),
            "share": self.share,
            "confidence": self.confidence,
            "width": self.width,
            "trials": [[rung, int(done)] for rung, done in self.trials],
            "staked": self.staked,
            "expected": self.expected,
        }

    @classmethod
    def from_dict(cls, saved: Mapping[str, Any]) -> Limit:
        """Return a limit that was saved.

        Raises:
            StoreError: it is none.
        """
        try:
            rungs = tuple(float(value) for value in saved["rungs"])
            ladder = Ladder(name=str(saved["ladder"]), unit=str(saved["unit"]), rungs=rungs)
            pairs = cast("Sequence[tuple[int, int]]", saved["trials"])
            trials = _trials(pairs, len(rungs))
            share, confidence = float(saved["share"]), float(saved["confidence"])
            check_share(share)
            check_confidence(confidence)
            expected = saved["expected"]
            return cls(
                ladder=ladder,
                share=share,
                confidence=confidence,
                width=int(saved["width"]),
                trials=trials,
                staked=int(saved["staked"]),
                expected=None if expected is None else _near(float(expected), len(rungs)),
            )
        except (KeyError, TypeError, ValueError, OverflowError, UsageError) as error:
            raise StoreError(
                f"saved limit cannot be read: {error}", fix="save the baseline again"
            ) from error

    def _bound(self, rung: int) -> Bound | None:
        inside = 0 <= rung < len(self.ladder.rungs)
        return Bound(rung, self.ladder.rungs[rung]) if inside else None


def _trials(pairs: Sequence[tuple[int, int]], rungs: int) -> tuple[tuple[int, bool], ...]:
    """Return saved trials, each at one of the rungs.

    Raises:
        ValueError: they are too many, or at no rung.
    """
    if len(pairs) > _MOST_TRIALS:
        raise ValueError(f"it has over {_MOST_TRIALS} trials")
    trials = tuple((int(rung), bool(done)) for rung, done in pairs)
    beyond = [rung for rung, _ in trials if not 0 <= rung < rungs]
    if beyond:
        raise ValueError(f"a trial is at rung {beyond[0]} of {rungs}")
    return trials


def _near(expected: float, rungs: int) -> float:
    """Return a saved rung that was expected to be the limit.

    Raises:
        ValueError: it is far from the ladder.
    """
    if not -1.0 <= expected <= rungs:
        raise ValueError(f"the limit was expected at rung {expected:g} of {rungs}")
    return expected
