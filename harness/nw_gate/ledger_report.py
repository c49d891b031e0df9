"""What a ledger's verdicts are worth together: false alarms, re-rolls, and the best of many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from statistics import fmean

from nw_base.words import PanelKind
from nw_gate.ledger import LedgerEntry
from nw_gate.stats.baseline.trials import most_false_alarms
from nw_gate.stats.power import luck_of_the_best
from nw_gate.verdict import Word

_DAYS = 365.25
_SHORTEST = 7.0  # days from which a year is foretold
_MOST_CANDIDATES = 200  # of a seed set that are simulated: more say no more


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
    """Of the files of its first verdict."""
    exports: int
    """Pairs of a checkpoint and a card by which it was given: of one network, as its digest or the
    same trajectories show."""
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
    """Candidates that met the same seed set, of which the best may be chosen."""

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
    head: str = ""
    """The sum of its last line; empty for an empty one."""


def ledger_report(
    entries: Sequence[LedgerEntry], *, dropped: str | None = None, head: str = ""
) -> LedgerReport:
    """Summarise a ledger.

    A wrong word has at most the probability that its test was set to, so that some tests together
    give on average at most the sum of these of them, whether they are independent or not. And at
    least one is wrong with at most that probability.

    Args:
        entries: verdicts, in any order.
        dropped: a sentence about a torn last line.
        head: the sum of the last line.
    """
    whose = _candidates(entries)
    tests = _tests(entries, whose)
    times = sorted(entry.time for entry in entries)
    return LedgerReport(
        entries=len(entries),
        since=times[0] if times else None,
        until=times[-1] if times else None,
        per_year=_per_year(times),
        words=dict(Counter(entry.word for entry in entries)),
        judged_again=sum(entry.is_test for entry in entries) - len(tests),
        against_baselines=_alarms([each for each in tests if each.baseline is not None]),
        against_bars=_alarms([each for each in tests if _has_bar(each)], of_bar=True),
        rerolls=_rerolls(tests, whose),
        best_of_many=_best_of_many(tests, whose),
        dropped=dropped,
        head=head,
    )


def _candidates(entries: Sequence[LedgerEntry]) -> dict[str, str]:
    """Return for each pair of checkpoint and card the first one that is the same candidate.

    Those are that compute the same. So are those that met at least one start together and went the
    same way from every start that they share, bit for bit: nothing that was judged tells them
    apart.
    """
    same: dict[str, str] = {}
    drawn: dict[str, str] = {}
    for entry in sorted(entries, key=lambda entry: entry.time):
        digest = entry.candidate_digest
        if digest not in same:
            same[digest] = drawn.get(entry.computes, digest) if entry.computes else digest
        if entry.computes:
            drawn.setdefault(entry.computes, same[digest])
    went: dict[str, dict[str, set[str]]] = {}
    for entry in entries:
        ways = went.setdefault(same[entry.candidate_digest], {})
        for start, way in entry.trajectories.items():
            ways.setdefault(start, set()).add(way)
    first = dict.fromkeys(same.values())
    joined: dict[str, str] = {}
    met: dict[tuple[str, str], list[str]] = {}
    for digest in first:
        ways = went[digest]
        places = [(start, way) for start, all_of in ways.items() for way in sorted(all_of)]
        known = dict.fromkeys(other for place in places for other in met.get(place, ()))
        alike = (
            joined[other]
            for other in known
            if all(ways[start] & went[other][start] for start in ways.keys() & went[other].keys())
        )
        joined[digest] = next(alike, digest)
        for place in places:
            met.setdefault(place, []).append(digest)
    return {digest: joined[one] for digest, one in same.items()}


def _tests(entries: Sequence[LedgerEntry], whose: Mapping[str, str]) -> list[LedgerEntry]:
    """Return the last verdict of each test, in the order in which the tests were begun."""
    tests: dict[tuple[object, ...], LedgerEntry] = {}
    for entry in sorted(entries, key=lambda entry: entry.time):
        if entry.is_test:
            tests[whose[entry.candidate_digest], entry.test] = entry
    return list(tests.values())


def _per_year(times: Sequence[datetime]) -> float | None:
    if len(times) < 2:
        return None
    days = (times[-1] - times[0]).total_seconds() / 86400.0
    return None if days < _SHORTEST else (len(times) - 1) / days * _DAYS


def _has_bar(test: LedgerEntry) -> bool:
    """Whether success or a score was held against a bar."""
    return any(bar is not None for bar in (test.bar, *(each[0] for each in test.scores.values())))


def _alphas(test: LedgerEntry, *, bar: bool, baseline: bool) -> tuple[float, float]:
    """Return with which probability a test flags and passes wrongly, by bar, baseline or either.

    Either of them flags, and so do critical scenes alone. Both must pass, so that no wrong PASS
    is likelier than by the one of them that it slips through.
    """
    by_bar = 1.0 - test.confidence if bar and _has_bar(test) else None
    against = test.baseline if baseline else None
    alone = sum(scene.alone for scene in test.seen)
    critical, scenes = alone, len(test.seen)
    if against is not None and against.scenes:
        critical, scenes = against.critical, against.scenes
    regressed = most_false_alarms(
        bar=by_bar,
        bar_critical=alone > 0,
        # What an entry has is the share of success; each gated score and limit has one like it.
        baseline=None
        if against is None
        else against.alpha_regr * (1 + len(test.scores) + len(test.limits)),
        critical=min(critical, scenes),
        scenes=scenes,
    )
    return regressed, max(by_bar or 0.0, 0.0 if against is None else against.alpha_pass)


def _alarms(tests: Sequence[LedgerEntry], *, of_bar: bool = False) -> Alarms:
    alphas = [_alphas(test, bar=of_bar, baseline=not of_bar) for test in tests]
    return Alarms(
        tests=len(tests),
        regressed=sum(regressed for regressed, _ in alphas),
        passed=sum(passed for _, passed in alphas),
    )


def _rerolls(tests: Sequence[LedgerEntry], whose: Mapping[str, str]) -> tuple[Reroll, ...]:
    def who(test: LedgerEntry) -> tuple[str, str]:
        return test.suite, whose[test.candidate_digest]

    rerolls: list[Reroll] = []
    for (suite, digest), group in groupby(sorted(tests, key=who), key=who):
        entries = list(group)
        if len(entries) > 1:
            chances = [_alphas(test, bar=True, baseline=True) for test in entries]
            rerolls.append(
                Reroll(
                    candidate=entries[-1].candidate,
                    digest=digest,
                    exports=len({test.candidate_digest for test in entries}),
                    suite=suite,
                    tests=len(entries),
                    words=tuple(test.word for test in entries),
                    false_regressed=min(1.0, sum(regressed for regressed, _ in chances)),
                    false_passed=min(1.0, sum(passed for _, passed in chances)),
                )
            )
    return tuple(rerolls)


def _best_of_many(tests: Sequence[LedgerEntry], whose: Mapping[str, str]) -> tuple[BestOfMany, ...]:
    def panel(test: LedgerEntry) -> tuple[str, str, str]:
        return test.suite, test.suite_digest, test.panel

    best: list[BestOfMany] = []
    for _, group in groupby(sorted(tests, key=panel), key=panel):
        latest = {whose[test.candidate_digest]: test for test in group if test.seen}
        if len(latest) > 1:
            best.append(_best(list(latest.values())))
    return tuple(best)


def _best(tests: Sequence[LedgerEntry]) -> BestOfMany:
    """Return the best of some candidates, each with its last verdict on one seed set."""
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
