"""A sweep in words and as a table: where a policy breaks off, and where two part."""

from __future__ import annotations

from collections.abc import Sequence

from nw_eval.gate.sweep import AxisCurve, Cliff, Point, chance, needed_to_part
from nw_eval.plural import plural
from nw_eval.reporting.tables.table import Table, span
from nw_eval.suite.perturb import UNITS


def axis_label(axis: str) -> str:
    """Return an axis with its unit: `payload, kg`."""
    return f"{axis}, {UNITS[axis]}" if axis in UNITS else axis


def cliff_words(curve: AxisCurve) -> list[str]:
    """Return what a curve says, a line for each cliff, or one that says why there is none."""
    who, reference, values = curve.policy, curve.reference, [p.value for p in curve.points]
    if reference.mean is None:
        return [f"{who}: no result at {curve.axis} {reference.value:g}"]
    if reference.share == 0.0:
        where = f"{plural(reference.trials, 'trial')} at {curve.axis} {reference.value:g} completed"
        return [f"{who}: nothing to fall from: none of {where}"]
    if not curve.cliffs and curve.needed is not None:
        return [f"{who}: {too_few(curve.needed)} for a fall from {_counts(reference)} to none"]
    if not curve.cliffs:
        span = f"{curve.axis} {values[0]:g} to {values[-1]:g}"
        at = f"{reference.value:g} ({_share(reference)})"
        return [f"{who}: no cliff from {span}: nowhere beyond chance fewer complete than at {at}"]
    return [f"{who}: {_cliff(curve, cliff)}" for cliff in curve.cliffs]


def too_few(needed: int) -> str:
    """Return that a sweep has too few trials for its test, and how many `--trials` would do."""
    return (
        f"too few trials to tell; {needed} needed in each scene at each value (--trials {needed})"
    )


def _cliff(curve: AxisCurve, cliff: Cliff) -> str:
    reference, holds, falls = curve.reference, cliff.holds, cliff.falls
    fallen = (
        f"falls at {curve.axis} {falls.value:g}: {_share(falls)} against {_counts(reference)} at "
        f"{reference.value:g}"
    )
    if holds.share >= reference.share:
        return f"{fallen}; holds at {holds.value:g}"
    return f"{fallen}; whether it holds at {holds.value:g} ({_counts(holds)}), chance leaves open"


def _share(point: Point) -> str:
    return f"{_counts(point)} completed"


def _counts(point: Point) -> str:
    return f"{sum(done for done, _ in point.completed.values())} of {point.trials}"


def parting_words(one: AxisCurve, other: AxisCurve) -> str:
    """Return at which values two policies part beyond chance, Bonferroni over all of them."""
    theirs = {point.value: point for point in other.points}
    both = [(point, theirs[point.value]) for point in one.points if point.value in theirs]
    most = (1.0 - one.confidence) / max(1, len(both))
    parted = [(a, b) for a, b in both if chance(a, b) <= most]
    needed = needed_to_part(one, other)
    if not parted and needed is not None:
        both = f"{one.policy} and {other.policy}"
        return f"{both}: {too_few(needed)} for all of one and none of the other"
    if not parted:
        return f"{one.policy} and {other.policy}: at no value do they part beyond chance"
    words = ", ".join(f"{a.value:g} ({a.share:.2f} and {b.share:.2f})" for a, b in parted)
    return f"{one.policy} and {other.policy}: different shares complete at {one.axis} {words}"


def sweep_table(curves: Sequence[AxisCurve]) -> Table:
    """Return the table of one axis: a line for each value and policy."""
    first = curves[0]
    percent = f"{100 * first.confidence:.4g} % each alone"
    lines = [
        (
            f"{point.value:g}",
            curve.policy,
            str(point.trials) + (f", {point.errors} errors" if point.errors else ""),
            "none" if point.mean is None else f"{point.mean:.3f}",
            "" if point.mean is None else span(point.interval),
            _counts(point),
        )
        for value in sorted({point.value for curve in curves for point in curve.points})
        for curve in curves
        for point in curve.points
        if point.value == value
    ]
    return Table(
        title=f"Success by {first.axis}",
        columns=(axis_label(first.axis), "policy", "trials", "success", percent, "completed"),
        rows=tuple(lines),
        numbers=frozenset({axis_label(first.axis), "success"}),
        note="Success is the mean over scenes of the share of waypoints reached, its interval a "
        "Bayesian bootstrap. A cliff is the first value, outwards from the one nearest to neutral, "
        "at which fewer trials complete than there by Fisher's exact test with scenes as strata, "
        "Bonferroni over the values; where not even a fall to none would show, there are too few "
        "trials to tell. Two policies meet the same starts; two values do not.",
    )
