"""report.html: the verdict and what failed first, all trials last, in one file without others.

The three worst trials are shown from outside beside what their policy saw, with what the
baseline's policy did from the same start.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from shlex import quote
from typing import NamedTuple

from nw_base.words import FAULTS, OUTCOMES
from nw_eval.reporting.headline import (
    blind_spot,
    flagged_by,
    headline_parts,
    how_sure,
    stopped_early,
)
from nw_eval.reporting.html.drawn import course, gauges, plan_views
from nw_eval.reporting.html.environment import render
from nw_eval.reporting.html.evidence import (
    NO_EVIDENCE,
    Clip,
    LogEvidence,
    clips_that_fit,
    pictures_that_fit,
)
from nw_eval.reporting.tables import NO_RIVALS, Rivals, named_tables
from nw_eval.reporting.tables.run import label_name, throughput
from nw_eval.reporting.tables.table import WORST, judged
from nw_eval.reporting.tables.trials import (
    how_ended,
    parting,
    replay_command,
    view_link,
    worst_trials,
)
from nw_gate.cause import Cause
from nw_gate.results.labels import links_of
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.verdict import Verdict


def render_html(
    run: RunInfo,
    rows: Sequence[Row],
    verdict: Verdict,
    folder: Path,
    evidence: LogEvidence = NO_EVIDENCE,
    cause: Cause | None = None,
    rivals: Rivals = NO_RIVALS,
) -> str:
    """Return the page; the same values give the same text.

    Args:
        run: the run's provenance.
        rows: one for each trial, in any order.
        verdict: what the gate says of them.
        folder: the run's folder as a reader would type it; replay commands start with it.
        evidence: what the logs of its trials show.
        cause: what its drop is due to, where that was asked.
        rivals: trials of the baseline's policy from the same starts, by the run's trials.
    """
    rows = sorted(rows, key=attrgetter("trial_id"))
    clips, clips_left_out = clips_that_fit(evidence)
    pictures, pictures_left_out = pictures_that_fit(evidence)
    failing = course(rows, verdict)
    views = plan_views(rows, evidence, pictures)
    of_views = [*([evidence.of_paths] if evidence.of_paths else []), *pictures_left_out]
    word, *parts = headline_parts(verdict, run)
    return render(
        "report.html.j2",
        run=run,
        suite=str(run.suite.get("name", "suite")),
        word=word,
        by=flagged_by(verdict),
        parts=parts,
        blind_spot=blind_spot(verdict, run),
        reasons=verdict.reasons,
        stopped=stopped_early(run),
        gauges=gauges(verdict),
        how_sure=how_sure(verdict, run),
        tables=named_tables(run, rows, verdict, cause),
        course=failing,
        # Where most was lost first, as in the table above them.
        views=[views[name] for name in dict.fromkeys((*failing.order, *views)) if name in views],
        outcomes=_outcomes(rows),
        worst=worst_cards(judged(rows, verdict), clips, run, folder, rivals),
        places={name: number for number, name in enumerate(views, 1)},
        links={label_name(key): url for key, url in links_of(run.labels).items()},
        remarks=(*evidence.remarks, *clips_left_out, *([] if views else of_views)),
        of_views=of_views,
        spent=throughput(rows, run),
        trials=trial_lines(listed_trials(rows), run, folder),
        trials_in_all=len(rows),
        reached="waypoints" if any(row.waypoints_total for row in rows) else "success",
        scenes=sorted({row.scene for row in rows}),
        view=f"nw-eval view {quote(str(folder))}",
    )


def _outcomes(rows: Sequence[Row]) -> dict[str, int]:
    """Return how many trials ended in each way that any did, results before errors."""
    counts = Counter(row.outcome for row in rows)
    return {name: counts[name] for name in (*OUTCOMES, *FAULTS) if counts[name]}


@dataclass(frozen=True, kw_only=True)
class WorstTrial:
    """A trial that went badly."""

    row: Row
    ended: str
    parting: str
    """Where it parts from the baseline's trial; empty without one."""
    clip: Clip | None
    command: str
    """That replays it; empty without a log."""
    link: str
    """To its last second; empty without a log."""


class TrialLine(NamedTuple):
    """A trial in the table of all of them, cell by cell."""

    trial: str
    scene: str
    setting: str
    """What was changed; empty where nothing was."""
    outcome: str
    reason: str
    success: str
    at: str
    wall: str
    command: str
    link: str


def worst_cards(
    rows: Sequence[Row],
    clips: Mapping[str, Clip],
    run: RunInfo,
    folder: Path,
    rivals: Rivals = NO_RIVALS,
) -> tuple[WorstTrial, ...]:
    """Return the trials that went worst, and the others of which there is a clip.

    Those with a clip come first, in the order of the clips, and then the worst does.
    """
    known = {row.trial_id: row for row in rows}
    named = [known[trial] for trial in clips if trial in known]
    named += [row for row in worst_trials(rows)[:WORST] if row.trial_id not in clips]
    return tuple(
        WorstTrial(
            row=row,
            ended=how_ended(row),
            parting=parting(row, rivals.get(row.trial_id)),
            clip=clips.get(row.trial_id),
            command=replay_command(row, folder),
            link=view_link(row, run.id),
        )
        for row in named
    )


MOST_LINES = 5000
"""Trials in the table of all of them: a browser needs a second for each 5,000 lines."""


def listed_trials(rows: Sequence[Row]) -> Sequence[Row]:
    """Return the trials that the table of all of them has, as many as it may: failures first.

    Args:
        rows: in the order of their names, in which those stay that did equally well.
    """
    return sorted(rows, key=lambda row: (row.completed, row.success or 0.0))[:MOST_LINES]


def trial_lines(rows: Sequence[Row], run: RunInfo, folder: Path) -> tuple[TrialLine, ...]:
    """Return every trial, in the order of `rows`."""
    return tuple(
        TrialLine(
            trial=row.trial_id,
            scene=row.scene,
            setting=", ".join([f"{axis} {value:g}" for axis, value in row.perturbation]),
            outcome=row.outcome,
            reason=row.end_reason,
            success="" if row.success is None else row.standing,
            at=f"{row.sim_s:.2f}",
            wall=f"{row.wall_s:.1f}",
            command=replay_command(row, folder),
            link=view_link(row, run.id),
        )
        for row in rows
    )
