"""Reads the triangles of OBJ files, and their materials (MTL)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.clean import clean
from nw_eval.errors import SceneError
from nw_eval.scenes.limits import TEXTURES
from nw_eval.scenes.mesh_parts import (
    AGAIN,
    CUT_SHORT,
    Arrays,
    Material,
    Remarks,
    bytes_beside,
    check_count,
    cut_faces,
    fast_numbers,
    numbers_of,
)

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


def read_obj(path: Path, remarks: Remarks) -> Arrays:
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
    check_count(path, max(len(points), len(polygons)))
    vertices = numbers_of(path, points, point_lines, "v")
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
            fix=CUT_SHORT,
        )
    if remarks.paint is None:
        return vertices, cut_faces(path, vertices, widths, corners, lines)
    # Corners are cut instead of vertices: each has its own point in the texture.
    own = np.arange(len(corners))
    finite = np.where(np.isfinite(vertices), vertices, 0.0)
    cut = cut_faces(path, finite[corners], widths, own, lines)
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
        remarks: Remarks,
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
        rows = fast_numbers(points, np.float64)
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
        found = fast_numbers(numbers, np.int64)
        values = [line.split()[:2] for line in self.coordinates]
        flat = fast_numbers(
            [" ".join(one if len(one) == 2 else [*one, "0"]) for one in values], np.float64
        )
        if found is None or len(found) != count or flat is None or len(flat) != 2 * len(values):
            raise SceneError(f"{path}: a `vt` or a corner's second number is none", fix=AGAIN)
        above = np.array(self.above, dtype=np.int64)[face_of]
        index = np.where(found < 0, above + found, found - 1)
        known = (found != 0) & (index >= 0) & (index < len(values))
        table = np.vstack([flat.reshape(-1, 2), [[np.nan, np.nan]]])
        places = table[np.where(known, index, len(values))]
        return (np.array([0.0, 1.0]) + np.array([1.0, -1.0]) * places)[cut].astype(np.float32)


def _materials(path: Path, library: str, remarks: Remarks) -> dict[str, Material]:
    """Return the materials of an MTL file in the folder of an OBJ, by name."""
    content = bytes_beside(path, library, remarks)
    found: dict[str, Material] = {}
    name, factor, picture = "", (1.0, 1.0, 1.0), ""

    def keep() -> None:
        texture = bytes_beside(path, picture, remarks) if picture else None
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
            values = fast_numbers([rest], np.float64)
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


def _vertex_numbers(path: Path, rows: list[str], lines: list[int], count: int) -> NDArray[np.int64]:
    """(count,) int64 numbers of vertices of all rows, what follows a slash left out.

    Raises:
        SceneError: naming the line of the first row with another word.
    """
    if not rows:
        return np.zeros(0, np.int64)
    bare = re.sub(r"/\S*", "", "\n".join(rows)).split("\n")
    values = fast_numbers(bare, np.int64)
    if values is not None and len(values) == count:
        return values
    found: list[int] = []
    for row, number in zip(bare, lines, strict=True):
        for word in row.split():
            if re.fullmatch(r"[+-]?[0-9]{1,15}", word) is None:
                raise SceneError(
                    f"{path}:{number}: {clean(word, at_most=40)!r} is no number of a vertex",
                    fix=AGAIN,
                )
            found.append(int(word))
    if len(found) != count:  # A word that begins with a slash.
        raise SceneError(f"{path}: a face has a corner without a vertex", fix=AGAIN)
    return np.array(found, dtype=np.int64)
