"""report.html: the verdict and what failed first, all trials last, in one file without others.

The three worst trials are shown from outside, beside the baseline's policy from the same initial
state. Every trial with a log opens in the page itself: its chart over time, where it walked, and
the command that replays it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
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
    next_step,
    stopped_early,
)
from nw_eval.reporting.html.drawn import Timeline, course, gauges, plan_views, timeline
from nw_eval.reporting.html.environment import render
from nw_eval.reporting.html.evidence import (
    NO_EVIDENCE,
    Clip,
    LogEvidence,
    clips_that_fit,
    pictures_that_fit,
)
from nw_eval.reporting.html.limits import DrawnLadder, LadderLimit, drawn_ladders
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
    listed = listed_trials(rows)
    charts = _charts(listed, evidence, rivals)
    worst = worst_cards(judged(rows, verdict), clips, run, folder, rivals, charts)
    sheets = trial_sheets(listed, worst, run, folder, rivals, charts)
    opened = {each.row.trial_id for each in (*worst, *sheets)}
    return render(
        "report.html.j2",
        run=run,
        suite=str(run.suite.get("name", "suite")),
        policy=run.policy.folder_name,
        digest=run.policy.short_digest,
        word=word,
        by=flagged_by(verdict),
        parts=parts,
        next_step=next_step(verdict, run),
        blind_spot=blind_spot(verdict, run),
        reasons=verdict.reasons,
        stopped=stopped_early(run),
        gauges=gauges(verdict),
        how_sure=how_sure(verdict, run),
        tables=named_tables(run, rows, verdict, cause),
        ladders=_ladders(verdict),
        course=failing,
        # Where most was lost first, as in the table above them.
        views=[views[name] for name in dict.fromkeys((*failing.order, *views)) if name in views],
        views_by_scene=views,
        paths={
            path.trial_id: number
            for number, path in enumerate(path for view in views.values() for path in view.paths)
        },
        outcomes=_outcomes(rows),
        worst=worst,
        sheets=sheets,
        places={name: number for number, name in enumerate(views, 1)},
        links={label_name(key): url for key, url in links_of(run.labels).items()},
        remarks=(*evidence.remarks, *clips_left_out, *([] if views else of_views)),
        of_views=of_views,
        spent=throughput(rows, run),
        trials=trial_lines(listed, run, folder, opened),
        trials_in_all=len(rows),
        reached="waypoints" if any(row.waypoints_total for row in rows) else "success",
        scenes=sorted({row.scene for row in rows}),
        view=f"nw-eval view {quote(str(folder))}",
    )


def _ladders(verdict: Verdict) -> list[DrawnLadder]:
    """Return the ladders that were climbed, the candidate's limit above the baseline's."""
    return drawn_ladders(
        [
            LadderLimit(policy=policy, ladder=item.ladder, title=item.title, limit=limit)
            for item in verdict.limits
            for policy, limit in (("candidate", item.candidate), ("baseline", item.baseline))
            if item.candidate is not None and limit is not None
        ]
    )


def _outcomes(rows: Sequence[Row]) -> dict[str, int]:
    """Return how many trials ended in each way that any did, results before errors."""
    counts = Counter(row.outcome for row in rows)
    return {name: counts[name] for name in (*OUTCOMES, *FAULTS) if counts[name]}


MOST_CHARTS = 320
"""Trials that open in the page: each has 3 kB, and logs of more are not read."""
NO_CHARTS: Mapping[str, Timeline] = {}
"""Where no log was read."""


@dataclass(frozen=True, kw_only=True)
class OpenedTrial:
    """A trial as the page shows it by itself: a card of the worst, or a sheet."""

    row: Row
    ended: str
    parting: str
    """Where it parts from the baseline's trial; empty without one."""
    clip: Clip | None
    command: str
    """That replays it; empty without a log."""
    link: str
    """To its last second; empty without a log."""
    chart: Timeline | None
    scores: tuple[str, ...]
    """Each with its value."""

    @property
    def anchor(self) -> str:
        """What a link within the page, or from a comment, calls it."""
        return anchor(self.row.trial_id)


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
    anchor: str
    """Of its sheet or card; empty if it has neither."""


