"""Plots of numbers over the seconds before a moment."""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_eval.view.trace import Series

_SECONDS = 4.0
"""Before the moment, that a plot shows."""
_COLOURS = ("#1973f0", "#e8590c", "#2b8a3e", "#8641c4")


def window(series: Series, moment: float) -> tuple[Any, ...]:
    """Return what a plot shows at a moment, s: times, then a column for each line."""
    last = int(np.searchsorted(series.times, moment + 1e-6, side="right"))
    first = int(np.searchsorted(series.times, moment - _SECONDS))
    rows = slice(first, max(last, first + 1))
    return (series.times[rows], *series.values[rows].T)


def plot_of(gui: Any, series: Series) -> Any:
    """Add a plot to viser's panel, at the beginning of its series; return its handle."""
    from viser import uplot

    lines = [
        uplot.Series(label=name, stroke=_COLOURS[n % len(_COLOURS)], width=1)
        for n, name in enumerate(_names(series))
    ]
    return gui.add_uplot(
        data=window(series, 0.0),
        series=(uplot.Series(label="s"), *lines),
        title=series.title,
        legend=uplot.Legend(show=len(lines) <= 3),
        scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
        aspect=2.0,
    )


def _names(series: Series) -> tuple[str, ...]:
    return series.names or tuple(str(n) for n in range(series.values.shape[1]))
