"""Gaussians to begin with, and how far points are from others."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.splat.gaussians import SH0, SH_COUNTS, Gaussians
from nw_eval.twin.gaussians.kernels.rows import (
    NEIGHBOURS,
    least_square_distances,
    mean_square_distances,
)

LEAST_SQUARE = 1e-7
"""Least mean squared distance, so that points in one place get a size."""
FLAT = 0.1
"""Thickness of a Gaussian that lies in a surface, as a share of its size along it."""


def gaussians_at(
    points: NDArray[np.floating],
    colours: NDArray[np.floating],
    normals: NDArray[np.floating] | None = None,
    *,
    sh_degree: int = 1,
    opacity: float = 0.1,
    size: float = 1.0,
) -> Gaussians:
    """Return Gaussians at points: round ones, as the 3DGS paper begins, or flat ones.

    Round Gaussians of a floor stand out of it. From above that does not show, so no photograph
    mends it, but a robot that looks along the floor sees fog in front of all edges.

    Args:
        points: (N, 3), such as points on a mesh.
        colours: (N, 3), 0 to 1.
        normals: (N, 3) unit vectors of the surface that the Gaussians lie in; None = round ones.
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
    log_scales = np.repeat(np.log(size * distance)[:, None], 3, axis=1)
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (n, 1))
    if normals is not None:
        log_scales[:, 2] += math.log(FLAT)
        quats = _upright_to(normals)
    sh = np.zeros((n, SH_COUNTS[sh_degree], 3), dtype=np.float32)
    sh[:, 0] = (colours - 0.5) / SH0
    return Gaussians(
        means=points.astype(np.float32),
        log_scales=log_scales.astype(np.float32),
        quats=quats.astype(np.float32),
        opacity_logits=np.full(n, math.log(opacity / (1.0 - opacity)), dtype=np.float32),
        sh=sh,
    )


def _upright_to(normals: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return unit quaternions (N, 4), wxyz, of the shortest turns of the z axis to (N, 3)."""
    # A surface has two sides: the one that looks up is never the opposite of the z axis.
    x, y, z = (normals * np.where(normals[:, 2:] < 0.0, -1.0, 1.0)).astype(np.float64).T
    quats = np.stack([1.0 + z, -y, x, np.zeros_like(z)], axis=1)
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def distances(points: NDArray[np.floating], others: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return (N,) how far the nearest of `others` (M, 3), M > 0, is from each of (N, 3)."""
    squares = np.empty(len(points))
    places, candidates = (np.ascontiguousarray(each, np.float64) for each in (points, others))
    least_square_distances(places, candidates, squares)
    return np.sqrt(squares)
