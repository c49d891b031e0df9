"""How far points are from others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.gaussians.kernels.nearby import least_square_distances


def distances(points: NDArray[np.floating], others: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return (N,) how far the nearest of `others` (M, 3), M > 0, is from each of (N, 3)."""
    squares = np.empty(len(points))
    places, candidates = (np.ascontiguousarray(each, np.float64) for each in (points, others))
    least_square_distances(places, candidates, squares)
    return np.sqrt(squares)
