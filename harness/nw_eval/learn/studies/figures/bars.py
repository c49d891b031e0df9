"""Bars of scores with their intervals, two to a place: training and evaluation scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from nw_eval.learn.studies.figures.paper import COLOURS
from nw_eval.learn.studies.plan import Part

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from nw_eval.learn.studies.scores import Score

_BAR = 0.36
_UNSEEN = 0.01
"""A bar of less height is drawn as a line."""
_OVER_A_LINE = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8}
PARTS: tuple[Part, ...] = get_args(Part)


def draw_bars(
    axes: Axes,
    places: Sequence[str],
    scores: Mapping[tuple[int, Part], Score],
    *,
    is_difference: bool = False,
) -> None:
    """Draw a pair of bars at each place, or points where they are differences.

    Args:
        axes: to draw in.
        places: names from left to right.
        scores: by place and part; what is missing leaves a hole.
        is_difference: whether they go from -1 to 1 around a line at 0.
    """
    # Numbers shrink where bars are narrow, as far as one can read them at 800 pixels.
    size = 9 if len(places) <= 4 else 8
    for (place, part), score in scores.items():
        if score.estimate is None:
            continue
        at = place + (PARTS.index(part) - 0.5) * _BAR * 1.1
        low, high = score.estimate.interval
        mean = score.estimate.mean
        if is_difference:
            axes.plot(at, mean, "o", color=COLOURS[part], markersize=6)
        else:
            axes.bar(at, mean, _BAR, color=COLOURS[part])
            if mean < _UNSEEN:
                axes.hlines(mean, at - _BAR / 2, at + _BAR / 2, color=COLOURS[part], linewidth=4)
        axes.plot([at, at], [low, high], color="black", linewidth=1.3)
        axes.annotate(
            f"{mean:+z.2f}" if is_difference else f"{mean:.2f}",
            (at, high),
            (0, 2),
            textcoords="offset points",
            ha="center",
            fontsize=size,
            bbox=_OVER_A_LINE if is_difference else None,
        )
    axes.set_xticks(range(len(places)), places, parse_math=False)
    axes.set_xlim(-0.6, len(places) - 0.4)
    axes.tick_params(axis="x", length=0, labelsize=9)
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)
    if is_difference:
        axes.axhline(0.0, color="black", linewidth=0.8)
        axes.set_ylim(*_around(scores))
    else:
        axes.set_ylim(0.0, 1.12)
        axes.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0])


def _around(scores: Mapping[tuple[int, Part], Score]) -> tuple[float, float]:
    """Return what of -1 to 1 is to be seen, with room for the numbers above."""
    ends = [end for each in scores.values() if each.estimate for end in each.estimate.interval]
    most = max([0.1, *(abs(end) for end in ends)])
    return -1.1 * most, 1.3 * most
