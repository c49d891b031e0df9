"""What is simulated for a report: other policies at this gate, and this one after more trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nw_eval.gate.baseline.comparison import Comparison
from nw_eval.gate.baseline.finding import Finding
from nw_eval.gate.baseline.foresee import outset_of_bank
from nw_eval.gate.baseline.met import Met
from nw_eval.results.bank import Panel, Stratum
from nw_eval.stats.bank import CurvePoint
from nw_eval.suite.model import Gate


@dataclass(frozen=True, kw_only=True)
class Foresight:
    """What was simulated."""

    curve: tuple[CurvePoint, CurvePoint, CurvePoint]
    """How this gate ends for an equal policy, and for ones worse by half of max_drop and by it."""
    more: str | None
    """About how many more trials would settle it; None where it is settled."""


def foresight(
    found: Comparison,
    finding: Finding,
    met: Met,
    judged: Sequence[Stratum],
    panel: Panel,
    gate: Gate,
) -> Foresight:
    """Simulate what a comparison leaves open.

    Args:
        found: the comparison.
        finding: what it rests on.
        met: the trials that it rests on.
        judged: strata that count.
        panel: of the baseline, in the scenes of the run.
        gate: margins, errors and tiers.
    """
    outset = outset_of_bank(panel, gate)
    return Foresight(
        curve=outset.foresee(),
        more=None,
    )
