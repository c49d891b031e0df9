"""Point clouds of scanners and phones, to meshes: a surface is drawn through the points.

PLY files without faces, LAS, LAZ and E57. Points are thinned to an even spacing, get normals of one
side, and a surface by Poisson's equation (Kazhdan and Hoppe, "Screened Poisson Surface
Reconstruction", 2013), which is kept where points are near.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.files.inside import regular
from nw_base.files.ply import Ply
from nw_base.plural import plural
from nw_scenes.limits import MESH_FACES
from nw_scenes.mesh_file import PaintedMesh
from nw_scenes.mesh_parts import Material
from nw_twin.align.planes import find_planes
from nw_twin.packages import package
from nw_twin.scans.converted import PLY, SCANNER, converted, named_as
from nw_twin.scans.splat_points import SPLAT_SUFFIXES, points_of_splat

Values = NDArray[np.float64]

LAS_SUFFIXES = (".las", ".laz")
CLOUD_SUFFIXES = (*LAS_SUFFIXES, ".e57", *SPLAT_SUFFIXES)
"""Of files that hold point clouds alone; a PLY may hold one, too."""

_MOST = 20_000_000
"""Points that are read."""
_THINNED = 300_000
"""Points that a surface is drawn through, at most."""
_FEWEST = 1000
_FARTHEST = 1e9
"""Of a coordinate, in units of the file: survey coordinates have up to 1e8 cm."""
_SAMPLE = 20_000
"""Points whose nearest neighbours say how far points are apart."""
_APART = 1.5
"""Spacing of the thinned points, in distances of nearest neighbours."""
_ROUND = 24
"""Points that a normal is of."""
_SIDE = 12
"""Neighbours that are brought to one side."""
_NEAR = 3.0
"""Spacings from a point up to which the surface is kept: a hole twice as wide is closed."""
_COMPANY, _FLOATS = 8, 3.0
"""Of a splat, a point floats that has fewer neighbours within so many spacings."""
_CRUMB = 0.01
"""Of a splat, pieces of the surface that have fewer triangles of the largest one's are left out."""
_DEEPEST = 11
_STEEP = 0.94
"""Cosine of the angle to an axis up to which a normal looks along it."""
_FLAT = 0.01
"""Of the extent, how far off a plane a point of it lies."""
_TOLD = 0.02
"""Share of the points by which more of them tell one side from the other, for it to be told."""
_LOW = 0.3
"""Share of the level points, from below, that are ground."""
_LESS = 400_000
"""Triangles of the surface, about."""


@dataclass(frozen=True, kw_only=True)
class Cloud:
    """Points in the axes and the unit of their file.

    Attributes:
        points: (N, 3) float64; finite.
        normals: (N, 3) of unit length; None = the file has none.
        colours: (N, 3) float64, 0 to 1; None = the file has none.
        seen_from: (N, 3) where the scanner stood; None = the file does not say.
        unread: what of the file was not read, in words.
    """

    points: Values
    normals: Values | None
    colours: Values | None
    unread: tuple[str, ...]
    seen_from: Values | None = None


def is_cloud(source: Path) -> bool:
    """Whether a file holds points and no faces; Gaussians, too, have points on their surfaces.

    Raises:
        SceneError: a PLY cannot be read.
    """
    if source.suffix.lower() in CLOUD_SUFFIXES:
        return True
    if source.suffix.lower() != ".ply" or not source.is_file():
        return False
    ply = Ply.open(source)
    has_faces = any(len(ply.elements.get(one, ())) for one in ("face", "tristrips"))
    return is_splat(source) or ({"x", "y", "z"} <= _names(ply) and not has_faces)


def is_splat(source: Path) -> bool:
    """Whether a file holds Gaussians."""
    if source.suffix.lower() != ".ply":
        return source.suffix.lower() in SPLAT_SUFFIXES
    return bool({"f_dc_0", "packed_position"} & _names(Ply.open(source)))


def _names(ply: Ply) -> set[str]:
    table = ply.elements.get("vertex")
    return set() if table is None else set(table.dtype.names or ())


