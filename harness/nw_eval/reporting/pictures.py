"""Pictures by Matplotlib: a sweep, policies side by side, the operating curve of a gate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nw_base.clean import clean
from nw_base.files.cache import atomic_path, followed
from nw_base.plural import plural
from nw_eval.reporting.side_by_side import ranks_text
from nw_gate.side_by_side import PolicyComparison
from nw_gate.stats.baseline.curve import CurvePoint
from nw_gate.stats.baseline.evidence import Margins
from nw_gate.sweep import AxisCurve
from nw_sim.axes import axis_named

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_COLOURS = ("#1b6ca8", "#c8553d", "#3a7d44", "#7b4b94")
_NAME = 40  # characters of a name
_AXIS_WIDE, _AXIS_TALL = 5.0, 3.6  # inches of an axis
_ASIDE = 0.008
"""Share of an axis by which each policy's curve lies beside the one before."""


def draw_sweep(axes: Sequence[Sequence[AxisCurve]], title: str, path: Path) -> None:
    """Draw a sweep.

    Args:
        axes: for each axis the curves of all policies.
        title: above all.
        path: a PNG; appears whole or not at all.

    Raises:
        StoreError: the picture cannot be written.
    """
    from matplotlib.figure import Figure

    columns = min(3, len(axes))
    rows = -(-len(axes) // columns)
    figure = Figure(figsize=(_AXIS_WIDE * columns, _AXIS_TALL * rows + 0.6), layout="constrained")
    figure.suptitle(clean(title, at_most=200), parse_math=False, fontsize="medium")
    places = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for place, curves in zip(places, axes, strict=False):
        for number, curve in enumerate(curves):
            _draw_policy(place, curve, number)
        place.set(ylim=(-0.04, 1.04), xlabel=axis_label(curves[0].axis))
        place.grid(alpha=0.3)
    for place in places[len(axes) :]:
        place.set_visible(False)
    for place in places[::columns]:
        place.set_ylabel("success")
    figure.legend(*places[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)


def axis_label(axis: str) -> str:
    """Return an axis with its unit: `payload, kg`."""
    return axis_named(axis).label


def _draw_policy(axes: Axes, curve: AxisCurve, number: int) -> None:
    colour, aside = _COLOURS[number % len(_COLOURS)], _ASIDE * number
    known = [point for point in curve.points if point.mean is not None]
    span = curve.points[-1].value - curve.points[0].value
    values = [point.value + aside * span for point in known]
    label = clean(curve.policy, at_most=_NAME)
    axes.fill_between(
        values,
        [point.interval.low for point in known],
        [point.interval.high for point in known],
        color=colour,
        alpha=0.15,
        linewidth=0,
    )
    means = [point.mean or 0.0 for point in known]
    axes.plot(values, means, "o-", color=colour, label=label)
    if not curve.cliffs and curve.needed is not None:
        axes.annotate(
            f"too few trials to tell; {curve.needed} needed",
            (0.02, 0.5),
            (0, -11 * number),
            xycoords="axes fraction",
            textcoords="offset points",
            color=colour,
            fontsize="small",
            bbox={"color": "white", "alpha": 0.7, "pad": 0.5},
        )
    for cliff in curve.cliffs:
        middle = (cliff.holds.value + cliff.falls.value) / 2.0 + aside * span
        axes.axvline(middle, color=colour, linestyle="--", linewidth=1.2)
        axes.annotate(
            f"falls at {cliff.falls.value:g}",
            (middle, 1.0),
            (3, -10 - 11 * number),
            textcoords="offset points",
            color=colour,
            fontsize="small",
            bbox={"color": "white", "alpha": 0.7, "pad": 0.5},
        )


_ROW, _COLUMN, _NAMES = 0.3, 1.5, 3.0  # inches
_TALLEST = 60.0  # inches
_DARK = 0.6  # Below this success a cell is dark and its number white.


def draw_comparison(found: PolicyComparison, path: Path) -> None:
    """Draw a comparison.

    Args:
        found: the comparison.
        path: a PNG; appears whole or not at all.

    Raises:
        StoreError: the picture cannot be written.
    """
    from matplotlib.figure import Figure

    tall = min(_ROW * len(found.scenes) + 0.8, _TALLEST)
    wide = _NAMES + _COLUMN * max(3, len(found.policies))
    figure = Figure(figsize=(wide, tall + 3.0), layout="constrained")
    # A dollar sign in a name begins no formula.
    figure.suptitle(_title(found), parse_math=False, fontsize="medium")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.0, tall])
    _draw_means(above, found)
    _draw_matrix(below, found)
    with atomic_path(followed(path)) as temporary:
        figure.savefig(temporary, format="png", dpi=120)


