"""Reads the triangles of GLB files (glTF 2 in one file), and of OBJ files with their materials."""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_scenes.limits import TEXTURE_BYTES, TEXTURES
from nw_scenes.mesh import rotation_matrix
from nw_scenes.mesh_parts import (
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
    strips,
)

_GLTF_TRIANGLES = (4, 5, 6)  # Triangles, strips, fans.
_GLTF_KINDS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_GLTF_LOOKS = re.compile(
    r"(KHR|EXT)_(materials|texture|lights|animation)_\w+|KHR_mesh_quantization"
)
"""Extensions that change no surface, or that are understood."""
_GLTF_SILENT = re.compile(
    r"(KHR|EXT)_(materials|texture|lights|meshopt)_\w+|KHR_(mesh_quantization|xmp|draco)\w*"
)
"""Extensions that are read, or of no effect: gloss, lamps, authorship, and compressed copies of
what stands plain beside, or else its accessors are refused. Textures not read are remarked."""
_GLTF_FIELDS = re.compile(
    r"asset|scenes?|nodes|mesh(es)?|accessors|bufferViews|buffers|materials?|textures|images|name"
    r"|samplers|cameras?|skins?|animations|extensions(Used|Required)?|extras|children|matrix|mode"
    r"|rotation|scale|translation|weights|primitives|attributes|indices|targets|alphaMode"
    r"|alphaCutoff|doubleSided|pbrMetallicRoughness|(normal|occlusion|emissive)Texture"
    r"|emissiveFactor"
)
"""Fields of the file, nodes, meshes, primitives and materials that are read, remarked elsewhere
(skins, morph targets, animations, alphaMode), or of no effect: cameras, relief and glow, and
`doubleSided`, for rays and feet meet faces from both sides."""
_GLTF_ATTRIBUTES = re.compile(r"POSITION|COLOR_0|TEXCOORD_\d+|NORMAL|TANGENT|(JOINTS|WEIGHTS)_\d+")
"""Of vertices: those that are read, directions that faces say themselves, and those of skins."""


def read_glb(path: Path, remarks: Remarks) -> Arrays:
    """Vertices and triangles of the default scene of a glTF 2 in one file, turned to +z up.

    After https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.
    """
    try:
        with np.errstate(all="ignore"):  # `checked_mesh` names what is not finite.
            vertices, faces = _Glb(path, remarks).read()
    except SceneError:
        raise
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError,
            struct.error) as error:  # fmt: skip
        raise SceneError(
            f"{path}: no readable GLB mesh: {type(error).__name__}: "
            f"{clean(str(error), at_most=200)}",
            fix=AGAIN,
        ) from None
    if remarks.paint is not None:  # Whoever wants colours turns it.
        return vertices, faces
    remarks.turned = True
    x, y, z = vertices.T
    return np.stack([x, -z, y], axis=-1), faces


