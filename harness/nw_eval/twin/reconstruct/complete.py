"""Holes of flat planes, filled where photographs look at them and none looks through.

What has no texture has no depth: carpets and plain walls come out in patches. Where a plane lies
around a hole in all eight directions, and nothing was seen behind it, it goes on through the hole.
A gap between two platforms has them at two sides alone, and stays one. A plane that bounds the
place, as a floor does, goes on as well under what stands on it and hides it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.reconstruct.clean import FlatPlane
from nw_eval.twin.reconstruct.depth import DepthMap
from nw_eval.twin.reconstruct.mesh import ColourMesh
from nw_eval.twin.reconstruct.packages import package
from nw_eval.twin.reconstruct.planes import SupposedPlane

F64 = NDArray[np.float64]
Cells = NDArray[np.bool_]
Counts = NDArray[np.int64]

_BAND = 1.5
"""Voxels from a plane within which a vertex covers it."""
_COSINE = np.cos(np.deg2rad(35.0))
_CELL = 2.0
"""Voxels of a cell of the plane: it has room for eight faces."""
_FULL = 0.7
"""Share of a cell that faces cover; one with less has a hole."""
_CRACK = 4
"""Cells to each side among which what the mesh covers wholly must be met about a crack."""
_REACH = 64
"""Cells to each side among which the plane must be met again."""
_LARGEST = 4_000_000
"""Cells of a plane that is looked at."""
_BEHIND = 0.03
"""Share of its depth by which a surface lies before or behind the plane, and is no part of it."""
_LEAST_VIEWS = 2

_BANDS_BEHIND = 2.0
"""Bands from a plane, on the side that nobody sees, from which on a vertex lies behind it."""
_MOST_BEHIND = 0.02
"""Share of the vertices that may: what is far off and wrong."""


def complete(
    mesh: ColourMesh,
    planes: Sequence[FlatPlane],
    maps: Sequence[DepthMap],
    voxel: float,
    small: Sequence[FlatPlane] = (),
) -> tuple[ColourMesh, float]:
    """Return the mesh with the holes of its planes filled, and the area that was filled.

    Args:
        mesh: flattened.
        planes: of `flatten`.
        maps: depths by which a hole is told from a way through.
        voxel: edge of a voxel.
        small: planes of `flatten_small`: none of these bounds the place.
    """
    added, area = [mesh], 0.0
    normals = _vertex_normals(mesh)
    for plane in (*planes, *small):
        outer = plane in planes and bounds(mesh, plane, _BAND * voxel)
        patch = _patch(mesh, normals, plane, maps, _CELL * voxel, _BAND * voxel, outer)
        if patch is not None:
            added.append(patch)
            area += 0.5 * float(np.linalg.norm(patch.normals, axis=1).sum())
    return _joined(added), area


def on_planes(mesh: ColourMesh, planes: Sequence[FlatPlane | SupposedPlane], voxel: float) -> Cells:
    """Return whether each vertex (V,) lies on one of the planes and faces as it does."""
    normals, found = _vertex_normals(mesh), np.zeros(len(mesh.vertices), dtype=bool)
    for plane in planes:
        found |= _near(mesh, normals, plane, _BAND * voxel)
    return found


def _near(mesh: ColourMesh, normals: F64, plane: FlatPlane | SupposedPlane, band: float) -> Cells:
    normal = np.array(plane.normal)
    return (np.abs(mesh.vertices @ normal - plane.offset) < band) & (normals @ normal > _COSINE)


def _patch(
    mesh: ColourMesh,
    normals: F64,
    plane: FlatPlane,
    maps: Sequence[DepthMap],
    cell: float,
    band: float,
    outer: bool,
) -> ColourMesh | None:
    """Return quads for the cells of a plane that are to be filled; None without any."""
    normal = np.array(plane.normal)
    along, across = _axes(normal)
    near = _near(mesh, normals, plane, band)
    faces = near[mesh.faces].all(axis=1)
    if not faces.any():
        return None
    middles = mesh.vertices[mesh.faces[faces]].mean(axis=1)
    areas = 0.5 * np.linalg.norm(mesh.normals[faces], axis=1)
    flat = np.column_stack([middles @ along, middles @ across])
    low = flat.min(axis=0) - 1.25 * cell  # No face's middle lies just between two cells.
    shape = np.ceil((flat.max(axis=0) + cell - low) / cell).astype(np.int64)
    if shape.prod() > _LARGEST:
        return None
    known = np.zeros(tuple(shape))
    np.add.at(known, tuple(((flat - low) / cell).astype(np.int64).T), areas / cell**2)
    covered = known > 0.0
    whole = known >= _FULL
    # At the rim of a platform lie cells that faces cover in part: they are no holes.
    cracks = covered & ~whole & _enclosed(whole, _CRACK)
    holes = (_enclosed(covered, _REACH) & ~covered) | cracks
    if outer:
        off = mesh.vertices[behind(mesh, plane, band)] - low[0] * along - low[1] * across
        places = (np.column_stack([off @ along, off @ across]) / cell).astype(np.int64)
        places = places[((places >= 0) & (places < shape)).all(axis=1)]
        lower = np.zeros_like(covered)
        lower[tuple(places.T)] = True
        for _ in range(_CRACK):
            lower = _grown(lower)
        holes |= in_hull(covered) & ~covered & ~lower
    cells = np.argwhere(holes)
    centres = _points(low + (cells + 0.5) * cell, plane, along, across)
    views, through, colours = _seen(centres, maps)
    colours[views == 0] = mesh.colours[near].mean(axis=0)
    # One wrong depth among many is none.
    open_cells = (through <= views // 8) & (outer | (views >= _LEAST_VIEWS))
    holes[tuple(cells[~open_cells].T)] = False
    if not holes.any():
        return None
    paint = np.zeros((*shape, 3))
    paint[tuple(cells[open_cells].T)] = colours[open_cells]
    # A cell more on each side, which the mesh covers: no crack stays between them.
    return _quads(_grown(holes) & (holes | covered), holes, paint, low, cell, plane, along, across)


def _enclosed(covered: Cells, most: int) -> Cells:
    """Return the cells from which, at most so far, a covered one lies in each of 8 directions."""
    around = np.ones_like(covered)
    for step in [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]:
        met, reach = _shifted(covered, *step), 1
        while reach < most:  # What reaches n cells reaches 2n from n cells on.
            met |= _shifted(met, step[0] * reach, step[1] * reach)
            reach *= 2
        around &= met
    return around


def _shifted(cells: Cells, down: int, right: int) -> Cells:
    """Return cells moved, with none coming in at the sides."""
    out = np.zeros_like(cells)
    rows, columns = cells.shape
    if abs(down) >= rows or abs(right) >= columns:
        return out
    out[max(down, 0) : rows + min(down, 0), max(right, 0) : columns + min(right, 0)] = cells[
        max(-down, 0) : rows + min(-down, 0), max(-right, 0) : columns + min(-right, 0)
    ]
    return out


def _grown(cells: Cells) -> Cells:
    out = cells.copy()
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            out |= _shifted(cells, down, right)
    return out


def _seen(points: F64, maps: Sequence[DepthMap]) -> tuple[Counts, Counts, F64]:
    """Return how many maps look at points, how many of these through them, and their colours."""
    views, through = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    total = np.zeros((len(points), 3))
    for each in maps:
        view, T = each.view, each.view.T_camera_world
        local = points @ T[:3, :3].T + T[:3, 3]
        z = np.maximum(local[:, 2], 1e-9)
        u = view.K[0, 0] * local[:, 0] / z + view.K[0, 2]
        v = view.K[1, 1] * local[:, 1] / z + view.K[1, 2]
        height, width = view.size
        inside = (local[:, 2] > 0.0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        rows = np.flatnonzero(inside)
        x, y = u[rows].astype(np.int64), v[rows].astype(np.int64)
        depth, far = each.depth[y, x], z[rows]
        known = depth > 0.0
        hidden = known & (depth < far * (1.0 - _BEHIND))
        through[rows] += known & (depth > far * (1.0 + _BEHIND))
        rows, x, y = rows[~hidden], x[~hidden], y[~hidden]
        views[rows] += 1
        total[rows] += view.rgb[y, x]
    return views, through, total / np.maximum(views, 1)[:, None]


def _quads(
    cells: Cells,
    own: Cells,
    paint: F64,
    low: F64,
    cell: float,
    plane: FlatPlane,
    along: F64,
    across: F64,
) -> ColourMesh:
    """Return two triangles for each cell, counter-clockwise about the plane's normal."""
    rows, columns = cells.shape
    first = np.argwhere(cells)
    corners = first[:, None] + np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    numbers = corners[..., 0] * (columns + 1) + corners[..., 1]
    used, renumbered = np.unique(numbers, return_inverse=True)
    quads = renumbered.reshape(-1, 4)
    lattice = np.column_stack([used // (columns + 1), used % (columns + 1)])
    # A corner has the mean colour of the cells about it that were looked at, two to each side.
    total, count = np.zeros((rows + 3, columns + 3, 3)), np.zeros((rows + 3, columns + 3, 1))
    for down in range(4):
        for right in range(4):
            total[down : rows + down, right : columns + right] += paint * own[..., None]
            count[down : rows + down, right : columns + right] += own[..., None]
    total, count = total[1:-1, 1:-1], count[1:-1, 1:-1]
    at = tuple(lattice.T)
    colours = total[at] / np.maximum(count[at], 1.0)
    return ColourMesh(
        vertices=_points(low + lattice * cell, plane, along, across),
        faces=np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32),
        colours=np.round(np.clip(colours, 0.0, 255.0)).astype(np.uint8),
    )


def _axes(normal: F64) -> tuple[F64, F64]:
    """Return two unit vectors in a plane, right-handed with its normal."""
    along: F64 = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))]).astype(np.float64)
    along = along / np.linalg.norm(along)
    return along, np.cross(normal, along).astype(np.float64)


