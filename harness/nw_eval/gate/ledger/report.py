"""What a ledger's verdicts are worth together: false alarms, re-rolls, and the best of many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from statistics import fmean

from nw_eval.gate.ledger.entry import LedgerEntry
from nw_eval.gate.verdict import Word
from nw_eval.stats.best_of_many import luck_of_the_best
from nw_eval.words import PanelKind

_DAYS = 365.25
_SHORTEST = 7.0  # days from which a year is foretold
_MOST_CANDIDATES = 200  # of a panel that are simulated: more say no more


@dataclass(frozen=True, kw_only=True)
class Alarms:
    """How many wrong words some tests give at most, on average."""

    tests: int
    regressed: float
    """Of candidates none of which is worse than is tolerated: false REGRESSED."""
    passed: float
    """Of candidates all of which are worse by max_drop, or exactly at the bar: false PASS."""


@dataclass(frozen=True, kw_only=True)
class Reroll:
    """One candidate that was tested more than once: each test is another chance of a wrong word."""

    candidate: str
    digest: str
    suite: str
    tests: int
    words: tuple[Word, ...]
    """In their order, one for each test: the last that it gave."""
    false_regressed: float
    """Largest chance of at least one false REGRESSED."""
    false_passed: float
    """Largest chance of at least one false PASS."""


@dataclass(frozen=True, kw_only=True)
class BestOfMany:
    """Candidates that met the same panel, of which the best may be chosen."""

    suite: str
    suite_digest: str
    panel: PanelKind
    candidates: int
    best: str
    digest: str
    """Of the best one's checkpoint and card."""
    shown: float
    """Mean success of the best."""
    mean: float
    """Of all of them."""
    overstated: float | None
    """How much more than it is the best would show if none were better than the others, simulated;
    None where a mean of 0 or 1 leaves nothing to chance."""
    bar: float | None
    any_passes: float | None
    """Share of simulations in which at least one passes, were all exactly at the bar."""


@dataclass(frozen=True, kw_only=True)
class LedgerReport:
    """What a ledger says."""

    entries: int
    since: datetime | None
    until: datetime | None
    per_year: float | None
    """Gates a year at this rate; None for less than a week."""
    words: Mapping[Word, int]
    judged_again: int
    """Verdicts on trials that had been judged by the same rules before: no tests of their own."""
    against_baselines: Alarms
    against_bars: Alarms
    rerolls: tuple[Reroll, ...]
    best_of_many: tuple[BestOfMany, ...]
    dropped: str | None = None


def ledger_report(entries: Sequence[LedgerEntry], *, dropped: str | None = None) -> LedgerReport:
    """Reckon up a ledger.

    A wrong word has at most the probability that its test was set to, so that some tests together
    give on average at most the sum of these of them, whether they are independent or not. And at
    least one is wrong with at most that probability.
    """
    tests = _tests(entries)
    times = sorted(entry.time for entry in entries)
    return LedgerReport(
        entries=len(entries),
        since=times[0] if times else None,
        until=times[-1] if times else None,
        per_year=_per_year(times),
        words=dict(Counter(entry.word for entry in entries)),
        judged_again=sum(entry.is_test for entry in entries) - len(tests),
        against_baselines=_alarms([each for each in tests if each.baseline is not None]),
        against_bars=_alarms([each for each in tests if each.bar is not None], of_bar=True),
        rerolls=_rerolls(tests),
        best_of_many=_best_of_many(tests),
        dropped=dropped,
    )


def _tests(entries: Sequence[LedgerEntry]) -> list[LedgerEntry]:
    """Return the last verdict of each test, in the order in which the tests were begun."""
    tests: dict[tuple[object, ...], LedgerEntry] = {}
    for entry in sorted(entries, key=lambda entry: entry.time):
        if entry.is_test:
            tests[entry.test] = entry
    return list(tests.values())


