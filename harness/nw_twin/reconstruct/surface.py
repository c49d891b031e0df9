"""From depth maps to a surface: points with normals, and the screened Poisson surface of them.

Points of many pixels become one in each cell of space. Cells are as large as what two pixels show
there: fine near cameras and coarse far away. The surface (Kazhdan and Hoppe, "Screened Poisson
surface reconstruction", 2013) is Open3D's. It is kept where points are near; farther than that, as
in a hole, where it is flat, ends at what is kept all around, and no photograph looks through it.

Also here: coloured triangle meshes, and `mesh.ply`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.files.cache import atomic_path
from nw_base.files.ply import Ply
from nw_scenes.mesh_file import read_mesh
from nw_twin.packages import package
from nw_twin.reconstruct.depth import DepthMap, darker
from nw_twin.reconstruct.views import F64


@dataclass(frozen=True, kw_only=True, eq=False)
class ColourMesh:
    """Triangles in a capture's frame and unit, counter-clockwise seen from outside.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) int32 numbers of vertices.
        colours: (V, 3) uint8.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    colours: NDArray[np.uint8]

    @property
    def normals(self) -> NDArray[np.float64]:
        """Of each face, as long as twice its area, (F, 3)."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    def keep(self, faces: NDArray[np.bool_]) -> ColourMesh:
        """Return the mesh of some of the faces, without vertices that none uses."""
        used, renumbered = np.unique(self.faces[faces], return_inverse=True)
        return ColourMesh(
            vertices=self.vertices[used],
            faces=renumbered.reshape(-1, 3).astype(np.int32),
            colours=self.colours[used],
        )


def parts_of(links: NDArray[np.integer], count: int) -> tuple[int, NDArray[np.int32]]:
    """Return how many parts `count` vertices are in, and the part of each.

    Args:
        links: (N, K), K >= 2: vertices in a row belong together.
        count: of vertices.
    """
    sparse, graph = package("scipy.sparse"), package("scipy.sparse.csgraph")
    one = np.repeat(links[:, 0], links.shape[1] - 1)
    other = links[:, 1:].ravel()
    ones = np.ones(len(one), np.int8)
    matrix = sparse.coo_array((ones, (one, other)), shape=(count, count))
    return graph.connected_components(matrix, directed=False)


def write_mesh(mesh: ColourMesh, path: Path) -> None:
    """Write a mesh as a binary PLY with colours of its vertices.

    Raises:
        StoreError: the file cannot be written.
    """
    from trimesh import Trimesh
    from trimesh.exchange.ply import export_ply

    shape = Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.colours, process=False)
    with atomic_path(path) as temporary:
        temporary.write_bytes(export_ply(shape, encoding="binary", vertex_normal=False))


def read_colour_mesh(path: Path) -> ColourMesh:
    """Read a mesh; one without colours is grey.

    Raises:
        SceneError: as `nw_scenes.mesh_file.read_mesh`.
    """
    mesh = read_mesh(path)  # Everything is checked there; colours are all that is left to read.
    colours = np.full((len(mesh.vertices), 3), 128, np.uint8)
    table = Ply.open(path).elements["vertex"]
    if {"red", "green", "blue"} <= set(table.dtype.names or ()):
        colours = np.stack([table[name] for name in ("red", "green", "blue")], axis=-1)
        if colours.dtype.kind == "f":  # Shares of 1.
            colours = np.clip(np.nan_to_num(colours) * 255, 0, 255).round()
        colours = colours.astype(np.uint8)
    return ColourMesh(vertices=mesh.vertices, faces=mesh.faces, colours=colours)


Flags = NDArray[np.bool_]

_FINEST = 0.5
"""Voxels: edge of the smallest cell."""
_LEVELS = 4
"""Sizes of cells, each twice as large as the one before; what is coarser is left out."""
_DEEPEST = 12
"""Times that the box about all points is halved at most."""
_STRAY = 0.05
"""Percent of points at each end of an axis that may lie far off."""
_LEAST_PIXELS = 2
"""That a cell is known by."""
_LEAST_SAMPLES = 32
"""That a surface is made of."""
_ONE_WAY = 0.5
"""Length of the mean of a cell's unit normals, below which its pixels show no one surface."""
_GRAZED = 0.15
"""Cosine between ray and normal that no pixel is taken to fall below."""

