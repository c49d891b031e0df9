"""Planes that a place may have: where its surface is flat, and where edges of boxes crowd.

The side of a platform in the shade shows no surface, but its edges are points, and most things that
people build stand square to each other. Along each of three axes, of the largest planes, a plane is
supposed wherever points of edges crowd (Furukawa, Curless, Seitz and Szeliski, "Manhattan-world
stereo", 2009). What is oblique has to show a surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.reconstruct.depth.maps import DepthMap
from nw_eval.twin.reconstruct.depth.view import F64
from nw_eval.twin.reconstruct.mesh_file import ColourMesh
from nw_eval.twin.reconstruct.packages import package
from nw_eval.twin.reconstruct.planes.search import PlaneSearch

_MOST, _MISSES = 40, 4
"""Planes that a surface is searched for, and tries in vain that end it."""
_PATCH = 40.0
"""Voxels: edge of the square by which the area of a plane is counted."""
_LEAST = 0.3
"""Such squares that a plane of the surface has."""
_SHELL = 2.5
"""Voxels from a plane within which no other is sought that faces nearly as it does."""
_FACING = 0.85
_EDGE = 6.0
"""Grey levels per pixel from which on a point is of an edge."""
_ALONG = 14
"""Planes that are supposed along an axis at most."""
_CROWD = 3.25
"""Times as many points of edges as is usual about there: a crowd."""
_ABOUT = 31
"""Half voxels of that surrounding."""
_LARGE = 1.0
"""Squares of a plane whose own points are left out when crowds are sought a second time."""
_SAME = 1.5
"""Voxels by which a supposed plane is none of its own."""
_UPRIGHT = 0.05
_DEAREST = 0.25
"""Cost of the smallest plane, of 1 for the worst match."""
_SUPPOSED = 0.2
"""Squares that a plane of edges counts as."""
_SQUARE_SHARE = 0.3
"""Of that cost, for planes that lie along the axes: chance seldom puts one there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SupposedPlane:
    """A plane n . x = offset in the capture's frame.

    Attributes:
        normal: (3,) unit vector.
        offset: along it.
        prior: cost of supposing it, 0 for large planes.
        one_sided: whether it is only seen from where its normal points.
    """

    normal: F64
    offset: float
    prior: float
    one_sided: bool

    def turned(self) -> SupposedPlane:
        """Return the same plane with its normal on the other side."""
        return SupposedPlane(
            normal=-self.normal, offset=-self.offset, prior=self.prior, one_sided=self.one_sided
        )


def hypotheses(surface: ColourMesh, maps: Sequence[DepthMap], voxel: float) -> list[SupposedPlane]:
    """Return the planes of a place, those of its surface first; none where nothing is flat.

    Args:
        surface: as it was cut from the volume.
        maps: that it came from.
        voxel: edge of a voxel.
    """
    found = _of_surface(surface, voxel)
    axes = _axes([normal for normal, _, _ in found])
    planes = [
        SupposedPlane(
            normal=normal,
            offset=offset,
            prior=_prior(squares) * (_SQUARE_SHARE if _is_square(normal, axes) else 1.0),
            one_sided=True,
        )
        for normal, offset, squares in found
    ]
    if axes is None:
        return planes
    points = np.concatenate([_points_of_edges(each) for each in maps])
    other = points[~_of_large(points, found, voxel)]
    known = [(plane.normal, plane.offset) for plane in planes]
    for axis in axes:
        for offset in (*_crowds(other @ axis, voxel), *_crowds(points @ axis, voxel)):
            if not any(_is_same(axis, offset, *one, _SAME * voxel) for one in known):
                known.append((axis, offset))
                prior = _SQUARE_SHARE * _prior(_SUPPOSED)
                planes.append(
                    SupposedPlane(normal=axis, offset=offset, prior=prior, one_sided=False)
                )
    return planes


