"""What makes a surface a scene to walk in: one piece, flat where it is flat, of few faces.

Floors and walls that are flat are made flat, where the evidence agrees. What lies within a voxel of
a plane is compared with it patch by patch: noise is mean-free in a patch, a threshold, a mat or a
step is not. Only patches whose mean is as near to the plane as a single vertex is to its patch are
moved.

A plane that is nearly parallel to a larger one and lies over it is that same surface, found twice:
its faces that lie over those of the larger one go.

Small planes are made flat too, where photographs or edges speak for them. A slope, a tread or the
top of a box is a hundredth of all that photographs show: too little to be told from a rounded
corner by its area alone. But pixels were given planes that views agree on; what lies on one of
those is flat.

Then the parts that hang together are kept or dropped, and faces become fewer: flat parts become
coarse, edges stay fine (Garland and Heckbert 1997).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_twin.packages import package
from nw_twin.reconstruct.planes import PlaneSearch, SupposedPlane
from nw_twin.reconstruct.surface import ColourMesh, parts_of

F64 = NDArray[np.float64]

_PLANES = 12
_LEAST_AREA = 0.03
"""Of all area, below which a plane is not looked for: what is small may be a rounded corner."""
_PARALLEL = np.cos(np.deg2rad(1.0))
_APART = 6.0
"""Voxels between two parallel planes that may be one."""
_CELL = 2.0
"""Voxels: edge of a square of such a plane."""
_TWICE = 0.1
"""Share of its vertices that lie over the larger one, if it is that surface."""
_AROUND = 8
"""Of a square and the eight about it, those with vertices of the larger: at a step some lack."""
_RINGS = 16
"""Steps of averaging with neighbours: a patch is about four edges in radius."""
_BAND = 1.5
"""Voxels from a plane within which a vertex of an island lies."""
_LEAST_NOISE = 0.15
"""Voxels: agreement is not asked to be better than a voxel can show."""

ROOM = 480.0
"""Area of a small plane, in squares of a voxel's edge: about a step that a foot has room on."""

_CRUMB, _ISLAND = 0.8, 0.5
"""Share of a part's vertices that lie on a plane, if it is an island of it: chance puts most of a
crumb near one of a scene's many planes, and seldom half of what a foot has room on."""


@dataclass(frozen=True, kw_only=True)
class FlatPlane:
    """A plane n . x = offset that vertices were moved to.

    Attributes:
        normal: unit vector, out of the surface.
        offset: along it.
        area: of the vertices within a voxel of it.
        noise: standard deviation of a vertex from its patch, before.
        moved: share of those vertices that were moved all the way.
    """

    normal: tuple[float, float, float]
    offset: float
    area: float
    noise: float
    moved: float


def flatten(
    mesh: ColourMesh, voxel: float, measured: Sequence[SupposedPlane] = ()
) -> tuple[ColourMesh, list[FlatPlane]]:
    """Return the mesh with flat planes flat, and the planes, the largest first.

    No vertex moves by more than a voxel. The same mesh gives the same bits.

    Args:
        mesh: of about one vertex to a voxel's face, not simplified.
        voxel: edge of a voxel.
        measured: planes whose place is known better than the mesh shows it: pixels' depths gave it.
    """
    mesh = _one_sheet(mesh, voxel)
    search = PlaneSearch.of(mesh, voxel)
    vertices, planes = mesh.vertices.copy(), list[FlatPlane]()
    for normal, offset, near in _large_planes(search, [p for p in measured if p.one_sided]):
        shift, flat = flattened(search, near, normal, offset)
        vertices += shift
        planes.append(flat)
    planes.sort(key=lambda plane: -plane.area)
    return ColourMesh(vertices=vertices, faces=mesh.faces, colours=mesh.colours), planes


def _large_planes(
    search: PlaneSearch, measured: Sequence[SupposedPlane] = ()
) -> Iterator[tuple[F64, float, NDArray[np.bool_]]]:
    """Yield normal, offset and vertices (V,) of the large planes: measured ones, then others.

    Either are about the largest first.
    """
    area, rng = search.area, np.random.default_rng(0)
    free = area > 0
    for plane in measured:
        near = free & search.near(plane.normal, plane.offset)
        if area[near].sum() >= _LEAST_AREA * area.sum():
            free &= ~near
            yield plane.normal, plane.offset, near
    for _ in range(_PLANES):
        plane = search.best(free, rng)
        if plane is None:
            return
        normal, offset = plane
        near = free & search.near(normal, offset)
        if area[near].sum() < _LEAST_AREA * area.sum():
            return
        free &= ~near
        yield normal, offset, near


