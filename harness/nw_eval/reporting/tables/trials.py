"""Tables of single trials: those that failed, went worst, or are to be doubted."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote

from nw_base.files.inside import OutsideError, checked
from nw_eval.reporting.tables.table import WORST, Table, judged, mean, more, share
from nw_gate.results.baseline import Start
from nw_gate.results.moment_link import MomentLink
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.verdict import Verdict

BEFORE_END = 1.0
"""Seconds before a trial's end at which a link to it begins."""
COVERED = 0.5
"""Mean alpha of a frame below which the camera looked mostly at what was never captured."""
_NAME = re.compile(r"[A-Za-z0-9_.+~=@-]+")


def contacts_table(rows: Sequence[Row], run: RunInfo) -> Table:
    """Return how often head or trunk collided where that ends no trial; none where it does."""
    shown: list[tuple[str, ...]] = []
    if not run.suite.get("episode", {}).get("contact_termination", True):
        by_scene: defaultdict[str, list[float]] = defaultdict(list)
        for row in rows:
            by_scene[row.scene].append(row.contact_s)
        for scene, seconds in sorted(by_scene.items()):
            hit = [value for value in seconds if value > 0.0]
            shown.append((scene, f"{len(hit)} of {len(seconds)}", f"{sum(seconds):.2f} s"))
    return Table(
        title="Contacts of head and trunk",
        columns=("scene", "trials", "in contact"),
        rows=tuple(shown),
        numbers=frozenset({"in contact"}),
        note="The suite lets trials continue after a contact of more than 10 N.",
    )


def failures_table(rows: Sequence[Row], *, compared: bool) -> Table:
    """Return the trials in which the policy itself failed, twice in the same way.

    Args:
        rows: in the order of their names.
        compared: whether they were compared with a baseline.
    """
    against = "; against the baseline they count as 0" if compared else ""
    failed = [row for row in rows if row.outcome == "policy_failed"]
    return Table(
        title="Policy failures",
        columns=("trial", "kind", "success", "what happened"),
        rows=tuple(
            (row.trial_id, row.end_reason, mean([row.success]), row.error_text)
            for row in failed[:WORST]
        ),
        numbers=frozenset({"success"}),
        note=more(len(failed)) + "The policy failed in a fresh process again: these trials are "
        f"results, and count with the waypoints reached until then{against}.",
    )


def errors_table(rows: Sequence[Row]) -> Table:
    """Return the trials without a result: faults of the machine, not of the policy."""
    failed = [row for row in rows if row.status == "error"]
    return Table(
        title="Errors",
        columns=("trial", "kind", "attempts", "what happened"),
        rows=tuple(
            (row.trial_id, row.outcome, str(row.attempt), row.error_text or row.error_type)
            for row in failed[:WORST]
        ),
        numbers=frozenset({"attempts"}),
        note=more(len(failed)) + "An error is not a failure of the policy; it is counted apart.",
    )


def worst_trials(rows: Sequence[Row]) -> list[Row]:
    """Return the trials that did not complete, those first that got least far."""
    failed = [row for row in rows if row.success is not None and not row.completed]
    return sorted(failed, key=lambda row: (row.success, row.sim_s, row.trial_id))


Rivals = Mapping[str, Row | Start]
"""Of a baseline's policy, by the trial of the candidate that began at the same start."""

NO_RIVALS: Rivals = {}
"""Where there is no baseline, or its trials began elsewhere."""


def parting(row: Row, rival: Row | Start | None) -> str:
    """Return how the baseline's policy fared from the start of a trial that did not complete.

    Args:
        row: of the candidate.
        rival: of the baseline's policy; a start of a baseline has no times. None gives no words.
    """
    if rival is None:
        return ""
    times = rival.waypoint_times if isinstance(rival, Row) else ()
    at_end = f" at {rival.sim_s:.1f} s" if isinstance(rival, Row) else ""
    ended = "" if rival.outcome in ("fell", "collided") else "ended as "
    end = f"completed{at_end}" if rival.completed else f"{ended}{rival.outcome}{at_end}"
    point = row.waypoints_reached + 1
    if not row.waypoints_total or point > row.waypoints_total:
        return f"The baseline's policy {end} from the same initial state."
    if rival.waypoints_reached >= point:
        passed = f" at {times[point - 1]:.1f} s" if times else ""
        return f"The baseline's policy passed waypoint {point}{passed} and {end}."
    if rival.waypoints_reached == row.waypoints_reached:
        return f"The baseline's policy did not pass waypoint {point} either: it {end}."
    reached = f"{rival.waypoints_reached} of {rival.waypoints_total} waypoints"
    return f"The baseline's policy reached {reached} and {end}."


