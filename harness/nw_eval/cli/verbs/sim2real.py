"""`nw-eval sim2real`: does the simulator rank policies as the robot does?"""

from __future__ import annotations

from math import isinf
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_gate.stats.agreement import Agreement, AgreementFigure, Gap
    from nw_gate.stats.interval import Interval


@verb_of("sim2real")
class SimToReal(Printed, Verb):
    """Compare simulated results with real-robot results.

    Prints the gap of each policy, and how well simulator and robot agree on the ranking (Pearson,
    Spearman, MMRV). Beside it stands what a perfect simulator would show in as many trials.
    """

    real: Path

    def show(self, result: Agreement) -> str:
        return agreement_text(result)


_WIDTH = 100
_TITLES = {"pearson": "Pearson's r", "spearman": "Spearman's rho", "mmrv": "MMRV"}
_NOTE = (
    "Intervals are for the mean over sets of as many such policies (jackknife over policies). A "
    "perfect simulator has the robot's own {what} for every policy; the last columns show its "
    "values in as many trials. A value no worse than its worst 5 % does not show a fault. MMRV, "
    "the mean maximum rank violation, is best at 0."
)


def agreement_text(found: Agreement) -> str:
    """Return a line for each policy and figure, and what cannot be said."""
    percent = f"{100 * found.confidence:.4g} %"
    rows = [_gap_row(found, each) for each in found.gaps]
    right = (len(rows[0]) - 2,)
    gap_lines = aligned([(*_titles(found), f"{percent} each alone"), *rows], right=right)
    what = "limit" if found.score == "limit" else "success"
    if not found.figures:
        return "\n".join([*gap_lines, "", *found.remarks])
    figures = aligned(
        [
            ("agreement", "value", f"{percent} interval", "perfect: mean", "worst 5 %"),
            *(_line(each) for each in found.figures),
        ],
        right=(1, 3, 4),
    )
    return "\n".join(
        [*gap_lines, "", *figures, "", *found.remarks, fill(_NOTE.format(what=what), _WIDTH)]
    )


def _line(each: AgreementFigure) -> tuple[str, ...]:
    return (
        _TITLES[each.name],
        f"{each.value:.3f}",
        _span(each.interval),
        f"{each.perfect.mean:.3f}",
        f"{each.perfect.worst:.3f}",
    )


def _titles(found: Agreement) -> tuple[str, ...]:
    """Return the titles of what `_gap_row` has before the interval."""
    if found.score == "limit":
        return "policy", "ladder", "limit: simulator less robot"
    if found.score == "success":
        return "policy", "simulator less robot"
    unit = f", {found.unit}" if found.unit else ""
    return "policy", f"{found.score}{unit}: simulator less robot"


def _gap_row(found: Agreement, each: Gap) -> tuple[str, ...]:
    policy = clean(each.policy, at_most=80)
    if found.score == "success":
        return policy, f"{each.value:+.3f}", _span(each.interval, "+")
    if found.score == "limit":
        ladder, unit = clean(each.ladder, at_most=80), f" {each.unit}".rstrip()
        return policy, ladder, f"{each.value:+.3g}{unit}", _open_span(each.interval)
    return policy, f"{each.value:+.4g}", f"{each.interval.low:+.4g} to {each.interval.high:+.4g}"


def _open_span(interval: Interval) -> str:
    """Return a range of which an end may be unknown."""
    if isinf(interval.low) and isinf(interval.high):
        return "unknown"
    if isinf(interval.low):
        return f"at most {interval.high:+.3g}"
    if isinf(interval.high):
        return f"at least {interval.low:+.3g}"
    return f"{interval.low:+.3g} to {interval.high:+.3g}"


def _span(interval: Interval, sign: str = "") -> str:
    return f"{interval.low:{sign}.2f} to {interval.high:{sign}.2f}"
