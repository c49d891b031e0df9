"""The table of what changed against a baseline, scene by scene."""

from __future__ import annotations

from nw_eval.gate.baseline.comparison import Comparison, SceneDrop
from nw_eval.plural import plural
from nw_eval.reporting.tables.table import Bar, Table
from nw_eval.stats.bank import SUSPECT

_SHOWN = 1e6
"""Evidence over which a cell says only that it is over it."""


def baseline_table(found: Comparison | None) -> Table:
    """Return the drop in each scene, those that fell first; none without a baseline."""
    items = () if found is None else sorted(found.scenes, key=_order)
    tiers = any(item.tier != "supporting" for item in items)
    return Table(
        title="Against the baseline",
        columns=(
            "scene",
            *(("tier",) if tiers else ()),
            "trials",
            "baseline",
            "candidate",
            "drop",
            "evidence",
            "fell",
            "from waypoint",
        ),
        rows=tuple(_line(item, tiers=tiers) for item in items),
        numbers=frozenset({"trials", "baseline", "candidate", "drop", "evidence", "from waypoint"}),
        note="" if found is None else _note(found),
        marked="baseline",
        bars=tuple(
            None if item.candidate is None else Bar(value=item.candidate, mark=item.baseline)
            for item in items
        ),
    )


def _order(item: SceneDrop) -> tuple[bool, float, float, str]:
    return (not item.counts, -item.evidence, -(item.drop or 0.0), item.name)


def _line(item: SceneDrop, *, tiers: bool) -> tuple[str, ...]:
    return (
        item.name,
        *((item.tier,) if tiers else ()),
        str(item.trials),
        f"{item.baseline:.3f}",
        "none" if item.candidate is None else f"{item.candidate:.3f}",
        "" if item.drop is None else f"{item.drop:z.3f}",
        _evidence(item) if item.counts and item.trials else "",
        "yes" if item.named else "",
        "" if item.waypoint is None else str(item.waypoint),
    )


def _evidence(item: SceneDrop) -> str:
    return f"over {_SHOWN:.0f}" if item.evidence > _SHOWN else f"{item.evidence:.3g}"


def _note(found: Comparison) -> str:
    """Return what the columns hold, and what the numbers of evidence mean."""
    judged = sum(item.counts for item in found.scenes)
    means = (
        f"The baseline {found.policy} is all {found.starts} starts of the bank {found.bank} in "
        f"each scene, the candidate {plural(found.rounds, 'round')}."
    )
    if found.basis == "same":
        return means
    return (
        f"{means} Evidence is against a drop of at most {found.scene_drop:g} in that scene alone: "
        f"{judged / found.alpha_regr:.0f} names it as fallen ({plural(judged, 'scene')} share an "
        f"error of {100 * found.alpha_regr:.3g} %), and from {SUSPECT:g} on a PASS waits."
    )