def read_cloud(source: Path) -> Cloud:
    """Read the points of a PLY, LAS, LAZ or E57, or points on the surfaces of a splat.

    Raises:
        SceneError: it is damaged, or has too few or too many points.
        PrerequisiteError: the package that reads LAS or E57 is not installed.
    """
    try:
        regular(source).stat()
    except (OSError, ValueError) as error:  # A path with a zero byte is a ValueError.
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise SceneError(f"{source}: the points cannot be read: {reason}") from None
    if source.suffix.lower() == ".e57":
        with converted(source) as (folder, _), named_as(source, folder / PLY):
            cloud = _read_ply(folder / PLY)
    elif is_splat(source):
        points, colours, left = points_of_splat(source)
        cloud = Cloud(points=points, normals=None, colours=colours, unread=tuple(left))
    else:
        is_las = source.suffix.lower() in LAS_SUFFIXES
        cloud = _read_las(source) if is_las else _read_ply(source)
    whole = np.asarray(np.isfinite(cloud.points).all(axis=1))
    if (most := float(np.abs(cloud.points[whole]).max(initial=0.0))) > _FARTHEST:
        raise SceneError(
            f"{source}: coordinates of up to {most:.3g}: single numbers cannot tell points there",
            fix="export it in metres, near its origin",
        )
    if cloud.normals is not None:
        length = np.linalg.norm(cloud.normals, axis=1)
        usable = np.isfinite(length) & (length > 0.5)
        if usable.mean() < 0.99:
            unread = (*cloud.unread, "its normals, of which some have no length")
            cloud = replace(cloud, normals=None, unread=unread)
        else:
            whole &= usable
            cloud = replace(cloud, normals=cloud.normals / np.maximum(length, 1e-9)[:, None])
    points = np.where(whole[:, None], cloud.points, 0.0)
    # One stray point would make all others one place; what is far beyond all others goes.
    low, high = np.quantile(points[whole], (0.001, 0.999), axis=0) if whole.any() else points[:2]
    room = np.maximum(high - low, 1e-9)
    near = ((points >= low - room) & (points <= high + room)).all(axis=1)
    stray = int((whole & ~near).sum())
    whole &= near
    # Two exports of one scan in one file have each point twice.
    kept = np.zeros(len(points), np.bool_)
    _, first = np.unique(points[whole], axis=0, return_index=True)
    kept[np.flatnonzero(whole)[first]] = True
    whole = kept
    if stray:
        cloud = replace(
            cloud, unread=(*cloud.unread, plural(stray, "point") + " far from all others")
        )
    count = int(whole.sum())
    if count < _FEWEST:
        raise SceneError(
            f"{source}: a point cloud of {plural(count, 'different point')}: too few for a surface",
            fix=f"export it with {_FEWEST:,} points or more, or as a mesh",
        )
    return replace(
        cloud,
        points=cloud.points[whole],
        normals=None if cloud.normals is None else cloud.normals[whole],
        colours=None if cloud.colours is None else cloud.colours[whole],
        seen_from=None if cloud.seen_from is None else cloud.seen_from[whole],
    )


def _read_ply(source: Path) -> Cloud:
    ply = Ply.open(source, most_rows={"vertex": _MOST})
    table, names = ply.elements["vertex"], _names(ply)

    def columns(*wanted: str) -> Values | None:
        if not set(wanted) <= names:
            return None
        return np.stack([table[one].astype(np.float64) for one in wanted], axis=-1)

    points, shades = columns("x", "y", "z"), columns("red", "green", "blue")
    if points is None:
        raise SceneError(f"{source}: no points are in it", fix="export it again, with its points")
    if shades is not None:
        shades = _shares(shades, is_byte=table.dtype["red"] == np.uint8)
    known = {"x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha", *SCANNER}
    return Cloud(
        points=points,
        normals=columns("nx", "ny", "nz"),
        colours=shades,
        seen_from=columns(*SCANNER),
        unread=tuple(sorted(names - known)),
    )


def _shares(shades: Values, *, is_byte: bool) -> Values | None:
    """Return colours (N, 3) as shares of white; None where all are black or one is no number.

    Files have them to 255, to 65,535 or to 1, whatever the type of their numbers says.

    Args:
        shades: as a file has them.
        is_byte: whether they are up to 255 at least.
    """
    most = float(shades.max(initial=0.0))
    if not np.isfinite(shades).all() or most <= 0.0:
        return None
    white = 65535.0 if most > 255.0 else 255.0 if is_byte or most > 1.0 else 1.0
    return np.clip(shades / white, 0.0, 1.0)


