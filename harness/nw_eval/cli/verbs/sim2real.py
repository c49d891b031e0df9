"""`nw-eval sim2real`: does the simulator rank policies as the robot does?"""

from __future__ import annotations

from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_eval.cli.terminal.lines import aligned
from nw_eval.cli.verbs.printed import Printed
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_gate.stats.agreement import Agreement, AgreementFigure
    from nw_gate.stats.interval import Interval


@verb_of("sim2real")
class SimToReal(Printed, Verb):
    """Compare simulated results with real-robot results, and with a perfect simulator."""

    real: Path

    def show(self, found: Agreement) -> str:
        return agreement_text(found)


_WIDTH = 100
_TITLES = {"pearson": "Pearson's r", "spearman": "Spearman's rho", "mmrv": "MMRV"}
_NOTE = (
    "Intervals: of what sets of as many such policies show in the mean (jackknife over policies). "
    "A perfect simulator has the robot's own success for every policy, and shows this in as many "
    "trials: no worse than its worst 5 % is no sign of a fault. MMRV, the mean maximum rank "
    "violation, is best at 0."
)


def agreement_text(found: Agreement) -> str:
    """Return a line for each policy and figure, and what cannot be said."""
    percent = f"{100 * found.confidence:.4g} %"
    gaps = [
        (clean(each.policy, at_most=80), f"{each.value:+.4g}", _gap_span(each.interval))
        if found.score != "success"
        else (clean(each.policy, at_most=80), f"{each.value:+.3f}", _span(each.interval, "+"))
        for each in found.gaps
    ]
    gap_lines = aligned([("policy", _gap_title(found), f"{percent} each alone"), *gaps], right=(1,))
    if not found.figures:
        return "\n".join([*gap_lines, "", *found.remarks])
    figures = aligned(
        [
            ("agreement", "value", f"{percent} interval", "perfect: mean", "worst 5 %"),
            *(_line(each) for each in found.figures),
        ],
        right=(1, 3, 4),
    )
    return "\n".join([*gap_lines, "", *figures, "", *found.remarks, fill(_NOTE, _WIDTH)])


def _line(each: AgreementFigure) -> tuple[str, ...]:
    return (
        _TITLES[each.name],
        f"{each.value:.3f}",
        _span(each.interval),
        f"{each.perfect.mean:.3f}",
        f"{each.perfect.worst:.3f}",
    )


def _gap_title(found: Agreement) -> str:
    if found.score == "success":
        return "simulator less robot"
    unit = f", {found.unit}" if found.unit else ""
    return f"{found.score}{unit}: simulator less robot"


def _gap_span(interval: Interval) -> str:
    return f"{interval.low:+.4g} to {interval.high:+.4g}"


def _span(interval: Interval, sign: str = "") -> str:
    return f"{interval.low:{sign}.2f} to {interval.high:{sign}.2f}"