def _title(found: PolicyComparison) -> str:
    suite, first = (clean(name, at_most=_NAME) for name in (found.suite, found.policies[0].label))
    title = f"{suite}: mean success of {plural(found.starts, 'initial state')}, "
    title += f"{100 * found.confidence:.4g} % each alone"
    if any(each.shown and each.scene for each in found.partings):
        title += f"\nw2: parts from {first} at waypoint 2 of the scene"
    return title


def _draw_means(axes: Axes, found: PolicyComparison) -> None:
    for index, each in enumerate(found.policies):
        axes.plot([index, index], each.interval, color="black", linewidth=1.5)
        axes.plot(index, each.mean, "o", color="black")
        axes.annotate(f"{each.mean:.3f}", (index, each.mean), (8, -3), textcoords="offset points")
    axes.set(ylim=(-0.05, 1.05), ylabel="success")
    axes.grid(axis="y", alpha=0.3)


def _draw_matrix(axes: Axes, found: PolicyComparison) -> None:
    parted = {(each.scene, each.policy): each.at for each in found.partings if each.shown}
    means = np.array([each.means for each in found.scenes])
    axes.imshow(means, cmap="cividis", vmin=0.0, vmax=1.0, aspect="auto")
    for row, scene in enumerate(found.scenes):
        for column, mean in enumerate(scene.means):
            at = parted.get((scene.scene, column))
            text = f"{mean:.2f}" + (f"  w{at.waypoint}" if at else "")
            colour = "white" if mean < _DARK else "black"
            axes.text(column, row, text, ha="center", va="center", color=colour)
    names = [clean(each.scene, at_most=_NAME) for each in found.scenes]
    axes.set_yticks(range(len(names)), names, parse_math=False)
    labels = [
        f"{clean(each.label, at_most=_NAME)}\nrank {ranks_text(each)}" for each in found.policies
    ]
    axes.set_xticks(range(len(labels)), labels, parse_math=False)


_WORDS = (
    ("REGRESSED", "#c0392b"),
    ("INCONCLUSIVE", "#b8b8b8"),
    ("PASS", "#2e8b57"),
)


def draw_curve(points: Sequence[CurvePoint], path: Path, *, margins: Margins, title: str) -> None:
    """Draw which share of policies of each drop is flagged, passed and left open, and the trials.

    Args:
        points: of the curve, drops rising.
        path: of the PNG.
        margins: the gate's.
        title: what it is the curve of.

    Raises:
        StoreError: the picture cannot be written.
    """
    from matplotlib.figure import Figure

    drops = [point.drop for point in points]
    shares = [
        [100 * point.regressed for point in points],
        [100 * point.undecided for point in points],
        [100 * point.passed for point in points],
    ]
    figure = Figure(figsize=(8, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1.4))
    upper.stackplot(
        drops, shares, labels=[word for word, _ in _WORDS], colors=[colour for _, colour in _WORDS]
    )
    upper.set(ylim=(0, 100), xlim=(drops[0], drops[-1]), ylabel="of such policies, %")
    for axes in (upper, lower):
        for drop in (margins.tolerate, margins.max_drop):
            axes.axvline(drop, color="black", linewidth=1, linestyle="--")
    for drop, name in ((margins.tolerate, "tolerate"), (margins.max_drop, "max_drop")):
        upper.annotate(f"{name} {drop:g}", (drop, 100), (3, 4), textcoords="offset points")
    upper.legend(loc="center right", reverse=True)
    # A dollar sign in a title begins no formula.
    figure.suptitle(title, parse_math=False)
    lower.plot(drops, [point.trials for point in points], color="#34495e", marker="o")
    lower.set(ylim=(0, None), xlabel="true drop of mean success", ylabel="trials, mean")
    lower.grid(alpha=0.3)
    with atomic_path(followed(path)) as temporary:
        figure.savefig(temporary, format="png", dpi=100, metadata={"Software": None})
