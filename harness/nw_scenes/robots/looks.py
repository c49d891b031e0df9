"""What a robot looks like: its meshes with fewer faces, thinned out once into the user's cache.

Vertices are clustered in the cells of a grid, and each cell's vertex stands where the planes of
its faces meet best: Lindstrom, "Out-of-core simplification of large polygonal models", SIGGRAPH
2000. It is coarser than to collapse edges one by one, but needs no closed surface: meshes of robots
are many loose shells.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Literal

import mujoco as _mujoco
import numpy as np
import numpy.typing as npt

from nw_base.errors import StoreError
from nw_base.files.cache import cache_dir, read_sealed, sealed_path
from nw_scenes.robots.compiled import CompiledRobot
from nw_scenes.robots.spec import Shape, Triangles

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

MOST_FACES = 20_000
"""Of all meshes of a robot together, as it is drawn."""

Array = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int64]

_VERSION = 1  # of the way in which meshes are thinned; another one writes other files
_FINEST = 1024  # cells along the longest side of a mesh's box
_HOLD = 1e-3  # how strongly a vertex is held at the middle of its cell's, beside the planes


def shares(faces: Sequence[int], sizes: Sequence[float], most: int = MOST_FACES) -> list[int]:
    """Return how many faces each mesh may keep, so that all have `most` together at most.

    Args:
        faces: how many each has.
        sizes: of each, m: as much larger one is than another, as many more faces it may keep.
        most: of all.
    """
    counts, weights = np.array(faces, dtype=np.int64), np.array(sizes)
    if counts.sum() <= most:
        return counts.tolist()
    low, high = 0.0, most / float(weights.min())
    for _ in range(60):
        middle = (low + high) / 2
        fits = np.minimum(counts, (middle * weights).astype(np.int64)).sum() <= most
        low, high = (middle, high) if fits else (low, middle)
    return np.minimum(counts, (low * weights).astype(np.int64)).tolist()


def kept_thinned(vertices: Array, faces: Faces, most: int) -> Triangles:
    """Return `thinned` from the cache; thin out on first use.

    Nothing is kept where the cache cannot be written.
    """
    words = f"{_VERSION} {most} {vertices.shape} {faces.shape}".encode()
    key = hashlib.sha256(words + vertices.tobytes() + faces.tobytes()).hexdigest()
    try:
        path = cache_dir("robots") / f"{key[:32]}.npz"
    except StoreError:
        return thinned(vertices, faces, most)
    # A file that is not there, or damaged, is written anew.
    with (
        suppress(StoreError, OSError, ValueError, KeyError, zipfile.BadZipFile),
        np.load(io.BytesIO(read_sealed(path)), allow_pickle=False) as kept,
    ):
        if bytes(kept["key"]).decode() == key:
            return Triangles.of(kept["vertices"], kept["faces"])
    fewer = thinned(vertices, faces, most)
    arrays: dict[str, Any] = {"vertices": fewer.vertices, "faces": fewer.faces}
    with suppress(StoreError), sealed_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, key=np.frombuffer(key.encode(), np.uint8), **arrays)
    return fewer


def thinned(vertices: Array, faces: Faces, most: int) -> Triangles:
    """Return a mesh with fewer faces.

    No vertex is farther from one of the original than the diagonal of a cell, which is as small as
    so few faces allow.

    Args:
        vertices: (V, 3) m.
        faces: (F, 3) rows of `vertices`, counter-clockwise from outside.
        most: how many faces it may have; as many or fewer stay as they are.
    """
    points, same = np.unique(vertices, axis=0, return_inverse=True)
    corners = _whole(same.reshape(-1)[faces])
    if len(corners) <= most:
        used, corners = np.unique(corners, return_inverse=True)
        return Triangles.of(points[used], corners.reshape(-1, 3))
    low = points.min(axis=0)
    side = max(float((points.max(axis=0) - low).max()), 1e-9)

    def clustered(count: int) -> tuple[Array, Faces, npt.NDArray[np.int64]]:
        """Return the cells (C, 3) that have vertices, faces between them, and each one's cell."""
        cells = np.minimum(((points - low) * (count / side)).astype(np.int64), count - 1)
        wide = count + 1
        flat = (cells[:, 0] * wide + cells[:, 1]) * wide + cells[:, 2]
        codes, own = np.unique(flat, return_inverse=True)
        own = own.reshape(-1)
        places = np.stack([codes // wide**2, codes // wide % wide, codes % wide], axis=1)
        return places * (side / count) + low, _whole(own[corners]), own

    # The finest grid that has no more faces; nearly always, a finer one has more.
    few, many = 1, _FINEST
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (middle, many) if len(clustered(middle)[1]) <= most else (few, middle)
    cells, kept, own = clustered(few)
    moved = _meeting(points, corners, cells, own, side / few)
    used, kept = np.unique(kept, return_inverse=True)
    return Triangles.of(moved[used], kept.reshape(-1, 3))


def _whole(faces: Faces) -> Faces:
    """Return the faces that have three corners, each once."""
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    # The least corner first: one that is turned round is another face, the back of a thin plate.
    first = faces.argmin(axis=1)[:, np.newaxis]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return np.unique(turned, axis=0)


def _meeting(
    points: Array, faces: Faces, cells: Array, own: npt.NDArray[np.int64], size: float
) -> Array:
    """Return where the planes of faces meet best in each cell, (C, 3).

    Args:
        points: (V, 3) of the original.
        faces: (F, 3) of the original.
        cells: (C, 3) lowest corners.
        own: (V,) the cell of each point.
        size: of a cell, m.
    """
    count = len(cells)
    members = np.maximum(np.bincount(own, minlength=count), 1)[:, np.newaxis]
    middles = np.stack([np.bincount(own, points[:, k], count) for k in range(3)], axis=1) / members
    corner = points[faces]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    normals = normals / np.maximum(areas, 1e-30)[:, np.newaxis]
    planes, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for k in range(3):
        cell = own[faces[:, k]]
        # From the middle of the cell's points: numbers of one size.
        offset = ((corner[:, k] - middles[cell]) * normals).sum(axis=1)
        for i in range(3):
            right[:, i] += np.bincount(cell, areas * normals[:, i] * offset, count)
            for j in range(3):
                planes[:, i, j] += np.bincount(cell, areas * normals[:, i] * normals[:, j], count)
    hold = _HOLD * np.trace(planes, axis1=1, axis2=2) + 1e-30
    planes += hold[:, np.newaxis, np.newaxis] * np.eye(3)
    moved = middles + np.linalg.solve(planes, right[..., np.newaxis])[..., 0]
    return np.clip(moved, cells, cells + size)


_MOST_SHAPES = 400  # that are drawn
_GRID = (
    2.0**14
)  # points of meshes stand on 1/16384 m: the zero bits compress, without a visible change
_PLAIN = (0.5, 0.5, 0.5, 1.0)  # the colour of a geom that has none of its own
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): ("sphere", 1),
    int(mujoco.mjtGeom.mjGEOM_BOX): ("box", 3),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", 2),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
}


