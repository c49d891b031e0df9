"""Reads triangle meshes from OBJ, STL, PLY and GLB files that nobody has vouched for.

By own code: trimesh's readers resolve relative indices of an OBJ at its end, fill the notches of
polygons, refuse a PLY of triangles and quads, and lose the poses of glTF nodes below one without
triangles.
"""

from __future__ import annotations

import base64
import json
import re
import struct
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.clean import clean
from nw_eval.errors import SceneError
from nw_eval.files.inside import OutsideError, bounded_bytes, inside, regular, what_is
from nw_eval.files.ply import Ply
from nw_eval.scenes.finding import SceneFinding
from nw_eval.scenes.limits import MESH_BYTES, MESH_FACES, MESH_REACH, TEXTURE_BYTES, TEXTURES
from nw_eval.scenes.mesh import FACE_KINDS, FaceKind, TriangleMesh, rotation_matrix
from nw_eval.scenes.polygons import PolygonError, triangulated

MESH_SUFFIXES = (".glb", ".obj", ".ply", ".stl")

_AGAIN = "open it in a mesh viewer and export it again"
_CUT_SHORT = "the file is cut short; export it again"


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
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise SceneError(
            f"{path}: no mesh format that is read here", fix=f"give {', '.join(MESH_SUFFIXES)}"
        )
    remarks = _Remarks(path)
    vertices, faces = _read(path, remarks)
    vertices = vertices * np.asarray(scale, dtype=np.float64)
    return checked_mesh(vertices, faces, kind, str(path)), remarks.findings()


def _read(path: Path, remarks: _Remarks) -> _Arrays:
    try:
        size = regular(path).stat().st_size
        if size > MESH_BYTES:
            raise SceneError(f"{path}: {size} bytes", fix=f"decimate it below {MESH_BYTES} bytes")
        vertices, faces = _READERS[path.suffix.lower()](path, remarks)
    except (OSError, ValueError) as error:  # A path with a zero byte is a ValueError.
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise SceneError(f"{path}: the mesh cannot be read: {reason}") from None
    if len(faces) == 0 and remarks.dropped:
        raise SceneError(f"{path}: no triangles in it, {remarks.words()}", fix=_AGAIN)
    return vertices, faces


@dataclass(frozen=True, kw_only=True)
class Material:
    """What colours some triangles.

    Attributes:
        factor: red, green, blue, 0 to 1; a texture's colours are multiplied by it.
        texture: bytes of a picture file, which nobody has looked at; None = the factor alone.
        is_linear: the factor, and colours of vertices, are linear; as displayed (sRGB) if not.
    """

    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: bytes | None = None
    is_linear: bool = False


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
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colours: NDArray[np.float32] | None
    uv: NDArray[np.float32] | None
    material: NDArray[np.int32]
    materials: tuple[Material, ...]
    findings: tuple[SceneFinding, ...]

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
    if suffix not in MESH_SUFFIXES:
        raise SceneError(
            f"{path}: no mesh format that is read here", fix=f"give {', '.join(MESH_SUFFIXES)}"
        )
    paint = _Paint()
    remarks = _Remarks(path, paint)
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
    )


@dataclass
class _Paint:
    """Colours of the faces that a reader returns, part after part."""

    materials: list[Material] = field(default_factory=list)
    parts: list[tuple[int, Any, Any, Any]] = field(default_factory=list)

    def add(
        self,
        faces: int,
        *,
        colours: NDArray[np.floating] | None = None,
        uv: NDArray[np.floating] | None = None,
        material: NDArray[np.integer] | int = 0,
    ) -> None:
        self.parts.append((faces, colours, uv, material))

    def joined(self, faces: int) -> tuple[Any, Any, NDArray[np.int32]]:
        count = sum(part[0] for part in self.parts)
        if count != faces:
            self.parts.append((faces - count, None, None, 0))
        colours = uv = None
        if any(part[1] is not None for part in self.parts):
            colours = np.concatenate(
                [np.ones((n, 3, 3), np.float32) if c is None else c for n, c, _, _ in self.parts]
            ).astype(np.float32)
        if any(part[2] is not None for part in self.parts):
            nowhere = np.float32(np.nan)
            uv = np.concatenate(
                [np.full((n, 3, 2), nowhere) if t is None else t for n, _, t, _ in self.parts]
            ).astype(np.float32)
        material = np.concatenate(
            [np.zeros(0, np.int32)] + [np.broadcast_to(m, n) for n, _, _, m in self.parts]
        ).astype(np.int32)
        return colours, uv, material