def _read_las(source: Path) -> Cloud:
    laspy = package("laspy")
    read, points, names = None, np.zeros((0, 3)), set[str]()
    try:
        with laspy.open(source) as file:
            count = int(file.header.point_count)
            read: Any = file.read() if count <= _MOST else None
        if read is not None:
            points = np.stack([np.asarray(read[axis], np.float64) for axis in "xyz"], axis=-1)
            names = {str(name) for name in read.point_format.dimension_names}
    except Exception as error:
        raise SceneError(
            f"{source}: no point cloud can be read in it: {type(error).__name__}: {error}",
            fix="export it again, as LAS 1.2 to 1.4 or LAZ",
        ) from error
    if read is None:
        raise SceneError(f"{source}: {count:,} points", fix=f"thin it below {_MOST:,}")
    colours = None
    if {"red", "green", "blue"} <= names:
        shades = [np.asarray(read[one], np.float64) for one in ("red", "green", "blue")]
        colours = _shares(np.stack(shades, axis=-1), is_byte=True)
    return Cloud(points=points, normals=None, colours=colours, unread=())


def surfaced(source: Path, up: str) -> tuple[PaintedMesh, list[str]]:
    """Return a surface through the points of a file, in its axes and unit, and what is said of it.

    The same file gives the same bytes.

    Args:
        source: a file that `is_cloud`.
        up: axis of the file that is up, such as `+z`; `auto` = it is not known.

    Raises:
        SceneError: it is damaged, or no surface can be drawn through it.
        PrerequisiteError: Open3D, or the package that reads LAS, is not installed.
    """
    cloud = read_cloud(source)
    o3d = package("open3d")
    # Coordinates of surveys are millions of metres, and Open3D's surface has single precision.
    middle = np.median(cloud.points, axis=0)
    whole = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points - middle))
    if cloud.colours is not None:
        whole.colors = o3d.utility.Vector3dVector(cloud.colours)
    if cloud.normals is not None:
        whole.normals = o3d.utility.Vector3dVector(cloud.normals)
    thinned, spacing = _thinned(whole)
    if len(thinned.points) < _FEWEST:
        places = plural(len(thinned.points), "place")
        raise SceneError(
            f"{source}: its {len(cloud.points):,} points lie in {places}: too few for a surface",
            fix="export it denser, or as a mesh",
        )
    if is_splat(source):
        thinned = thinned.remove_radius_outlier(_COMPANY, _FLOATS * spacing)[0]
    if cloud.normals is None:
        thinned.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(_ROUND))
        if cloud.seen_from is None:
            _to_one_side(thinned, o3d, source)
            _to_the_open(thinned, o3d, up)
        else:
            _to_the_scanner(thinned, o3d, cloud.points - middle, cloud.seen_from - middle)
    mesh = _poisson(thinned, spacing, o3d)
    if is_splat(source):
        _without_crumbs(mesh)
    vertices = np.asarray(mesh.vertices).astype(np.float64) + middle
    faces = np.asarray(mesh.triangles).astype(np.int64)
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Where the surface was made simpler, a triangle may be folded to a line.
    faces = faces[np.linalg.norm(normal, axis=1) > 1e-9 * spacing**2]
    if not len(faces):
        raise SceneError(
            f"{source}: no surface can be drawn through its points",
            fix="export the scan as a mesh",
        )
    colours = None
    if cloud.colours is not None:
        colours = np.clip(np.asarray(mesh.vertex_colors), 0.0, 1.0).astype(np.float32)[faces]
    lines = [
        (
            f"a surface was drawn through {len(cloud.points):,} points, {spacing:.3g} units apart: "
            f"holes of up to {2 * _NEAR * spacing:.2g} units are closed, edges are rounded off; a "
            "mesh of the same app, if it exports one, is sharper"
        ),
        *([] if not cloud.unread else [f"not read of the points: {', '.join(cloud.unread)}"]),
    ]
    painted = PaintedMesh(
        vertices=vertices,
        faces=faces,
        colours=colours,
        uv=None,
        material=np.zeros(len(faces), np.int32),
        materials=(Material(),),
        findings=(),
    )
    return painted, lines


