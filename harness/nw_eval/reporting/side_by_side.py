"""A comparison of policies, as tables and as a page of Markdown."""

from __future__ import annotations

from nw_base.plural import plural
from nw_eval.reporting.markdown import escaped, markdown_table
from nw_eval.reporting.tables.table import Table, span
from nw_gate.side_by_side import ComparedPolicy, PolicyComparison, SceneParting
from nw_gate.stats.hazard import Hazard

_MOST = 12
"""Suspect waypoints that a table names."""


def comparison_page(found: PolicyComparison) -> str:
    """Return the page: each table under its title, with its note."""
    parts: list[str] = []
    for level, table in enumerate(comparison_tables(found)):
        parts += [f"{'##' if level else '#'} {table.title}", markdown_table(table)]
        parts += [escaped(table.note)] if table.note else []
    return "\n\n".join(parts) + "\n"


def comparison_tables(found: PolicyComparison) -> tuple[Table, ...]:
    """Return the policies, tasks, scenes and where they part, of these what there is to say."""
    tables = [_policies(found)]
    if len(found.tasks) > 1:
        tables.append(_tasks(found))
    tables.append(_scenes(found))
    if found.scores:
        tables.append(_scores(found))
    if found.limits:
        tables.append(_limits(found))
    return (*tables, _partings(found)) if found.partings else tuple(tables)


def ranks_text(policy: ComparedPolicy) -> str:
    """Return the ranks that a policy may have, such as `2` or `1 to 3`."""
    ranks = policy.ranks
    return str(ranks.best) if ranks.decided else f"{ranks.best} to {ranks.worst}"


def _policies(found: PolicyComparison) -> Table:
    percent = f"{100 * found.confidence:.4g} %"
    order = sorted(found.policies, key=lambda each: -each.mean)
    return Table(
        title=f"Policies on {found.suite}",
        columns=("policy", "rank", "success", f"{percent} each alone", "completed", "from"),
        rows=tuple(
            (
                each.label,
                ranks_text(each),
                f"{each.mean:.3f}",
                span(each.interval),
                f"{each.completed} of {found.starts}",
                each.source,
            )
            for each in order
        ),
        numbers=frozenset({"success"}),
        note=f"Success is the mean over scenes of the share of waypoints reached, {_met(found)}. "
        "For these initial states it is exact. Intervals and ranks are for new initial states in "
        f"the same scenes: each interval holds alone, all ranks hold together ({percent} "
        "confidence). A range of ranks is not decided yet.",
    )


def _met(found: PolicyComparison) -> str:
    """Return which starts the numbers are over."""
    starts = plural(found.starts, "initial state")
    left = (
        f"; {plural(found.left_out, 'initial state')} of some only left out"
        if found.left_out
        else ""
    )
    if found.unmet:
        every = len(found.unmet) + len(found.scenes)
        left += (
            f"; in {len(found.scenes)} of {every} scenes: not all have a result from "
            f"{', '.join(found.unmet[:3])}"
            + (f" and {len(found.unmet) - 3} more" if len(found.unmet) > 3 else "")
        )
    if found.shared:
        return f"from the {starts} that all have a result from{left}"
    return f"from {starts} of its own each: too few are shared for a comparison of the same{left}"


def _tasks(found: PolicyComparison) -> Table:
    labels = tuple(each.label for each in found.policies)
    percent = f"{100 * found.confidence:.4g} %"
    return Table(
        title="Success by task",
        columns=("task", "scenes", *labels),
        rows=tuple(
            (
                each.task,
                str(each.scenes),
                *(f"{one.mean:.3f} ({span(one.interval)})" for one in each.estimates),
            )
            for each in found.tasks
        ),
        numbers=frozenset({"scenes"}),
        note=f"In brackets what new initial states in these scenes may give, {percent} each alone.",
    )


def _scenes(found: PolicyComparison) -> Table:
    labels = tuple(each.label for each in found.policies)
    return Table(
        title="Success by scene",
        columns=("scene", "initial states", *labels),
        rows=tuple(
            (each.scene, str(each.starts), *(f"{mean:.3f}" for mean in each.means))
            for each in found.scenes
        ),
        numbers=frozenset({"initial states", *labels}),
    )


def _scores(found: PolicyComparison) -> Table:
    labels = tuple(each.label for each in found.policies)
    percent = f"{100 * found.confidence:.4g} %"
    return Table(
        title="Scores",
        columns=("score", "unit", "better", *labels),
        rows=tuple(
            (
                each.spec.name,
                each.spec.unit or "-",
                each.spec.better,
                *(
                    f"{one.mean:.4g} ({one.interval.low:.4g} to {one.interval.high:.4g})"
                    for one in each.estimates
                ),
            )
            for each in found.scores
        ),
        note="Means over the same initial states as success. In brackets what new initial states "
        f"in these scenes may give, {percent} each alone. A trial in which a score is undefined "
        "counts as its definition requires.",
    )


def _limits(found: PolicyComparison) -> Table:
    return Table(
        title="Limits",
        columns=("ladder", *(each.label for each in found.policies)),
        rows=tuple(
            (ladder, *("" if each is None else each.range_text for each in limits))
            for ladder, limits in found.limits.items()
        ),
        note="The hardest rung that is shown to be cleared, and the easiest that is shown not to "
        "be. Bounds of a baseline's limit are surer than those of a run's.",
    )


def _partings(found: PolicyComparison) -> Table:
    shown = [each for each in found.partings if each.shown]
    suspect = [each for each in found.partings if not each.shown]
    first = found.policies[0].label
    percent = f"{100 * found.confidence:.4g} %"
    more = f" {len(suspect) - _MOST} more are suspect." if len(suspect) > _MOST else ""
    return Table(
        title=f"The first waypoint at which a policy parts from {first}",
        columns=("policy", "scene", "waypoint", f"{first} missed it", "policy missed it", "sure"),
        rows=tuple(_parting(found, each) for each in (*shown, *suspect[:_MOST])),
        numbers=frozenset({"waypoint"}),
        note=f"Missed it: of the trials that reached the previous waypoint. "
        f"{len(shown)} shown among "
        f"{plural(found.waypoints, 'waypoint')} looked at, with {percent} confidence for all of "
        "them (Fisher's exact test within scenes, Holm's procedure for all scenes together and for "
        "single ones, half of the error each). Suspect: sure if this waypoint were the only one, "
        f"which among so many means little.{more}",
    )


def _parting(found: PolicyComparison, each: SceneParting) -> tuple[str, ...]:
    return (
        found.policies[each.policy].label,
        each.scene or "all together",
        str(each.at.waypoint),
        _missed(each.at.first),
        _missed(each.at.second),
        "yes" if each.shown else "suspect",
    )


def _missed(hazard: Hazard) -> str:
    return f"{hazard.failed} of {hazard.trials}"
