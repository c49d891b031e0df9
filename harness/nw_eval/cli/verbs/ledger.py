"""`nw-eval ledger`: what many verdicts are worth together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.plural import plural
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_gate.ledger_report import Alarms, BestOfMany, LedgerReport, Reroll


@verb_of("read_ledger")
class Ledger(Printed, Verb):
    """Summarize a ledger of verdicts: gates per year, false alarms, repeated tests, best of many.

    A ledger is the file to which `run --ledger` and `gate --ledger` append their verdicts.
    """

    file: Path

    def show(self, result: LedgerReport) -> str:
        return ledger_page(result)


_LISTED = 10  # candidates, or seed sets, that have a line of their own


def ledger_page(report: LedgerReport) -> str:
    """Return what a ledger says: how many gates, how many wrong words, re-rolls, the best."""
    return "\n".join(_lines(report))


def _lines(report: LedgerReport) -> Iterator[str]:
    if report.dropped is not None:
        yield clean(report.dropped)
    if report.since is None or report.until is None:
        yield "no verdicts"
        return
    words = ", ".join(f"{count} {word}" for word, count in sorted(report.words.items()))
    yield f"{plural(report.entries, 'verdict')} ({words})"
    yield f"from {report.since:%Y-%m-%d} to {report.until:%Y-%m-%d}: {_rate(report)}"
    if report.judged_again:
        repeats = plural(report.judged_again, "verdict")
        yield f"{repeats} on trials that had been judged by the same rules before: no new test"
    yield from _wrong(report)
    yield from _again(report)
    yield from _best(report)
    if report.head:
        yield ""
        yield f"head {report.head}: kept elsewhere, --head shows later whether the end was cut off"


def _rate(report: LedgerReport) -> str:
    if report.per_year is None:
        return "too few days to estimate the gates of a year"
    return f"{report.per_year:.0f} gates a year at this rate"


def _wrong(report: LedgerReport) -> Iterator[str]:
    if (alarms := report.against_baselines).tests:
        yield ""
        yield f"{plural(alarms.tests, 'test')} against a baseline; on average at most"
        yield f"  {_flagged(alarms, report)} if no candidate is worse than is tolerated"
        yield f"  {_number(alarms.passed)} false PASS if every candidate is worse by max_drop"
    if (alarms := report.against_bars).tests:
        yield ""
        yield f"{plural(alarms.tests, 'test')} by a bar; on average at most"
        yield f"  {_flagged(alarms, report)} if every candidate is at the bar, or better"
        yield f"  {_number(alarms.passed)} false PASS if every candidate is at the bar, or worse"


def _flagged(alarms: Alarms, report: LedgerReport) -> str:
    words = f"{_number(alarms.regressed)} false REGRESSED"
    if report.per_year is None:
        return words
    return f"{words} ({_number(alarms.regressed / report.entries * report.per_year)} a year)"


def _again(report: LedgerReport) -> Iterator[str]:
    if not report.rerolls:
        return
    yield ""
    yield f"{plural(len(report.rerolls), 'candidate')} tested more than once, each as a new test:"
    worst = sorted(report.rerolls, key=lambda each: (-each.tests, each.digest))
    yield from (f"  {_reroll(each)}" for each in worst[:_LISTED])
    if len(worst) > _LISTED:
        yield f"  and {len(worst) - _LISTED} more"


def _reroll(each: Reroll) -> str:
    words = ", ".join(f"{count} {word}" for word, count in Counter(each.words).items())
    name = f"{clean(each.candidate, at_most=80)} ({each.digest[:8]}) on {clean(each.suite)}"
    if each.exports > 1:
        name += f", {each.exports} exports of one policy"
    return (
        f"{name}: {each.tests} tests ({words}); chance of at least one wrong word: REGRESSED at "
        f"most {_percent(each.false_regressed)}, PASS at most {_percent(each.false_passed)}"
    )


def _best(report: LedgerReport) -> Iterator[str]:
    if not report.best_of_many:
        return
    yield ""
    yield "the best of many on one seed set shows more than it is; simulated from what was seen:"
    largest = sorted(report.best_of_many, key=lambda each: (-each.candidates, each.suite_digest))
    for each in largest[:_LISTED]:
        yield f"  {_luck(each)}"
    if len(largest) > _LISTED:
        yield f"  and {len(largest) - _LISTED} more seed sets"


def _luck(each: BestOfMany) -> str:
    where = f"suite {clean(each.suite)}, {each.panel} seed set ({each.suite_digest[:8]})"
    # By its digest too: checkpoints of one card share the name.
    name = f"{clean(each.best, at_most=80)} ({each.digest[:8]})"
    best = f"the best, {name}, shows {each.shown:.3f}"
    words = f"{where}: of {each.candidates} candidates {best}, all of them {each.mean:.3f}"
    if each.overstated is not None:
        words += (
            f"; were none better than another, the best would show {each.overstated:.3f} too much"
        )
    if each.any_passes is not None:
        words += (
            f"; were all exactly at the bar {each.bar:g}, at least one would pass in "
            f"{_percent(each.any_passes)}"
        )
    return words + "; `--seed-set fresh` confirms the chosen one on new initial states"


def _number(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"