def _one_sheet(mesh: ColourMesh, voxel: float) -> ColourMesh:
    """Return the mesh without faces of a plane that lie over or under a larger one, near to it.

    What stands beside the larger one, as a step or a mat does, stays: the floor below is not
        visible.
    """
    search = PlaneSearch.of(mesh, voxel)
    larger: list[tuple[F64, float, NDArray[np.bool_]]] = []
    doubled = np.zeros(len(mesh.vertices), np.bool_)
    planes = sorted(_large_planes(search), key=lambda plane: -float(search.area[plane[2]].sum()))
    for normal, offset, near in planes:
        for other, place, whose in larger:
            apart = abs(float(np.median(search.points[near] @ other)) - place)
            if normal @ other > _PARALLEL and apart < _APART * voxel:
                over = _above(search.points, near, whose, other, _CELL * voxel)
                if over.sum() > _TWICE * near.sum():
                    doubled |= over
        larger.append((normal, offset, near))
    single = ~doubled[mesh.faces[:, 0]] & ~doubled[mesh.faces[:, 1]] & ~doubled[mesh.faces[:, 2]]
    return mesh if single.all() else mesh.keep(single)


def _above(
    points: F64, some: NDArray[np.bool_], others: NDArray[np.bool_], normal: F64, cell: float
) -> NDArray[np.bool_]:
    """Return which of some vertices (V,) have others above or below them, and all around there."""
    along = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    along = along / np.linalg.norm(along)
    flat = np.column_stack([points @ along, points @ np.cross(normal, along)])
    places = np.floor((flat - flat.min(axis=0)) / cell).astype(np.int64) + 1
    width = int(places[:, 1].max()) + 2
    cells = places @ np.array([width, 1])
    taken = np.unique(cells[others])
    around = np.zeros(int(some.sum()), np.int64)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            around += np.isin(cells[some] + down * width + right, taken)
    above = np.zeros(len(points), np.bool_)
    above[some] = around >= _AROUND
    return above


def flattened(
    search: PlaneSearch, near: NDArray[np.bool_], normal: F64, offset: float
) -> tuple[F64, FlatPlane]:
    """Return how vertices (V, 3) move that are made flat, and the plane.

    Args:
        search: the mesh.
        near: (V,) which vertices are of the plane.
        normal: (3,) of it.
        offset: along it.
    """
    off = search.points @ normal - offset
    share, noise = _agreement(search.links, off, near, search.voxel)
    x, y, z = (float(part) for part in normal)
    plane = FlatPlane(
        normal=(x, y, z),
        offset=offset,
        area=float(search.area[near].sum()),
        noise=noise,
        moved=float((share[near] == 1.0).mean()),
    )
    return -(share * off)[:, None] * normal, plane


def _agreement(links: Any, off: F64, near: NDArray[np.bool_], voxel: float) -> tuple[F64, float]:
    """Return which share of its distance each vertex is to be moved, and the noise of one."""
    inner = near.astype(np.float64)
    patch = off * inner
    for _ in range(_RINGS):
        total = links @ inner + inner
        patch = np.where(near, (links @ patch + patch) / np.maximum(total, 1.0), 0.0)
    noise = 1.4826 * float(np.median(np.abs(off - patch)[near]))
    bound = max(noise, _LEAST_NOISE * voxel)
    beyond = np.clip(np.abs(patch) / bound - 1.0, 0.0, 1.0)
    return np.where(near, 1.0 - beyond * beyond * (3.0 - 2.0 * beyond), 0.0), noise


def flatten_small(
    mesh: ColourMesh,
    planes: Sequence[FlatPlane],
    supposed: Sequence[SupposedPlane],
    voxel: float,
) -> tuple[ColourMesh, list[FlatPlane]]:
    """Return the mesh with supposed planes flat that it shows, and those, the largest first.

    No vertex moves by more than a voxel. The same mesh gives the same bits.

    Args:
        mesh: of `flatten`.
        planes: that it is flat on already.
        supposed: planes that pixels may have been given.
        voxel: edge of a voxel.
    """
    search = PlaneSearch.of(mesh, voxel)
    free = search.area > 0
    for plane in planes:
        free &= ~search.near(np.array(plane.normal), plane.offset)
    sides = [
        side
        for plane in supposed
        for side in ((plane,) if plane.one_sided else (plane, plane.turned()))
    ]
    areas = [float(search.area[free & search.near(s.normal, s.offset)].sum()) for s in sides]
    vertices, small = mesh.vertices.copy(), list[FlatPlane]()
    for number in np.argsort(-np.array(areas), kind="stable"):
        side = sides[number]
        near = free & search.near(side.normal, side.offset)
        if search.area[near].sum() < ROOM * voxel**2:
            continue
        shift, flat = flattened(search, near, side.normal, side.offset)
        vertices += shift
        free &= ~near
        small.append(flat)
    small.sort(key=lambda plane: -plane.area)
    return ColourMesh(vertices=vertices, faces=mesh.faces, colours=mesh.colours), small