class _Remarks:
    """What is left out of a file, and its colours if somebody wants them."""

    def __init__(self, path: Path, paint: _Paint | None = None) -> None:
        self.path = path
        self.paint = paint
        self.dropped: Counter[str] = Counter()
        self.turned = False

    def words(self) -> str:
        return ", ".join(f"{count} {what}" for what, count in sorted(self.dropped.items()))

    def findings(self) -> tuple[SceneFinding, ...]:
        found: list[SceneFinding] = []
        if self.turned:
            found.append(
                SceneFinding(
                    code="mesh_turned",
                    severity="note",
                    message=f"{self.path.name}: +y is up in glTF; it is turned so that +z is: "
                    "(x, y, z) of the file is (x, -z, y) of the world",
                    fix="if the file has +z up already, write it as .ply or .obj",
                )
            )
        if self.dropped:
            found.append(
                SceneFinding(
                    code="mesh_partly_read",
                    severity="note",
                    message=f"{self.path.name}: only triangles are used; left out: {self.words()}",
                    fix="export these as triangles if a robot can touch them",
                )
            )
        return tuple(found)


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
    _check_count(origin, max(len(vertices), len(faces)))
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
            f"{origin}: a face names vertex {int(wrong[0])} of {len(vertices)}", fix=_CUT_SHORT
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


def _check_count(origin: object, count: int) -> None:
    if count > MESH_FACES:
        raise SceneError(
            f"{origin}: {count} vertices or faces", fix=f"decimate it below {MESH_FACES}"
        )


_Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


def _cut(
    path: Path,
    vertices: NDArray[np.float64],
    counts: NDArray[np.int64],
    corners: NDArray[np.int64],
    place: Sequence[int] | None = None,
) -> NDArray[np.int64]:
    """Return triangles of polygons whose corners are numbers of vertices; `place` has their lines.

    Raises:
        SceneError: a vertex is out of range or not finite, or a polygon cannot be cut.
    """
    if len(counts) == 0:
        return np.zeros((0, 3), np.int64)
    _check_count(path, int((counts - 2).sum()))
    if (counts == 3).all():
        return corners.reshape(-1, 3)
    if corners.min() < 0 or corners.max() >= len(vertices):
        wrong = corners[(corners < 0) | (corners >= len(vertices))]
        raise SceneError(
            f"{path}: a face names vertex {int(wrong[0])} of {len(vertices)}", fix=_CUT_SHORT
        )
    if not np.isfinite(vertices).all():  # `checked_mesh` names it.
        vertices = np.zeros_like(vertices)
    try:
        with np.errstate(all="ignore"):
            return triangulated(vertices, counts, corners)
    except PolygonError as error:
        where = f"{path}:{place[error.face]}" if place else f"{path}: face {error.face}"
        raise SceneError(f"{where}: {error}", fix="triangulate it before it is exported") from None


