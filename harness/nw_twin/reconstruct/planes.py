"""Planes that a scene may have: where its surface is flat, and where edges of boxes crowd.

The side of a platform in the shade shows no surface, but its edges are points, and most things that
people build stand square to each other. Along each of three axes, of the largest planes, a plane is
supposed wherever points of edges crowd (Furukawa, Curless, Seitz and Szeliski, "Manhattan-world
stereo", 2009). What is oblique has to show a surface: planes of a mesh are grown each from a
vertex, as RANSAC tries many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_twin.packages import package
from nw_twin.reconstruct.depth import DepthMap
from nw_twin.reconstruct.surface import ColourMesh
from nw_twin.reconstruct.views import F64

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

BAND = 1.0
"""Voxels from a plane within which a vertex may be of it."""
COSINE = np.cos(np.deg2rad(25.0))
_TRIES = 24
_SAMPLE = 20_000
"""Vertices that a plane is sought among."""
_FIRST = 8.0
"""Voxels about a seed that its first plane is fitted to."""
_LEAST_FIT = 8
"""Vertices that a plane is fitted to."""
_PIXELS, _LEAST_PIXELS = 1_000_000, 400
"""Of all pictures that planes are fitted to in the end, and of one plane."""


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
    """Return the planes of a scene, those of its surface first; none where nothing is flat.

    Args:
        surface: as it was cut from the volume.
        maps: that it came from.
        voxel: edge of a voxel.
    """
    measured = Measured.of(maps)
    surface_planes = [
        (*measured.fitted(normal, offset, voxel), squares)
        for normal, offset, squares in _of_surface(surface, voxel)
    ]
    axes = _axes([normal for normal, _, _ in surface_planes])
    planes = [
        SupposedPlane(
            normal=normal,
            offset=offset,
            prior=_prior(squares) * (_SQUARE_SHARE if _is_square(normal, axes) else 1.0),
            one_sided=True,
        )
        for normal, offset, squares in surface_planes
    ]
    if axes is None:
        return planes
    points = np.concatenate([_points_of_edges(each) for each in maps])
    other = points[~_of_large(points, surface_planes, voxel)]
    known = [(plane.normal, plane.offset) for plane in planes]
    for axis in axes:
        for crowd in (*_crowds(other @ axis, voxel), *_crowds(points @ axis, voxel)):
            offset = measured.shifted(axis, crowd, voxel)
            if not any(_is_same(axis, offset, *one, _SAME * voxel) for one in known):
                known.append((axis, offset))
                prior = _SQUARE_SHARE * _prior(_SUPPOSED)
                planes.append(
                    SupposedPlane(normal=axis, offset=offset, prior=prior, one_sided=False)
                )
    return planes


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """What pixels of all maps show, at most `_PIXELS` of them, in the capture's frame.

    Attributes:
        points: (N, 3).
        normals: (N, 3) of unit length.
        weight: (N,) by confidence, and by how exact a depth is.
    """

    points: F64
    normals: F64
    weight: F64

    @classmethod
    def of(cls, maps: Sequence[DepthMap]) -> Measured:
        """Return every n-th of the pixels whose depth is known."""
        step = max(1, -(-sum(int((each.depth > 0).sum()) for each in maps) // _PIXELS))
        points, normals, weights = [np.empty((0, 3))], [np.empty((0, 3))], [np.empty(0)]
        for each in maps:
            rows, columns = (index[::step] for index in np.nonzero(each.depth > 0))
            depth = each.depth[rows, columns].astype(np.float64)
            points.append(_points(each, rows, columns))
            turn = each.view.T_camera_world[:3, :3]
            normals.append(each.normal[rows, columns].astype(np.float64) @ turn)
            # The error of a depth by matching grows with its square.
            weights.append(each.confidence[rows, columns] / depth**4)
        return cls(
            points=np.concatenate(points),
            normals=np.concatenate(normals),
            weight=np.concatenate(weights),
        )

    def fitted(self, normal: F64, offset: float, voxel: float) -> tuple[F64, float]:
        """Return a plane fitted to the pixels on it; as it is where they are few.

        A surface is smooth where it bends, so that a plane of its vertices leans towards what it
        ends at; a pixel's own depth does not.
        """
        for band in (BAND, *(0.5 * BAND,) * 2):
            near = np.abs(self.points @ normal - offset) < band * voxel
            near &= self.normals @ normal > COSINE
            if near.sum() < _LEAST_PIXELS:
                break
            normal, offset = _middle(
                self.points[near], self.weight[near], normal, offset, 0.1 * voxel
            )
        return normal, offset

    def shifted(self, axis: F64, offset: float, voxel: float) -> float:
        """Return the offset of a plane of edges by the pixels that face along its axis."""
        off = self.points @ axis - offset
        near = (np.abs(off) < BAND * voxel) & (np.abs(self.normals @ axis) > COSINE)
        return offset + (float(np.median(off[near])) if near.sum() >= _LEAST_PIXELS else 0.0)


def _middle(
    points: F64, weight: F64, normal: F64, offset: float, least: float
) -> tuple[F64, float]:
    """Return a plane fitted again to those of the points near it that are not off their middle."""
    off = points @ normal - offset
    middle = float(np.median(off))
    spread = 1.4826 * float(np.median(np.abs(off - middle)))
    near = np.abs(off - middle) <= max(2.0 * spread, least)
    return _fitted(points[near], weight[near], normal)


def _of_surface(surface: ColourMesh, voxel: float) -> list[tuple[F64, float, float]]:
    """Return normal, offset and area in squares of the planes of a surface."""
    search = PlaneSearch.of(surface, voxel)
    free, planes, misses = search.area > 0, [], 0
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
        planes.append((normal, offset, squares))
    return planes


def _of_large(
    points: F64, planes: Sequence[tuple[F64, float, float]], voxel: float
) -> NDArray[np.bool_]:
    """Return which points (N,) lie on a plane so large that what is drawn on it would crowd."""
    near = np.zeros(len(points), dtype=bool)
    for normal, offset, squares in planes:
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
    return _points(each, rows, columns)


def _points(each: DepthMap, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> F64:
    """Return the points (N, 3) of pixels of a map, capture's frame."""
    view = each.view
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
    crowds = []
    for i in order:
        weights = count[i - 2 : i + 3] + 1e-9
        middles = cells[i - 2 : i + 3] + 0.25 * voxel
        crowds.append(float((middles * weights).sum() / weights.sum()))
    return crowds


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneSearch:
    """A mesh as planes are sought in it.

    Attributes:
        points: (V, 3).
        normals: (V, 3) of unit length, smoothed over neighbours.
        area: (V,) a third of that of its faces.
        links: sparse (V, V) of 0 and 1: which vertices share an edge.
        voxel: edge of a voxel.
    """

    points: F64
    normals: F64
    area: F64
    links: Any
    voxel: float

    @classmethod
    def of(cls, mesh: ColourMesh, voxel: float) -> PlaneSearch:
        """Return the search in a mesh of about one vertex to a voxel's face, not simplified."""
        normals, area = _of_vertices(mesh)
        links = _links(mesh)
        for _ in range(3):
            normals = links @ normals + normals
        unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        return cls(points=mesh.vertices, normals=unit, area=area, links=links, voxel=voxel)

    def near(self, normal: F64, offset: float, band: float = BAND) -> NDArray[np.bool_]:
        """Return which vertices (V,) lie within so many voxels of a plane, and face as it does."""
        off = np.abs(self.points @ normal - offset)
        return (off < band * self.voxel) & (self.normals @ normal > COSINE)

    def best(self, free: NDArray[np.bool_], rng: np.random.Generator) -> tuple[F64, float] | None:
        """Return the plane with the most free area near it of some tries; None without any.

        Args:
            free: (V,) which vertices are of no plane yet.
            rng: of the tries.
        """
        area = np.where(free, self.area, 0.0)
        if not area.any():
            return None
        rows = np.flatnonzero(area)
        weight = area[rows] / area[rows].sum()
        if len(rows) > _SAMPLE:
            rows = rng.choice(rows, _SAMPLE, p=weight)
            weight = np.full(_SAMPLE, 1.0 / _SAMPLE)
        points, normals = self.points[rows], self.normals[rows]
        best, most = None, 0.0
        for seed in rng.choice(len(points), _TRIES, p=weight):
            normal, offset = _grown(points, normals, weight, int(seed), self.voxel)
            near = np.abs(points @ normal - offset) < BAND * self.voxel
            support = float(weight[near & (normals @ normal > COSINE)].sum())
            if support > most:
                best, most = (normal, offset), support
        return best


