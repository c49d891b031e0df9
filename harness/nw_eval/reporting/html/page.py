"""report.html: verdict and success first, then the evidence, in one file that needs no other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from shlex import quote

from nw_eval.gate.cause import Cause
from nw_eval.gate.verdict import Verdict
from nw_eval.reporting.certainty import how_sure
from nw_eval.reporting.headline import blind_spot, headline_parts
from nw_eval.reporting.html.budget import clips_that_fit, pictures_that_fit
from nw_eval.reporting.html.drawn.course import course
from nw_eval.reporting.html.drawn.gauge import gauges
from nw_eval.reporting.html.drawn.plan_view import plan_views
from nw_eval.reporting.html.environment import render
from nw_eval.reporting.html.evidence import NO_EVIDENCE, LogEvidence
from nw_eval.reporting.html.trials import trial_lines, worst_cards
from nw_eval.reporting.tables import named_tables
from nw_eval.reporting.tables.table import judged
from nw_eval.reporting.throughput import throughput
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.words import FAULTS, OUTCOMES


def render_html(
    run: RunInfo,
    rows: Sequence[Row],
    verdict: Verdict,
    folder: Path,
    evidence: LogEvidence = NO_EVIDENCE,
    cause: Cause | None = None,
) -> str:
    """Return the page; the same values give the same text.

    Args:
        run: the run's provenance.
        rows: one for each trial, in any order.
        verdict: what the gate says of them.
        folder: the run's folder as a reader would type it; replay commands start with it.
        evidence: what the logs of its trials show.
        cause: what its drop is due to, where that was asked.
    """
    rows = sorted(rows, key=attrgetter("trial_id"))
    clips, clips_left_out = clips_that_fit(evidence)
    pictures, pictures_left_out = pictures_that_fit(evidence)
    failing = course(rows, verdict)
    views = plan_views(rows, evidence, pictures)
    word, *parts = headline_parts(verdict, run, intervals=False)
    return render(
        "report.html.j2",
        run=run,
        suite=str(run.suite.get("name", "suite")),
        word=word,
        parts=parts,
        blind_spot=blind_spot(verdict, run),
        reasons=verdict.reasons,
        gauges=gauges(verdict),
        how_sure=how_sure(verdict, run),
        tables=named_tables(run, rows, verdict, cause),
        course=failing,
        # Where most was lost first, as in the table above them.
        views=[views[name] for name in dict.fromkeys((*failing.order, *views)) if name in views],
        outcomes=_outcomes(rows),
        worst=worst_cards(judged(rows, verdict), clips, run, folder),
        remarks=(*evidence.remarks, *clips_left_out, *pictures_left_out),
        spent=throughput(rows, run),
        trials=trial_lines(rows, run, folder),
        scenes=sorted({row.scene for row in rows}),
        view=f"nw-eval view {quote(str(folder))}",
    )


def _outcomes(rows: Sequence[Row]) -> dict[str, int]:
    """Return how many trials ended in each way that any did, results before errors."""
    counts = Counter(row.outcome for row in rows)
    return {name: counts[name] for name in (*OUTCOMES, *FAULTS) if counts[name]}
