"""What a report says, as tables of text that Markdown and the console draw in their own ways."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

import numpy as np

from nw_eval.clean import clean
from nw_eval.gate.verdict import Verdict
from nw_eval.inside import OutsideError, checked
from nw_eval.reporting.throughput import throughput
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row
from nw_eval.stats import Interval, mean_of_scenes
from nw_eval.suite.digest import digest_of
from nw_eval.words import OUTCOMES

WORST = 8
"""Trials that the table of worst ones names."""

COVERED = 0.5
"""Mean alpha of a frame below which the camera looked mostly at what was never captured."""


_SHOWN, _TYPED = 500, 4000  # characters of a cell, and of one to type


@dataclass(frozen=True, kw_only=True)
class Table:
    """A titled table. `code` names the columns that hold something to type.

    Rows and run.json may be a stranger's: what they say is cleaned here, for every page.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: frozenset[str] = frozenset()  # Columns to align on the right.
    code: frozenset[str] = frozenset()
    note: str = ""

    def __post_init__(self) -> None:
        longest = [_TYPED if name in self.code else _SHOWN for name in self.columns]
        rows = tuple(
            tuple(clean(cell, at_most=most) for cell, most in zip(row, longest, strict=True))
            for row in self.rows
        )
        object.__setattr__(self, "rows", rows)


def scenes_table(verdict: Verdict) -> Table:
    """Return success by scene, the lowest first."""
    scores = sorted(verdict.per_scene, key=lambda item: (item.mean is not None, item.mean))
    tiers = any(item.tier != "supporting" for item in scores)
    percent = f"{100 * verdict.confidence:.4g} %"
    return Table(
        title="Success by scene",
        columns=(
            "scene",
            *(("tier",) if tiers else ()),
            "trials",
            "success",
            f"{percent} each alone",
            "completed",
            f"{percent} of completed",
        ),
        rows=tuple(
            (
                item.scene,
                *((item.tier,) if tiers else ()),
                str(item.n) if item.n == item.planned else f"{item.n} of {item.planned}",
                "none" if item.mean is None else f"{item.mean:.3f}",
                "" if item.mean is None else _span(item.interval),
                f"{item.completed} of {item.n}",
                _span(item.completion) if item.n else "",
            )
            for item in scores
        ),
        numbers=frozenset({"trials", "success"}),
        note="Success is the share of the trail's waypoints reached, completed the share of trials "
        "that reached all. Each interval is for its scene alone: of many, some miss. That of "
        "success is a Bayesian bootstrap, that of completed trials Wilson's; the verdict uses "
        "neither, but bounds that hold for any distribution.",
    )


def outcomes_table(rows: Sequence[Row]) -> Table:
    """Return how the trials ended."""
    counts = Counter(row.outcome for row in rows)
    order = sorted(counts, key=lambda name: (name not in OUTCOMES, -counts[name], name))
    return Table(
        title="Outcomes",
        columns=("outcome", "trials", "share", "mean success", "most often by"),
        rows=tuple(
            (
                name if name in OUTCOMES else f"{name} (error)",
                str(counts[name]),
                f"{100 * counts[name] / len(rows):.0f} %",
                _mean([row.success for row in rows if row.outcome == name]),
                Counter(row.end_reason for row in rows if row.outcome == name).most_common(1)[0][0],
            )
            for name in order
        ),
        numbers=frozenset({"trials", "share", "mean success"}),
    )


def perturbations_table(rows: Sequence[Row], confidence: float) -> Table:
    """Return success in every cell of the perturbation grid, over all scenes; none without one."""
    cells = sorted({row.perturbation for row in rows} - {()})
    lines: list[tuple[str, ...]] = []
    for cell in cells:
        scenes: dict[str, list[float]] = {}
        for row in rows:
            if row.perturbation == cell and row.success is not None:
                scenes.setdefault(row.scene, []).append(row.success)
        name = ", ".join(f"{axis} {value:g}" for axis, value in cell)
        if scenes:
            groups = [np.array(values) for _, values in sorted(scenes.items())]
            found = mean_of_scenes(groups, confidence)
            lines.append((name, str(found.n), f"{found.mean:.3f}", _span(found.interval)))
        else:
            lines.append((name, "0", "none", ""))
    return Table(
        title="Success by perturbation",
        columns=("perturbation", "trials", "success", f"{100 * confidence:.4g} % interval"),
        rows=tuple(lines),
        numbers=frozenset({"trials", "success"}),
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
        note=_more(len(failed)) + "An error is no failure of the policy; it is counted apart.",
    )


def failures_table(rows: Sequence[Row]) -> Table:
    """Return the trials in which the policy itself failed, twice in the same way."""
    failed = [row for row in rows if row.outcome == "policy_failed"]
    return Table(
        title="Policy failures",
        columns=("trial", "kind", "success", "what happened"),
        rows=tuple(
            (row.trial_id, row.end_reason, _mean([row.success]), row.error_text)
            for row in failed[:WORST]
        ),
        numbers=frozenset({"success"}),
        note=_more(len(failed)) + "The policy failed in a fresh process again: these trials are "
        "results, and count with the waypoints reached until then.",
    )


def worst_table(rows: Sequence[Row], folder: Path, most: int = WORST) -> Table:
    """Return the trials that went worst, each with the command that shows it again."""
    failed = [row for row in rows if row.success is not None and not row.completed]
    failed.sort(key=lambda row: (row.success, row.sim_s, row.trial_id))
    return Table(
        title="Worst trials",
        columns=("trial", "success", "outcome", "at", "replay"),
        rows=tuple(
            (
                row.trial_id,
                f"{row.waypoints_reached}/{row.waypoints_total}",
                f"{row.outcome} ({row.end_reason})" if row.end_reason else row.outcome,
                f"{row.sim_s:.2f} s",
                replay_command(row, folder),
            )
            for row in failed[:most]
        ),
        numbers=frozenset({"at"}),
        code=frozenset({"replay"}),
        note=_more(len(failed), most),
    )