def _thinned(cloud: Any) -> tuple[Any, float]:
    """Return a cloud with even spacing, and that."""
    points = np.asarray(cloud.points)
    tree = package("scipy.spatial").cKDTree(points)
    sample = points[:: max(1, len(points) // _SAMPLE)]
    nearest = tree.query(sample, 2)[0][:, 1]
    apart = float(np.median(nearest[nearest > 0.0])) if (nearest > 0.0).any() else 0.0
    extent = float(np.ptp(points, axis=0).max())
    spacing = max(_APART * apart, extent / 2**_DEEPEST, 1e-9)
    thinned = cloud.voxel_down_sample(spacing)
    while len(thinned.points) > _THINNED:
        spacing *= 1.2
        thinned = cloud.voxel_down_sample(spacing)
    return thinned, spacing


def _to_one_side(cloud: Any, o3d: Any, source: Path) -> None:
    """Give the normals of a cloud one side of its surface.

    Raises:
        SceneError: the points lie on a line.
    """
    points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-4 * spread[0]:
        raise SceneError(f"{source}: its points lie on a line", fix="export the scan as a mesh")
    if spread[2] < 1e-6 * spread[0]:
        # All in one plane: the triangulation that neighbours come from has no volume there.
        plane = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
        cloud.normals = o3d.utility.Vector3dVector(np.tile(plane, (len(normals), 1)))
        return
    cloud.orient_normals_consistent_tangent_plane(_SIDE)


def _to_the_scanner(cloud: Any, o3d: Any, points: Values, seen_from: Values) -> None:
    """Turn each normal of a cloud to where the nearest of its points (N, 3) was seen from."""
    middles, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    nearest = package("scipy.spatial").cKDTree(points).query(middles)[1]
    sense = np.einsum("ni,ni->n", normals, seen_from[nearest] - middles)
    turned = normals * np.where(sense < 0.0, -1.0, 1.0)[:, None]
    cloud.normals = o3d.utility.Vector3dVector(turned)


def _to_the_open(cloud: Any, o3d: Any, up: str) -> None:
    """Turn all normals over if they look into what is solid.

    Nearly all of a scan lies on the open side of its floors and walls. Where it is as flat as its
    largest plane, or somebody says what is up, that is up.
    """
    normals, points = np.asarray(cloud.normals), np.asarray(cloud.points)
    sense = 0.0
    if up == "auto":
        tolerance = _FLAT * float(np.linalg.norm(points.std(axis=0)))
        for plane in find_planes(points, tolerance, np.random.default_rng(0)):
            away = plane.distances(points)
            facing = (normals @ plane.normal)[np.abs(away) <= tolerance]
            along = np.sign(facing[np.abs(facing) >= _STEEP])
            open_side = float((away > 3.0 * tolerance).mean() - (away < -3.0 * tolerance).mean())
            sense += open_side * float(along.sum())
    if abs(sense) < _TOLD * len(points):
        axis, sign = (
            ("xyz".index(up[-1]), -1.0 if up[0] == "-" else 1.0) if up != "auto" else (2, 1.0)
        )
        level = np.abs(normals[:, axis]) >= _STEEP
        heights = sign * points[level, axis]
        low = heights <= np.quantile(heights, _LOW) if level.any() else level[level]
        sense = float(np.sign(sign * normals[level, axis])[low].sum())
    if sense < 0.0:
        cloud.normals = o3d.utility.Vector3dVector(-normals)


def _poisson(cloud: Any, spacing: float, o3d: Any) -> Any:
    """Return the surface near the points, of about `_LESS` triangles."""
    points = np.asarray(cloud.points)
    extent = 1.1 * float(np.ptp(points, axis=0).max())
    depth = min(max(int(np.ceil(np.log2(extent / spacing))), 4), _DEEPEST)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, depth=depth, scale=1.1, linear_fit=True, n_threads=1
        )
    tree = package("scipy.spatial").cKDTree(points)
    far = tree.query(np.asarray(mesh.vertices))[0] > _NEAR * spacing
    mesh.remove_vertices_by_mask(far)
    most = min(_LESS, MESH_FACES)
    if len(mesh.triangles) > most:
        mesh = mesh.simplify_quadric_decimation(most)
    mesh.remove_duplicated_vertices().remove_duplicated_triangles()
    return mesh.remove_degenerate_triangles().remove_unreferenced_vertices()


def _without_crumbs(mesh: Any) -> None:
    """Remove what floats apart from all else, and is small."""
    number, counts, _ = mesh.cluster_connected_triangles()
    counts = np.asarray(counts)
    mesh.remove_triangles_by_mask(counts[np.asarray(number)] < _CRUMB * counts.max())
    mesh.remove_unreferenced_vertices()
