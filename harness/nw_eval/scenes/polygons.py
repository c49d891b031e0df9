"""Cuts polygons into triangles; a notch stays open."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_EVEN = 1e-9
"""A corner is a notch if it turns back by more than this share of the polygon's area."""
_LOOKS = 4_000_000
"""Corners that are held against ears in one file: some seconds."""


class PolygonError(ValueError):
    """A polygon cannot be cut.

    Attributes:
        face: which one, counted from 0.
    """

    def __init__(self, face: int, reason: str) -> None:
        super().__init__(reason)
        self.face = face


def triangulated(
    vertices: NDArray[np.float64], counts: NDArray[np.int64], corners: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return (F, 3) triangles of polygons, in their order and with their winding.

    A polygon without a notch is cut as a fan from its first corner, one with a single notch as a
    fan from there, any other by ear clipping (Meisters 1975) in the plane of its Newell normal.

    Args:
        vertices: (V, 3) finite coordinates.
        counts: (P,) corners of each polygon, 3 at least.
        corners: (sum of counts,) numbers of vertices, polygon after polygon.

    Raises:
        PolygonError: a polygon with several notches crosses itself, or there are too many such.
    """
    firsts = np.cumsum(counts) - counts
    rows = np.cumsum(counts - 2) - (counts - 2)
    out = np.empty((int((counts - 2).sum()), 3), dtype=np.int64)
    looks = _LOOKS
    for n in np.unique(counts).tolist():
        faces = np.flatnonzero(counts == n)
        polygons = corners[firsts[faces, None] + np.arange(n)]
        if n > 3:
            notches = _notches(vertices[polygons])
            several = notches.sum(axis=1) > 1
            start = np.where(several, 0, notches.argmax(axis=1))
            turned = (start[:, None] + np.arange(n)) % n
            polygons = np.take_along_axis(polygons, turned, axis=1)
        else:
            several = np.zeros(len(faces), dtype=bool)
        fan = np.stack(
            [np.broadcast_to(polygons[:, :1], (len(faces), n - 2)), polygons[:, 1:-1],
             polygons[:, 2:]], axis=-1,
        )  # fmt: skip
        out[rows[faces, None] + np.arange(n - 2)] = fan
        for number in np.flatnonzero(several).tolist():
            face = int(faces[number])
            cut, looks = _clipped(vertices[polygons[number]], face, looks)
            out[rows[face] : rows[face] + n - 2] = polygons[number][cut]
    return out


def _normals(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P, 3) of polygons (P, n, 3), as long as twice their area (Newell)."""
    local = points - points[:, :1]
    return np.cross(local, np.roll(local, -1, axis=1)).sum(axis=1)


def _notches(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(P, n) corners at which polygons (P, n, 3) turn the other way."""
    normal = _normals(points)
    before = points - np.roll(points, 1, axis=1)
    after = np.roll(points, -1, axis=1) - points
    turn = np.einsum("pnk,pk->pn", np.cross(before, after), normal)
    return turn < -_EVEN * (normal**2).sum(axis=1, keepdims=True)


def _clipped(points: NDArray[np.float64], face: int, looks: int) -> tuple[list[list[int]], int]:
    """Return the triangles of one polygon (n, 3) as corners of it, and the looks that are left."""
    normal = _normals(points[None])[0]
    axis = int(np.abs(normal).argmax())
    u, v = ((1, 2), (2, 0), (0, 1))[axis]
    sign = 1.0 if normal[axis] > 0 else -1.0
    flat = [(p[u], p[v] * sign) for p in (points - points[0]).tolist()]
    even = _EVEN * float(np.abs(normal[axis]))

    def twice(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = flat[a], flat[b], flat[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    left = list(range(len(points)))
    cut: list[list[int]] = []
    at = failed = 0
    while len(left) > 3:
        looks -= len(left)
        if looks < 0:
            raise PolygonError(face, "its polygons have too many notches")
        at %= len(left)
        a, b, c = left[at - 1], left[at], left[(at + 1) % len(left)]
        size = twice(a, b, c)
        tips = (flat[a], flat[b], flat[c])
        ear = abs(size) <= even or (
            size > 0
            and not any(
                twice(a, b, p) >= -even and twice(b, c, p) >= -even and twice(c, a, p) >= -even
                for p in left
                if flat[p] not in tips
            )
        )
        if ear:
            cut.append([a, b, c])
            del left[at]
            failed = 0
            at -= 1
        else:
            failed += 1
            at += 1
            if failed > len(left):
                raise PolygonError(face, "a polygon crosses itself")
    cut.append(left)
    return cut, looks
