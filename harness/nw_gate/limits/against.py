"""A candidate's limit against a baseline's: PASS, REGRESSED or INCONCLUSIVE, at any trial.

Let I be the baseline's limit, which is unknown, and v(.) the value of a rung, larger where harder.
The baseline's trials have won W_(I+1), "rung I + 1 is not cleared", and V_I, "rung I is cleared":
both nulls are true. The candidate's trials are others, from other starts, and have won W' and V'.
Then

    E_pass(I) = (1 + V_I) / 2  W'_i,  with i the easiest rung with v(i) >= v(I) - max_drop,

bets against "the baseline's limit is I and the candidate's is lower by more than max_drop", under
which rung i is not cleared, and

    E_regressed(I) = (1 + W_(I+1)) / 2  V'_r,  with r the easiest rung with v(r) >= v(I) - tolerate,

against "the baseline's limit is I and the candidate's is lower by no more than tolerate", under
which rung r is cleared. As I is unknown, a verdict needs E_pass(I), or E_regressed(I), to have
reached 1 / alpha for every I: PASS where the baseline's failures rule out what is too hard for the
candidate, REGRESSED where its completions rule out what the candidate does reach. The true I alone
decides the error, which is at most alpha at any number of trials (Ville's inequality; products of
independent e-values: V. Vovk and R. Wang, "E-values: calibration, combination and applications",
Ann. Stat. 49 (2021), section 4). What the baseline's few trials leave open is part of the error.
The half that is not staked keeps a bet that the baseline lost from being the candidate's to win
back. The baseline's evidence should suffice for both claims: `LimitMargins.baseline_confidence`.

Off the ladder a limit has no value. A baseline that clears no rung cannot be fallen short of. Where
v(I) - max_drop lies below the easiest rung, PASS needs that rung; where v(I) - tolerate does, the
candidate is not REGRESSED.

`at_least` is a fixed limit: PASS needs W'_i, and REGRESSED V'_i, of the easiest rung with
v(i) >= at_least. With both, PASS needs both, and `false_alarm` is shared.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log
from typing import Literal

import numpy as np

from nw_base import same_bits
from nw_base.errors import IncomparableError, UsageError
from nw_base.plural import plural
from nw_gate.limits.curves import Array, Beliefs
from nw_gate.limits.ladder import Ladder, check_confidence, check_most, check_share
from nw_gate.limits.limit import Limit
from nw_gate.limits.path import TrialPath
from nw_gate.limits.search import Search, gains
from nw_gate.limits.wealth import Wealth

LimitWord = Literal["PASS", "REGRESSED", "INCONCLUSIVE"]
_ROUNDING = 1e-9
_LEAST_MISSING = 0.2


@dataclass(frozen=True, kw_only=True)
class LimitMargins:
    """What must be shown of a limit.

    Attributes:
        max_drop: drop of the limit against the baseline's that PASS rules out, in the ladder's
            unit; None = there is no baseline to compare with.
        tolerate: drop that counts as equal; REGRESSED needs a larger one to be shown.
        at_least: value, in the ladder's unit, that the limit must reach by itself; None = none. On
            a ladder that falls, the limit must be at most that.
        confidence: that a PASS is right.
        false_alarm: largest probability of a wrong REGRESSED.
        ladders: how many ladders a suite judges so, which share `false_alarm`: that any of them is
            wrongly REGRESSED has at most this probability. A suite passes where all of them do,
            which needs no share.

    Raises:
        UsageError: they do not fit one another.
    """

    max_drop: float | None = None
    tolerate: float = 0.0
    at_least: float | None = None
    confidence: float = 0.95
    false_alarm: float = 0.01
    ladders: int = 1

    def __post_init__(self) -> None:
        if self.max_drop is None and self.at_least is None:
            raise UsageError("nothing to judge a limit by", fix="give max_drop, at_least or both")
        if self.max_drop is not None and not 0.0 <= self.tolerate <= self.max_drop < inf:
            raise UsageError(
                f"tolerate {self.tolerate:g} and max_drop {self.max_drop:g} do not fit",
                fix="give 0 <= tolerate <= max_drop, in the ladder's unit",
            )
        check_confidence(self.confidence)
        if not 0.0 < self.false_alarm <= 0.5:
            raise UsageError(
                f"false_alarm {self.false_alarm:g} is not from 0 to 0.5",
                fix="give 0.01 for one wrong REGRESSED in 100 at most",
            )
        if self.ladders < 1:
            raise UsageError(f"ladders {self.ladders} is below 1", fix="count the suite's ladders")

    @property
    def alpha_regressed(self) -> float:
        """The error of each claim that makes one ladder REGRESSED."""
        claims = (self.max_drop is not None) + (self.at_least is not None)
        return self.false_alarm / claims / self.ladders

    @property
    def baseline_confidence(self) -> float:
        """Confidence of a baseline's bounds with which its evidence suffices for REGRESSED.

        (1 + W) / 2 then reaches 1 / alpha; 0.995 where false_alarm is 0.01 for a single claim.
        """
        return 1.0 - self.alpha_regressed / (2.0 - self.alpha_regressed)


@dataclass(frozen=True, kw_only=True)
class LimitVerdict:
    """What a candidate's trials show of its limit.

    Attributes:
        word: PASS, REGRESSED or INCONCLUSIVE.
        sentence: why, in words.
        candidate: its limit. Its bounds are at the margins' confidence, and decide nothing.
        baseline: the limit that it was compared with; None without one.
        margins: what had to be shown.
    """

    word: LimitWord
    sentence: str
    candidate: Limit
    baseline: Limit | None
    margins: LimitMargins


@dataclass(frozen=True, eq=False)
class Claims:
    """Logarithms of wealth that verdicts need of the candidate, by rung; -inf where none is."""

    passed: Array
    """(n,): of W'. PASS needs all of them."""
    regressed: tuple[Array, ...]
    """Each (n,): of V'. REGRESSED needs all of one of them."""

    @classmethod
    def of(cls, ladder: Ladder, margins: LimitMargins, baseline: Limit | None) -> Claims:
        """Return what is needed.

        Raises:
            UsageError: `at_least` lies beyond the hardest rung.
            IncomparableError: `max_drop` lacks a baseline, or it has another ladder.
        """
        needs_pass = -log(1.0 - margins.confidence)
        needs_regressed = -log(margins.alpha_regressed)
        hard, count = ladder.hardness, len(ladder.rungs)
        passed, regressed = np.full(count, -inf), list[Array]()
        if margins.max_drop is not None:
            too_hard, reached = _won(ladder, baseline)
            fallen = np.full(count, -inf)
            for limit in range(-1, count):
                if limit >= 0:
                    i = _easiest(hard, hard[limit] - margins.max_drop)
                    passed[i] = max(passed[i], needs_pass - too_hard[limit + 1])
                tolerable = hard[limit] - margins.tolerate if limit >= 0 else -inf
                if tolerable < hard[0] - _ROUNDING:
                    # The candidate cannot be shown to be lower: the baseline must not be here.
                    if reached[limit + 1] < needs_regressed - _ROUNDING:
                        fallen[:] = inf
                else:
                    r = _easiest(hard, tolerable)
                    fallen[r] = max(fallen[r], needs_regressed - reached[limit + 1])
            regressed.append(fallen)
        if margins.at_least is not None:
            sign = 1.0 if ladder.rises else -1.0
            i = _easiest(hard, sign * margins.at_least)
            if i == count:
                raise UsageError(
                    f"at_least {ladder.says(margins.at_least)} is beyond the hardest rung of "
                    f"ladder {ladder.name!r}, {ladder.says(ladder.rungs[-1])}",
                    fix="give a smaller limit, or a ladder with harder rungs",
                )
            passed[i] = max(passed[i], needs_pass)
            regressed.append(np.where(np.arange(count) == i, needs_regressed, -inf))
        # Wealth of 1 is had without a trial.
        return cls(
            np.where(passed > 0.0, passed, -inf),
            tuple(np.where(each > 0.0, each, -inf) for each in regressed),
        )

    @property
    def can_regress(self) -> bool:
        """Whether any trials would suffice for REGRESSED: the baseline's are enough for it."""
        return any((each < inf).all() for each in self.regressed)

    def fallen(self, wealth: Wealth) -> tuple[bool, ...]:
        """Return which of the claims of REGRESSED are shown: of max_drop, of at_least."""
        return tuple(
            bool((wealth.most_failed[0] >= each - _ROUNDING).all()) for each in self.regressed
        )

    def word(self, wealth: Wealth) -> LimitWord:
        """Return the verdict so far, of a single ladder."""
        if (wealth.most_cleared[0] >= self.passed - _ROUNDING).all():
            return "PASS"
        if any(self.fallen(wealth)):
            return "REGRESSED"
        return "INCONCLUSIVE"

    def next(self, wealth: Wealth, beliefs: Beliefs, share: float) -> int:
        """Return the rung of the cheapest verdict: its hardest claim of PASS, else its easiest."""
        gain_cleared, gain_failed = (each[0] for each in gains(beliefs, share))
        options = [_cheapest(self.passed, wealth.cleared[0], wealth.most_cleared[0], gain_cleared)]
        for each in self.regressed:
            # Trials at easier rungs bet against harder ones, too: the mirror image.
            cost, rung = _cheapest(
                each[::-1], wealth.failed[0, ::-1], wealth.most_failed[0, ::-1], gain_failed[::-1]
            )
            options.append((cost, len(each) - 1 - rung))
        return min(options)[1]


