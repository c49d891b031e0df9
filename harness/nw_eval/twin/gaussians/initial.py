"""Gaussians to begin with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.splat.gaussians import SH0, SH_COUNTS, Gaussians
from nw_eval.twin.gaussians.kernels.nearby import NEIGHBOURS, mean_square_distances

LEAST_SQUARE = 1e-7
"""Least mean squared distance, so that points in one place get a size."""


def gaussians_at(
    points: NDArray[np.floating],
    colours: NDArray[np.floating],
    *,
    sh_degree: int = 1,
    opacity: float = 0.1,
    size: float = 1.0,
) -> Gaussians:
    """Return round Gaussians at points, as the 3DGS paper begins.

    Args:
        points: (N, 3), such as points on a mesh.
        colours: (N, 3), 0 to 1.
        sh_degree: 0 to 3; harmonics above the constant are 0.
        opacity: of each; MCMC begins with 0.5.
        size: standard deviation as a share of the root mean squared distance to the three nearest
            neighbours; MCMC begins with 0.1.

    Raises:
        SceneError: fewer than four points, or some are not finite.
    """
    if len(points) <= NEIGHBOURS or points.shape[1:] != (3,) or colours.shape != points.shape:
        raise SceneError(
            f"{points.shape} points with {colours.shape} colours",
            fix=f"give at least {NEIGHBOURS + 1} points (N, 3) and as many colours",
        )
    if not (np.isfinite(points).all() and np.isfinite(colours).all()):
        raise SceneError("points or colours are not finite", fix="leave those points out")
    order = np.argsort(points[:, 0], kind="stable")
    squares = np.empty(len(points))
    mean_square_distances(np.ascontiguousarray(points[order], dtype=np.float64), squares)
    distance = np.empty_like(squares)
    distance[order] = np.sqrt(np.maximum(squares, LEAST_SQUARE))
    n = len(points)
    sh = np.zeros((n, SH_COUNTS[sh_degree], 3), dtype=np.float32)
    sh[:, 0] = (colours - 0.5) / SH0
    return Gaussians(
        means=points.astype(np.float32),
        log_scales=np.repeat(np.log(size * distance)[:, None], 3, axis=1).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (n, 1)),
        opacity_logits=np.full(n, math.log(opacity / (1.0 - opacity)), dtype=np.float32),
        sh=sh,
    )
