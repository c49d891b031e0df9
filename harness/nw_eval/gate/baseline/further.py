"""What is simulated for a report: other policies at this gate, and this one after more rounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.gate.baseline.comparison import TIMES, Comparison
from nw_eval.gate.baseline.draw import draw_starts
from nw_eval.gate.baseline.finding import Finding
from nw_eval.gate.baseline.foresee import Outset, about_more_rounds, outset_of_bank
from nw_eval.gate.baseline.rounds import Floats, Rounds, scores_of
from nw_eval.results.bank import Panel, Stratum
from nw_eval.results.provenance import RunInfo
from nw_eval.stats.bank import Bank, CurvePoint, progress_after
from nw_eval.suite.model import Gate


@dataclass(frozen=True, kw_only=True)
class Foresight:
    """What was simulated."""

    curve: tuple[CurvePoint, CurvePoint, CurvePoint]
    """How this gate ends for an equal policy, and for ones worse by half of max_drop and by it."""
    more: str | None
    """About how many more rounds would settle it; None where it is settled."""


def foresight(
    found: Comparison, finding: Finding, rounds: Rounds, panel: Panel, run: RunInfo, gate: Gate
) -> Foresight:
    """Simulate what a comparison leaves open.

    Args:
        found: the comparison, of rounds that were judged.
        finding: what it rests on.
        rounds: those that it rests on.
        panel: of the baseline, in the scenes of the run.
        run: the candidate's.
        gate: margins, errors and tiers.
    """
    outset = outset_of_bank(panel, gate.model_copy(update={"rounds": found.budget}))
    is_open = found.word == "INCONCLUSIVE" and bool(found.rounds)
    return Foresight(
        curve=outset.foresee(),
        more=_more(found, finding, rounds, panel, run, outset) if is_open else None,
    )


def _more(
    found: Comparison,
    finding: Finding,
    rounds: Rounds,
    panel: Panel,
    run: RunInfo,
    outset: Outset,
) -> str:
    judged = list(finding.evidence)
    bank = Bank.of(np.array([scores_of(panel, stratum) for stratum in judged]))
    # With more rounds than this a claim of fresh starts would not hold.
    most = found.starts if found.claim == "panel" else found.starts // TIMES
    if found.claim != "panel":
        bank = bank.fresh()
    if found.basis == "fresh":
        known = np.broadcast_to(bank.means, (max(most, rounds.count), len(judged)))
    else:
        known = _drawn(judged, rounds, panel, run)[: max(most, rounds.count)]
    progress = progress_after(
        bank,
        rounds.scores(judged),
        known,
        outset.rules,
        waypoints=[len(course.counts) - 1 for course in outset.seen],
        named=tuple(judged.index(stratum) for stratum in finding.named),
    )
    return f"{about_more_rounds(progress, len(judged))}; --resume with more --trials runs them"


def _drawn(judged: Sequence[Stratum], rounds: Rounds, panel: Panel, run: RunInfo) -> Floats:
    """Return b of all starts: of the rounds so far, then in the order of those to come, (M, S)."""
    starts = min(len(panel.by_stratum[stratum]) for stratum in judged)
    order = draw_starts(judged, starts, candidate=run.drawn_by, suite_digest=run.suite_digest)
    columns: list[Floats] = []
    for stratum in judged:
        met = rounds.starts[stratum]
        ahead = [start for start in order[stratum] if start not in met]
        columns.append(scores_of(panel, stratum)[np.array([*met, *ahead], dtype=np.intp)])
    return np.array(columns).T
