"""Moving Gaussians between frames, their harmonics included."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.splat.gaussians import Gaussians

_FIRST = (0, 1, 4, 9)


def transformed(gaussians: Gaussians, T: NDArray[np.float64]) -> Gaussians:
    """Return the Gaussians mapped by a similarity: rotation, positive scale, translation.

    Args:
        gaussians: N Gaussians in frame a.
        T: (4, 4) T_b_a.

    Returns:
        The same Gaussians in frame b.

    Raises:
        SceneError: when T is no similarity.
    """
    linear = np.asarray(T, dtype=np.float64)[:3, :3]
    determinant = float(np.linalg.det(linear))
    scale = abs(determinant) ** (1 / 3)
    rotation = linear / max(scale, 1e-300)
    if determinant <= 0 or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4:
        raise SceneError(
            f"not a similarity: determinant {determinant:g}", fix="give a rotation times a scale"
        )
    w, x, y, z = quaternions(rotation)
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return replace(
        gaussians,
        means=(gaussians.means @ linear.T + T[:3, 3]).astype(np.float32),
        log_scales=gaussians.log_scales + np.float32(math.log(scale)),
        quats=(gaussians.quats @ left.T).astype(np.float32),
        sh=rotate_harmonics(gaussians.sh, rotation),
    )


def rotate_harmonics(sh: NDArray[np.float32], rotation: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the (N, K, 3) coefficients of functions turned by a rotation: f'(R d) = f(d).

    Within a degree the harmonics span a space that rotations map to itself, so its matrix follows
    from values at enough directions: Y(d) c' = Y(R' d) c for all d.
    """
    out = sh.copy()
    directions = np.random.default_rng(1).normal(size=(64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    here, there = harmonics(directions), harmonics(directions @ rotation)
    for degree in (1, 2, 3):
        first = _FIRST[degree]
        part = slice(first, first + 2 * degree + 1)
        if first >= sh.shape[1]:
            break
        matrix = np.linalg.lstsq(here[:, part], there[:, part], rcond=None)[0]
        out[:, part] = np.einsum("ij,njc->nic", matrix.astype(np.float32), sh[:, part])
    return out


def harmonics(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 16) values of the real harmonics of degree 0 to 3 in 3DGS order, at unit directions."""
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    return np.stack(
        [
            np.full_like(x, 0.28209479177387814),
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
        axis=-1,
    )


def quaternions(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the w x y z (..., 4) of rotation matrices (..., 3, 3).

    The eigenvector of Davenport's matrix with the largest eigenvalue.
    """
    r = np.moveaxis(rotations, (-2, -1), (0, 1))
    rows = [
        [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
        [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2]],
        [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1]],
    ]
    davenport = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    return np.linalg.eigh(davenport)[1][..., 3]