def _of_surface(surface: ColourMesh, voxel: float) -> list[tuple[F64, float, float]]:
    """Return normal, offset and area in squares of the planes of a surface."""
    search = PlaneSearch.of(surface, voxel)
    free, found, misses = search.area > 0, [], 0
    rng = np.random.default_rng(0)
    for _ in range(_MOST):
        plane = search.best(free, rng)
        if plane is None:
            break
        normal, offset = plane
        near = free & search.near(normal, offset)
        squares = float(search.area[near].sum()) / (_PATCH * voxel) ** 2
        if squares < _LEAST:
            misses += 1
            if misses > _MISSES:
                break
            continue
        off = np.abs(search.points @ normal - offset)
        free &= ~(near | ((off < _SHELL * voxel) & (search.normals @ normal > _FACING)))
        found.append((normal, offset, squares))
    return found


def _of_large(
    points: F64, found: Sequence[tuple[F64, float, float]], voxel: float
) -> NDArray[np.bool_]:
    """Return which points (N,) lie on a plane so large that what is drawn on it would crowd."""
    near = np.zeros(len(points), dtype=bool)
    for normal, offset, squares in found:
        if squares >= _LARGE:
            near |= np.abs(points @ normal - offset) < _SAME * voxel
    return near


def _prior(squares: float) -> float:
    """Return the cost of a plane by its area: none from one square on, all below a sixteenth."""
    return _DEAREST * float(np.clip(-np.log2(max(squares, 1e-9)) / 4.0, 0.0, 1.0))


def _axes(normals: Sequence[F64]) -> tuple[F64, F64, F64] | None:
    """Return the normal of the largest plane, of the largest upright to it, and the third."""
    for other in normals[1:]:
        first = normals[0]
        if abs(other @ first) < _UPRIGHT:
            second = other - first * (first @ other)
            second = second / np.linalg.norm(second)
            return first, second, np.cross(first, second).astype(np.float64)
    return None


def _is_square(normal: F64, axes: tuple[F64, F64, F64] | None) -> bool:
    along = abs(float(normal @ axes[0])) if axes is not None else 0.5
    return along < _UPRIGHT or along > 1.0 - _UPRIGHT**2 / 2.0


def _is_same(axis: F64, offset: float, normal: F64, other: float, within: float) -> bool:
    turn = float(axis @ normal)
    return abs(turn) > 0.998 and abs(offset - np.sign(turn) * other) < within


def _points_of_edges(each: DepthMap) -> F64:
    """Return the points (N, 3) of a map at which its picture has an edge, capture's frame."""
    cv2 = package("cv2")
    view = each.view
    grey = cv2.GaussianBlur(view.grey, (0, 0), 1.0)
    slope = np.hypot(cv2.Sobel(grey, -1, 1, 0), cv2.Sobel(grey, -1, 0, 1)) / 8.0
    rows, columns = np.nonzero((slope > _EDGE) & (each.depth > 0))
    z = each.depth[rows, columns].astype(np.float64)
    x = (columns + 0.5 - view.K[0, 2]) / view.K[0, 0] * z
    y = (rows + 0.5 - view.K[1, 2]) / view.K[1, 1] * z
    T = np.linalg.inv(view.T_camera_world)
    return np.column_stack([x, y, z]) @ T[:3, :3].T + T[:3, 3]


def _crowds(places: F64, voxel: float) -> list[float]:
    """Return where places (N,) along an axis crowd, the densest first."""
    if len(places) == 0:
        return []
    low, high = np.percentile(places, [0.5, 99.5])
    cells = np.arange(low, high, 0.5 * voxel)
    if len(cells) < _ABOUT:
        return []
    count = np.histogram(places, cells)[0].astype(np.float64)
    smooth = np.convolve(count, [0.25, 0.5, 1.0, 0.5, 0.25], "same")
    usual = np.convolve(count, np.full(_ABOUT, 1.0 / _ABOUT), "same")
    peak = smooth > _CROWD * usual
    peak &= (smooth > np.roll(smooth, 1)) & (smooth >= np.roll(smooth, -1))
    peak[:2] = peak[-2:] = False
    order = np.flatnonzero(peak)
    order = order[np.argsort(-(smooth - 2.5 * usual)[order], kind="stable")][:_ALONG]
    found = []
    for i in order:
        weights = count[i - 2 : i + 3] + 1e-9
        middles = cells[i - 2 : i + 3] + 0.25 * voxel
        found.append(float((middles * weights).sum() / weights.sum()))
    return found
