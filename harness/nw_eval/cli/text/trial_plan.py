"""How many trials a gate takes and what it sees, as lines of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.cli.text.table import aligned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.api import TrialPlan

_CHANCES = (0.8, 0.9)


def trial_plan_page(planned: TrialPlan) -> str:
    """Return a plan of trials as lines of text: how many, how long, and the curve."""
    outset = planned.outset
    rules, margins = outset.rules, outset.rules.margins
    bank = "of" if outset.known else "if it is the baseline's, and a bank of it has"
    errors = f"{100 * rules.alpha_pass:.4g} %, a wrong REGRESSED {100 * rules.alpha_regr:.4g} %"
    lines = [
        f"suite     {planned.suite}: at most {rules.rounds} rounds of {outset.scenes} trials",
        f"from      {planned.source}: success {outset.baseline:.3f} {bank} {outset.starts} starts "
        "in each scene",
        f"margins   max_drop {margins.max_drop:g}, tolerate {margins.tolerate:g}; a wrong PASS at "
        f"most {errors}",
        f"detect    {_detection(planned)}",
        f"equal     {_rounds(planned, planned.equal.passed, 'an equal policy is passed')}",
        "",
        *_curve(planned),
        "",
        "between tolerate and max_drop either verdict is legitimate; shares are simulated, "
        "1.6 % uncertain at most",
    ]
    return "\n".join(lines)


def _detection(planned: TrialPlan) -> str:
    return _rounds(planned, planned.dropped.regressed, f"a drop of {planned.detect:g} is convicted")


def _rounds(planned: TrialPlan, shares: Sequence[float], what: str) -> str:
    """Return after how many rounds something is so in 80 and in 90 %."""
    from nw_eval.stats.bank import rounds_for

    found = [(chance, rounds_for(shares, chance)) for chance in _CHANCES]
    parts = [
        f"in {100 * chance:.0f} % within {_trials(planned, rounds)}"
        for chance, rounds in found
        if rounds is not None
    ]
    if len(parts) < len(found):
        most = f"{100 * shares[-1]:.0f} %"
        parts.append(f"in no more than {most} however many of the starts are run")
    return f"{what} {', '.join(parts)}"


def _trials(planned: TrialPlan, rounds: int) -> str:
    trials = rounds * planned.outset.scenes
    panel = "" if 3 * rounds <= planned.outset.starts else ", of this panel only"
    return f"{rounds} rounds ({trials} trials, {planned.minutes(trials):.1f} minutes{panel})"


def _curve(planned: TrialPlan) -> list[str]:
    rows = [("drop", "REGRESSED", "PASS", "open", "trials", "minutes")]
    for point in planned.curve:
        trials = point.rounds * planned.outset.scenes
        shares = (f"{100 * x:.0f} %" for x in (point.regressed, point.passed, point.undecided))
        regressed, passed, undecided = shares
        minutes = f"{planned.minutes(trials):.1f}"
        rows.append((f"{point.drop:.2f}", regressed, passed, undecided, f"{trials:.0f}", minutes))
    return aligned(rows, right=range(6))
