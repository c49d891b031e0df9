"""A scene from above: heights, trail and spawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nw_eval.files.cache import atomic_path, followed
from nw_eval.scenes.scene import Scene

_MARGIN = 1.6  # m around trail and spawn
_CELL = 0.02  # m
_LONGEST = 1200  # cells along a side
_TALLEST = 40.0  # inches


def draw_plan(scene: Scene, path: Path) -> None:
    """Draw a scene from above: ground heights by colour, trail and spawn on them.

    Raises:
        StoreError: the picture cannot be written.
    """
    from matplotlib.figure import Figure

    from nw_eval.scenes.rays import RayScene

    points = np.vstack([scene.trail[:, :2], scene.spawn.position[:2]])
    (x0, y0), (x1, y1) = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    cell = max(_CELL, (x1 - x0) / _LONGEST, (y1 - y0) / _LONGEST)
    xs, ys = np.arange(x0, x1, cell), np.arange(y0, y1, cell)
    grid = np.stack(np.meshgrid(xs, ys, indexing="xy"), axis=-1).reshape(-1, 2)
    heights = RayScene(scene.mesh()).height(grid).reshape(len(ys), len(xs))
    heights = np.where(np.isfinite(heights), heights, np.nan)
    tall = min(10 * (y1 - y0) / (x1 - x0), _TALLEST)
    figure = Figure(figsize=(10, tall + 1.2), layout="constrained")
    axes = figure.subplots()
    top = max(0.4, float(np.nanmax(scene.trail[:, 2])) + 0.1)
    low = min(-0.1, scene.ground.z)
    image = axes.imshow(
        np.clip(heights, low, top),
        origin="lower",
        extent=(x0, x1, y0, y1),
        cmap="viridis",
    )
    axes.plot(*scene.trail[:, :2].T, "o-", color="white", markeredgecolor="black", linewidth=1)
    for index, (px, py, pz) in enumerate(scene.trail.tolist()):
        axes.annotate(
            f"{index + 1}: {pz:.2f} m",
            (px, py),
            (7, 7),
            textcoords="offset points",
            bbox={"facecolor": "white", "alpha": 0.7, "pad": 1.5, "linewidth": 0},
        )
    x, y, _ = scene.spawn.position
    ahead = np.array([np.cos(scene.spawn.yaw), np.sin(scene.spawn.yaw)]) * 0.5
    axes.arrow(x, y, *ahead, width=0.04, color="red")
    # A dollar sign in a title begins no formula.
    axes.set_title(f"{scene.name}: {scene.title}", parse_math=False)
    axes.set(xlabel="x, m", ylabel="y, m")
    figure.colorbar(image, label="height of the ground, m", shrink=0.8)
    with atomic_path(followed(path)) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