def on_planes(
    mesh: ColourMesh, planes: Sequence[FlatPlane | SupposedPlane], voxel: float
) -> NDArray[np.bool_]:
    """Return whether each vertex (V,) lies on one of the planes and faces as it does."""
    search, on_plane = PlaneSearch.of(mesh, voxel), np.zeros(len(mesh.vertices), np.bool_)
    for plane in planes:
        on_plane |= search.near(np.array(plane.normal), plane.offset, _BAND)
    return on_plane


@dataclass(frozen=True, kw_only=True)
class PartsKept:
    """What became of a mesh's parts.

    Attributes:
        kept: how many.
        dropped: how many.
        dropped_area: of those, a share of all area.
    """

    kept: int
    dropped: int
    dropped_area: float


def large_parts(
    mesh: ColourMesh, least: float, flat: NDArray[np.bool_] | None = None, room: float = np.inf
) -> tuple[ColourMesh, PartsKept]:
    """Return a mesh of the largest part, of those with at least a share of its area, and flat ones.

    Args:
        mesh: to choose from.
        least: share.
        flat: (V,) whether a vertex lies on a plane of the scene; parts that do for the most are
            islands of a floor or a wall that is plain between them. None if unknown.
        room: area from which on a part is no crumb: the sides of a platform are not photographed
            that stands in a pit, so that its top hangs together with nothing.
    """
    count, part = parts_of(mesh.faces, len(mesh.vertices))
    own = part[mesh.faces[:, 0]]
    area = np.bincount(own, 0.5 * np.linalg.norm(mesh.normals, axis=1), minlength=count)
    large = area >= max(least * area.max(), 1e-300)
    if flat is not None:
        vertices = np.bincount(part, minlength=count)
        share = np.where(area < room, _CRUMB, _ISLAND)
        large |= np.bincount(part, flat, minlength=count) > share * vertices
    facts = PartsKept(
        kept=int(large.sum()),
        dropped=int(count - large.sum()),
        dropped_area=float(area[~large].sum() / max(area.sum(), 1e-300)),
    )
    return mesh.keep(large[own]), facts


@dataclass(frozen=True, kw_only=True)
class Hole:
    """A closed border of the surface; the longest one is usually its rim.

    Attributes:
        centre: (x, y, z) mean of the border.
        length: of the border.
        across: diagonal of the box about it.
    """

    centre: tuple[float, float, float]
    length: float
    across: float


def holes(mesh: ColourMesh) -> list[Hole]:
    """Return the borders, the longest first: edges of one face. Borders that touch are one."""
    edges = np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)]).astype(np.int64)
    count = len(mesh.vertices)
    keys = np.sort(edges, axis=1) @ np.array([count, 1])
    _, place, uses = np.unique(keys, return_index=True, return_counts=True)
    border = edges[place[uses == 1]]
    if len(border) == 0:
        return []
    used, local = np.unique(border, return_inverse=True)
    local = local.reshape(-1, 2)
    loops, whose = parts_of(local, len(used))
    ends = mesh.vertices[border]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    own = whose[local[:, 0]]
    order = np.argsort(own, kind="stable")
    holes: list[Hole] = []
    for rows in np.split(order, np.searchsorted(own[order], np.arange(1, loops))):
        points = ends[rows].reshape(-1, 3)
        x, y, z = points.mean(axis=0)
        span = points.max(axis=0) - points.min(axis=0)
        holes.append(
            Hole(
                centre=(float(x), float(y), float(z)),
                length=float(lengths[rows].sum()),
                across=float(np.linalg.norm(span)),
            )
        )
    return sorted(holes, key=lambda hole: (-hole.length, hole.centre))


def simplify(mesh: ColourMesh, most: int) -> ColourMesh:
    """Return the mesh with about `most` faces at most, and none that a file cannot hold.

    Raises:
        PrerequisiteError: Open3D is not installed.
    """
    o3d = package("open3d")
    shape = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.faces)
    )
    shape.vertex_colors = o3d.utility.Vector3dVector(mesh.colours / 255.0)
    simple = shape.simplify_quadric_decimation(most) if len(mesh.faces) > most else shape
    # As a file has them: what its single precision makes one vertex is one.
    simple.vertices = o3d.utility.Vector3dVector(np.asarray(simple.vertices).astype(np.float32))
    simple.remove_duplicated_vertices().remove_duplicated_triangles()
    simple.remove_degenerate_triangles().remove_unreferenced_vertices()
    faces = ColourMesh(
        vertices=np.asarray(simple.vertices).astype(np.float64),
        faces=np.asarray(simple.triangles).astype(np.int32),
        colours=np.round(np.asarray(simple.vertex_colors) * 255.0).astype(np.uint8),
    )
    return faces.keep((faces.normals != 0.0).any(axis=1))