_NEAR, _FAR = 1.5, 24.0
"""Cells from a point: where the surface is kept, and where none is supposed in a hole."""
_OFF = 0.02
"""Share of its depth by which a point lies off the plane that a pixel shows, and is not on it."""
_FLAT = 0.95
"""Area of a patch as its mean normal sees it, a share of its area, if it is flat."""
_NEAREST = 8
"""Samples whose mean normal a point of the surface is compared with."""
_LIKE = 0.85
"""Cosine between a patch and the samples about it, in the mean: it goes on as they do."""
_OTHER = 0.3
"""Share of the vertices of a patch that photographs may show darker than what is about it."""
_KNOWN = 0.33
"""Share of the views of a point that have to know it there: edges seen from afar join over gaps
that nearer photographs leave open."""
_OPEN = 0.1
"""Share of the vertices of a patch that photographs may look through."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Points of surfaces, one in each cell, in the capture's frame.

    Attributes:
        points: (N, 3).
        normals: (N, 3) of unit length, towards the cameras.
        colours: (N, 3), 0 to 255.
        cells: (N,) edge of the cell of each.
        finest: edge of the smallest cell.
    """

    points: F64
    normals: F64
    colours: F64
    cells: F64
    finest: float


def voxel_of(maps: Sequence[DepthMap]) -> float:
    """Return two pixels' breadth at the median depth: what the maps can show, and no more.

    Raises:
        SceneError: no depth is known.
    """
    breadths = [
        float(np.median(each.depth[each.depth > 0])) / each.view.K[0, 0]
        for each in maps
        if (each.depth > 0).any()
    ]
    if not breadths:
        raise SceneError(
            "no two photographs agree on any depth",
            fix="photograph surfaces with texture, from positions closer to each other",
        )
    return 2.0 * float(np.median(breadths))


def surface(
    maps: Sequence[DepthMap], voxel: float, most: int, say: Callable[[str], None]
) -> ColourMesh:
    """Return the surface that depth maps show, counter-clockwise seen from where the cameras were.

    The same maps give the same bits: Open3D works on one thread.

    Args:
        maps: of the capture.
        voxel: edge of a typical cell.
        most: samples that there may be, each with about 1 kB.
        say: receives progress messages.

    Raises:
        SceneError: no depth is known, there are too many samples, or no surface comes of them.
        PrerequisiteError: Open3D or SciPy is not installed.
    """
    sampled = samples(maps, voxel)
    if len(sampled.points) > most:
        raise SceneError(
            f"the surface takes {len(sampled.points)} points, {most} are allowed",
            fix=f"give a larger voxel than {voxel:.4g}, or more points",
        )
    say(
        f"joins {len(maps)} depth maps in {len(sampled.points)} points of {sampled.finest:.3g} "
        "and more"
    )
    if len(sampled.points) >= _LEAST_SAMPLES:
        whole, normals = _poisson(sampled)
        kept = whole.keep(_supported(whole, normals, sampled, maps)) if len(whole.faces) else whole
        if len(kept.faces):
            return kept
    raise SceneError("the depth maps have no surface in common", fix="take more photographs")


def samples(maps: Sequence[DepthMap], voxel: float) -> Samples:
    """Return the points of all maps, one in each cell; none that more photographs see through.

    In a cell a pixel counts by its confidence and by how finely it shows its surface: many that
    look from afar and at a slant do not outvote the few from near. No cell has a point that holds
    a finer one.

    Raises:
        SceneError: no depth is known.
    """
    coarsest = _FINEST * voxel * 2 ** (_LEVELS - 1)
    sample = np.concatenate(
        [rows[rows[:, -1] <= coarsest, :3][::16] for rows in map(_pixels, maps)]
    )
    if len(sample) == 0:
        raise SceneError("no depth is known", fix="photograph what has texture")
    low, high = np.percentile(sample, [_STRAY, 100.0 - _STRAY], axis=0)
    finest = max(_FINEST * voxel, float((high - low).max()) * 1.1 / 2**_DEEPEST)
    tables: list[list[F64]] = [[] for _ in range(_LEVELS)]
    for each in maps:
        rows = _pixels(each)
        rows = rows[((rows[:, :3] >= low) & (rows[:, :3] <= high)).all(axis=1)]
        level = np.ceil(np.log2(np.maximum(rows[:, -1] / finest, 1.0)))
        for number, table in enumerate(tables):
            own = rows[level == number, :-1]
            own[:, :-2] *= own[:, -2:-1]  # Sums of what is weighted, of weights, and of pixels.
            table.append(_summed(own, _cells_of(own[:, :3] / own[:, -2:-1], low, finest, number)))
    kept: list[tuple[F64, F64]] = []
    for number, table in enumerate(tables):
        sums = np.concatenate(table)
        sums = _summed(sums, _cells_of(sums[:, :3] / sums[:, 9:10], low, finest, number))
        sums = sums[sums[:, 10] >= _LEAST_PIXELS]
        means = sums[:, :9] / sums[:, 9:10]
        known = np.linalg.norm(means[:, 3:6], axis=1) > _ONE_WAY
        for finer, _ in kept:
            taken = np.unique(_cells_of(finer[:, :3], low, finest, number))
            known &= ~np.isin(_cells_of(means[:, :3], low, finest, number), taken)
        kept.append((means[known], np.full(int(known.sum()), finest * 2**number)))
    means, cells = (np.concatenate(part) for part in zip(*kept, strict=True))
    views, through, on = _looks(means[:, :3], means[:, 3:6], maps)
    real = ~_open(views, through, on) & (on >= _KNOWN * views)
    means, cells = means[real], cells[real]
    length = np.linalg.norm(means[:, 3:6], axis=1, keepdims=True)
    return Samples(
        points=means[:, :3],
        normals=means[:, 3:6] / np.maximum(length, 1e-300),
        colours=means[:, 6:9],
        cells=cells,
        finest=finest,
    )


