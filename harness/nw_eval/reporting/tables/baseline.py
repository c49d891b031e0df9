"""The table of what changed against a baseline, scene by scene."""

from __future__ import annotations

from nw_eval.gate.verdict import Comparison, SceneDrop
from nw_eval.plural import plural
from nw_eval.reporting.tables.table import Bar, Table, bounds_header, span, uncorrected
from nw_eval.stats.bank.trials import SUSPECT
from nw_eval.stats.interval import Interval

_SHOWN = 1e6
"""Evidence over which a cell says only that it is over it."""


def baseline_table(found: Comparison | None, *, brief: bool = False) -> Table:
    """Return the drop in each scene, those that fell first; none without a baseline.

    Args:
        found: the comparison.
        brief: for a terminal: without intervals.
    """
    items = () if found is None else sorted(found.scenes, key=_order)
    tiers = any(item.tier != "supporting" for item in items)
    alone = not brief and any(item.interval for item in items)
    return Table(
        title="Against the baseline",
        columns=(
            "scene",
            *(("tier",) if tiers else ()),
            "trials",
            "baseline",
            "candidate",
            "drop",
            *((_alone(found),) if alone and found is not None else ()),
            "evidence",
            "regressed",
            "from waypoint",
        ),
        rows=tuple(_line(item, tiers=tiers, alone=alone) for item in items),
        numbers=frozenset(
            {
                *("trials", "baseline", "candidate", "drop", "evidence", "from waypoint"),
                *(() if found is None else (_alone(found),)),
            }
        ),
        note="" if found is None else _note(found),
        marked="baseline",
        bars=tuple(
            None
            if item.candidate is None or item.baseline is None
            else Bar(value=item.candidate, mark=item.baseline, interval=_left(item), change=True)
            for item in items
        ),
    )


def _alone(found: Comparison) -> str:
    """Return the header of the intervals of drops."""
    return bounds_header(found.alpha_regr, found.alpha_pass)


def _order(item: SceneDrop) -> tuple[bool, float, float, str]:
    return (not item.counts, -item.evidence, -(item.drop or 0.0), item.name)


def _line(item: SceneDrop, *, tiers: bool, alone: bool) -> tuple[str, ...]:
    return (
        item.name,
        *((item.tier,) if tiers else ()),
        str(item.trials),
        "none" if item.baseline is None else f"{item.baseline:.3f}",
        "none" if item.candidate is None else f"{item.candidate:.3f}",
        "" if item.drop is None else f"{item.drop:z.3f}",
        *((_interval(item),) if alone else ()),
        _evidence(item) if item.counts and item.trials else "",
        "yes" if item.named else "",
        "" if item.waypoint is None else str(item.waypoint),
    )


def _interval(item: SceneDrop) -> str:
    return "" if item.interval is None or not item.trials else span(item.interval)


def _left(item: SceneDrop) -> Interval | None:
    """Return the candidate's success that the trials of the scene leave possible."""
    if item.interval is None or item.baseline is None:
        return None
    low, high = (item.baseline - drop for drop in reversed(item.interval))
    return Interval(max(0.0, low), min(1.0, high))


def _evidence(item: SceneDrop) -> str:
    return f"over {_SHOWN:.0f}" if item.evidence > _SHOWN else f"{item.evidence:.3g}"


def _note(found: Comparison) -> str:
    """Return what the columns hold, and what the numbers of evidence mean."""
    judged = sum(item.counts for item in found.scenes)
    known = f"{plural(found.starts, 'start')} in each scene"
    if found.basis == "control":
        known = f"{plural(found.control, 'trial')} that ran beside the candidate"
    means = (
        f"The baseline {found.policy} is {known}, the candidate {plural(found.trials, 'trial')}."
    )
    if found.basis == "same":
        return means
    alone = f"{uncorrected('scene', _alone(found))} "
    return (
        f"{means} {alone if any(item.interval for item in found.scenes) else ''}"
        f"Evidence is against a drop of at most {found.scene_drop:g} in that scene. Evidence >= "
        f"{judged / found.alpha_regr:.0f}: reported as regressed ({plural(judged, 'scene')} share "
        f"an error of {100 * found.alpha_regr:.3g} %). >= {SUSPECT:g}: PASS is held back."
    )
