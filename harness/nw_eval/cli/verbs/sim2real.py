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
    "perfect simulator has the robot's own success for every policy; the last columns show its "
    "values in as many trials. A value no worse than its worst 5 % does not show a fault. MMRV, "
    "the mean maximum rank violation, is best at 0."
)


def agreement_text(agreement: Agreement) -> str:
    """Return a line for each policy and figure, and what cannot be said."""
    percent = f"{100 * agreement.confidence:.4g} %"
    gaps = [
        (clean(each.policy, at_most=80), f"{each.value:+.4g}", _gap_span(each.interval))
        if agreement.score != "success"
        else (clean(each.policy, at_most=80), f"{each.value:+.3f}", _span(each.interval, "+"))
        for each in agreement.gaps
    ]
    gap_lines = aligned(
        [("policy", _gap_title(agreement), f"{percent} each alone"), *gaps], right=(1,)
    )
    if not agreement.figures:
        return "\n".join([*gap_lines, "", *agreement.remarks])
    figures = aligned(
        [
            ("agreement", "value", f"{percent} interval", "perfect: mean", "worst 5 %"),
            *(_line(each) for each in agreement.figures),
        ],
        right=(1, 3, 4),
    )
    return "\n".join([*gap_lines, "", *figures, "", *agreement.remarks, fill(_NOTE, _WIDTH)])


def _line(each: AgreementFigure) -> tuple[str, ...]:
    return (
        _TITLES[each.name],
        f"{each.value:.3f}",
        _span(each.interval),
        f"{each.perfect.mean:.3f}",
        f"{each.perfect.worst:.3f}",
    )


def _gap_title(agreement: Agreement) -> str:
    if agreement.score == "success":
        return "simulator less robot"
    unit = f", {agreement.unit}" if agreement.unit else ""
    return f"{agreement.score}{unit}: simulator less robot"


def _gap_span(interval: Interval) -> str:
    return f"{interval.low:+.4g} to {interval.high:+.4g}"


def _span(interval: Interval, sign: str = "") -> str:
    return f"{interval.low:{sign}.2f} to {interval.high:{sign}.2f}"
