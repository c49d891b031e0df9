"""A matrix of scores: rows against columns, with the numbers in the cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nw_eval.learn.studies.figures.paper import WIDTH, folded, save
from nw_eval.plural import plural

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from nw_eval.learn.studies.scores import Score

_CELL = 0.88
"""inches; a cell's numbers take three quarters of it."""
_NAMES = 1.7
_DARK = 0.5
"""Below this success a cell is dark and its numbers white."""


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
    save(figure, path)


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
