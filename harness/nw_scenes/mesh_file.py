"""Reads triangle meshes from untrusted OBJ, STL, PLY and GLB files.

By own code: trimesh's readers resolve relative indices of an OBJ at its end, fill the notches of
polygons, refuse a PLY of triangles and quads, and lose the poses of glTF nodes below one without
triangles.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.files.inside import foreign, regular, what_is
from nw_base.files.ply import Ply
from nw_scenes.finding import SceneFinding
from nw_scenes.limits import MESH_BYTES, MESH_FACES, MESH_REACH, TEXTURES
from nw_scenes.mesh import FACE_KINDS, FaceKind, TriangleMesh
from nw_scenes.mesh_formats import read_glb, read_obj
from nw_scenes.mesh_parts import (
    AGAIN,
    CUT_SHORT,
    Arrays,
    Material,
    Paint,
    Remarks,
    bytes_beside,
    check_count,
    cut_faces,
    fast_numbers,
    numbers_of,
    strips,
)

MESH_SUFFIXES = (".glb", ".obj", ".ply", ".stl")


def read_mesh(
    path: Path, *, scale: Sequence[float] = (1.0, 1.0, 1.0), kind: FaceKind = "ground"
) -> TriangleMesh:
    """Return the triangles of a file, materials and textures left alone.

    Args:
        path: OBJ, STL (either form), PLY (either form) or GLB (turned from +y up to +z up);
            polygons and strips are cut into triangles.
        scale: what coordinates are multiplied by.
        kind: what the faces belong to.

    Raises:
        SceneError: the file is missing, too large, of another format, empty, or has vertices that
            are not finite or indices out of range.
    """
    return inspect_mesh(path, scale=scale, kind=kind)[0]


def inspect_mesh(
    path: Path, *, scale: Sequence[float] = (1.0, 1.0, 1.0), kind: FaceKind = "ground"
) -> tuple[TriangleMesh, tuple[SceneFinding, ...]]:
    """Return the triangles of a file, and what of it was left out or understood in a certain way.

    Raises:
        SceneError: as `read_mesh`.
    """
    remarks = Remarks(path)
    vertices, faces = _read(path, remarks)
    vertices = vertices * np.asarray(scale, dtype=np.float64)
    return checked_mesh(vertices, faces, kind, str(path)), remarks.findings()


def _read(path: Path, remarks: Remarks) -> Arrays:
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise unread(path, MESH_SUFFIXES)
    try:
        size = regular(path).stat().st_size
        if (other := foreign(path)) is not None:
            raise SceneError(f"{path}: it is {other[0]}", fix=other[1])
        if size > MESH_BYTES:
            raise SceneError(
                f"{path} has {size} bytes", fix=f"decimate it below {MESH_BYTES} bytes"
            )
        vertices, faces = _READERS[path.suffix.lower()](path, remarks)
    except (OSError, ValueError) as error:  # A path with a zero byte is a ValueError.
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise SceneError(f"{path}: the mesh cannot be read: {reason}") from None
    if len(faces) == 0 and remarks.dropped:
        raise SceneError(f"{path}: no triangles in it, {remarks.words()}", fix=AGAIN)
    return vertices, faces


def unread(path: Path, suffixes: Sequence[str]) -> SceneError:
    """Return what is wrong with a file of none of these suffixes: what it is, and what to give."""
    fix = f"give {', '.join(suffixes)}"
    if what_is(path) == "folder":
        inside = sorted(one.name for one in path.iterdir() if one.suffix.lower() in suffixes)
        listed = ", ".join(clean(one, at_most=60) for one in inside[:3])
        return SceneError(
            f"{path}: a folder", fix=f"give a file in it: {listed}" if inside else fix
        )
    if path.suffix.lower() == ".gltf":
        fix = "pack it into one file: `npx @gltf-transform/cli copy IN.gltf OUT.glb`"
        return SceneError(f"{path}: glTF that lies in several files", fix=fix)
    known = foreign(path)
    if known is None and path.suffix.lower() in {".splat", ".spz", ".sog", ".ksplat"}:
        known = "a Gaussian splat, which has no surface", "give a mesh, and the splat with --splat"
    if known is None:
        return SceneError(f"{path}: no format that is read here", fix=fix)
    return SceneError(f"{path}: it is {known[0]}", fix=known[1])


@dataclass(frozen=True, kw_only=True, eq=False)
class PaintedMesh:
    """The triangles of a scan in the axes and the unit of its file, and their colours.

    Attributes:
        vertices: (V, 3) float64; finite.
        faces: (F, 3) int64 indices into `vertices`; all have an area.
        colours: (F, 3, 3) float32, of each corner, 0 to 1; None = the file has none.
        uv: (F, 3, 2) float32 places in the texture of each corner, (0, 0) at its upper left and v
            down; nan where a corner has none. None = no corner has one.
        material: (F,) int32 index into `materials`.
        materials: at least one.
        findings: what was left out of the file.
        unit: that a comment of the file names, as it names it; of glTF the metre. None = none.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colours: NDArray[np.float32] | None
    uv: NDArray[np.float32] | None
    material: NDArray[np.int32]
    materials: tuple[Material, ...]
    findings: tuple[SceneFinding, ...]
    unit: str | None = None

    @property
    def is_painted(self) -> bool:
        """Whether the file says anything of colours."""
        used = [self.materials[number] for number in np.unique(self.material)]
        return self.colours is not None or any(
            one.texture is not None or one.factor != (1.0, 1.0, 1.0) for one in used
        )


