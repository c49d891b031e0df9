"""Formats that others' libraries read: USD stages of phones, and E57 clouds of laser scanners.

Their readers are C++ and take what they are given, so each file is opened in a confined process,
which can read that file alone and write into a folder of ours. It leaves an OBJ or a PLY there, and
that is read like any file that is not trusted.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.confinement import Rules
from nw_base.errors import PolicyError, PrerequisiteError, SceneError
from nw_base.files.inside import regular
from nw_base.plural import plural
from nw_scenes.mesh_file import PaintedMesh, read_painted
from nw_sim.rollout.confined.isolated import call_isolated
from nw_twin.packages import package

Values = NDArray[np.float64]

USD_SUFFIXES = (".usdz", ".usdc", ".usda", ".usd")
OBJ, PLY = "stage.obj", "points.ply"
"""What the confined process leaves."""
_MEMORY, _COPIES = 3 * 2**30, 12
"""Bytes that it may hold, and how many times the file's size more."""
_SECONDS = 300.0
_MOST_BYTES = 2 * 2**30
_SAFE = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg"}
"""How pictures begin that are read."""
_ROOMPLAN = "/Room/Parametric_grp"
"""Where Apple's RoomPlan puts walls, doors and furniture, as boxes."""
SCANNER = ("scanner_x", "scanner_y", "scanner_z")
"""Columns with where each point was seen from."""


@contextmanager
def converted(source: Path) -> Generator[tuple[Path, dict[str, Any]]]:
    """Give a folder with a USD stage as OBJ or an E57 as PLY, and what is said of the file.

    Raises:
        SceneError: it cannot be read.
        PrerequisiteError: the package that reads it is not installed.
    """
    try:
        size = regular(source).stat().st_size
    except (OSError, ValueError) as error:  # A path with a zero byte is a ValueError.
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise SceneError(f"{source}: it cannot be read: {reason}") from None
    if size > _MOST_BYTES:
        raise SceneError(f"{source} has {size} bytes", fix=f"thin it below {_MOST_BYTES}")
    is_usd = source.suffix.lower() in USD_SUFFIXES
    package("pxr" if is_usd else "pye57")
    with TemporaryDirectory(prefix="nw-eval-") as made:
        rules = Rules(
            reads=(source.resolve(),),
            writes=(Path(made).resolve(),),
            memory=_MEMORY + _COPIES * size,
        )
        try:
            said = call_isolated(
                _stage_to_obj if is_usd else _cloud_to_ply,
                subject=str(source),
                rules=rules,
                time_limit=_SECONDS,
                source=str(source.resolve()),
                folder=str(Path(made).resolve()),
            )
        except PrerequisiteError:
            raise
        except PolicyError as error:  # In its words it opens a checkpoint.
            what = "a USD stage" if is_usd else "an E57 point cloud"
            reason = (
                error.message.removeprefix(f"{source}: ")
                .replace("the checkpoint", "it")
                .rstrip(": ")
            )
            raise SceneError(
                f"{source}: it cannot be read as {what}: {reason}",
                fix="export it again, or in another format: .glb, .obj, .ply, .las",
            ) from None
        yield Path(made), said


@contextmanager
def named_as(source: Path, path: Path) -> Generator[None]:
    """Let errors of a file that was made name the one that it was made of."""
    try:
        yield
    except SceneError as error:
        lines = error.message.replace(str(path), str(source))
        raise SceneError(lines, fix=error.fix) from None


def _stage_to_obj(*, source: str, folder: str) -> dict[str, Any]:
    """Write the meshes and boxes of a USD stage as OBJ, in its own axes and unit.

    Returns:
        Its `up` (`+y` or `+z`), `metres` in its unit, `unread` kinds with their numbers, its
        `creator`, and whether it `is_roomplan`.
    """
    usd = _usd("Usd")
    geom = _usd("UsdGeom")
    stage = usd.Stage.Open(source)
    if not stage:
        raise SceneError(f"{source}: no stage can be opened in it")
    unread, painter = Counter[str](), _Painter(Path(folder))
    vertices = places = 0
    with (Path(folder) / OBJ).open("w", encoding="ascii") as out:
        out.write("mtllib stage.mtl\n")
        for prim, points, faces, corners in _parts(stage, unread):
            uv, at = _places(prim, corners)
            out.writelines(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in points.tolist())
            out.writelines(f"vt {u:.7g} {v:.7g}\n" for u, v in uv.tolist())
            ends = [f"{corner}/" for corner in (corners + vertices + 1).tolist()]
            if len(uv):
                ends = [f"{a}{b}" for a, b in zip(ends, (at + places + 1).tolist(), strict=True)]
            before = ""
            for face, material in zip(faces, painter.of_faces(prim, len(faces)), strict=True):
                if material != before:
                    out.write(f"usemtl {material}\n")
                    before = material
                out.write(f"f {' '.join(ends[corner] for corner in face)}\n")
            vertices, places = vertices + len(points), places + len(uv)
    painter.write()
    return {
        "up": "+z" if geom.GetStageUpAxis(stage) == geom.Tokens.z else "+y",
        "metres": float(geom.GetStageMetersPerUnit(stage)),
        "unread": dict(unread),
        "is_roomplan": bool(stage.GetPrimAtPath(_ROOMPLAN)),
        "creator": str(stage.GetRootLayer().customLayerData.get("creator", ""))[:80],
    }


