"""Missing surface: small gaps are closed, large ones stay open, and all of them are said."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.health.finding import SceneFinding
from nw_eval.scenes.terrain.features.regions import label_regions
from nw_eval.scenes.terrain.grid import Grid, shifted

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SMOOTHING = 30
# Square metres below which a gap is not worth a word.
_UNSAID = 1e-3
_MOST_FINDINGS = 10


def close_holes(
    heights: Values, grid: Grid, largest: float
) -> tuple[Values, Mask, tuple[SceneFinding, ...]]:
    """Interpolate over holes.

    Args:
        heights: (R, C) metres, nan where the mesh has no surface.
        grid: where they are.
        largest: square metres; larger holes, and what lies outside the mesh, stay nan.

    Returns:
        Heights, where they were interpolated (R, C), and the holes inside the mesh, largest first.
    """
    labels, count = label_regions(np.isnan(heights))
    sizes = np.bincount(labels.ravel(), minlength=count + 1) * grid.spacing**2
    rim = np.zeros(count + 1, dtype=np.bool_)
    rim[np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])] = True
    closes = ~rim & (sizes <= largest)
    closes[0] = False
    closed = closes[labels]
    points = grid.points()
    findings: list[SceneFinding] = []
    inner = [i for i in range(1, count + 1) if not rim[i] and sizes[i] > _UNSAID]
    for index in sorted(inner, key=lambda i: -sizes[i])[:_MOST_FINDINGS]:
        x, y = points[(labels == index).ravel()].mean(axis=0).tolist()
        findings.append(
            SceneFinding(
                code="hole",
                severity="warning",
                message=f"the mesh has a hole of {sizes[index]:.3f} m2 at ({x:.2f}, {y:.2f}), "
                + ("closed by interpolation" if closes[index] else "left open"),
                value=float(sizes[index]),
                place=(x, y, 0.0),
            )
        )
    return _interpolate(heights, closed), closed, tuple(findings)


def _interpolate(heights: Values, closed: Mask) -> Values:
    filled = heights.copy()
    if not closed.any():
        return filled
    rows, columns = np.nonzero(closed)
    box = (
        slice(max(rows.min() - 1, 0), rows.max() + 2),
        slice(max(columns.min() - 1, 0), columns.max() + 2),
    )
    part, mask = filled[box], closed[box]
    # From the rim inwards, then smoothed: a soap film over the hole.
    while (missing := mask & np.isnan(part)).any():
        around = shifted(part, np.nan)
        known = ~np.isnan(around)
        number = known.sum(axis=0)
        ready = missing & (number > 0)
        total = np.where(known, around, 0.0).sum(axis=0)
        part[ready] = total[ready] / number[ready]
    for _ in range(_SMOOTHING):
        around = shifted(part, np.nan)
        known = ~np.isnan(around)
        mean = np.where(known, around, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        part[mask] = mean[mask]
    filled[box] = part
    return filled