def _per_year(times: Sequence[datetime]) -> float | None:
    if len(times) < 2:
        return None
    days = (times[-1] - times[0]).total_seconds() / 86400.0
    return None if days < _SHORTEST else (len(times) - 1) / days * _DAYS


def _alphas(test: LedgerEntry, *, of_bar: bool) -> tuple[float, float]:
    """Return with which probability a test convicts and passes wrongly, at most."""
    if not of_bar:
        assert test.baseline is not None, "only tests against a baseline are asked"
        return test.baseline.alpha_regr, test.baseline.alpha_pass
    if test.bar is None:
        return 0.0, 0.0
    alpha = 1.0 - test.confidence
    critical = any(scene.alone for scene in test.seen)
    return (2.0 if critical else 1.0) * alpha, alpha


def _alarms(tests: Sequence[LedgerEntry], *, of_bar: bool = False) -> Alarms:
    alphas = [_alphas(test, of_bar=of_bar) for test in tests]
    return Alarms(
        tests=len(tests),
        regressed=sum(regressed for regressed, _ in alphas),
        passed=sum(passed for _, passed in alphas),
    )


def _rerolls(tests: Sequence[LedgerEntry]) -> tuple[Reroll, ...]:
    def who(test: LedgerEntry) -> tuple[str, str]:
        return test.suite, test.candidate_digest

    found: list[Reroll] = []
    for (suite, digest), group in groupby(sorted(tests, key=who), key=who):
        again = list(group)
        if len(again) > 1:
            chances = [_either(test) for test in again]
            found.append(
                Reroll(
                    candidate=again[-1].candidate,
                    digest=digest,
                    suite=suite,
                    tests=len(again),
                    words=tuple(test.word for test in again),
                    false_regressed=min(1.0, sum(regressed for regressed, _ in chances)),
                    false_passed=min(1.0, sum(passed for _, passed in chances)),
                )
            )
    return tuple(found)


def _either(test: LedgerEntry) -> tuple[float, float]:
    """Return with which probability a test convicts and passes wrongly, by bar or baseline.

    Either of them convicts; both must pass, so that no wrong PASS is likelier than by one of them.
    """
    bar = _alphas(test, of_bar=True)
    if test.baseline is None:
        return bar
    baseline = _alphas(test, of_bar=False)
    passed = baseline[1] if test.bar is None else max(bar[1], baseline[1])
    return bar[0] + baseline[0], passed


def _best_of_many(tests: Sequence[LedgerEntry]) -> tuple[BestOfMany, ...]:
    def panel(test: LedgerEntry) -> tuple[str, str, str]:
        return test.suite, test.suite_digest, test.panel

    found: list[BestOfMany] = []
    for _, group in groupby(sorted(tests, key=panel), key=panel):
        latest = {test.candidate_digest: test for test in group if test.seen}
        if len(latest) > 1:
            found.append(_best(list(latest.values())))
    return tuple(found)


def _best(tests: Sequence[LedgerEntry]) -> BestOfMany:
    """Return the best of some candidates, each with its last verdict on one panel."""
    best = max(tests, key=lambda test: (test.success or 0.0, test.candidate_digest))
    mean = fmean(test.success or 0.0 for test in tests)
    simulated = [test.scenes for test in tests[-_MOST_CANDIDATES:]]
    bar, passes = best.bar, None
    if bar is not None:
        luck = luck_of_the_best(simulated, bar, bar=bar, confidence=best.confidence)
        passes = luck.any_passes
    return BestOfMany(
        suite=best.suite,
        suite_digest=best.suite_digest,
        panel=best.panel,
        candidates=len(tests),
        best=best.candidate,
        digest=best.candidate_digest,
        shown=best.success or 0.0,
        mean=mean,
        overstated=luck_of_the_best(simulated, mean).overstated if 0.0 < mean < 1.0 else None,
        bar=bar,
        any_passes=passes,
    )
