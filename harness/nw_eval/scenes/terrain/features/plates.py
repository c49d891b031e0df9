"""Boxes whose upper face is a given plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import FaceKind
from nw_eval.scenes.scene import Box
from nw_eval.scenes.terrain.solids import Friction

Values = NDArray[np.float64]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Plate:
    """A rectangle in the plan that carries a box below a plane.

    Attributes:
        origin: (2,) middle in the plan, metres, world.
        along: (2,) unit vector of the first side; the second side is a quarter turn to the left.
        half: half lengths of the sides in the plan, metres.
        top: height of the plane at `origin`.
        slopes: rise of the plane per metre along the two sides.
        thickness: vertical extent of the box below the plane, metres.
    """

    origin: Values
    along: Values
    half: tuple[float, float]
    top: float
    slopes: tuple[float, float]
    thickness: float

    @property
    def across(self) -> Values:
        """(2,) unit vector of the second side."""
        return np.array([-self.along[1], self.along[0]])

    def local(self, xy: Values) -> Values:
        """Return points (N, 2) of the plan in coordinates along the sides, from the middle."""
        offset = xy - self.origin
        return np.stack([offset @ self.along, offset @ self.across], axis=-1)

    def covers(self, xy: Values) -> NDArray[np.bool_]:
        """Return which points (N, 2) lie in the rectangle."""
        first, second = np.abs(self.local(xy)).T
        return (first <= self.half[0]) & (second <= self.half[1])

    def plane(self, xy: Values) -> Values:
        """Return the height of the plane at points (N, 2)."""
        return self.top + self.local(xy) @ np.asarray(self.slopes)

    def box(self, *, friction: Friction, kind: FaceKind = "obstacle") -> Box:
        """Return the box."""
        first = np.array([*self.along, self.slopes[0]])
        second = np.array([*self.across, self.slopes[1]])
        normal = np.cross(first, second)
        normal /= np.linalg.norm(normal)
        x = first / np.linalg.norm(first)
        y = np.cross(normal, x)
        depth = self.thickness * float(normal[2]) / 2
        center = np.array([*self.origin, self.top]) - depth * normal
        half = (
            self.half[0] * float(np.linalg.norm(first)),
            self.half[1] * float(np.linalg.norm(second)),
            depth,
        )
        cx, cy, cz = (round(part, 6) for part in center.tolist())
        w, qx, qy, qz = quaternion(np.column_stack([x, y, normal]))
        return Box(
            # Micrometres: the last bits of a CPU change no digest.
            center=(cx, cy, cz),
            half_size=(round(half[0], 6), round(half[1], 6), round(half[2], 6)),
            quat=(round(w, 9) + 0.0, round(qx, 9) + 0.0, round(qy, 9) + 0.0, round(qz, 9) + 0.0),
            friction=friction,
            kind=kind,
        )


def quaternion(rotation: Values) -> Quaternion:
    """Return the w x y z quaternion, w >= 0, of a (3, 3) rotation matrix."""
    m = rotation.tolist()
    trace = m[0][0] + m[1][1] + m[2][2]
    # The largest component first: the others divide by it.
    squares = [trace, m[0][0], m[1][1], m[2][2]]
    largest = squares.index(max(squares))
    if largest == 0:
        w = 0.5 * math.sqrt(1.0 + trace)
        parts = [
            w,
            (m[2][1] - m[1][2]) / (4 * w),
            (m[0][2] - m[2][0]) / (4 * w),
            (m[1][0] - m[0][1]) / (4 * w),
        ]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q = 0.5 * math.sqrt(1.0 + m[i][i] - m[j][j] - m[k][k])
        parts = [0.0] * 4
        parts[0] = (m[k][j] - m[j][k]) / (4 * q)
        parts[1 + i] = q
        parts[1 + j] = (m[j][i] + m[i][j]) / (4 * q)
        parts[1 + k] = (m[k][i] + m[i][k]) / (4 * q)
    sign = -1.0 if parts[0] < 0 else 1.0
    w, x, y, z = (sign * part for part in parts)
    return w, x, y, z


def fit_plane(local: Values, z: Values) -> tuple[float, tuple[float, float], Values]:
    """Return height at 0, slopes, and residuals (N,) of the plane through points.

    Args:
        local: (N, 2) metres.
        z: (N,) metres.
    """
    # Normal equations by hand: LAPACK rounds differently from one CPU to the next.
    middle = local.mean(axis=0)
    x, y = (local - middle).T
    height = float(z.mean())
    xx, yy, xy = float((x * x).sum()), float((y * y).sum()), float((x * y).sum())
    xz, yz = float((x * z).sum()), float((y * z).sum())
    determinant = xx * yy - xy * xy
    if determinant > 1e-12 * max(xx, yy, 1e-9) ** 2:
        a = (xz * yy - yz * xy) / determinant
        b = (yz * xx - xz * xy) / determinant
    else:
        a, b = (xz / xx if xx > 0 else 0.0), 0.0
    residual = z - (height + a * x + b * y)
    return height - a * float(middle[0]) - b * float(middle[1]), (a, b), residual
