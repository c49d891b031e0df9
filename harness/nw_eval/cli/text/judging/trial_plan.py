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
    size = f"{plural(rules.rounds, 'round')} of {plural(outset.scenes, 'trial')}"
    lines = [
        f"suite     {planned.suite}: at most {size}",
        f"from      {planned.source}: success {outset.baseline:.3f}, {_bank(outset)}",
        f"margins   {drops}; wrong PASS {wrong_pass}, wrong REGRESSED {wrong_regressed} at most",
        f"detect    {_detection(planned)}",
        f"equal     {_rounds(planned, planned.equal.passed, 'an equal policy is passed')}",
        "",
        *_curve(planned),
        "",
        "Simulated, 1,000 gates at each drop: the standard error of a share is at most 1.6 %.",
        "Between tolerate and max_drop either verdict is legitimate.",
    ]
    return "\n".join(lines)


def _bank(outset: Outset) -> str:
    from nw_eval.gate.baseline.comparison import TIMES

    starts = f"{outset.starts} starts in each scene"
    if not outset.known:
        return f"as a bank of {starts} would have it"
    enough = TIMES * outset.rules.rounds
    return starts if outset.starts >= enough else f"{starts} (to speak of fresh ones: {enough})"


def _detection(planned: TrialPlan) -> str:
    found = _rounds(
        planned, planned.dropped.regressed, f"a drop of {planned.detect:g} is convicted"
    )
    margins = planned.outset.rules.margins
    rare = planned.dropped.regressed[-1] < _CHANCES[-1]
    if rare and margins.tolerate < planned.detect < margins.max_drop:
        return f"{found}: it is below max_drop, and may pass"
    return found


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
    return f"{plural(rounds, 'round')} ({plural(trials, 'trial')}, {_minutes(planned, trials)})"


def _minutes(planned: TrialPlan, trials: int) -> str:
    return f"{planned.minutes(trials):.1f} minutes"


def _curve(planned: TrialPlan) -> list[str]:
    rows = [("drop", "REGRESSED", "PASS", "open", "trials", "minutes")]
    for point in planned.curve:
        trials = point.rounds * planned.outset.scenes
        shares = (f"{100 * x:.0f} %" for x in (point.regressed, point.passed, point.undecided))
        regressed, passed, undecided = shares
        minutes = f"{planned.minutes(trials):.1f}"
        rows.append((f"{point.drop:.2f}", regressed, passed, undecided, f"{trials:.0f}", minutes))
    return aligned(rows, right=range(6))
