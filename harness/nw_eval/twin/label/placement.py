"""Where a place lies in the world: a similarity, and the moves that change it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import rotation_matrix
from nw_eval.scenes.neverwhere.scan import check_similarity
from nw_eval.splat.transform import quaternions

Point = tuple[float, float, float]
"""x, y, z in the world, m."""

Axis = Literal["x", "y", "z"]


@dataclass(frozen=True, kw_only=True)
class Placement:
    """From the frame of the opened files to the world: scale, then rotation, then translation.

    Attributes:
        scale: metres in one unit of the files.
        quat: w x y z, of unit length.
        translation: m.
    """

    scale: float = 1.0
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    translation: Point = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, T: NDArray[np.float64]) -> Placement:
        """Return the placement of a (4, 4) similarity.

        Raises:
            SceneError: it stretches, mirrors or flattens, or its scale is out of bounds.
        """
        scale = check_similarity(T, "the place")
        w, x, y, z = quaternions(T[:3, :3] / scale).tolist()
        return cls(scale=scale, quat=(w, x, y, z), translation=as_point(T[:3, 3]))

    @property
    def matrix(self) -> NDArray[np.float64]:
        """T_world_file, (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = self.scale * rotation_matrix(self.quat)
        T[:3, 3] = self.translation
        return T


def turn(axis: Axis, angle: float, about: Point) -> NDArray[np.float64]:
    """Return the (4, 4) turn by an angle (rad, right-handed) about an axis through a point."""
    i = "xyz".index(axis)
    quat = [math.cos(angle / 2), 0.0, 0.0, 0.0]
    quat[1 + i] = math.sin(angle / 2)
    T = np.eye(4)
    T[:3, :3] = rotation_matrix(quat)
    T[:3, 3] = np.array(about) - T[:3, :3] @ np.array(about)
    return T


def shift(offset: Point) -> NDArray[np.float64]:
    """Return the (4, 4) shift by an offset, m."""
    T = np.eye(4)
    T[:3, 3] = offset
    return T


def stretch(factor: float) -> NDArray[np.float64]:
    """Return the (4, 4) scaling about the origin, which leaves a floor at z = 0 where it is."""
    return np.diag([factor, factor, factor, 1.0])


def mapped(points: NDArray[np.float64], T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (N, 3) under a (4, 4) transform."""
    return points @ T[:3, :3].T + T[:3, 3]


def as_point(values: NDArray[np.float64]) -> Point:
    """Return an array (3,) as a point of plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z