def _grown(points: F64, normals: F64, weight: F64, seed: int, voxel: float) -> tuple[F64, float]:
    """Return a plane through a seed, fitted to ever more of what lies near it."""
    centre, normal = points[seed], normals[seed]
    offset = float(centre @ normal)
    reach = np.linalg.norm(points - centre, axis=1)
    radius, band = _FIRST * voxel, BAND * voxel
    while True:
        off = points @ normal - offset
        near = (reach < radius) & (np.abs(off) < band) & (normals @ normal > COSINE)
        if near.sum() < _LEAST_FIT:
            return normal, offset
        normal, offset = _fitted(points[near], weight[near], normal)
        if radius > reach.max():
            break
        radius *= 2.0
    for _ in range(3):  # What belongs to a step or a mat is to have no say.
        off = points @ normal - offset
        near = (np.abs(off) < band) & (normals @ normal > COSINE)
        if near.sum() < _LEAST_FIT:
            break
        normal, offset = _middle(points[near], weight[near], normal, offset, 0.1 * voxel)
    return normal, offset


def _fitted(points: F64, weight: F64, like: F64) -> tuple[F64, float]:
    """Return the plane of least squares, its normal on the same side as `like`."""
    share = (weight / weight.sum())[:, None]
    centre = (points * share).sum(axis=0)
    rest = points - centre
    _, axes = np.linalg.eigh((rest[:, :, None] * rest[:, None, :] * share[:, :, None]).sum(axis=0))
    normal = axes[:, 0] * (1.0 if axes[:, 0] @ like >= 0.0 else -1.0)
    return normal, float(centre @ normal)


def _of_vertices(mesh: ColourMesh) -> tuple[F64, F64]:
    """Return each vertex's normal (V, 3), weighted by area, and a third of its faces' area."""
    normals, areas = np.zeros_like(mesh.vertices), np.zeros(len(mesh.vertices))
    faces = mesh.normals
    size = np.linalg.norm(faces, axis=1) / 6.0
    for k in range(3):
        corner = mesh.faces[:, k]
        areas += np.bincount(corner, size, minlength=len(areas))
        for axis in range(3):
            normals[:, axis] += np.bincount(corner, faces[:, axis], minlength=len(areas))
    return normals, areas


def _links(mesh: ColourMesh) -> Any:
    sparse = package("scipy.sparse")
    one, other = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    count = len(mesh.vertices)
    both = (np.concatenate([one, other]), np.concatenate([other, one]))
    matrix = sparse.coo_array((np.ones(len(both[0])), both), shape=(count, count)).tocsr()
    matrix.data[:] = 1.0
    return matrix
