"""A comparison of policies as a picture: success and ranks above, scene by policy below."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nw_eval.clean import clean
from nw_eval.files.cache import atomic_path, followed
from nw_eval.gate.side_by_side import PolicyComparison
from nw_eval.plural import plural
from nw_eval.reporting.side_by_side.tables import ranks_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROW, _COLUMN, _NAMES = 0.3, 1.5, 3.0  # inches
_TALLEST = 60.0  # inches
_LONGEST = 40  # characters of a name
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
    suite, first = (
        clean(name, at_most=_LONGEST) for name in (found.suite, found.policies[0].label)
    )
    title = f"{suite}: mean success of {plural(found.starts, 'start')}, "
    title += f"{100 * found.confidence:.4g} % each alone"
    if any(each.shown and each.scene for each in found.partings):
        title += f"\nw2: parts from {first} at waypoint 2 of the scene"
    return title


def _draw_means(axes: Axes, found: PolicyComparison) -> None:
    for place, each in enumerate(found.policies):
        axes.plot([place, place], each.interval, color="black", linewidth=1.5)
        axes.plot(place, each.mean, "o", color="black")
        axes.annotate(f"{each.mean:.3f}", (place, each.mean), (8, -3), textcoords="offset points")
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
    names = [clean(each.scene, at_most=_LONGEST) for each in found.scenes]
    axes.set_yticks(range(len(names)), names, parse_math=False)
    labels = [
        f"{clean(each.label, at_most=_LONGEST)}\nrank {ranks_text(each)}" for each in found.policies
    ]
    axes.set_xticks(range(len(labels)), labels, parse_math=False)