def read_painted(path: Path) -> PaintedMesh:
    """Return the triangles of a scan with their colours; nothing is turned, scaled or moved.

    Textures are those of glTF's base colour (and of `KHR_materials_pbrSpecularGlossiness`), of
    `map_Kd` of an OBJ's materials, whose files must lie in the OBJ's folder, and of the comment
    `TextureFile` of a PLY with `texcoord`. Colours of vertices are read, too. An STL has none.

    Args:
        path: OBJ, STL, PLY or GLB.

    Raises:
        SceneError: as `read_mesh`, but a scan may lie far from its origin.
    """
    suffix = path.suffix.lower()
    paint = Paint()
    remarks = Remarks(path, paint)
    vertices, faces = _read(path, remarks)
    if len(vertices) and np.isfinite(vertices).all():
        # What is near its own middle is checked like any mesh.
        checked_mesh(vertices - vertices.mean(axis=0), faces, "ground", str(path))
    else:
        checked_mesh(vertices, faces, "ground", str(path))
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    whole = (area != 0).any(axis=1)
    colours, uv, material = paint.joined(len(faces))
    remarks.turned = False
    return PaintedMesh(
        vertices=vertices,
        faces=faces[whole],
        colours=None if colours is None else colours[whole],
        uv=None if uv is None else uv[whole],
        material=material[whole],
        materials=tuple(paint.materials) or (Material(),),
        findings=remarks.findings(),
        unit="m" if suffix == ".glb" else _unit_of(path),
    )


_UNIT = re.compile(
    rb"\bunits?\b\W{0,3}(?:(?:is|are|in)\W+)?(mm|cm|m|in|ft|millimet\w+|centimet\w+|met(?:er|re)s?"
    rb"|inch(?:es)?|foot|feet)\b",
    re.IGNORECASE,
)


def _unit_of(path: Path) -> str | None:
    """Return the unit that the head of an OBJ, PLY or STL names, such as `# units: mm`."""
    with path.open("rb") as file:
        units = {one.lower() for one in _UNIT.findall(file.read(4096))}
    short = {
        b"milli": "mm",
        b"centi": "cm",
        b"met": "m",
        b"inch": "in",
        b"foot": "ft",
        b"fee": "ft",
    }
    named = {
        next((unit for begin, unit in short.items() if one.startswith(begin)), one.decode())
        for one in units
    }
    return named.pop() if len(named) == 1 else None