def visuals_of(robot: CompiledRobot) -> tuple[tuple[Shape, ...], Literal["geoms", "visuals"]]:
    """Return what is drawn, and what of it pictures show.

    Where all that is only seen are primitives, pictures show these geoms. Else no mesh is left
    to physics, and a body without anything that is only seen shows what collides.
    """
    model = robot.model
    geoms = [g for g in range(model.ngeom) if colour_of(model, g)[3] > 0.0]
    only_seen = [g for g in geoms if str(model.geom(g).name) not in robot.solid]
    has_meshes = any(model.geom_type[g] == _MESH for g in only_seen)
    if only_seen and not has_meshes:
        shapes = [shape for g in only_seen[:_MOST_SHAPES] for shape in _shapes(robot, g, None)]
        return tuple(shapes), "geoms"
    shown = {int(model.geom_bodyid[g]) for g in only_seen}
    seen = [g for g in geoms if g in only_seen or int(model.geom_bodyid[g]) not in shown]
    meshes = [g for g in seen[:_MOST_SHAPES] if model.geom_type[g] == _MESH]
    faces = [int(model.mesh_facenum[model.geom_dataid[g]]) for g in meshes]
    sizes = [float(np.linalg.norm(model.geom_aabb[g, 3:])) for g in meshes]
    most = dict(zip(meshes, shares(faces, sizes), strict=True))
    return tuple(s for g in seen[:_MOST_SHAPES] for s in _shapes(robot, g, most.get(g))), "visuals"


def colour_of(model: Any, geom: int) -> tuple[float, float, float, float]:
    """Return the colour of a geom, 0 to 1: its own, else its material's, as MuJoCo draws it."""
    material = int(model.geom_matid[geom])
    own = model.geom_rgba[geom]
    is_own = material < 0 or not np.array_equal(own, np.array(_PLAIN, np.float32))
    red, green, blue, alpha = _decimals(own if is_own else model.mat_rgba[material])
    return red, green, blue, alpha


def _shapes(robot: CompiledRobot, geom: int, most: int | None) -> list[Shape]:
    """Return what a geom looks like, in the frame of its body.

    Args:
        robot: that has it.
        geom: its number.
        most: how many faces a mesh may have.
    """
    model = robot.model
    kind, size = int(model.geom_type[geom]), model.geom_size[geom].tolist()
    position, turn = model.geom_pos[geom], tuple(model.geom_quat[geom].tolist())
    at = tuple(position.tolist())
    body = robot.body_name(int(model.geom_bodyid[geom]))
    look: dict[str, Any] = {"body": body, "rgba": colour_of(model, geom)}
    if kind in _KINDS:
        name, count = _KINDS[kind]
        return [Shape(kind=name, size=tuple(size[:count]), position=at, quat=turn, **look)]  # pyright: ignore[reportArgumentType]
    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
    R = turned.reshape(3, 3)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        radius, half = size[:2]
        ends = [tuple((position + R[:, 2] * end).tolist()) for end in (half, -half)]
        tube = Shape(kind="cylinder", size=(radius, half), position=at, quat=turn, **look)
        return [tube, *(Shape(kind="sphere", size=(radius,), position=e, **look) for e in ends)]
    if kind != _MESH or not most:
        return []
    mesh = int(model.geom_dataid[geom])
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[start : start + count].astype(np.float64)
    start, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces = model.mesh_face[start : start + count].astype(np.int64)
    fewer = kept_thinned(vertices, faces, most)
    if not len(fewer.faces):
        return []
    points = np.rint((fewer.vertices @ R.T + position) * _GRID) / _GRID
    return [Shape(kind="mesh", size=(), triangles=Triangles.of(points, fewer.faces), **look)]


def _decimals(values: npt.NDArray[np.float32]) -> tuple[float, ...]:
    """Return what single-precision numbers were written as: 0.8, not 0.800000011920929."""
    return tuple(float(str(value)) for value in values)