def _pixels(each: DepthMap) -> F64:
    """Return place (3), normal (3), colour (3), weight, 1, and edge of the cell of each pixel."""
    view, (rows, columns) = each.view, np.nonzero(each.depth > 0)
    rays = _rays(view.K, columns + 0.5, rows + 0.5)
    z = each.depth[rows, columns].astype(np.float64)
    normal = each.normal[rows, columns].astype(np.float64)
    T = np.linalg.inv(view.T_camera_world)
    length = np.linalg.norm(rays, axis=1)
    breadth = z * length / view.K[0, 0]
    facing = np.clip(-(normal * rays).sum(axis=1) / length, _GRAZED, 1.0)
    weight = each.confidence[rows, columns] * facing / breadth**2
    return np.column_stack(
        [
            (rays * z[:, None]) @ T[:3, :3].T + T[:3, 3],
            normal @ T[:3, :3].T,
            view.rgb[rows, columns].astype(np.float64),
            weight,
            np.ones_like(z),
            2.0 * breadth / np.sqrt(facing),
        ]
    )


def _rays(K: F64, u: NDArray[np.floating], v: NDArray[np.floating]) -> F64:
    """Return the points (N, 3) at depth 1 that pixels show, in the camera's frame."""
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float64)


def _cells_of(points: F64, low: F64, finest: float, level: int) -> NDArray[np.int64]:
    place = np.floor((points - low) / (finest * 2**level)).astype(np.int64) + 1
    side = 2 ** (_DEEPEST + 2)
    return (place[:, 0] * side + place[:, 1]) * side + place[:, 2]


def _summed(rows: F64, cells: NDArray[np.int64]) -> F64:
    """Return the sum of the rows of each cell, in the order of the cells' numbers."""
    _, whose = np.unique(cells, return_inverse=True)
    sums = np.zeros((int(whose.max(initial=-1)) + 1, rows.shape[1]))
    for number, column in enumerate(rows.T):
        sums[:, number] = np.bincount(whose, column, len(sums))
    return sums


