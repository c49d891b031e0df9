"""Positions and orientations as MJCF writes them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.plural import plural
from nw_eval.scenes.limits import MESH_REACH, QUAT
from nw_eval.scenes.mesh import rotation_matrix
from nw_eval.scenes.neverwhere.xml_file import Element

Matrix = NDArray[np.float64]

_ORIENTATIONS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")


@dataclass(frozen=True, kw_only=True)
class Angles:
    """How a file writes angles.

    Attributes:
        unit: radians in one unit of the file.
        sequence: axes of Euler angles; small letters turn with the body, capitals do not.
    """

    unit: float
    sequence: str = "xyz"


def numbers(element: Element, name: str, counts: tuple[int, ...]) -> list[float] | None:
    """Return the numbers of an attribute, None if it is absent.

    Raises:
        SceneError: it holds something else, numbers of no place, or not as many as `counts` allows.
    """
    text = element.get(name)
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        raise element.error(f"{name}={text!r} is not a list of numbers") from None
    if not all(math.isfinite(value) for value in values):
        raise element.error(f"{name}={text!r} is not finite")
    if any(abs(value) > MESH_REACH for value in values):
        raise element.error(f"{name}={text!r}", fix=f"nothing may be beyond {MESH_REACH:g}")
    if len(values) not in counts:
        raise element.error(
            f"{name}={text!r} has {plural(len(values), 'number')}",
            fix="give " + " or ".join(map(str, counts)),
        )
    return values


def product(first: Matrix, second: Matrix) -> Matrix:
    """Return the matrix product of two small matrices, with the same bits on every CPU.

    BLAS adds in an order of its own, and digests of scenes count every bit.
    """
    return (first[:, :, None] * second[None, :, :]).sum(axis=1)


def moved(points: Matrix, transform: Matrix) -> Matrix:
    """Return points (N, 3) under a (4, 4) transform, with the same bits on every CPU."""
    x, y, z = points[:, :1], points[:, 1:2], points[:, 2:]
    linear = transform[:3, :3]
    return x * linear[:, 0] + y * linear[:, 1] + z * linear[:, 2] + transform[:3, 3]


def inverse(transform: Matrix) -> Matrix:
    """Return the inverse of an affine (4, 4) transform, with the same bits on every CPU."""
    a, b, c = transform[:3, 0], transform[:3, 1], transform[:3, 2]
    rows = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
    result = np.eye(4)
    result[:3, :3] = rows / (a * rows[0]).sum()
    result[:3, 3] = -(result[:3, :3] * transform[:3, 3]).sum(axis=1)
    return result


def pose(element: Element, angles: Angles) -> Matrix:
    """Return the (4, 4) transform from an element's frame to its parent's, metres."""
    transform = np.eye(4)
    position = numbers(element, "pos", (3,))
    if position is not None:
        transform[:3, 3] = position
    transform[:3, :3] = _rotation(element, angles)
    return transform


def _rotation(element: Element, angles: Angles) -> Matrix:
    named = [name for name in _ORIENTATIONS if element.get(name) is not None]
    if not named:
        return np.eye(3)
    if len(named) > 1:
        raise element.error(f"more than one orientation: {', '.join(named)}", fix="keep one")
    if named[0] == "quat":
        quat = numbers(element, "quat", (4,)) or []
        if sum(part * part for part in quat) * QUAT**2 < 1.0:
            raise element.error("quat is zero")
        return rotation_matrix(quat)
    if named[0] == "euler":
        return euler_rotation(numbers(element, "euler", (3,)) or [], angles)
    if named[0] == "axisangle":
        x, y, z, angle = numbers(element, "axisangle", (4,)) or []
        return _turn(np.array([x, y, z]), angle * angles.unit, element)
    if named[0] == "xyaxes":
        values = np.array(numbers(element, "xyaxes", (6,)))
        first = _unit(values[:3], element)
        second = _unit(values[3:] - (values[3:] @ first) * first, element)
        return np.column_stack([first, second, np.cross(first, second)])
    # The smallest turn that takes z to the given axis.
    axis = _unit(np.array(numbers(element, "zaxis", (3,))), element)
    about = np.cross([0.0, 0.0, 1.0], axis)
    angle = math.atan2(float(np.linalg.norm(about)), float(axis[2]))
    if not about.any():
        about = np.array([1.0, 0.0, 0.0])
    return _turn(about, angle, element)


def euler_rotation(values: list[float], angles: Angles) -> Matrix:
    """Return the (3, 3) rotation of three Euler angles: for `xyz`, Rx(a) Ry(b) Rz(c)."""
    rotation = np.eye(3)
    for value, axis in zip(values, angles.sequence, strict=True):
        c, s = math.cos(value * angles.unit), math.sin(value * angles.unit)
        i = "xyz".index(axis.lower())
        j, k = (i + 1) % 3, (i + 2) % 3
        turn = np.eye(3)
        turn[j, j] = turn[k, k] = c
        turn[k, j], turn[j, k] = s, -s
        rotation = product(rotation, turn) if axis.islower() else product(turn, rotation)
    return rotation


def _turn(axis: Matrix, angle: float, element: Element) -> Matrix:
    x, y, z = _unit(axis, element) * math.sin(angle / 2)
    return rotation_matrix((math.cos(angle / 2), float(x), float(y), float(z)))


def _unit(vector: Matrix, element: Element) -> Matrix:
    length = float(np.linalg.norm(vector))
    if length < 1e-12:
        raise element.error("an axis of its orientation is zero")
    return vector / length