def _picture_beside(path: Path, name: str, remarks: _Remarks) -> bytes | None:
    """Return a texture that a file names in its folder; None, and a remark, if it cannot be had."""
    try:
        picture = inside(path.parent, name.strip().replace("\\", "/"))
        if what_is(picture) != "nothing":
            return bounded_bytes(picture, TEXTURE_BYTES)
        reason: object = "it is not there"
    except (OutsideError, OSError, ValueError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
    label = clean(name.strip(), at_most=60)
    remarks.dropped[f"texture {label!r} ({clean(str(reason), at_most=80)})"] += 1
    return None


# --- OBJ ---------------------------------------------------------------------------------------

# Say nothing about where surfaces are.
_OBJ_SILENT = (
    "vt", "vn", "g", "o", "s", "mg", "usemtl", "mtllib", "usemap", "maplib", "bevel", "c_interp",
    "d_interp", "lod", "shadow_obj", "trace_obj",
)  # fmt: skip
_OBJ_DROPPED = {
    "p": "points", "l": "lines",
    **dict.fromkeys(("vp", "cstype", "bmat", "step", "curv", "curv2", "surf", "parm", "trim",
                     "hole", "scrv", "sp", "end", "con", "ctech", "stech", "bsp", "bzp", "cdc",
                     "cdp", "res"), "lines of curved surfaces"),
}  # fmt: skip


def _read_obj(path: Path, remarks: _Remarks) -> _Arrays:
    """Vertices (V, 3) and triangles of an OBJ; of `1/7/3` only the vertex counts."""
    points: list[str] = []
    point_lines: list[int] = []
    polygons: list[str] = []
    lines: list[int] = []
    before: list[int] = []  # Vertices that stand above each polygon: relative ones count from there
    looks = _ObjLooks()
    for number, line in _obj_lines(path.read_bytes()):
        kind, _, rest = line.replace("\t", " ").partition(" ")
        if kind == "v":
            points.append(rest)
            point_lines.append(number)
        elif kind in {"f", "fo"}:
            polygons.append(rest)
            lines.append(number)
            before.append(len(points))
            looks.face()
        elif remarks.paint is not None and kind in {"vt", "usemtl", "mtllib"}:
            looks.line(kind, rest)
        elif kind in _OBJ_DROPPED:
            remarks.dropped[_OBJ_DROPPED[kind]] += 1
        elif kind not in _OBJ_SILENT:
            remarks.dropped[f"unknown lines {clean(kind, at_most=20)!r}"] += 1
    _check_count(path, max(len(points), len(polygons)))
    vertices = _numbers(path, points, point_lines, "v")
    widths = np.array([len(line.split()) for line in polygons], dtype=np.int64)
    if len(widths) and widths.min() < 3:
        short = int(widths.argmin())
        raise SceneError(
            f"{path}:{lines[short]}: a face of {widths[short]} vertices", fix="export it again"
        )
    named = _vertex_numbers(path, polygons, lines, int(widths.sum()))
    above = np.repeat(np.array(before, dtype=np.int64), widths)
    corners = np.where(named < 0, above + named, named - 1)
    wrong = (named == 0) | (corners < 0) | (corners >= len(points))
    if wrong.any():
        at = int(np.flatnonzero(wrong)[0])
        face = int(np.searchsorted(np.cumsum(widths), at, side="right"))
        raise SceneError(
            f"{path}:{lines[face]}: a face names vertex {named[at]}, there are {len(points)}"
            + (f", {before[face]} of them above it" if named[at] < 0 else ""),
            fix=_CUT_SHORT,
        )
    if remarks.paint is None:
        return vertices, _cut(path, vertices, widths, corners, lines)
    # Corners are cut in place of vertices: each has a place in the texture of its own.
    own = np.arange(len(corners))
    finite = np.where(np.isfinite(vertices), vertices, 0.0)
    cut = _cut(path, finite[corners], widths, own, lines)
    looks.paint(
        path, remarks, cut, points, polygons, corners, np.repeat(own[: len(widths)], widths)
    )
    return vertices, corners[cut]


class _ObjLooks:
    """Texture coordinates and materials of an OBJ, as its lines come."""

    def __init__(self) -> None:
        self.coordinates: list[str] = []
        self.libraries: list[str] = []
        self.names: dict[str, int] = {"": 0}
        self.now = 0
        self.of_face: list[int] = []
        self.above: list[int] = []  # Texture coordinates that stand above each face.

    def face(self) -> None:
        self.of_face.append(self.now)
        self.above.append(len(self.coordinates))

    def line(self, kind: str, rest: str) -> None:
        if kind == "vt":
            self.coordinates.append(rest)
        elif kind == "mtllib":
            self.libraries.append(rest.strip())
        else:
            self.now = self.names.setdefault(rest.strip(), len(self.names))

    def paint(
        self,
        path: Path,
        remarks: _Remarks,
        cut: NDArray[np.int64],
        points: list[str],
        polygons: list[str],
        corners: NDArray[np.int64],
        face_of: NDArray[np.int64],
    ) -> None:
        """Give the cut triangles (F, 3) of corners their colours."""
        paint = remarks.paint
        assert paint is not None
        read: dict[str, Material] = {}
        for library in dict.fromkeys(self.libraries):
            read |= _materials(path, library, remarks)
        if len(self.names) > 10 * TEXTURES:
            raise SceneError(f"{path}: {len(self.names)} materials", fix="join them into an atlas")
        paint.materials += [read.get(name, Material()) for name in self.names]
        colours = None
        rows = _fast(points, np.float64)
        if rows is not None and len(points) and len(rows) in {6 * len(points), 7 * len(points)}:
            wide = len(rows) // len(points)
            shades = np.clip(rows.reshape(-1, wide)[:, 3:6], 0.0, 1.0)
            colours = shades[corners[cut]]
        paint.add(
            len(cut),
            colours=colours,
            uv=self._places(path, polygons, face_of, len(corners), cut),
            material=np.array(self.of_face, dtype=np.int64)[face_of[cut[:, 0]]],
        )

    def _places(
        self,
        path: Path,
        polygons: list[str],
        face_of: NDArray[np.int64],
        count: int,
        cut: NDArray[np.int64],
    ) -> NDArray[np.float32] | None:
        if not self.coordinates:
            return None
        words = [word.split("/") for word in " ".join(polygons).split()]
        if len(words) != count:
            return None
        numbers = [word[1] if len(word) > 1 and word[1] else "0" for word in words]
        found = _fast(numbers, np.int64)
        values = [line.split()[:2] for line in self.coordinates]
        flat = _fast(
            [" ".join(one if len(one) == 2 else [*one, "0"]) for one in values], np.float64
        )
        if found is None or len(found) != count or flat is None or len(flat) != 2 * len(values):
            raise SceneError(f"{path}: a `vt` or a corner's second number is none", fix=_AGAIN)
        above = np.array(self.above, dtype=np.int64)[face_of]
        index = np.where(found < 0, above + found, found - 1)
        known = (found != 0) & (index >= 0) & (index < len(values))
        table = np.vstack([flat.reshape(-1, 2), [[np.nan, np.nan]]])
        places = table[np.where(known, index, len(values))]
        return (np.array([0.0, 1.0]) + np.array([1.0, -1.0]) * places)[cut].astype(np.float32)


def _materials(path: Path, library: str, remarks: _Remarks) -> dict[str, Material]:
    """Return the materials of an MTL file in the folder of an OBJ, by name."""
    content = _picture_beside(path, library, remarks)
    found: dict[str, Material] = {}
    name, factor, picture = "", (1.0, 1.0, 1.0), ""

    def keep() -> None:
        texture = _picture_beside(path, picture, remarks) if picture else None
        # Many exporters write a grey Kd that they themselves do not multiply textures by.
        found[name] = Material(
            factor=(1.0, 1.0, 1.0) if texture is not None else factor, texture=texture
        )

    for line in (content or b"").decode("utf-8-sig", errors="replace").splitlines():
        word, _, rest = line.strip().replace("\t", " ").partition(" ")
        if word == "newmtl":
            keep()
            name, factor, picture = rest.strip(), (1.0, 1.0, 1.0), ""
            if len(found) > TEXTURES:
                raise SceneError(
                    f"{path}: over {TEXTURES} materials in {clean(library, at_most=60)!r}",
                    fix="join their textures into an atlas",
                )
        elif word == "Kd":
            values = _fast([rest], np.float64)
            if values is not None and len(values) >= 3 and np.isfinite(values[:3]).all():
                r, g, b = np.clip(values[:3], 0.0, 1.0).tolist()
                factor = (r, g, b)
        elif word == "map_Kd":
            # `-s 1 1 1 name`: what stands before the name is how it is laid on.
            rest = rest.strip()
            picture = rest.rpartition(" ")[2] if rest.startswith("-") else rest
    keep()
    return found


def _obj_lines(data: bytes) -> Iterator[tuple[int, str]]:
    """Yield each line that says something, by its number; those that go on are joined."""
    text = data.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    begun, head = 0, ""
    for number, raw in enumerate(text.split("\n"), 1):
        line = raw.strip()
        if not head and (not line or line[0] == "#"):
            continue
        begun = begun or number
        if line.endswith("\\"):
            head += line[:-1] + " "
            continue
        yield begun, (head + line).strip().partition("#")[0]
        begun, head = 0, ""
    if head.strip():
        yield begun, head.strip()


def _numbers(path: Path, rows: list[str], lines: list[int], what: str) -> NDArray[np.float64]:
    """(rows, 3) float64: the first three numbers of each row.

    Raises:
        SceneError: naming the line of the first row that has not so many.
    """
    if not rows:
        return np.zeros((0, 3))
    widths = {len(row.split()) for row in rows}
    wide = max(widths)
    if len(widths) == 1 and wide >= 3:
        values = _fast(rows, np.float64)
        if values is not None and len(values) == len(rows) * wide:
            return np.ascontiguousarray(values.reshape(-1, wide)[:, :3])
    out = np.empty((len(rows), 3))
    for i, row in enumerate(rows):
        found = _fast([row], np.float64)
        if found is not None and len(found) >= 3:
            out[i] = found[:3]
        else:
            raise SceneError(
                f"{path}:{lines[i]}: `{what}` is not followed by three numbers: "
                f"{clean(row, at_most=60)!r}",
                fix=_AGAIN,
            ) from None
    return out


def _vertex_numbers(path: Path, rows: list[str], lines: list[int], count: int) -> NDArray[np.int64]:
    """(count,) int64 numbers of vertices of all rows, what follows a slash left out.

    Raises:
        SceneError: naming the line of the first row with another word.
    """
    if not rows:
        return np.zeros(0, np.int64)
    bare = re.sub(r"/\S*", "", "\n".join(rows)).split("\n")
    values = _fast(bare, np.int64)
    if values is not None and len(values) == count:
        return values
    found: list[int] = []
    for row, number in zip(bare, lines, strict=True):
        for word in row.split():
            if re.fullmatch(r"[+-]?[0-9]{1,15}", word) is None:
                raise SceneError(
                    f"{path}:{number}: {clean(word, at_most=40)!r} is no number of a vertex",
                    fix=_AGAIN,
                )
            found.append(int(word))
    if len(found) != count:  # A word that begins with a slash.
        raise SceneError(f"{path}: a face has a corner without a vertex", fix=_AGAIN)
    return np.array(found, dtype=np.int64)


def _fast(rows: list[str], kind: type[np.float64 | np.int64]) -> NDArray[Any] | None:
    """Return all numbers of some lines, None if there is another word among them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # Older NumPy warns where it stops.
        try:
            return np.fromstring(" ".join(rows), dtype=kind, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


# --- STL ---------------------------------------------------------------------------------------

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def _read_stl(path: Path, remarks: _Remarks) -> _Arrays:
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
        return _read_ascii_stl(path, data)
    if len(data) < needed or len(data) < 84:
        raise SceneError(
            f"{path}: no readable STL mesh: {len(data)} bytes, its {count} facets need {needed}",
            fix=_CUT_SHORT,
        )
    if count == 0 and len(data) > needed:
        raise SceneError(
            f"{path}: no readable STL mesh: it says 0 facets, and {len(data) - needed} bytes "
            "follow: its writer did not finish",
            fix="export it again",
        )
    if len(data) > needed:
        remarks.dropped["bytes after the last facet"] += len(data) - needed
    _check_count(path, 3 * count)
    corners = np.frombuffer(data, _FACET, count, 84)["corners"].reshape(-1, 3)
    return corners.astype(np.float64), np.arange(3 * count).reshape(-1, 3)


def _read_ascii_stl(path: Path, data: bytes) -> _Arrays:
    text = data.decode("utf-8", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    rows: list[str] = []
    lines: list[int] = []
    begun: int | None = None
    for number, line in enumerate(text.split("\n"), 1):
        words = line.split(maxsplit=1)
        word = words[0].lower() if words else ""
        if word == "facet":
            if begun is not None:
                break
            begun = len(rows)
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
        raise SceneError(f"{path}: a facet does not end", fix=_CUT_SHORT)
    if len(rows) % 3:
        raise SceneError(f"{path}: a vertex stands outside of a facet", fix=_AGAIN)
    _check_count(path, len(rows))
    return _numbers(path, rows, lines, "vertex"), np.arange(len(rows)).reshape(-1, 3)


# --- PLY ---------------------------------------------------------------------------------------

_PLY_SURFACES = ("face", "tristrips")
_PLY_TEXTURE = re.compile(r"TextureFile\s+\S", re.IGNORECASE)


def _read_ply(path: Path, remarks: _Remarks) -> _Arrays:
    ply = Ply.open(path, most_rows={"vertex": MESH_FACES, "face": MESH_FACES})
    table = ply.elements.get("vertex")
    names = table.dtype.names or () if table is not None else ()
    if table is None or not {"x", "y", "z"} <= set(names):
        raise SceneError(f"{path}: no vertices with x, y and z in it", fix=_AGAIN)
    vertices = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    for name, rows in ply.elements.items():
        if name not in {"vertex", *_PLY_SURFACES} and len(rows):
            remarks.dropped[f"rows of {clean(name, at_most=20)!r}"] += len(rows)
    faces = [np.zeros((0, 3), np.int64)]
    looks = _PlyLooks(ply, remarks)
    for element in _PLY_SURFACES:
        lists = ply.lists.get(element, {})
        found = lists.get("vertex_indices") or lists.get("vertex_index")
        if found is None:
            if len(ply.elements.get(element, ())):
                raise SceneError(
                    f"{path}: element {element} has no list vertex_indices", fix=_AGAIN
                )
            continue
        corners = found.values.astype(np.int64)
        if element == "tristrips":
            faces.append(_strips(corners, found.counts))
            looks.add(faces[-1])
            continue
        narrow = found.counts < 3
        if narrow.any():
            remarks.dropped["faces of fewer than three vertices"] += int(narrow.sum())
            corners = corners[np.repeat(~narrow, found.counts)]
        faces.append(_cut(path, vertices, found.counts[~narrow], corners))
        looks.add(faces[-1], is_whole=bool((found.counts == 3).all()))
    return vertices, np.concatenate(faces)


class _PlyLooks:
    """Colours of a PLY: of its vertices, or a texture with `texcoord` of its faces or vertices."""

    def __init__(self, ply: Ply, remarks: _Remarks) -> None:
        self.ply, self.paint = ply, remarks.paint
        self.colours: NDArray[np.float64] | None = None
        self.places: NDArray[np.float64] | None = None
        if self.paint is None:
            return
        table = ply.elements["vertex"]
        names = table.dtype.names or ()
        if {"red", "green", "blue"} <= set(names):
            shades = [table[one] for one in ("red", "green", "blue")]
            whole = [one.dtype.kind == "f" or np.iinfo(one.dtype).max for one in shades]
            self.colours = np.stack(
                [np.clip(one / w, 0.0, 1.0) for one, w in zip(shades, whole, strict=True)], axis=-1
            )
        for u, v in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")):
            if {u, v} <= set(names):
                self.places = np.stack([table[u], table[v]], axis=-1).astype(np.float64)
        pictures = [one.split(None, 1)[1] for one in ply.comments if _PLY_TEXTURE.match(one)]
        for picture in pictures[:TEXTURES]:
            texture = _picture_beside(ply.path, picture, remarks)
            self.paint.materials.append(Material(texture=texture))

    def add(self, faces: NDArray[np.int64], *, is_whole: bool = False) -> None:
        """Give triangles (F, 3) their colours; `is_whole`: they are all of the file's faces."""
        if self.paint is None or (len(faces) and faces.max() >= len(self.ply.elements["vertex"])):
            return
        uv = None if self.places is None else self.places[faces]
        material: NDArray[np.integer] | int = 0
        corners = self.ply.lists.get("face", {}).get("texcoord")
        if is_whole and corners is not None and (corners.counts == 6).all():
            uv = corners.values.reshape(-1, 3, 2).astype(np.float64)
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


def _strips(corners: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """(F, 3) triangles of strips: each list is one or more, -1 ends one."""
    run = np.insert(corners, np.cumsum(counts)[:-1], -1)
    place = np.arange(len(run))
    place -= np.maximum.accumulate(np.where(run == -1, place, -1)) + 1  # In its strip.
    last = np.flatnonzero(place >= 2)
    a, b, c = run[last - 2], run[last - 1], run[last]
    # Every other triangle of a strip is wound the other way.
    odd = (place[last] % 2 == 1)[:, None]
    return np.where(odd, np.stack([b, a, c], -1), np.stack([a, b, c], -1))


# --- GLB ---------------------------------------------------------------------------------------

_GLTF_TRIANGLES = (4, 5, 6)  # Triangles, strips, fans.
_GLTF_KINDS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_GLTF_LOOKS = re.compile(
    r"(KHR|EXT)_(materials|texture|lights|animation)_\w+|KHR_mesh_quantization"
)
"""Extensions that change no surface, or that are understood."""


def _read_glb(path: Path, remarks: _Remarks) -> _Arrays:
    """Vertices and triangles of the default scene of a glTF 2 in one file, turned to +z up.

    After https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.
    """
    try:
        vertices, faces = _Glb(path, remarks).read()
    except SceneError:
        raise
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError,
            struct.error) as error:  # fmt: skip
        raise SceneError(
            f"{path}: no readable GLB mesh: {type(error).__name__}: "
            f"{clean(str(error), at_most=200)}",
            fix=_AGAIN,
        ) from None
    if remarks.paint is not None:  # Whoever wants colours turns it.
        return vertices, faces
    remarks.turned = True
    x, y, z = vertices.T
    return np.stack([x, -z, y], axis=-1), faces


class _Glb:
    def __init__(self, path: Path, remarks: _Remarks) -> None:
        data = path.read_bytes()
        if data[:4] != b"glTF" or len(data) < 20:
            raise SceneError(f"{path}: it begins with {data[:4]!r}, not with b'glTF'", fix=_AGAIN)
        version, whole, length = struct.unpack_from("<III", data, 4)
        if version != 2 or whole > len(data) or 20 + length > whole:
            raise SceneError(
                f"{path}: glTF version {version}, {whole} bytes said, {len(data)} there",
                fix="export glTF 2 (.glb) again",
            )
        self.path, self.remarks = path, remarks
        self.materials: dict[int | None, int] = {}
        self.content: dict[str, Any] = json.loads(data[20 : 20 + length])
        self.buffers = [
            self._buffer(one.get("uri"), data[28 + length : whole])
            for one in self.content.get("buffers", ())
        ]
        needed = [str(one) for one in self.content.get("extensionsRequired", ())]
        unknown = [name for name in needed if not _GLTF_LOOKS.fullmatch(name)]
        if unknown:
            raise SceneError(
                f"{path}: it needs {clean(', '.join(unknown), at_most=100)}",
                fix="export it without compression of the mesh",
            )

    def _buffer(self, uri: str | None, binary: bytes) -> bytes:
        """Return the bytes of a buffer: the file's second part, or what is written in the JSON."""
        if uri is None:
            return binary
        kind, _, text = uri.partition(";base64,")
        if not kind.startswith("data:"):
            raise SceneError(
                f"{self.path}: its numbers lie in {clean(uri, at_most=60)!r}",
                fix="export one .glb file",
            )
        return base64.b64decode(text, validate=True)

    def read(self) -> _Arrays:
        """Walk the tree of nodes."""
        vertices = [np.zeros((0, 3))]
        faces = [np.zeros((0, 3), np.int64)]
        nodes: list[dict[str, Any]] = self.content.get("nodes", [])
        scenes = self.content.get("scenes")
        if scenes:
            roots = scenes[self.content.get("scene", 0)].get("nodes", [])
        else:
            roots = sorted(
                set(range(len(nodes))) - {c for n in nodes for c in n.get("children", ())}
            )
        count = triangles = 0
        met: set[int] = set()
        parts: dict[int, list[tuple[_Arrays, dict[str, Any]]]] = {}
        waiting = [(int(root), np.eye(4)) for root in reversed(roots)]
        while waiting:
            number, T_parent = waiting.pop()
            if number in met or number < 0:
                raise SceneError(f"{self.path}: its nodes are no tree", fix=_AGAIN)
            met.add(number)
            node = nodes[number]
            T = T_parent @ _gltf_pose(node)
            waiting += [(int(child), T) for child in reversed(node.get("children", ()))]
            if "mesh" not in node:
                continue
            if "skin" in node:
                self.remarks.dropped["skins (bodies stand as they were modelled)"] += 1
            if node["mesh"] not in parts:
                parts[node["mesh"]] = list(self._parts(self.content["meshes"][node["mesh"]]))
            for (points, corners), looks in parts[node["mesh"]]:
                # A mirror turns faces inside out; glTF turns them back.
                is_mirrored = np.linalg.det(T[:3, :3]) < 0
                wound = corners[:, ::-1] if is_mirrored else corners
                if self.remarks.paint is not None:
                    laid = {
                        name: value[:, ::-1] if is_mirrored and value is not None else value
                        for name, value in looks.items()
                        if name != "material"
                    }
                    self.remarks.paint.add(len(corners), material=looks["material"], **laid)
                vertices.append(points @ T[:3, :3].T + T[:3, 3])
                faces.append(wound + count)
                count += len(points)
                triangles += len(corners)
                _check_count(self.path, max(count, triangles))  # A mesh may stand at many places.
        return np.concatenate(vertices), np.concatenate(faces)

    def _parts(self, mesh: dict[str, Any]) -> Iterator[tuple[_Arrays, dict[str, Any]]]:
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", 4)
            if mode not in _GLTF_TRIANGLES:
                self.remarks.dropped[
                    "primitives of points" if mode == 0 else "primitives of lines"
                ] += 1
                continue
            if primitive.get("targets"):
                self.remarks.dropped["morph targets"] += len(primitive["targets"])
            points = self._accessor(primitive["attributes"]["POSITION"], "VEC3")
            if "indices" in primitive:
                run = self._accessor(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
            else:
                run = np.arange(len(points))
            if run.size and (run.min() < 0 or run.max() >= len(points)):
                raise SceneError(
                    f"{self.path}: a face names vertex {int(run.max())} of {len(points)}",
                    fix=_CUT_SHORT,
                )
            if mode == 4:
                if len(run) % 3:
                    raise SceneError(f"{self.path}: {len(run)} corners of triangles", fix=_AGAIN)
                corners = run.reshape(-1, 3)
            elif mode == 5:
                corners = _strips(run, np.array([len(run)]))
            else:
                corners = np.stack([np.full(len(run[2:]), run[0]), run[1:-1], run[2:]], axis=-1)
            yield (points, corners), self._looks(primitive, corners)

    def _looks(self, primitive: dict[str, Any], corners: NDArray[np.int64]) -> dict[str, Any]:
        """Return what `_Paint.add` wants of the triangles of a primitive."""
        paint = self.remarks.paint
        if paint is None:
            return {}
        attributes: dict[str, int] = primitive["attributes"]
        colours = uv = None
        if "COLOR_0" in attributes:
            shape = str(self.content["accessors"][attributes["COLOR_0"]]["type"])
            shades = self._accessor(attributes["COLOR_0"], "VEC3" if shape == "VEC3" else "VEC4")
            colours = np.clip(shades[:, :3], 0.0, 1.0)[corners]
        number: int | None = primitive.get("material")
        look = {} if number is None else self.content["materials"][number]
        gloss = look.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
        base = look.get("pbrMetallicRoughness", {})
        entry = base.get("baseColorTexture") or gloss.get("diffuseTexture") or {}
        moved = entry.get("extensions", {}).get("KHR_texture_transform", {})
        places = f"TEXCOORD_{int(moved.get('texCoord', entry.get('texCoord', 0)))}"
        if entry and places in attributes:
            uv = self._accessor(attributes[places], "VEC2")
            turn = float(moved.get("rotation", 0.0))
            c, s = np.cos(turn), np.sin(turn)
            uv = uv * np.array(moved.get("scale", (1.0, 1.0)), dtype=np.float64)
            uv = uv @ np.array([[c, -s], [s, c]]) + np.array(moved.get("offset", (0.0, 0.0)))
            uv = uv[corners]
        if number not in self.materials:
            factor = base.get("baseColorFactor") or gloss.get("diffuseFactor") or (1.0, 1.0, 1.0)
            r, g, b = np.clip(np.array(factor[:3], dtype=np.float64), 0.0, 1.0).tolist()
            texture = self._picture(int(entry["index"])) if "index" in entry else None
            self.materials[number] = len(paint.materials)
            paint.materials.append(Material(factor=(r, g, b), texture=texture, is_linear=True))
        return {"colours": colours, "uv": uv, "material": self.materials[number]}

    def _picture(self, number: int) -> bytes | None:
        """Return the bytes of a texture's picture; None, and a remark, if they are not read."""
        texture: dict[str, Any] = self.content["textures"][number]
        webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
        source = texture.get("source", webp.get("source"))
        if source is None:
            self.remarks.dropped["textures of KTX2, which are not read"] += 1
            return None
        image: dict[str, Any] = self.content["images"][source]
        if "bufferView" in image:
            view = self.content["bufferViews"][image["bufferView"]]
            first = int(view.get("byteOffset", 0))
            found = self.buffers[view["buffer"]][first : first + int(view["byteLength"])]
        else:
            found = self._buffer(str(image["uri"]), b"")
        if len(found) > TEXTURE_BYTES:
            raise SceneError(
                f"{self.path}: a texture of {len(found)} bytes", fix=f"{TEXTURE_BYTES} at most"
            )
        return found

    def _accessor(self, number: int, shape: str) -> NDArray[np.float64]:
        """(rows, columns) numbers of an accessor."""
        one = self.content["accessors"][number]
        if "sparse" in one or "bufferView" not in one or one["type"] != shape:
            raise SceneError(
                f"{self.path}: accessor {number} of type {clean(str(one['type']), at_most=20)} is "
                f"sparse, or no {shape}",
                fix="export it plainly",
            )
        view = self.content["bufferViews"][one["bufferView"]]
        numbers = self.buffers[view["buffer"]]
        kind = np.dtype(_GLTF_KINDS[one["componentType"]])
        columns, rows = int(shape[3:]) if shape[:3] == "VEC" else 1, int(one["count"])
        stride = int(view.get("byteStride", columns * kind.itemsize))
        first = int(view.get("byteOffset", 0)) + int(one.get("byteOffset", 0))
        end = first + (rows - 1) * stride + columns * kind.itemsize
        if rows < 1 or stride < columns * kind.itemsize or first < 0 or end > len(numbers):
            raise SceneError(
                f"{self.path}: accessor {number} of {rows} rows ends at byte {end} of "
                f"{len(numbers)}",
                fix=_CUT_SHORT,
            )
        raw = np.ndarray((rows, columns), kind, numbers, first, (stride, kind.itemsize))
        values = raw.astype(np.float64)
        if one.get("normalized"):
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return values


def _gltf_pose(node: dict[str, Any]) -> NDArray[np.float64]:
    """(4, 4) T_parent_node."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    T = np.eye(4)
    x, y, z, w = map(float, node.get("rotation", (0, 0, 0, 1)))
    scale = np.array(node.get("scale", (1, 1, 1)), dtype=np.float64).reshape(3)
    T[:3, :3] = rotation_matrix((w, x, y, z)) * scale
    T[:3, 3] = np.array(node.get("translation", (0, 0, 0)), dtype=np.float64).reshape(3)
    return T


_READERS = {".glb": _read_glb, ".obj": _read_obj, ".ply": _read_ply, ".stl": _read_stl}