def worst_table(
    rows: Sequence[Row], folder: Path, most: int = WORST, rivals: Rivals = NO_RIVALS
) -> Table:
    """Return the trials that went worst, each with the command that shows it again."""
    failed = worst_trials(rows)
    return Table(
        title="Worst trials",
        columns=("trial", "success", "outcome", "at", "baseline", "replay"),
        rows=tuple(
            (
                row.trial_id,
                row.standing,
                how_ended(row),
                f"{row.sim_s:.2f} s",
                parting(row, rivals.get(row.trial_id)),
                replay_command(row, folder),
            )
            for row in failed[:most]
        ),
        numbers=frozenset({"at"}),
        code=frozenset({"replay"}),
        note=more(len(failed), most),
    ).without_empty()


def how_ended(row: Row) -> str:
    """Return a trial's outcome, and what decided it."""
    return f"{row.outcome} ({row.end_reason})" if row.end_reason else row.outcome


def replay_command(row: Row, folder: Path) -> str:
    """Return the command that replays a trial; empty if it has no log in the folder."""
    if not row.mcap_path:
        return ""
    try:
        checked(row.mcap_path)
    except OutsideError:
        return ""
    return f"nw-eval replay {quote(str(folder / row.mcap_path))}"


def view_link(row: Row, run: str) -> str:
    """Return where `nw-eval view` shows a trial shortly before its end.

    Empty without a log, and for names that no run of ours gives: they are text, and no address.
    """
    if not row.mcap_path or not (_NAME.fullmatch(run) and _NAME.fullmatch(row.trial_id)):
        return ""
    return MomentLink(run=run, trial=row.trial_id, time=max(0.0, row.sim_s - BEFORE_END)).url


def left_table(rows: Sequence[Row], verdict: Verdict) -> Table:
    """Return the trials that left the captured volume, those that went farthest first."""
    left = [row for row in rows if row.trial_id in verdict.left]
    left.sort(key=lambda row: (-max(row.capture_distance, default=0.0), row.trial_id))
    return Table(
        title="Left the captured volume",
        columns=("trial", "farthest", "widest angle", "least coverage", "outcome"),
        rows=tuple(
            (
                row.trial_id,
                f"{max(row.capture_distance, default=0.0):.2f} m",
                f"{max(row.capture_angle, default=0.0):.2f} rad",
                share(min(row.capture_alpha, default=None)),
                row.outcome,
            )
            for row in left[:WORST]
        ),
        numbers=frozenset({"farthest", "widest angle", "least coverage"}),
        note=more(len(left)) + "For longer than the suite's gate.validity allows, the policy saw "
        "what no photograph shows from there. These trials count neither for it nor against it.",
    )


def coverage_table(rows: Sequence[Row], verdict: Verdict) -> Table:
    """Return other trials whose camera saw too little of the splat for images to mean much."""
    low = [
        row
        for row in judged(rows, verdict)
        if row.coverage_min is not None and row.coverage_min < COVERED
    ]
    low.sort(key=lambda row: (row.coverage_min or 0.0, row.trial_id))
    return Table(
        title="Out of the captured volume",
        columns=("trial", "least coverage", "mean coverage", "outcome"),
        rows=tuple(
            (row.trial_id, share(row.coverage_min), share(row.coverage_mean), row.outcome)
            for row in low[:WORST]
        ),
        numbers=frozenset({"least coverage", "mean coverage"}),
        note=more(len(low)) + f"In some frame less than {COVERED:g} of the image was covered by "
        "the splat; such images do not show the scene: doubt the result.",
    )
