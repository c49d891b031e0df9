"""Figures of studies: no screen is needed, and colours differ for everybody."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, get_args

import numpy as np

from nw_eval.clean import clean
from nw_eval.files.cache import atomic_path
from nw_eval.learn.studies.plan import Part
from nw_eval.plural import plural

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nw_eval.learn.studies.scores import Score

_BAR = 0.36
_UNSEEN = 0.01
"""A bar of less height is drawn as a line."""
_OVER_A_LINE = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8}
PARTS: tuple[Part, ...] = get_args(Part)

_CELL = 0.88
"""inches; a cell's numbers take three quarters of it."""
_NAMES = 1.7
_DARK = 0.5
"""Below this success a cell is dark and its numbers white."""

COLOURS: dict[Part, str] = {"training": "#0072B2", "evaluation": "#E69F00"}
"""Blue and orange of Okabe and Ito (2008), which people with any colour vision tell apart."""

WIDTH = 8.0
"""Of a figure, inches; 800 pixels."""

_LONGEST = 60


def _save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100, metadata={"Software": None})


def folded(name: str, width: int) -> str:
    """Return a name, such as a scene's, in lines of so many letters."""
    words = clean(name, at_most=_LONGEST).replace("/", " ").replace("_", " ")
    return textwrap.fill(words, width)


def draw_bars(
    axes: Axes,
    places: Sequence[str],
    scores: Mapping[tuple[int, Part], Score],
    *,
    is_difference: bool = False,
) -> None:
    """Draw a pair of bars at each position, or points where they are differences.

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


def save_bars(figure: Figure, path: Path, title: str) -> None:
    """Write a figure of bars with its title, and what the colours of its parts are.

    Raises:
        StoreError: it cannot be written.
    """
    from matplotlib.patches import Patch

    patches = [Patch(color=COLOURS[part], label=f"{part} scenes") for part in PARTS]
    figure.suptitle(f"{title}: mean and 95 % interval", fontsize="large")
    figure.legend(handles=patches, loc="outside lower center", ncols=2, frameon=False)
    _save(figure, path)


def _around(scores: Mapping[tuple[int, Part], Score]) -> tuple[float, float]:
    """Return what of -1 to 1 is to be seen, with room for the numbers above."""
    ends = [end for each in scores.values() if each.estimate for end in each.estimate.interval]
    most = max([0.1, *(abs(end) for end in ends)])
    return -1.1 * most, 1.3 * most


def draw_matrix(
    path: Path,
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Mapping[tuple[int, int], Score],
    *,
    titles: tuple[str, str, str],
) -> None:
    """Draw mean success as a matrix.

    Args:
        path: of the PNG.
        rows: their names.
        columns: theirs.
        cells: scores by row and column; what is missing stays empty.
        titles: of the figure, its rows and its columns.

    Raises:
        StoreError: it cannot be written.
    """
    from matplotlib.figure import Figure

    wide = max(WIDTH, _NAMES + 1.0 + _CELL * len(columns))
    figure = Figure(figsize=(wide, 1.9 + 0.75 * len(rows)), layout="constrained")
    axes = figure.subplots()
    means = np.full((len(rows), len(columns)), np.nan)
    for place, score in cells.items():
        means[place] = np.nan if score.estimate is None else score.estimate.mean
    shown = axes.imshow(means, cmap="cividis", vmin=0.0, vmax=1.0, aspect="auto")
    for place, score in cells.items():
        _annotate(axes, place, score)
    title, down, across = titles
    axes.set_title(title, parse_math=False, fontsize="medium")
    axes.set_yticks(range(len(rows)), [folded(name, 18) for name in rows], parse_math=False)
    names = [folded(name, 11) for name in columns]
    axes.set_xticks(range(len(columns)), names, parse_math=False)
    axes.tick_params(labelsize=9, length=0)
    axes.set_ylabel(down)
    axes.set_xlabel(across)
    figure.colorbar(shown, ax=axes, label="mean success", fraction=0.04, pad=0.02)
    _save(figure, path)


def _annotate(axes: Axes, place: tuple[int, int], score: Score) -> None:
    row, column = place
    found = score.estimate
    if found is None:
        axes.text(column, row, "no result", ha="center", va="center", fontsize=9)
        return
    colour = "white" if found.mean < _DARK else "black"
    low, high = found.interval
    axes.text(
        column, row - 0.12, f"{found.mean:.2f}", ha="center", va="center", color=colour, fontsize=13
    )
    errors = f", {plural(score.errors, 'error')}" if score.errors else ""
    axes.text(
        column,
        row + 0.27,
        f"{low:.2f} to {high:.2f}\n{plural(found.n, 'trial')}{errors}",
        ha="center",
        va="center",
        color=colour,
        fontsize=8,
        linespacing=1.1,
    )
