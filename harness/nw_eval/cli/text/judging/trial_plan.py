"""How many trials a gate takes and what it sees, as lines of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.cli.text.table import aligned
from nw_eval.plural import plural

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.api import BarPlan, TrialPlan
    from nw_eval.gate.baseline.foresee import Outset

_CHANCES = (0.8, 0.9)


def bar_plan_page(planned: BarPlan) -> str:
    """Return what a bar takes as lines of text: how many trials, and who passes."""
    least = plural(planned.needed, "trial")
    rows = [("success", *(plural(size, "trial") for size in planned.sizes))]
    rows += [
        (f"{truth:.3f}", *(f"{100 * share:.0f} %" for share in shares))
        for truth, shares in planned.curve
    ]
    sure = f"{100 * planned.confidence:.4g} % sure"
    size = f"{plural(planned.trials, 'trial')} in each of {plural(planned.scenes, 'scene')}"
    lines = [
        f"suite     {planned.suite}: {size}",
        f"bar       success of at least {planned.bar:g}, {sure}; no baseline",
        f"needed    {least} in each scene, if none of them fails (--trials {planned.needed})",
        *(f"no PASS   {reason}" for reason in planned.obstacles),
        "",
        "PASS by true success and trials in each scene:",
        *aligned(rows, right=range(len(rows[0]))),
        "",
        "Simulated, 2,000 runs each: the standard error of a share is at most 1.1 %.",
    ]
    return "\n".join(lines)


def trial_plan_page(planned: TrialPlan) -> str:
    """Return a plan of trials as lines of text: how many, how long, and the curve."""
    outset = planned.outset
    rules, margins = outset.rules, outset.rules.margins
    drops = f"max_drop {margins.max_drop:g}, tolerate {margins.tolerate:g}"
    wrong_pass, wrong_regressed = (f"{100 * x:.4g} %" for x in (rules.alpha_pass, rules.alpha_regr))
    lines = [
        f"suite     {planned.suite}: {outset.in_words}",
        f"from      {planned.source}: success {outset.baseline:.3f}, {_bank(outset)}",
        f"margins   {drops}; wrong PASS {wrong_pass}, wrong REGRESSED {wrong_regressed} at most",
        f"detect    {_detection(planned)}",
        f"equal     {_within(planned, planned.equal.passed, 'an equally good policy passes')}",
        "",
        *_curve(planned),
        "",
        "Simulated, 1,000 gates at each drop: the standard error of a share is at most 1.6 %.",
        "Between tolerate and max_drop either verdict is legitimate.",
    ]
    return "\n".join(lines)


def _bank(outset: Outset) -> str:
    starts = f"{outset.starts} starts in each scene"
    return starts if outset.known else f"as a baseline of {starts} would have it"


def _detection(planned: TrialPlan) -> str:
    found = _within(
        planned, planned.dropped.regressed, f"a policy {planned.detect:g} worse is REGRESSED"
    )
    margins = planned.outset.rules.margins
    rare = planned.dropped.regressed[-1] < _CHANCES[-1]
    if rare and margins.tolerate < planned.detect < margins.max_drop:
        return f"{found}: the drop is below max_drop, and may pass"
    return found


def _within(planned: TrialPlan, shares: Sequence[float], what: str) -> str:
    """Return after how many trials something is so in 80 and in 90 %."""
    from nw_eval.stats.bank import trials_for

    found = [(chance, trials_for(shares, chance)) for chance in _CHANCES]
    parts = [
        f"in {100 * chance:.0f} % within {_trials(planned, trials)}"
        for chance, trials in found
        if trials is not None
    ]
    if len(parts) < len(found):
        most = f"{100 * shares[-1]:.0f} %"
        parts.append(f"in no more than {most} however many of the starts are run")
    return f"{what} {', '.join(parts)}"


def _trials(planned: TrialPlan, trials: int) -> str:
    return f"{plural(trials, 'trial')} ({planned.minutes(trials):.1f} minutes)"


def _curve(planned: TrialPlan) -> list[str]:
    rows = [("drop", "REGRESSED", "PASS", "undecided", "trials", "minutes")]
    for point in planned.curve:
        shares = (f"{100 * x:.0f} %" for x in (point.regressed, point.passed, point.undecided))
        regressed, passed, undecided = shares
        minutes = f"{planned.minutes(point.trials):.1f}"
        rows.append(
            (f"{point.drop:.2f}", regressed, passed, undecided, f"{point.trials:.0f}", minutes)
        )
    return aligned(rows, right=range(6))
