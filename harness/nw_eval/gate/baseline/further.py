"""What is simulated for a report: other policies at this gate, and this one after more trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nw_eval.gate.baseline.comparison import Comparison
from nw_eval.gate.baseline.finding import bank_of, numbers_of
from nw_eval.gate.baseline.foresee import Outset, about_more_trials, outset_of_bank
from nw_eval.gate.baseline.met import Met
from nw_eval.results.bank import Panel, Stratum
from nw_eval.stats.bank import Against, CurvePoint, progress_from
from nw_eval.suite.model import Gate


@dataclass(frozen=True, kw_only=True)
class Foresight:
    """What was simulated."""

    curve: tuple[CurvePoint, CurvePoint, CurvePoint]
    """How this gate ends for an equal policy, and for ones worse by half of max_drop and by it."""
    more: str | None
    """About how many more trials would settle it; None where it is settled."""


def foresight(
    found: Comparison, met: Met, judged: Sequence[Stratum], panel: Panel, gate: Gate
) -> Foresight:
    """Simulate what a comparison leaves open.

    Args:
        found: the comparison.
        met: trials of the candidate, and those that may be run beyond the budget.
        judged: strata that count, in the order of the panel.
        panel: of the baseline, in the scenes of the run.
        gate: margins, errors and tiers.
    """
    against: Against = "control" if found.basis == "control" else found.claim
    outset = outset_of_bank(panel, gate, budget=found.budget, against=against)
    is_open = found.word == "INCONCLUSIVE" and found.trials > 0
    return Foresight(
        curve=outset.foresee(),
        more=_more(met, judged, panel, found, outset) if is_open else None,
    )


def _more(
    met: Met, judged: Sequence[Stratum], panel: Panel, found: Comparison, outset: Outset
) -> str:
    bank = bank_of(panel, judged, found.basis, found.claim)
    progress = progress_from(
        bank,
        numbers_of(met, judged, panel, found.basis, bank),
        outset.rules,
        known=met.ended(met.places(judged).tolist()),
        waypoints=[len(course.counts) - 1 for course in outset.seen],
    )
    return f"{about_more_trials(progress)}; --resume with more --trials runs them"
