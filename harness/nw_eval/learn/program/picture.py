"""A training's curve as a picture: a panel for each group of names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from nw_eval.files.cache import atomic_path

_ACROSS = 3
_MOST_POINTS = 1000
"""Of a line: more are not seen, and take seconds to draw."""
_NAMED = 10
"""Lines that get a name in a panel's legend."""


def draw(
    path: Path,
    steps: Sequence[int],
    columns: Mapping[str, Sequence[float | None]],
    *,
    counts: str = "steps",
) -> None:
    """Draw columns over steps.

    Args:
        path: of the PNG; appears whole or not at all.
        steps: (N,).
        columns: (N,) each, by `group/name`; None is a hole that a line goes over.
        counts: what steps are, for the axis.

    Raises:
        StoreError: the picture cannot be written.
    """
    from matplotlib.figure import Figure

    groups: dict[str, list[str]] = {}
    for name in columns:
        groups.setdefault(name.rpartition("/")[0], []).append(name)
    across = min(_ACROSS, len(groups))
    down = math.ceil(len(groups) / across)
    width, height = 5.2 * across, 3.4 * down  # inches
    figure = Figure(figsize=(width, height))
    panels = figure.subplots(down, across, squeeze=False).flatten()
    # Margins for what stands around a panel; a layout that looks for them takes a second.
    figure.subplots_adjust(
        left=0.8 / width, right=1 - 0.2 / width, bottom=0.5 / height, top=1 - 0.4 / height,
        wspace=0.22, hspace=0.34,
    )  # fmt: skip
    unit, word = (1e6, f"million {counts}") if steps[-1] >= 1e6 else (1.0, counts)
    for axes, (group, names) in zip(panels, groups.items(), strict=False):
        for name in names:
            points = [
                (step / unit, value)
                for step, value in zip(steps, columns[name], strict=True)
                if value is not None
            ]
            points = points[:: math.ceil(len(points) / _MOST_POINTS)] if points else []
            axes.plot(
                [step for step, _ in points],
                [value for _, value in points],
                label=name.rpartition("/")[2],
                linewidth=1.2,
            )
        axes.set_title(group, parse_math=False)
        axes.set_xlabel(word)
        axes.grid(alpha=0.3)
        if 1 < len(names) <= _NAMED or not group:
            axes.legend(fontsize="small")
        elif len(names) == 1:
            axes.set_title(names[0], parse_math=False)
    for axes in panels[len(groups) :]:
        axes.remove()
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100, metadata={"Software": None})
