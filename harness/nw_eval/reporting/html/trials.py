"""Single trials on a page: the worst ones with what they saw, and all of them in a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from nw_eval.reporting.html.evidence import Clip
from nw_eval.reporting.tables.table import WORST
from nw_eval.reporting.tables.trials import how_ended, replay_command, view_link, worst_trials
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row


@dataclass(frozen=True, kw_only=True)
class WorstTrial:
    """A trial that went badly."""

    row: Row
    ended: str
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
    rows: Sequence[Row], clips: Mapping[str, Clip], run: RunInfo, folder: Path
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
            clip=clips.get(row.trial_id),
            command=replay_command(row, folder),
            link=view_link(row, run.id),
        )
        for row in named
    )


def trial_lines(rows: Sequence[Row], run: RunInfo, folder: Path) -> tuple[TrialLine, ...]:
    """Return every trial, in the order of `rows`."""
    return tuple(
        TrialLine(
            trial=row.trial_id,
            scene=row.scene,
            setting=", ".join([f"{axis} {value:g}" for axis, value in row.perturbation]),
            outcome=row.outcome,
            reason=row.end_reason,
            success="" if row.success is None else f"{row.waypoints_reached}/{row.waypoints_total}",
            at=f"{row.sim_s:.2f}",
            wall=f"{row.wall_s:.1f}",
            command=replay_command(row, folder),
            link=view_link(row, run.id),
        )
        for row in rows
    )
