"""Tables of what was reached: by scene, by outcome, by perturbation."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence

import numpy as np

from nw_eval.gate.verdict import SceneScore, Verdict
from nw_eval.plural import plural
from nw_eval.reporting.tables.table import Bar, Table, judged, mean, span
from nw_eval.results.row import Row
from nw_eval.stats import mean_of_scenes
from nw_eval.words import OUTCOMES

_LEFT = "left capture"
"""Trials that left the captured volume, and are counted apart."""


def scenes_table(verdict: Verdict) -> Table:
    """Return success by scene, the lowest first."""
    scores = sorted(verdict.per_scene, key=lambda item: (item.mean is not None, item.mean))
    splits = any(item.split for item in scores)
    tiers = any(item.tier != "supporting" for item in scores)
    outside = any(item.outside for item in scores)
    percent = f"{100 * verdict.confidence:.4g} %"
    return Table(
        title="Success by scene",
        columns=(
            "scene",
            *(("split",) if splits else ()),
            *(("tier",) if tiers else ()),
            "trials",
            *((_LEFT,) if outside else ()),
            "success",
            f"{percent} each alone",
            "completed",
            f"{percent} of completed",
        ),
        rows=tuple(
            (
                item.scene,
                *((item.split or "-",) if splits else ()),
                *((item.tier,) if tiers else ()),
                str(item.n) if item.n == item.planned else f"{item.n} of {item.planned}",
                *((str(item.outside),) if outside else ()),
                "none" if item.mean is None else f"{item.mean:.3f}",
                "" if item.mean is None else span(item.interval),
                f"{item.completed} of {item.n}",
                span(item.completion) if item.n else "",
            )
            for item in scores
        ),
        numbers=frozenset({"trials", _LEFT, "success"}),
        foot=_of_splits(scores),
        note="Success is the share of the trail's waypoints reached, completed the share of trials "
        "that reached all. Each interval is for its scene alone: of many, some miss. That of "
        "success is a Bayesian bootstrap, that of completed trials Wilson's; the verdict uses "
        "neither, but bounds that hold for any distribution.",
        marked="" if verdict.bar is None else "the bar",
        bars=tuple(
            None
            if item.mean is None
            else Bar(value=item.mean, interval=item.interval, mark=verdict.bar)
            for item in scores
        ),
    )


def _of_splits(scores: Sequence[SceneScore]) -> str:
    """Return the means of the scenes that a policy was trained in, and of the others; or nothing.

    Scenes weigh equally, as in the verdict, and informational ones do not count.
    """
    parts: list[str] = []
    for split, words in (("train", "it was trained in"), ("eval", "it was not trained in")):
        known = [
            item.mean
            for item in scores
            if item.split == split and item.mean is not None and item.tier != "informational"
        ]
        if known:
            average = float(np.mean(known))
            parts.append(f"{average:.3f} in {plural(len(known), 'scene')} that {words} ({split})")
    return f"Mean success: {', '.join(parts)}." if parts else ""


def outcomes_table(rows: Sequence[Row]) -> Table:
    """Return how the trials ended."""
    ended: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        ended[row.outcome].append(row)
    order = sorted(ended, key=lambda name: (name not in OUTCOMES, -len(ended[name]), name))
    return Table(
        title="Outcomes",
        columns=("outcome", "trials", "share", "mean success", "most often by"),
        rows=tuple(
            (
                name if name in OUTCOMES else f"{name} (error)",
                str(len(ended[name])),
                f"{100 * len(ended[name]) / len(rows):.0f} %",
                mean([row.success for row in ended[name]]),
                Counter(row.end_reason for row in ended[name]).most_common(1)[0][0],
            )
            for name in order
        ),
        numbers=frozenset({"trials", "share", "mean success"}),
    )


def perturbations_table(rows: Sequence[Row], verdict: Verdict) -> Table:
    """Return success in every cell of the perturbation grid, over all scenes; none without one."""
    confidence = verdict.confidence
    cells = sorted({row.perturbation for row in rows} - {()})
    lines: list[tuple[str, ...]] = []
    for cell in cells:
        scenes: dict[str, list[float]] = {}
        for row in judged(rows, verdict):
            if row.perturbation == cell and row.success is not None:
                scenes.setdefault(row.scene, []).append(row.success)
        name = ", ".join(f"{axis} {value:g}" for axis, value in cell)
        if scenes:
            groups = [np.array(values) for _, values in sorted(scenes.items())]
            found = mean_of_scenes(groups, confidence)
            lines.append((name, str(found.n), f"{found.mean:.3f}", span(found.interval)))
        else:
            lines.append((name, "0", "none", ""))
    return Table(
        title="Success by perturbation",
        columns=("perturbation", "trials", "success", f"{100 * confidence:.4g} % interval"),
        rows=tuple(lines),
        numbers=frozenset({"trials", "success"}),
    )