class _Glb:
    def __init__(self, path: Path, remarks: Remarks) -> None:
        data = path.read_bytes()
        if data[:4] != b"glTF" or len(data) < 20:
            raise SceneError(f"{path}: it begins with {data[:4]!r}, not with b'glTF'", fix=AGAIN)
        version, whole, length = struct.unpack_from("<III", data, 4)
        if version != 2 or whole > len(data) or 20 + length > whole:
            raise SceneError(
                f"{path}: glTF version {version}, {whole} bytes said, {len(data)} there",
                fix="export glTF 2 (.glb) again",
            )
        self.path, self.remarks = path, remarks
        self.materials: dict[int | None, int] = {}
        self.pictures: dict[int, bytes] = {}
        self.size = len(data)
        binary = self._second(data, 20 + length, whole)
        self.content: dict[str, Any] = json.loads(data[20 : 20 + length])
        self.buffers = [
            self._buffer(one.get("uri"), binary) for one in self.content.get("buffers", ())
        ]
        needed = [str(one) for one in self.content.get("extensionsRequired", ())]
        unknown = [name for name in needed if not _GLTF_LOOKS.fullmatch(name)]
        if unknown:
            raise SceneError(
                f"{path}: it needs {clean(', '.join(unknown), at_most=100)}",
                fix="export it without compression of the mesh",
            )

    def _second(self, data: bytes, at: int, whole: int) -> bytes:
        """Return the bytes of the file's second part; others are passed over, and remarked."""
        chunk = b""
        while at + 8 <= whole:
            size, kind = struct.unpack_from("<I4s", data, at)
            if kind == b"BIN\0" and not chunk:
                chunk = data[at + 8 : min(at + 8 + size, whole)]
            else:
                self.remarks.unread.append(
                    f"a part {clean(repr(kind), at_most=20)} of {size} bytes"
                )
            at += 8 + size
        return chunk

    def _account(self, met: set[int]) -> None:
        """Remark what of the file is not read: nodes, by number, stand in the scene."""
        content, unread = self.content, self.remarks.unread
        nodes: list[dict[str, Any]] = content.get("nodes", [])
        if apart := [i for i, one in enumerate(nodes) if "mesh" in one and i not in met]:
            self.remarks.dropped["nodes with meshes that are not in its default scene"] += len(
                apart
            )
        if moves := content.get("animations"):
            unread.append(f"{len(moves)} animations: nodes stand as they are without")
        materials: list[dict[str, Any]] = content.get("materials", [])
        modes = [
            str(one["alphaMode"]) for one in materials if one.get("alphaMode", "OPAQUE") != "OPAQUE"
        ]
        if modes:
            words = clean(", ".join(sorted(set(modes))), at_most=60)
            unread.append(f"alphaMode {words} of {len(modes)} materials, which are solid here")
        ways = {
            s.get(way, 10497) for s in content.get("samplers", ()) for way in ("wrapS", "wrapT")
        }
        if ways - {10497} and self.remarks.paint is not None:
            unread.append("that textures do not repeat (wrapS, wrapT): they do here")
        meshes: list[dict[str, Any]] = content.get("meshes", [])
        rows = [content, *nodes, *meshes, *materials, *(p for m in meshes for p in m["primitives"])]
        names = {key for row in rows for key in row if not _GLTF_FIELDS.fullmatch(key)}
        names |= {key for row in rows for key in row.get("attributes", ())
                  if not _GLTF_ATTRIBUTES.fullmatch(key)}  # fmt: skip
        used = {str(one) for one in content.get("extensionsUsed", ())}
        used |= {key for row in rows for key in row.get("extensions", ())}
        names |= {name for name in used if not _GLTF_SILENT.fullmatch(name)}
        if names:
            unread.append(clean(", ".join(sorted(names)), at_most=200))

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

    def read(self) -> Arrays:
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
        parts: dict[int, list[tuple[Arrays, dict[str, Any]]]] = {}
        waiting = [(int(root), np.eye(4)) for root in reversed(roots)]
        while waiting:
            number, T_parent = waiting.pop()
            if number in met or number < 0:
                raise SceneError(f"{self.path}: its nodes do not form a tree", fix=AGAIN)
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
                check_count(self.path, max(count, triangles))  # A mesh may stand at many places.
        self._account(met)
        return np.concatenate(vertices), np.concatenate(faces)

    def _parts(self, mesh: dict[str, Any]) -> Iterator[tuple[Arrays, dict[str, Any]]]:
        count = 0
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
            count += len(points)
            check_count(self.path, count)
            if "indices" in primitive:
                run = self._accessor(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
            else:
                run = np.arange(len(points))
            if run.size and (run.min() < 0 or run.max() >= len(points)):
                raise SceneError(
                    f"{self.path}: a face names vertex {int(run.max())} of {len(points)}",
                    fix=CUT_SHORT,
                )
            if mode == 4:
                if len(run) % 3:
                    raise SceneError(f"{self.path}: {len(run)} corners of triangles", fix=AGAIN)
                corners = run.reshape(-1, 3)
            elif mode == 5:
                corners = strips(run, np.array([len(run)]))
            else:
                corners = np.stack([np.full(len(run[2:]), run[0]), run[1:-1], run[2:]], axis=-1)
            yield (points, corners), self._looks(primitive, corners)

    def _looks(self, primitive: dict[str, Any], corners: NDArray[np.int64]) -> dict[str, Any]:
        """Return what `Paint.add` wants of the triangles of a primitive."""
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
            if np.isnan((r, g, b)).any():
                raise ValueError(f"the colour {factor} of a material is invalid")
            texture = self._picture(int(entry["index"])) if "index" in entry else None
            self.materials[number] = len(paint.materials)
            if len(self.materials) > 10 * TEXTURES:
                raise SceneError(
                    f"{self.path}: over {10 * TEXTURES} materials", fix="join them into an atlas"
                )
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
        if source in self.pictures:
            return self.pictures[source]
        image: dict[str, Any] = self.content["images"][source]
        if "bufferView" in image:
            view = self.content["bufferViews"][image["bufferView"]]
            buffer, first = self.buffers[view["buffer"]], int(view.get("byteOffset", 0))
            length = int(view["byteLength"])
            if first < 0 or length < 0 or first + length > len(buffer):
                raise SceneError(
                    f"{self.path}: the picture {source} lies at bytes {first} to {first + length} "
                    f"of {len(buffer)}",
                    fix=CUT_SHORT,
                )
            picture = buffer[first : first + min(length, TEXTURE_BYTES + 1)]
        else:
            picture = self._buffer(str(image["uri"]), b"")
        whole = len(picture) + sum(map(len, self.pictures.values()))
        if len(picture) > TEXTURE_BYTES or len(self.pictures) >= TEXTURES or whole > self.size:
            raise SceneError(
                f"{self.path}: over {TEXTURES} textures, one over {TEXTURE_BYTES // 10**6} MB, or "
                "all larger than the file",
                fix="join them into an atlas, or make them smaller",
            )
        self.pictures[source] = picture
        return picture

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
                fix=CUT_SHORT,
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
    if not 0.1 < x * x + y * y + z * z + w * w < 10.0:
        raise ValueError(f"the rotation {[x, y, z, w]} of a node is invalid")
    scale = np.array(node.get("scale", (1, 1, 1)), dtype=np.float64).reshape(3)
    T[:3, :3] = rotation_matrix((w, x, y, z)) * scale
    T[:3, 3] = np.array(node.get("translation", (0, 0, 0)), dtype=np.float64).reshape(3)
    return T


# Say nothing about where surfaces are.
_OBJ_SILENT = (
    "vt", "vn", "g", "o", "s", "mg", "usemtl", "mtllib", "usemap", "maplib", "bevel", "c_interp",
    "d_interp", "lod", "shadow_obj", "trace_obj",
)  # fmt: skip
_MTL_READ = re.compile(
    r"|#.*|(newmtl|Kd)\b.*|map_Kd\s+[^-\s].*|d\s+1(\.0*)?|Tr\s+0(\.0*)?"
    r"|((map_)?(K[ase]|N[si]|P[rms]|bump)|Tf|Pcr?|illum|sharpness|anisor?|norm|refl|map_aat)\b.*"
)
"""Lines of an MTL that are read, say that something is opaque, or are of no effect: gloss, glow and
relief, which a splat of plain colours does not have."""
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
    remarks.unread += _weights(points)
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


def _weights(points: list[str]) -> list[str]:
    """Return that vertices have a fourth number that is not 1, which curved surfaces alone use."""
    fourth = [words[3] for one in points if len(words := one.split(None, 6)) == 4]
    count = len([one for one in fourth if not re.fullmatch(r"1(\.0*)?", one)])
    return [f"the weight of {count} vertices"] if count else []


class _ObjLooks:
    """Texture coordinates and materials of an OBJ, as its lines come."""

    def __init__(self) -> None:
        self.coordinates: list[str] = []
        self.libraries: list[str] = []
        self.names: dict[str, int] = {"": 0}
        self.material = 0
        self.of_face: list[int] = []
        self.above: list[int] = []  # Texture coordinates that stand above each face.

    def face(self) -> None:
        self.of_face.append(self.material)
        self.above.append(len(self.coordinates))

    def line(self, kind: str, rest: str) -> None:
        if kind == "vt":
            self.coordinates.append(rest)
        elif kind == "mtllib":
            self.libraries.append(rest.strip())
        else:
            self.material = self.names.setdefault(rest.strip(), len(self.names))

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
        if lost := sorted(name for name in self.names if name and name not in read):
            named = clean(", ".join(lost[:5]), at_most=100)
            remarks.unread.append(f"{len(lost)} materials that no library has, white here: {named}")
        if len(self.names) > 10 * TEXTURES:
            raise SceneError(f"{path}: {len(self.names)} materials", fix="join them into an atlas")
        paint.materials += [read.get(name, Material()) for name in self.names]
        colours = None
        rows = fast_numbers(points, np.float64)
        if rows is not None and len(points) and len(rows) in {6 * len(points), 7 * len(points)}:
            wide = len(rows) // len(points)
            shades = np.clip(rows.reshape(-1, wide)[:, 3:6], 0.0, 1.0)
            colours = shades[corners[cut]]
        elif any(one.strip().count(" ") >= 5 for one in points):
            remarks.unread.append("colours of vertices, which not all vertices have")
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
        indices = fast_numbers(numbers, np.int64)
        values = [line.split()[:2] for line in self.coordinates]
        flat = fast_numbers(
            [" ".join(one if len(one) == 2 else [*one, "0"]) for one in values], np.float64
        )
        if indices is None or len(indices) != count or flat is None or len(flat) != 2 * len(values):
            raise SceneError(f"{path}: a `vt` or a corner's second number is invalid", fix=AGAIN)
        above = np.array(self.above, dtype=np.int64)[face_of]
        index = np.where(indices < 0, above + indices, indices - 1)
        known = (indices != 0) & (index >= 0) & (index < len(values))
        table = np.vstack([flat.reshape(-1, 2), [[np.nan, np.nan]]])
        places = table[np.where(known, index, len(values))]
        return (np.array([0.0, 1.0]) + np.array([1.0, -1.0]) * places)[cut].astype(np.float32)


def _materials(path: Path, library: str, remarks: Remarks) -> dict[str, Material]:
    """Return the materials of an MTL file in the folder of an OBJ, by name."""
    content = bytes_beside(path, library, remarks)
    materials: dict[str, Material] = {}
    name, factor, picture = "", (1.0, 1.0, 1.0), ""

    def keep() -> None:
        texture = bytes_beside(path, picture, remarks) if picture else None
        # Many exporters write a grey Kd that they themselves do not multiply textures by.
        materials[name] = Material(
            factor=(1.0, 1.0, 1.0) if texture is not None else factor, texture=texture
        )

    text = (content or b"").decode("utf-8-sig", errors="replace")
    lines = [line.strip() for line in text.splitlines()]
    for line in lines:
        word, _, rest = line.replace("\t", " ").partition(" ")
        if word == "newmtl":
            keep()
            name, factor, picture = rest.strip(), (1.0, 1.0, 1.0), ""
            if len(materials) > TEXTURES:
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
    if left := [one for one in dict.fromkeys(lines) if not _MTL_READ.fullmatch(one)]:
        words = clean("; ".join(left), at_most=200)
        remarks.unread.append(f"of {clean(library, at_most=60)}: {words}")
    return materials


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
    numbers: list[int] = []
    for row, number in zip(bare, lines, strict=True):
        for word in row.split():
            if re.fullmatch(r"[+-]?[0-9]{1,15}", word) is None:
                raise SceneError(
                    f"{path}:{number}: {clean(word, at_most=40)!r} is not a number of a vertex",
                    fix=AGAIN,
                )
            numbers.append(int(word))
    if len(numbers) != count:  # A word that begins with a slash.
        raise SceneError(f"{path}: a face has a corner without a vertex", fix=AGAIN)
    return np.array(numbers, dtype=np.int64)