def anchor(trial: str) -> str:
    """Return the name of a trial's sheet in a page's address: `report.html#trial-NAME`."""
    return "trial-" + "".join(each if each in _PLAIN else f".{ord(each):x}." for each in trial)


_PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-~=+")


def _charts(rows: Sequence[Row], evidence: LogEvidence, rivals: Rivals) -> dict[str, Timeline]:
    """Return the charts of trials whose paths are known, the first of `rows`, by trial."""
    paths = {path.trial_id: path for path in evidence.paths}
    known = [row for row in rows if row.trial_id in paths][:MOST_CHARTS]
    charts = {
        row.trial_id: timeline(row, paths[row.trial_id], rivals.get(row.trial_id)) for row in known
    }
    return {trial: chart for trial, chart in charts.items() if chart is not None}


def _scores(row: Row) -> tuple[str, ...]:
    return tuple(f"{name} {value:.4g}" for name, value in sorted(dict(row.scores).items()))


def worst_cards(
    rows: Sequence[Row],
    clips: Mapping[str, Clip],
    run: RunInfo,
    folder: Path,
    rivals: Rivals = NO_RIVALS,
    charts: Mapping[str, Timeline] = NO_CHARTS,
) -> tuple[OpenedTrial, ...]:
    """Return the trials that went worst, and the others of which there is a clip.

    Those with a clip come first, in the order of the clips, and then the worst does.
    """
    known = {row.trial_id: row for row in rows}
    named = [known[trial] for trial in clips if trial in known]
    named += [row for row in worst_trials(rows)[:WORST] if row.trial_id not in clips]
    return tuple(
        _opened(row, clips.get(row.trial_id), run, folder, rivals, charts) for row in named
    )


def trial_sheets(
    rows: Sequence[Row],
    worst: Sequence[OpenedTrial],
    run: RunInfo,
    folder: Path,
    rivals: Rivals = NO_RIVALS,
    charts: Mapping[str, Timeline] = NO_CHARTS,
) -> tuple[OpenedTrial, ...]:
    """Return the trials that open in the page besides those with a card, in the order of `rows`."""
    carded = {each.row.trial_id for each in worst}
    return tuple(
        _opened(row, None, run, folder, rivals, charts)
        for row in rows
        if row.trial_id in charts and row.trial_id not in carded
    )


def _opened(
    row: Row,
    clip: Clip | None,
    run: RunInfo,
    folder: Path,
    rivals: Rivals,
    charts: Mapping[str, Timeline],
) -> OpenedTrial:
    return OpenedTrial(
        row=row,
        ended=how_ended(row),
        parting="" if row.completed else parting(row, rivals.get(row.trial_id)),
        clip=clip,
        command=replay_command(row, folder),
        link=view_link(row, run.id),
        chart=charts.get(row.trial_id),
        scores=_scores(row),
    )


MOST_LINES = 5000
"""Trials in the table of all of them: a browser needs a second for each 5,000 lines."""


def listed_trials(rows: Sequence[Row]) -> Sequence[Row]:
    """Return the trials that the table of all of them has, as many as it may: failures first.

    Args:
        rows: in the order of their names, in which those stay that did equally well.
    """
    return sorted(rows, key=lambda row: (row.completed, row.success or 0.0))[:MOST_LINES]


def trial_lines(
    rows: Sequence[Row], run: RunInfo, folder: Path, opened: Collection[str] = ()
) -> tuple[TrialLine, ...]:
    """Return every trial, in the order of `rows`.

    Args:
        rows: of the trials.
        run: their run.
        folder: of the run, as a reader would type it.
        opened: names of those that open in the page.
    """
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
            anchor=anchor(row.trial_id) if row.trial_id in opened else "",
        )
        for row in rows
    )