class LimitGate(TrialPath):
    """Trials of a candidate, at the rungs that decide about its limit.

        gate = LimitGate(LimitMargins(max_drop=0.04), baseline=saved)
        while (trial := gate.next) is not None:
            gate.tell(trial, my_simulator(gate.ladder.rungs[trial.rung], seed=trial.number))
        print(gate.verdict.word, gate.verdict.sentence)

    Numbers of trials begin after those of the baseline: the candidate must meet other starts.

    Attributes:
        ladder: the baseline's, or the one that was given.
        share: q, as of the baseline.
        margins: what must be shown.
    """

    def __init__(
        self,
        margins: LimitMargins,
        *,
        baseline: Limit | None = None,
        ladder: Ladder | None = None,
        share: float = 0.5,
        most: int = 120,
        width: int | None = None,
    ) -> None:
        """Start without trials.

        Args:
            margins: what must be shown.
            baseline: limit to compare with; `max_drop` needs one.
            ladder: what is climbed; None = the baseline's.
            share: q, where there is no baseline.
            most: trials after which it ends INCONCLUSIVE.
            width: the candidate's own limit is searched first, as by `LimitSearch`, until its
                bounds are so many rungs apart. Its trials then begin at number 0, so that those of
                the baseline must be of another seed. None = only the verdict counts.

        Raises:
            UsageError: there is no ladder, or an argument cannot be used.
            IncomparableError: `max_drop` lacks a baseline, or it has another ladder.
        """
        check_most(most)
        check_share(share)
        climbed = ladder or (baseline.ladder if baseline else None)
        if climbed is None:
            raise UsageError("no ladder to climb", fix="give a baseline or a ladder")
        self.margins, self._baseline, self._most = margins, baseline, most
        self._claims = Claims.of(climbed, margins, baseline)
        self._width = width
        estimate = baseline.estimate if baseline else None
        expected = -1.0 if estimate is None else float(estimate.rung)
        is_told = baseline is not None and width is None
        super().__init__(
            climbed,
            baseline.share if baseline else share,
            expected if is_told else None,
            baseline.tried if baseline is not None and is_told else [0] * len(climbed.rungs),
        )

    @property
    def limit(self) -> Limit:
        """What the trials so far show of the candidate's limit."""
        return Limit(
            ladder=self.ladder,
            share=self.share,
            confidence=self.margins.confidence,
            width=1,
            trials=self.trials,
            staked=self._staked,
            expected=self._expected,
        )

    @property
    def verdict(self) -> LimitVerdict:
        """What the trials so far show."""
        return judge_limit(self.limit, self.margins, self._baseline)

    @property
    def most(self) -> int:
        """Trials, at most, before it ends undecided."""
        return self._most

    @property
    def is_decided(self) -> bool:
        """Whether the verdict is PASS or REGRESSED."""
        return self._claims.word(self._wealth) != "INCONCLUSIVE"

    def _stakes(self, wealth: Wealth) -> bool:  # noqa: ARG002  # Every trial is bet on.
        return True

    def _choose(self, wealth: Wealth, beliefs: Beliefs) -> int | None:
        if wealth.done.sum() + wealth.missed.sum() >= self._most:
            return None
        if self._width is not None:
            search = Search(
                curves=self._curves,
                share=self.share,
                confidence=self.margins.confidence,
                width=self._width,
                most=self._most,
            )
            if not search.ended(wealth)[0]:
                return int(search.next(wealth, beliefs)[0])
        if self._claims.word(wealth) != "INCONCLUSIVE":
            return None
        return self._claims.next(wealth, beliefs, self.share)


