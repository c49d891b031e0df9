"""Reads the triangles of GLB files: glTF 2 in one file."""

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

from nw_eval.clean import clean
from nw_eval.errors import SceneError
from nw_eval.scenes.limits import TEXTURE_BYTES, TEXTURES
from nw_eval.scenes.mesh import rotation_matrix
from nw_eval.scenes.mesh_parts import (
    AGAIN,
    CUT_SHORT,
    Arrays,
    Material,
    Remarks,
    check_count,
    strips,
)

_GLTF_TRIANGLES = (4, 5, 6)  # Triangles, strips, fans.
_GLTF_KINDS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_GLTF_LOOKS = re.compile(
    r"(KHR|EXT)_(materials|texture|lights|animation)_\w+|KHR_mesh_quantization"
)
"""Extensions that change no surface, or that are understood."""


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
        binary = data[28 + length : whole]
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
                raise SceneError(f"{self.path}: its nodes are no tree", fix=AGAIN)
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
                raise ValueError(f"the colour {factor} of a material is none")
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
            found = buffer[first : first + min(length, TEXTURE_BYTES + 1)]
        else:
            found = self._buffer(str(image["uri"]), b"")
        whole = len(found) + sum(map(len, self.pictures.values()))
        if len(found) > TEXTURE_BYTES or len(self.pictures) >= TEXTURES or whole > self.size:
            raise SceneError(
                f"{self.path}: over {TEXTURES} textures, one over {TEXTURE_BYTES // 10**6} MB, or "
                "all larger than the file",
                fix="join them into an atlas, or make them smaller",
            )
        self.pictures[source] = found
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
        raise ValueError(f"the rotation {[x, y, z, w]} of a node is none")
    scale = np.array(node.get("scale", (1, 1, 1)), dtype=np.float64).reshape(3)
    T[:3, :3] = rotation_matrix((w, x, y, z)) * scale
    T[:3, 3] = np.array(node.get("translation", (0, 0, 0)), dtype=np.float64).reshape(3)
    return T