def _looks(points: F64, normals: F64, maps: Sequence[DepthMap]) -> tuple[F64, F64, F64]:
    """Return what looks at points or through them, what looks through, and what at, (N,) weights.

    A pixel shows a plane. A point lies on it, behind it, where the pixel says nothing of it, or
    before it and nearer than the pixel is: then it is looked through. A pixel of no known depth
    looks at something else if it is darker than what is known about it. Each view counts by how
    many of its pixels an area there has: a near one from above sees what many from afar cannot.
    """
    views, through, on = (np.zeros(len(points)) for _ in range(3))
    for each in maps:
        view, T = each.view, each.view.T_camera_world
        local = points @ T[:3, :3].T + T[:3, 3]
        z = np.maximum(local[:, 2], 1e-9)
        u = view.K[0, 0] * local[:, 0] / z + view.K[0, 2]
        v = view.K[1, 1] * local[:, 1] / z + view.K[1, 2]
        height, width = view.size
        facing = -((normals @ T[:3, :3].T) * local).sum(axis=1) / np.linalg.norm(local, axis=1)
        inside = (local[:, 2] > 0.0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        rows = np.flatnonzero(inside & (facing > 0.0))
        x, y = u[rows].astype(np.int64), v[rows].astype(np.int64)
        weight = np.maximum(facing[rows], _GRAZED) * (view.K[0, 0] / z[rows]) ** 2
        depth = each.depth[y, x].astype(np.float64)
        shown = _rays(view.K, x + 0.5, y + 0.5) * depth[:, None]
        off = ((local[rows] - shown) * each.normal[y, x]).sum(axis=1) / z[rows]
        known = depth > 0.0
        other = ~known & darker(each)[y, x]
        through[rows] += weight * (known & (off > _OFF) & (depth > z[rows] * (1.0 + _OFF)))
        on[rows] += weight * (known & (np.abs(off) <= _OFF))
        views[rows] += weight * (other | (known & (off >= -_OFF)))
    return views, through, on


def _open(views: F64, through: F64, on: F64) -> Flags:
    """Return what is seen through; one wrong depth among many is none."""
    return through > np.maximum(on, views / 8.0)


def _poisson(sampled: Samples) -> tuple[ColourMesh, F64]:
    """Return the surface through all samples, closed but where its box ends, and its normals."""
    o3d = package("open3d")
    as_vectors = o3d.utility.Vector3dVector
    cloud = o3d.geometry.PointCloud(as_vectors(sampled.points))
    cloud.normals = as_vectors(sampled.normals)
    cloud.colors = as_vectors(sampled.colours / 255.0)
    extent = max(float(np.ptp(sampled.points, axis=0).max()) * 1.1, sampled.finest)
    depth = min(max(int(np.ceil(np.log2(extent / sampled.finest))), 1), _DEEPEST)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, depth=depth, scale=1.1, linear_fit=True, n_threads=1
        )
    colours = np.round(np.clip(np.asarray(mesh.vertex_colors) * 255.0, 0.0, 255.0))
    whole = ColourMesh(
        vertices=np.asarray(mesh.vertices).astype(np.float64),
        faces=np.asarray(mesh.triangles).astype(np.int32),
        colours=colours.astype(np.uint8).reshape(-1, 3),
    )
    return whole, np.asarray(mesh.vertex_normals).astype(np.float64)


def _supported(
    whole: ColourMesh, normals: F64, sampled: Samples, maps: Sequence[DepthMap]
) -> Flags:
    """Return the faces that samples lie near, or that close a hole of them."""
    faces, count = whole.faces, len(whole.vertices)
    count_near = min(_NEAREST, len(sampled.points))
    tree = package("scipy.spatial").cKDTree(sampled.points)
    off, nearest = tree.query(whole.vertices, range(1, count_near + 1))
    off = off[:, 0] / sampled.cells[nearest[:, 0]]
    about = sampled.normals[nearest].mean(axis=1)
    about /= np.maximum(np.linalg.norm(about, axis=1, keepdims=True), 1e-300)
    views, through, on = _looks(whole.vertices, normals, maps)
    open_ = _open(views, through, on)
    other = (views > 0.0) & (on < _KNOWN * views)
    like = (normals * about).sum(axis=1)
    kept = ((off <= _NEAR) & (like > 0.0) & ~open_ & ~other)[faces].all(axis=1)
    rest = faces[~kept]
    parts, part = parts_of(rest, count)
    size = np.bincount(part, minlength=parts)
    # A patch of a hole ends at what is kept: none of its vertices is at an end of the surface.
    beyond = np.bincount(part, (off > _FAR) | _ends(faces, count), minlength=parts) > 0
    looked_through = np.bincount(part, open_, minlength=parts) > _OPEN * size
    looked_through |= np.bincount(part, other, minlength=parts) > _OTHER * size
    bent = np.bincount(part, like, minlength=parts) < _LIKE * size
    areas, own = whole.normals[~kept], part[rest[:, 0]]
    whole_area = np.bincount(own, np.linalg.norm(areas, axis=1), minlength=parts)
    total = np.stack([np.bincount(own, axis, minlength=parts) for axis in areas.T])
    flat = np.linalg.norm(total, axis=0) > _FLAT * whole_area
    kept[~kept] = (~beyond & ~looked_through & ~bent & flat)[own]
    return kept


def _ends(faces: NDArray[np.int32], count: int) -> Flags:
    """Return which vertices (V,) are of an edge that one face alone has."""
    edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]).astype(np.int64)
    keys, uses = np.unique(np.sort(edges, axis=1) @ np.array([count, 1]), return_counts=True)
    ends = np.zeros(count, np.bool_)
    for corner in np.divmod(keys[uses == 1], count):
        ends[corner] = True
    return ends