def replay_command(row: Row, folder: Path) -> str:
    """Return the command that replays a trial; empty if it has no log in the folder."""
    try:
        checked(row.mcap_path)
    except OutsideError:
        return ""
    return f"nw-eval replay {quote(str(folder / row.mcap_path))}"


def throughput_table(rows: Sequence[Row], run: RunInfo) -> Table:
    """Return where the time went."""
    spent = throughput(rows)
    # A run that was resumed knows the time of its last part only.
    wall = max(run.wall_s, sum(row.wall_s for row in rows if not row.cached) / run.workers)
    rate = 60.0 * len(rows) / wall if wall > 0 else 0.0
    return Table(
        title="Where the time went",
        columns=("stage", "seconds", "ms per control step", "share"),
        rows=tuple(
            (
                stage.name,
                f"{stage.seconds:.1f}",
                f"{stage.ms_per_step:.2f}",
                f"{100 * stage.share:.0f} %",
            )
            for stage in spent.stages
        ),
        numbers=frozenset({"seconds", "ms per control step", "share"}),
        note=f"{rate:.1f} trials per minute on {_workers(run.workers)}; "
        f"{spent.sim_s:.0f} s simulated, {spent.real_time_factor:.1f} times real time per worker.",
    )


def coverage_table(rows: Sequence[Row]) -> Table:
    """Return trials whose camera saw too little of the splat for images to mean much."""
    low = [row for row in rows if row.coverage_min is not None and row.coverage_min < COVERED]
    low.sort(key=lambda row: (row.coverage_min or 0.0, row.trial_id))
    return Table(
        title="Out of the captured volume",
        columns=("trial", "least coverage", "mean coverage", "outcome"),
        rows=tuple(
            (row.trial_id, _share(row.coverage_min), _share(row.coverage_mean), row.outcome)
            for row in low[:WORST]
        ),
        numbers=frozenset({"least coverage", "mean coverage"}),
        note=_more(len(low)) + f"In some frame less than {COVERED:g} of the image was covered by "
        "the splat; such images show no place, and the result is to be doubted.",
    )


def contacts_table(rows: Sequence[Row], run: RunInfo) -> Table:
    """Return how often head or trunk collided where that ends no trial; none where it does."""
    shown: list[tuple[str, ...]] = []
    if not run.suite.get("episode", {}).get("contact_termination", True):
        for scene in sorted({row.scene for row in rows}):
            seconds = [row.contact_s for row in rows if row.scene == scene]
            hit = [value for value in seconds if value > 0.0]
            shown.append((scene, f"{len(hit)} of {len(seconds)}", f"{sum(seconds):.2f} s"))
    return Table(
        title="Contacts of head and trunk",
        columns=("scene", "trials", "in contact"),
        rows=tuple(shown),
        numbers=frozenset({"in contact"}),
        note="The suite lets trials go on after a contact of more than 10 N.",
    )


def provenance_table(run: RunInfo) -> Table:
    """Return what ran on what."""
    weights = f"checkpoint {run.policy.checkpoint_digest[:12]}"
    commit = f", commit {run.code.commit[:12]}{' with changes' if run.code.dirty else ''}"
    facts = {
        "run": run.id,
        "started": run.started,
        "suite": f"{run.suite_file}, {digest_of(run.suite)[:12]}",
        "panel of starts": f"{run.suite_digest[:12]} (same robot, protocol, seed, episode and "
        "perturbations: same starts)",
        "policy": f"{run.policy.name}, {run.policy.origin or weights}",
        "scenes": f"{len(run.scenes)}, {sum(run.planned.values())} trials planned",
        "renderer": run.renderer or "none",
        "fence": run.fence,
        "nw-eval": f"{run.code.version}{commit if run.code.commit else ''}",
        "code": run.code.digest[:12],
        "versions": ", ".join(f"{name} {number}" for name, number in run.versions.items()),
        "machine": f"{run.machine.cpu}, {run.machine.cores} cores, {run.machine.system}",
        "rows": run.rows_digest[:12],
    }
    return Table(
        title="Provenance",
        columns=("what", "value"),
        rows=tuple((name, value) for name, value in facts.items() if value),
    )


def all_tables(
    run: RunInfo, rows: Sequence[Row], verdict: Verdict, folder: Path
) -> tuple[Table, ...]:
    """Return every table that has rows, in the order of a report."""
    ordered = sorted(rows, key=lambda row: row.trial_id)
    tables = (
        scenes_table(verdict),
        perturbations_table(ordered, verdict.confidence),
        outcomes_table(ordered),
        contacts_table(ordered, run),
        failures_table(ordered),
        errors_table(ordered),
        worst_table(ordered, folder),
        throughput_table(ordered, run),
        coverage_table(ordered),
        provenance_table(run),
    )
    return tuple(table for table in tables if table.rows)


def _share(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _span(interval: Interval) -> str:
    return f"{interval.low:.2f} to {interval.high:.2f}"


def _mean(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{sum(known) / len(known):.3f}" if known else ""


def _more(total: int, most: int = WORST) -> str:
    return f"{total - most} more are in trials.parquet. " if total > most else ""


def _workers(count: int) -> str:
    return "1 worker" if count == 1 else f"{count} workers"
