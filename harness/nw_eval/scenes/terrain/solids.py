"""Solids that are no boxes: height fields, meshes of true triangles, round primitives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
Friction = tuple[float, float, float]

DEFAULT_FRICTION: Friction = (1.25, 0.3, 0.3)
"""Sliding, torsional and rolling coefficients of the published scenes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightField:
    """Ground given by its height on a regular grid, solid down to `floor`.

    Between samples it is what MuJoCo makes of it: two triangles a cell, divided along the diagonal
    from the lower left to the upper right sample.

    Attributes:
        center: x, y of the middle of the grid, metres.
        half_size: half extents along x and y, metres; samples lie on the border.
        heights: (R, C) float32, metres, world z. Row r is at y = center - half_size + r * step,
            column c likewise along x.
        floor: world z that the solid reaches down to, metres; below every height.
        friction: MuJoCo's sliding, torsional and rolling coefficients.
    """

    center: tuple[float, float]
    half_size: tuple[float, float]
    heights: NDArray[np.float32]
    floor: float
    friction: Friction = DEFAULT_FRICTION

    @property
    def spacing(self) -> tuple[float, float]:
        """Distance between samples along x and y, metres."""
        rows, columns = self.heights.shape
        return 2 * self.half_size[0] / (columns - 1), 2 * self.half_size[1] / (rows - 1)

    def height(self, xy: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the height at points (N, 2), (N,) metres; -inf outside the grid."""
        rows, columns = self.heights.shape
        low = np.subtract(self.center, self.half_size)
        u, v = ((np.asarray(xy, dtype=np.float64) - low) / self.spacing).T
        inside = (u >= 0) & (u <= columns - 1) & (v >= 0) & (v <= rows - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
        c = np.minimum(u.astype(np.int64), columns - 2)
        r = np.minimum(v.astype(np.int64), rows - 2)
        a, b = u - c, v - r
        z = self.heights.astype(np.float64)
        near, far = z[r, c], z[r + 1, c + 1]
        right, up = z[r, c + 1], z[r + 1, c]
        below = near + a * (right - near) + b * (far - right)
        above = near + b * (up - near) + a * (far - up)
        return np.where(inside, np.where(a >= b, below, above), -np.inf)


@dataclass(frozen=True, kw_only=True, eq=False)
class Triangles:
    """The triangles themselves: exact where a height field is not, and slow.

    Attributes:
        vertices: (V, 3) float64, metres, world.
        faces: (F, 3) int32.
        friction: MuJoCo's sliding, torsional and rolling coefficients.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    friction: Friction = DEFAULT_FRICTION


@dataclass(frozen=True, kw_only=True)
class Primitive:
    """A round solid of a parametric scene.

    Attributes:
        kind: which of MuJoCo's geoms.
        center: metres, world.
        size: as in MJCF, metres: sphere radius; capsule and cylinder radius and half length along
            z; ellipsoid radii.
        quat: orientation, w x y z.
        friction: MuJoCo's sliding, torsional and rolling coefficients.
    """

    kind: Literal["sphere", "capsule", "cylinder", "ellipsoid"]
    center: Vector
    size: tuple[float, ...]
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    friction: Friction = DEFAULT_FRICTION
