"""How far each point's nearest neighbours are."""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_eval.twin.gaussians.kernels.jit import kernel

NEIGHBOURS = 3


@kernel
def mean_square_distances(points: Any, out: Any) -> None:
    """Write the mean squared distance to the three nearest others.

    Along x, no point further on can be nearer once the step along x alone is too far: of points on
    surfaces, some hundred are looked at each.

    Args:
        points: (N, 3) float64, N > 3, ascending in x.
        out: (N,) float64, out.
    """
    n = len(points)
    for i in range(n):
        a = b = c = np.inf  # Ascending: the nearest three so far.
        for direction in (-1, 1):
            j = i + direction
            while 0 <= j < n:
                dx = points[j, 0] - points[i, 0]
                if dx * dx >= c:
                    break
                dy, dz = points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
                d = dx * dx + dy * dy + dz * dz
                if d < a:
                    a, b, c = d, a, b
                elif d < b:
                    b, c = d, b
                elif d < c:
                    c = d
                j += direction
        out[i] = (a + b + c) / NEIGHBOURS


@kernel
def least_square_distances(points: Any, others: Any, out: Any) -> None:
    """Write the squared distance to the nearest of other points.

    Args:
        points: (N, 3) float64.
        others: (M, 3) float64, M > 0.
        out: (N,) float64, out.
    """
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        least = np.inf
        for j in range(len(others)):
            dx, dy, dz = others[j, 0] - x, others[j, 1] - y, others[j, 2] - z
            least = min(least, dx * dx + dy * dy + dz * dz)
        out[i] = least
