"""From the splat's frame to world metres."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.files.inside import regular, what_is
from nw_eval.scenes.limits import MESH_REACH, SCALES

Matrix = NDArray[np.float64]

# How far the linear part may be from a rotation times a scale, relative to the scale.
_TOLERANCE = 1e-3
_BYTES = 1_000_000


def read_normalisation(path: Path) -> Matrix:
    """Return T_n (4, 4), which maps the COLMAP frame to the splat's: `3dgs/data_transforms.json`.

    Its key `transform` holds three rows of four; the key `scale` is informative and not used. The
    identity if there is no such file.

    Raises:
        SceneError: the file holds something else, or no similarity.
    """
    if what_is(path) == "nothing":
        return np.eye(4)
    try:
        if regular(path).stat().st_size > _BYTES:
            raise SceneError(f"{path}: too large", fix="it holds one 3 x 4 matrix")
        content: Any = json.loads(path.read_bytes())
        rows = np.array(content["transform"], dtype=np.float64)
    except (OSError, ArithmeticError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise SceneError(
            f"{path}: no key `transform` with a 3 x 4 matrix ({type(error).__name__})",
            fix="write the file again, or remove it if the splat is in the COLMAP frame",
        ) from None
    if rows.shape not in {(3, 4), (4, 4)} or not (np.abs(rows) <= MESH_REACH).all():
        raise SceneError(
            f"{path}: `transform` has shape {rows.shape}, or numbers out of bounds",
            fix=f"give 3 x 4 numbers, up to {MESH_REACH:g}",
        )
    transform = np.eye(4)
    transform[:3] = rows[:3]
    check_similarity(transform, str(path))
    return transform


def check_similarity(transform: Matrix, origin: str) -> float:
    """Return the scale of a (4, 4) similarity.

    Raises:
        SceneError: it stretches, mirrors or flattens.
    """
    linear = transform[:3, :3]
    determinant = float(np.linalg.det(linear))
    if determinant <= 0:
        raise SceneError(
            f"{origin}: the transform {'mirrors' if determinant < 0 else 'flattens'}: "
            f"determinant {determinant:g}",
            fix="give a rotation times a positive scale",
        )
    scale = determinant ** (1 / 3)
    if not SCALES[0] <= scale <= SCALES[1]:
        raise SceneError(f"{origin}: its scale is {scale:g}", fix="check the unit")
    off = float(np.abs(linear.T @ linear / scale**2 - np.eye(3)).max())
    if off > _TOLERANCE:
        raise SceneError(
            f"{origin}: the transform stretches axes differently, by {off:.3g} of its scale "
            f"{scale:.4g}",
            fix="give a rotation times one scale",
        )
    return scale