def _points(flat: F64, plane: FlatPlane, along: F64, across: F64) -> F64:
    return flat[:, :1] * along + flat[:, 1:] * across + plane.offset * np.array(plane.normal)


def _vertex_normals(mesh: ColourMesh) -> F64:
    total, faces = np.zeros_like(mesh.vertices), mesh.normals
    for k in range(3):
        for axis in range(3):
            corner = mesh.faces[:, k]
            total[:, axis] += np.bincount(corner, faces[:, axis], minlength=len(total))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)


def _joined(meshes: Sequence[ColourMesh]) -> ColourMesh:
    counts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + first for mesh, first in zip(meshes, counts, strict=False)]
    return ColourMesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate(faces).astype(np.int32),
        colours=np.concatenate([mesh.colours for mesh in meshes]),
    )


def behind(mesh: ColourMesh, plane: FlatPlane, band: float) -> NDArray[np.bool_]:
    """Return which vertices (V,) lie behind a plane by more than some of its bands."""
    return mesh.vertices @ np.array(plane.normal) - plane.offset < -_BANDS_BEHIND * band


def bounds(mesh: ColourMesh, plane: FlatPlane, band: float) -> bool:
    """Return whether a mesh lies before a plane, but for what is wrong."""
    return bool(behind(mesh, plane, band).mean() <= _MOST_BEHIND)


def in_hull(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells (H, W) within the convex hull of some; none if those lie on a line."""
    spatial = package("scipy.spatial")
    places = np.argwhere(cells)
    if len(places) < 3 or (np.ptp(places, axis=0) == 0).any():
        return np.zeros_like(cells)
    try:
        hull = spatial.ConvexHull(places)
    except spatial.QhullError:
        return np.zeros_like(cells)
    rows, columns = np.indices(cells.shape)
    found = np.ones(cells.shape, dtype=bool)
    for down, right, offset in hull.equations:
        found &= down * rows + right * columns + offset <= 1e-9
    return found