def judge_limit(
    candidate: Limit, margins: LimitMargins, baseline: Limit | None = None
) -> LimitVerdict:
    """Return what a candidate's trials show, whichever rule chose their rungs.

    Args:
        candidate: its trials; none of them from a start that a trial of the baseline's limit met.
        margins: what must be shown.
        baseline: limit to compare with; `max_drop` needs one.

    Raises:
        UsageError: `at_least` lies beyond the hardest rung.
        IncomparableError: `max_drop` lacks a baseline, or it has another ladder.
    """
    claims = Claims.of(candidate.ladder, margins, baseline)
    word = claims.word(candidate.wealth)
    shown = iter(claims.fallen(candidate.wealth))
    by_drop = margins.max_drop is not None and next(shown)
    by_least = margins.at_least is not None and next(shown)
    sentence = _sentence(word, candidate, baseline, margins, by_drop=by_drop, by_least=by_least)
    if word == "INCONCLUSIVE" and not claims.can_regress:
        sentence += (
            "; the baseline's trials are too few for REGRESSED: find its limit at a confidence of "
            f"{margins.baseline_confidence:.4f}"
        )
    return LimitVerdict(
        word=word,
        sentence=sentence,
        candidate=candidate,
        baseline=baseline,
        margins=margins,
    )