def checked_mesh(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], kind: FaceKind, origin: str
) -> TriangleMesh:
    """Return a mesh of arrays after checking them; `origin` names them in errors.

    Faces without area are left out: rays cannot meet them.

    Raises:
        SceneError: see `read_mesh`.
    """
    if len(vertices) == 0 or len(faces) == 0:
        raise SceneError(f"{origin}: {len(vertices)} vertices, {len(faces)} faces: nothing there")
    check_count(origin, max(len(vertices), len(faces)))
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        first = int(np.flatnonzero(~finite)[0])
        raise SceneError(
            f"{origin}: {int((~finite).sum())} vertices are not finite, first vertex {first}: "
            f"{vertices[first].tolist()}",
            fix="export the mesh again",
        )
    far = float(np.abs(vertices).max())
    if far > MESH_REACH:
        middle = np.median(vertices, axis=0).round().tolist()
        shift = "subtract its middle ({:.0f}, {:.0f}, {:.0f}) before it is exported, then check "
        raise SceneError(
            f"{origin}: a coordinate is {far:g}, its middle is {middle}",
            fix=shift.format(*middle) + "the unit: metres, with the start near the origin",
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = faces[(faces < 0) | (faces >= len(vertices))]
        raise SceneError(
            f"{origin}: a face names vertex {int(wrong[0])} of {len(vertices)}", fix=CUT_SHORT
        )
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    whole = (normal != 0).any(axis=1)
    if not whole.any():
        raise SceneError(f"{origin}: no face has an area", fix="check the scale")
    kept = np.ascontiguousarray(faces[whole], dtype=np.int32)
    return TriangleMesh(
        vertices=np.ascontiguousarray(vertices, dtype=np.float64),
        faces=kept,
        kinds=np.full(len(kept), FACE_KINDS.index(kind), dtype=np.uint8),
    )


# --- STL ---------------------------------------------------------------------------------------

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def _read_stl(path: Path, remarks: Remarks) -> Arrays:
    data = path.read_bytes()
    (count,) = struct.unpack_from("<I", data, 80) if len(data) >= 84 else (0,)
    needed = 84 + count * _FACET.itemsize
    exact = len(data) >= 84 and len(data) == needed
    # `solid` begins many binary files as well; theirs are as long as they say.
    if (
        not exact
        and re.match(rb"\s*solid\b", data, re.IGNORECASE)
        and b"facet" in data[:65536].lower()
    ):
        return _read_ascii_stl(path, data, remarks)
    if len(data) < needed or len(data) < 84:
        raise SceneError(
            f"{path}: no readable STL mesh: {len(data)} bytes, its {count} facets need {needed}",
            fix=CUT_SHORT,
        )
    if count == 0 and len(data) > needed:
        raise SceneError(
            f"{path}: no readable STL mesh: its header has 0 facets, and {len(data) - needed} "
            "bytes follow: its writer did not finish",
            fix="export it again",
        )
    if len(data) > needed:
        remarks.dropped["bytes after the last facet"] += len(data) - needed
    check_count(path, 3 * count)
    facets = np.frombuffer(data, _FACET, count, 84)
    corners = facets["corners"].astype(np.float64)
    # Programs keep colours or numbers of parts there, each in its own way.
    if marked := int((facets["attribute"] != 0).sum()):
        remarks.unread.append(f"the attributes of {marked} facets, such as colours")
    if b"COLOR=" in data[:80]:
        remarks.unread.append("the colour in its header")
    _check_turns(facets["normal"].astype(np.float64), corners, remarks)
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


_STL_WORDS = "solid|endsolid|facet|endfacet|outer|endloop|vertex"


def _check_turns(
    normals: NDArray[np.float64] | None, corners: NDArray[np.float64], remarks: Remarks
) -> None:
    """Remark that stored normals (F, 3) contradict the order of corners (F, 3, 3), which counts."""
    if normals is None or normals.size != 3 * len(corners):
        return
    normals = normals.reshape(-1, 3)
    with np.errstate(all="ignore"):
        turn = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        against = int(((turn * normals).sum(axis=1) < 0).sum())
    if against:
        remarks.unread.append(
            f"the normals of {against} of {len(normals)} facets, which contradict the order of "
            "their corners"
        )


def _read_ascii_stl(path: Path, data: bytes, remarks: Remarks) -> Arrays:
    text = data.decode("utf-8", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    rows: list[str] = []
    lines: list[int] = []
    normals: list[str] = []
    begun: int | None = None
    for number, line in enumerate(text.split("\n"), 1):
        words = line.split(maxsplit=1)
        word = words[0].lower() if words else ""
        if word == "facet":
            if begun is not None:
                break
            begun = len(rows)
            normals.append(words[1].lower().removeprefix("normal") if len(words) > 1 else "")
        elif word == "vertex":
            rows.append(words[1] if len(words) > 1 else "")
            lines.append(number)
        elif word == "endfacet":
            if begun is None or len(rows) != begun + 3:
                corners = len(rows) - (begun or 0)
                raise SceneError(
                    f"{path}:{number}: a facet of {corners} vertices",
                    fix="triangulate it before it is exported",
                )
            begun = None
    if begun is not None:
        raise SceneError(f"{path}: a facet does not end", fix=CUT_SHORT)
    if len(rows) % 3:
        raise SceneError(f"{path}: a vertex stands outside of a facet", fix=AGAIN)
    check_count(path, len(rows))
    vertices = numbers_of(path, rows, lines, "vertex")
    _check_turns(fast_numbers(normals, np.float64), vertices.reshape(-1, 3, 3), remarks)
    others = re.findall(rf"^[ \t]*(?!(?:{_STL_WORDS})\b)(\S+)", text, re.MULTILINE | re.IGNORECASE)
    for other in others:
        remarks.dropped[f"unknown lines {clean(other, at_most=20)!r}"] += 1
    return vertices, np.arange(len(rows)).reshape(-1, 3)


# --- PLY ---------------------------------------------------------------------------------------

_PLY_SURFACES = ("face", "tristrips")
_PLY_TEXTURE = re.compile(r"TextureFile\s+\S", re.IGNORECASE)
_PLY_SAID = re.compile(r"(TextureFile|.*\bunits?\b).*", re.IGNORECASE)


def _read_ply(path: Path, remarks: Remarks) -> Arrays:
    ply = Ply.open(path, most_rows={"vertex": MESH_FACES, "face": MESH_FACES})
    table = ply.elements.get("vertex")
    names = table.dtype.names or () if table is not None else ()
    if not any(len(ply.elements.get(one, ())) for one in _PLY_SURFACES):
        _no_surface(ply, names)
    if table is None or not {"x", "y", "z"} <= set(names):
        raise SceneError(f"{path}: no vertices with x, y and z in it", fix=AGAIN)
    vertices = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    for name, rows in ply.elements.items():
        if name not in {"vertex", *_PLY_SURFACES} and len(rows):
            remarks.dropped[f"rows of {clean(name, at_most=20)!r}"] += len(rows)
    faces = [np.zeros((0, 3), np.int64)]
    looks = _PlyLooks(ply, remarks)
    remarks.unread += ply.remarks("vertex", {"x", "y", "z", *looks.used}, _PLY_SILENT)
    remarks.unread += ply.unread_comments(_PLY_SAID)
    for element in _PLY_SURFACES:
        lists = ply.lists.get(element, {})
        polygons = lists.get("vertex_indices") or lists.get("vertex_index")
        if polygons is None:
            if len(ply.elements.get(element, ())):
                raise SceneError(f"{path}: element {element} has no list vertex_indices", fix=AGAIN)
            continue
        corners = polygons.values.astype(np.int64)
        if element == "tristrips":
            faces.append(strips(corners, polygons.counts))
            looks.add(faces[-1])
            remarks.unread += ply.remarks(element, {*_PLY_CORNERS, *looks.used}, _PLY_SILENT)
            continue
        narrow = polygons.counts < 3
        if narrow.any():
            remarks.dropped["faces of fewer than three vertices"] += int(narrow.sum())
            corners = corners[np.repeat(~narrow, polygons.counts)]
        faces.append(cut_faces(path, vertices, polygons.counts[~narrow], corners))
        looks.add(faces[-1], is_whole=bool((polygons.counts == 3).all()))
        remarks.unread += ply.remarks(element, {*_PLY_CORNERS, *looks.used}, _PLY_SILENT)
    return vertices, np.concatenate(faces)


_PLY_CORNERS = ("vertex_indices", "vertex_index")
_PLY_LOOKS = {
    *("red", "green", "blue", "s", "t", "u", "v", "texture_u", "texture_v"),
    *("texcoord", "texnumber"),
}
_PLY_SILENT = ("nx", "ny", "nz", "alpha", "flags")
"""Normals, which the faces say themselves, opacity, and what editors selected."""


def _no_surface(ply: Ply, names: Sequence[str]) -> None:
    """Refuse a PLY without faces for what it is.

    Raises:
        SceneError: it is a splat or a point cloud.
    """
    count = len(ply.elements.get("vertex", ()))
    if {"f_dc_0", "packed_position"} & set(names):
        raise SceneError(
            f"{ply.path}: {count} Gaussians of a splat, which has no surface to stand on",
            fix="give the mesh of the same scan, and this file with --splat",
        )
    if count:
        raise SceneError(
            f"{ply.path}: a point cloud: {count} points and no faces, so nothing to stand on",
            fix="export the scan as a mesh (Scaniverse, Polycam: as GLB or OBJ), or give the file "
            "to `nw-eval scenes import`",
        )


class _PlyLooks:
    """Colours of a PLY: of its vertices, or a texture with `texcoord` of its faces or vertices."""

    def __init__(self, ply: Ply, remarks: Remarks) -> None:
        self.ply, self.paint = ply, remarks.paint
        self.colours: NDArray[np.float64] | None = None
        self.places: NDArray[np.float64] | None = None
        self.used: set[str] = set()
        if self.paint is None:
            self.used |= _PLY_LOOKS  # Who asks for surfaces alone passes over all that colours.
            return
        table = ply.elements["vertex"]
        names = table.dtype.names or ()
        if {"red", "green", "blue"} <= set(names):
            shades = [table[one] for one in ("red", "green", "blue")]
            self.used |= {"red", "green", "blue"}
            whole = [one.dtype.kind == "f" or np.iinfo(one.dtype).max for one in shades]
            self.colours = np.stack(
                [np.clip(one / w, 0.0, 1.0) for one, w in zip(shades, whole, strict=True)], axis=-1
            )
        for u, v in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")):
            if {u, v} <= set(names):
                self.places = np.stack([table[u], table[v]], axis=-1).astype(np.float64)
                self.used |= {u, v}
        pictures = [one.split(None, 1)[1] for one in ply.comments if _PLY_TEXTURE.match(one)]
        if len(pictures) > TEXTURES:
            remarks.dropped[f"textures over {TEXTURES}"] += len(pictures) - TEXTURES
        for picture in pictures[:TEXTURES]:
            texture = bytes_beside(ply.path, picture, remarks)
            self.paint.materials.append(Material(texture=texture))

    def add(self, faces: NDArray[np.int64], *, is_whole: bool = False) -> None:
        """Give triangles (F, 3) their colours; `is_whole`: they are all of the file's faces."""
        count = len(self.ply.elements["vertex"])
        if self.paint is None or ((faces < 0) | (faces >= count)).any():  # `checked_mesh` names it.
            return
        uv = None if self.places is None else self.places[faces]
        material: NDArray[np.integer] | int = 0
        corners = self.ply.lists.get("face", {}).get("texcoord")
        if is_whole and corners is not None and (corners.counts == 6).all():
            uv = corners.values.reshape(-1, 3, 2).astype(np.float64)
            self.used |= {"texcoord", "texnumber"}
            table = self.ply.elements["face"]
            if "texnumber" in (table.dtype.names or ()):
                most = max(len(self.paint.materials) - 1, 0)
                material = np.clip(table["texnumber"].astype(np.int64), 0, most)
        self.paint.add(
            len(faces),
            colours=None if self.colours is None else self.colours[faces],
            uv=None if uv is None else np.array([0.0, 1.0]) + np.array([1.0, -1.0]) * uv,
            material=material,
        )


_READERS = {".glb": read_glb, ".obj": read_obj, ".ply": _read_ply, ".stl": _read_stl}
