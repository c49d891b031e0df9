"""Where photographs were taken from and through what, before distortion is removed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_twin.capture import FARTHEST
from nw_twin.lens import Lens

_ENTRY, _LAST = 10.0, 1e-6
"""Largest entry of what may be a rotation, and how far a last row may be from 0 0 0 1."""


@dataclass(frozen=True, kw_only=True)
class Placed:
    """One photograph whose camera is known.

    Attributes:
        name: of the photograph.
        lens: through which it was taken.
        T_world_camera: (4, 4) float64, OpenCV axes.
        seen: (K,) int32, sorted: numbers of the points that it shows.
    """

    name: str
    lens: Lens
    T_world_camera: NDArray[np.float64]
    seen: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Cameras and the points that they share.

    Attributes:
        placed: photographs whose cameras are known.
        points: (N, 3) float64.
        colours: (N, 3) uint8.
        errors: (N,) float32, pixels of the photographs.
    """

    placed: tuple[Placed, ...]
    points: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    colours: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    errors: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))

    @property
    def by_name(self) -> dict[str, Placed]:
        """The photographs by their names."""
        return {one.name: one for one in self.placed}


def inverse(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a pose (4, 4)."""
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
    return back


def check_pose(matrix: NDArray[np.float64], whose: str) -> None:
    """Check that the numbers of a (4, 4) matrix may be those of a pose.

    Raises:
        SceneError: one is not finite or too large, or the last row is not 0 0 0 1.
    """
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise SceneError(f"the pose of {whose} is not a finite 4x4 matrix", fix="export it again")
    if np.abs(matrix[:3, :3]).max() > _ENTRY:
        fault = f"is not a rotation: {matrix[:3, :3].tolist()}"
    elif np.abs(matrix[3] - (0, 0, 0, 1)).max() > _LAST:
        fault = f"has the last row {matrix[3].tolist()}, not 0 0 0 1"
    elif np.abs(matrix[:3, 3]).max() > FARTHEST:
        fault = f"is at {matrix[:3, 3].tolist()}, over {FARTHEST:g} from the origin"
    else:
        return
    raise SceneError(f"the pose of {whose} {fault}", fix="export it again")


def rigid(matrix: NDArray[np.float64], whose: str) -> NDArray[np.float64]:
    """Return a (4, 4) pose with its rotation made exact.

    Raises:
        SceneError: as `check_pose`; or its 3x3 block is no rotation, to one in a hundred.
    """
    check_pose(matrix, whose)
    u, _, v = np.linalg.svd(matrix[:3, :3])
    R = u @ v
    if np.abs(R - matrix[:3, :3]).max() > 0.01 or np.linalg.det(R) < 0:
        raise SceneError(
            f"the pose of {whose} is not a rotation"
            f"{': it mirrors' if np.linalg.det(R) < 0 else ''}: {matrix[:3, :3].tolist()}",
            fix="export it again, in right-handed axes",
        )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, matrix[:3, 3]
    return T
