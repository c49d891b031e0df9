"""A sweep as a picture: success by the value of each axis, with intervals and cliffs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.files.cache import atomic_path
from nw_eval.gate.sweep import AxisCurve
from nw_eval.reporting.sweep.words import axis_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = ("#1b6ca8", "#c8553d", "#3a7d44", "#7b4b94")
_LONGEST = 40  # characters of a name
_WIDE, _TALL = 5.0, 3.6  # inches of an axis
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
    figure = Figure(figsize=(_WIDE * columns, _TALL * rows + 0.6), layout="constrained")
    figure.suptitle(clean(title, at_most=200), parse_math=False, fontsize="medium")
    places = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for place, curves in zip(places, axes, strict=False):
        for number, curve in enumerate(curves):
            _draw(place, curve, number)
        place.set(ylim=(-0.04, 1.04), xlabel=axis_label(curves[0].axis))
        place.grid(alpha=0.3)
    for place in places[len(axes) :]:
        place.set_visible(False)
    for place in places[::columns]:
        place.set_ylabel("success")
    figure.legend(*places[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)


def _draw(axes: Axes, curve: AxisCurve, number: int) -> None:
    colour, aside = _COLOURS[number % len(_COLOURS)], _ASIDE * number
    known = [point for point in curve.points if point.mean is not None]
    span = curve.points[-1].value - curve.points[0].value
    values = [point.value + aside * span for point in known]
    label = clean(curve.policy, at_most=_LONGEST)
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