def _parts(
    stage: Any, unread: Counter[str]
) -> Iterator[tuple[Any, Values, list[list[int]], NDArray[np.int64]]]:
    """Yield what is seen of a stage: prim, points (P, 3), corners of each face, and their points.

    A left-handed or mirrored part has its faces turned over. `unread` gets what is left out.
    """
    usd = _usd("Usd")
    geom = _usd("UsdGeom")
    poses = geom.XformCache()
    for prim in usd.PrimRange.Stage(stage, usd.TraverseInstanceProxies()):
        if not prim.IsA(geom.Gprim):
            if prim.IsA(geom.PointInstancer):
                unread["PointInstancer"] += 1
            continue
        shown = geom.Imageable(prim)
        hidden = shown.ComputeVisibility() == geom.Tokens.invisible
        if hidden or shown.ComputePurpose() == geom.Tokens.guide:
            unread["hidden part"] += 1
            continue
        if prim.IsA(geom.Mesh):
            points, counts, corners = _mesh(geom.Mesh(prim))
        elif prim.IsA(geom.Cube):
            points, counts, corners = _box(float(geom.Cube(prim).GetSizeAttr().Get()))
        else:
            unread[str(prim.GetTypeName())] += 1
            continue
        if counts.sum() != len(corners) or not len(points) or not len(counts):
            unread["part without faces"] += 1
            continue
        pose = np.array(poses.GetLocalToWorldTransform(prim), dtype=np.float64)
        left = geom.Gprim(prim).GetOrientationAttr().Get() == geom.Tokens.leftHanded
        sense = -1 if left != (np.linalg.det(pose[:3, :3]) < 0) else 1
        starts = (np.cumsum(counts) - counts).tolist()
        faces = [
            list(range(at, at + n))[::sense] for at, n in zip(starts, counts.tolist(), strict=True)
        ]
        yield prim, points @ pose[:3, :3] + pose[3, :3], faces, corners


def _usd(module: str) -> Any:
    return package(f"pxr.{module}")


def _mesh(mesh: Any) -> tuple[Values, NDArray[np.int64], NDArray[np.int64]]:
    """Return points (P, 3), corners a face (F,), and points of all corners (C,)."""
    points = np.array(mesh.GetPointsAttr().Get() or [], dtype=np.float64).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [], dtype=np.int64)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], dtype=np.int64)
    return points, counts, corners


def _box(size: float) -> tuple[Values, NDArray[np.int64], NDArray[np.int64]]:
    """Return a cube about its origin, of which apps make walls, doors and furniture."""
    x, y, z = np.meshgrid(*[[-0.5 * size, 0.5 * size]] * 3, indexing="ij")
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    quads = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
    return points, np.full(6, 4), np.array(quads)


def _places(prim: Any, corners: NDArray[np.int64]) -> tuple[Values, NDArray[np.int64]]:
    """Return places in a texture (T, 2), v up, and which of them each corner has (C,)."""
    sdf = _usd("Sdf")
    geom = _usd("UsdGeom")
    for primvar in geom.PrimvarsAPI(prim).GetPrimvarsWithValues():
        kind = primvar.GetTypeName()
        if kind not in (sdf.ValueTypeNames.TexCoord2fArray, sdf.ValueTypeNames.Float2Array):
            continue
        uv = np.array(primvar.ComputeFlattened(), dtype=np.float64).reshape(-1, 2)
        if len(uv) == len(corners):
            return uv, np.arange(len(corners))
        if len(corners) and len(uv) > corners.max():
            return uv, corners
    return np.zeros((0, 2)), corners