def _won(ladder: Ladder, baseline: Limit | None) -> tuple[Array, Array]:
    """Return the logarithms of (1 + V_I) / 2 and (1 + W_(I+1)) / 2, for I = -1, 0 .. n - 1."""
    if baseline is None:
        raise IncomparableError("max_drop has no baseline to compare with", fix="give a baseline")
    if baseline.ladder != ladder:
        raise IncomparableError(
            f"the baseline's limit is on another ladder: {baseline.ladder.name!r} with rungs "
            f"{list(baseline.ladder.rungs)}",
            fix="save the baseline's limits on this ladder",
        )
    logs = np.r_[0.0, baseline.wealth.failed[0]], np.r_[baseline.wealth.cleared[0], 0.0]
    too_hard, reached = (same_bits.log(0.5 + 0.5 * same_bits.exp(each)) for each in logs)
    return too_hard, reached


def _easiest(hardness: tuple[float, ...], least: float) -> int:
    """Return the easiest rung that is at least so hard; their number if none is."""
    slack = _ROUNDING * max(1.0, abs(least))
    return next((i for i, value in enumerate(hardness) if value >= least - slack), len(hardness))


def _cheapest(needed: Array, have: Array, most: Array, gain: Array) -> tuple[float, int]:
    """Return about how many trials claims cost, and the first rung from the end that needs one.

    A trial at a rung bets for all rungs before it, so the claims are met from the last rung.
    """
    cost, won, rung = 0.0, 0.0, len(needed) - 1
    for i in range(len(needed) - 1, -1, -1):
        if most[i] >= needed[i] - _ROUNDING:
            continue
        missing = max(float(needed[i] - have[i]), _LEAST_MISSING) - won
        if missing > 0.0:
            rung = i if cost == 0.0 else rung
            cost, won = cost + missing / float(gain[i]), won + missing
    return cost, rung


def _sentence(
    word: LimitWord,
    candidate: Limit,
    baseline: Limit | None,
    margins: LimitMargins,
    *,
    by_drop: bool,
    by_least: bool,
) -> str:
    """Return what is shown, in words; of REGRESSED, by which of the claims."""
    says, name = candidate.ladder.says, candidate.ladder.name
    wanted: list[str] = []
    if margins.max_drop is not None:
        if word == "PASS":
            wanted.append(f"not lower than the baseline's by more than {says(margins.max_drop)}")
        elif by_drop:
            by = f" by more than {says(margins.tolerate)}" if margins.tolerate else ""
            wanted.append(f"lower than the baseline's{by}")
    if margins.at_least is not None and (by_least or word != "REGRESSED"):
        reached, missed = ("at least", "below") if candidate.ladder.rises else ("at most", "above")
        wanted.append(f"{missed if word == 'REGRESSED' else reached} {says(margins.at_least)}")
    trials = plural(len(candidate.trials), "trial")
    if word == "INCONCLUSIVE":
        text = f"{name}: {trials} do not settle the limit"
    else:
        joined = " and ".join(wanted)
        text = f"{name}: the limit is {joined}, shown by {trials}"
    if baseline is not None:
        text += f" (baseline {baseline.range_text}; candidate {candidate.range_text})"
    return f"{text}. {candidate.dip_sentence}".rstrip()