class _Painter:
    """Materials of an OBJ: each of another colour or picture once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names: dict[tuple[tuple[float, ...], str], str] = {}
        self._pictures: dict[str, str] = {}

    def of_faces(self, prim: Any, count: int) -> list[str]:
        """Return the name of each face's material."""
        shade = _usd("UsdShade")
        binding = shade.MaterialBindingAPI(prim)
        names = [self._name(binding.ComputeBoundMaterial()[0], prim)] * count
        for subset in binding.GetMaterialBindSubsets():
            part = subset.GetPrim()
            name = self._name(shade.MaterialBindingAPI(part).ComputeBoundMaterial()[0], prim)
            for face in subset.GetIndicesAttr().Get() or []:
                if 0 <= face < count:
                    names[face] = name
        return names

    def _name(self, material: Any, prim: Any) -> str:
        geom = _usd("UsdGeom")
        colour, picture = (1.0, 1.0, 1.0), ""
        shown = geom.Gprim(prim).GetDisplayColorAttr().Get()
        if shown is not None and len(shown) == 1:
            colour = tuple(shown[0])
        if material:
            colour, picture = self._surface(material, colour)
        # USD has colours linear, an MTL as they are displayed.
        displayed = tuple(round(min(max(c, 0.0), 1.0) ** (1.0 / 2.2), 3) for c in colour)
        return self._names.setdefault((displayed, picture), f"m{len(self._names)}")

    def _surface(self, material: Any, colour: tuple[float, ...]) -> tuple[tuple[float, ...], str]:
        """Return the colour of a material and the file of its picture; empty without."""
        gf = _usd("Gf")
        sdf = _usd("Sdf")
        shade = _usd("UsdShade")
        shader = material.ComputeSurfaceSource()[0]
        diffuse = shader.GetInput("diffuseColor") if shader else None
        if not diffuse:
            return colour, ""
        for attribute in shade.Utils.GetValueProducingAttributes(diffuse):
            value = attribute.Get()
            if isinstance(value, gf.Vec3f):
                colour = tuple(value)
            file = shade.Shader(attribute.GetPrim()).GetInput("file")
            asset: Any = file.Get() if file else None
            if isinstance(asset, sdf.AssetPath) and asset.resolvedPath:
                return (1.0, 1.0, 1.0), self._picture(asset.resolvedPath)
        return colour, ""

    def _picture(self, path: str) -> str:
        ar = _usd("Ar")
        if path not in self._pictures:
            asset = ar.GetResolver().OpenAsset(ar.ResolvedPath(path))
            content = bytes(asset.GetBuffer()) if asset else b""
            kind = next((s for mark, s in _SAFE.items() if content.startswith(mark)), "")
            self._pictures[path] = f"{len(self._pictures)}{kind}" if kind else ""
            if kind:
                (self._folder / self._pictures[path]).write_bytes(content)
        return self._pictures[path]

    def write(self) -> None:
        with (self._folder / "stage.mtl").open("w", encoding="ascii") as out:
            for (colour, picture), name in self._names.items():
                out.write(f"newmtl {name}\nKd {' '.join(map(str, colour))}\n")
                if picture:
                    out.write(f"map_Kd {picture}\n")


def _cloud_to_ply(*, source: str, folder: str) -> dict[str, Any]:
    """Write the points of all scans of an E57 as PLY, in the frame that its poses share.

    Returns:
        The number of `points` and of `scans`.
    """
    file = package("pye57").E57(source)
    parts: list[dict[str, Values]] = []
    for index in range(file.scan_count):
        header = file.get_header(index)
        fields = set(header.point_fields)
        if not header.point_count or not {"cartesianX", "sphericalRange"} & fields:
            continue
        coloured = {"colorRed", "colorGreen", "colorBlue"} <= fields
        read = file.read_scan(index, colors=coloured, ignore_missing_fields=True)
        columns = {axis: np.asarray(read[f"cartesian{axis.upper()}"], float) for axis in "xyz"}
        for name in ("red", "green", "blue"):
            shade = read.get(f"color{name.capitalize()}")
            if shade is not None:
                columns[name] = np.asarray(shade, float)
        # A scan that is a grid, or in angles, was seen from one place; others were put together.
        if header.has_pose() and {"rowIndex", "columnIndex", "sphericalRange"} & fields:
            place = np.asarray(header.translation, float)
            for name, value in zip(SCANNER, place, strict=True):
                columns[name] = np.full(len(columns["x"]), value)
        parts.append(columns)
    shared = [name for name in parts[0] if all(name in one for one in parts)] if parts else ["x"]
    table = {name: np.concatenate([one[name] for one in parts]) for name in shared if parts}
    count = len(table["x"]) if parts else 0
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property double {name}" for name in table] if parts else ["property double x"]
    with (Path(folder) / PLY).open("wb") as out:
        out.write("\n".join([*lines, "end_header", ""]).encode())
        if parts:
            np.stack(list(table.values()), axis=-1).astype("<f8").tofile(out)
    return {"points": count, "scans": len(parts)}


def read_stage(source: Path) -> tuple[PaintedMesh, str, list[str]]:
    """Return the triangles of a USD stage in its axes and in metres, its up, and what is said.

    Raises:
        SceneError: it cannot be read, or its unit is no sensible one.
        PrerequisiteError: the package that reads it is not installed.
    """
    with converted(source) as (folder, said):
        metres = float(said["metres"])
        if not (math.isfinite(metres) and 1e-6 <= metres <= 1e4):
            raise SceneError(f"{source}: its stage has {metres} metres per unit", fix="mend that")
        with named_as(source, folder / OBJ):
            painted = read_painted(folder / OBJ)
    lines = [
        f"the stage says: {said['up']} is up, one unit is {said['metres']:g} m"
        + (f", made by {said['creator']}" if said["creator"] else "")
    ]
    if said["is_roomplan"]:
        lines.append(
            "made by RoomPlan as boxes: doors are closed, and furniture is coarse; its export as a "
            "mesh has more"
        )
    if said["unread"]:
        parts = ", ".join(plural(n, kind) for kind, n in sorted(said["unread"].items()))
        lines.append(f"not read of the stage: {parts}")
    painted = replace(painted, vertices=painted.vertices * metres, unit="m")
    return painted, str(said["up"]), lines
