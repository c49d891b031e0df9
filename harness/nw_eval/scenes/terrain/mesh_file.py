"""Reads triangle meshes from OBJ, STL and PLY files that nobody has vouched for."""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.files.inside import regular
from nw_eval.scenes.limits import MESH_BYTES, MESH_FACES, MESH_REACH
from nw_eval.scenes.mesh import FACE_KINDS, FaceKind, TriangleMesh

MESH_SUFFIXES = (".obj", ".ply", ".stl")

_PLY_HEADER = 1 << 16  # Bytes.

# The parser logs tracebacks of what it forgives; what it does not is an error of ours.
logging.getLogger("trimesh").addHandler(logging.NullHandler())


def read_mesh(
    path: Path, *, scale: Sequence[float] = (1.0, 1.0, 1.0), kind: FaceKind = "ground"
) -> TriangleMesh:
    """Return the triangles of a file, materials and textures left alone.

    Args:
        path: OBJ, STL (either form) or PLY (either form); polygons are cut into triangles.
        scale: what coordinates are multiplied by.
        kind: what the faces belong to.

    Raises:
        SceneError: the file is missing, too large, of another format, empty, or has vertices that
            are not finite or indices out of range.
    """
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise SceneError(
            f"{path}: no mesh format that is read here", fix=f"give {', '.join(MESH_SUFFIXES)}"
        )
    try:
        size = regular(path).stat().st_size
        if size > MESH_BYTES:
            raise SceneError(f"{path}: {size} bytes", fix=f"decimate it below {MESH_BYTES} bytes")
        if suffix == ".ply":
            _check_ply(path, size)
        vertices, faces = _load(path, suffix)
    except (OSError, ValueError) as error:  # A path with a zero byte is a ValueError.
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise SceneError(f"{path}: the mesh cannot be read: {reason}") from None
    return checked_mesh(vertices * np.asarray(scale, dtype=np.float64), faces, kind, str(path))


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
    if max(len(vertices), len(faces)) > MESH_FACES:
        raise SceneError(
            f"{origin}: {len(vertices)} vertices, {len(faces)} faces",
            fix=f"decimate it below {MESH_FACES}",
        )
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
        raise SceneError(f"{origin}: a coordinate is {far:g}", fix="check the unit: metres")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError(
            f"{origin}: a face names vertex {int(faces.max())} of {len(vertices)}",
            fix="the file is cut short; export it again",
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


def _check_ply(path: Path, size: int) -> None:
    """Compare what a header claims with the file: the parser allocates, and loops, by the claim.

    Raises:
        SceneError: more rows than bytes, or edges, which the parser would make paths of.
    """
    with path.open("rb") as file:
        head = file.read(_PLY_HEADER)
    text = head[: max(head.find(b"end_header"), 0)].decode("latin-1")
    for number, line in enumerate(text.splitlines(), 1):
        match line.split():
            case ["element", "edge", *_]:
                raise SceneError(f"{path}:{number}: it has edges", fix="export the triangles only")
            case ["element", name, count] if not count.isdecimal() or int(count[:18]) > size:
                raise SceneError(
                    f"{path}:{number}: {count[:20]} rows of {name[:40]!r} in {size} bytes",
                    fix="the file is cut short; export it again",
                )
            case _:
                pass


def _load(path: Path, suffix: str) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    try:
        with path.open("rb") as file, warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # Of numpy, on numbers that are checked later.
            return _joined(_parse(file, suffix))
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001 - a parser meets a stranger's file; any fault is one.
        raise SceneError(
            f"{path}: no readable {suffix[1:].upper()} mesh: {type(error).__name__}: "
            f"{str(error)[:200]}",
            fix="open it in a mesh viewer and export it again",
        ) from None


def _parse(file: IO[bytes], suffix: str) -> dict[str, Any]:
    # trimesh's loaders take open files; without a resolver they cannot follow `mtllib` or images.
    from trimesh.exchange.obj import load_obj
    from trimesh.exchange.ply import load_ply
    from trimesh.exchange.stl import load_stl

    if suffix == ".obj":
        return load_obj(_without_materials(file.read()), resolver=None, split_objects=False)
    if suffix == ".ply":
        return load_ply(file, resolver=None, fix_texture=False, skip_materials=True)
    return load_stl(file)


def _joined(parsed: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Return vertices (V, 3) and triangles (F, 3) of all parts of a file."""
    parts = list(parsed["geometry"].values()) if "geometry" in parsed else [parsed]
    vertices: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.integer]] = []
    count = 0
    for part in parts:
        points = np.asarray(part.get("vertices", np.zeros((0, 3))), dtype=np.float64)
        corners = part.get("faces")
        if corners is None or len(corners) == 0:
            continue
        vertices.append(points.reshape(-1, 3))
        faces.append(_triangles(corners) + count)
        count += len(points)
    if not faces:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    return np.concatenate(vertices), np.concatenate(faces)


def _triangles(faces: Any) -> NDArray[np.integer]:
    from trimesh.geometry import triangulate_quads

    array = np.asarray(faces)
    if array.ndim == 2 and array.shape[1] == 3:
        return array.astype(np.int64)
    cut = np.asarray(triangulate_quads(faces), dtype=np.int64)
    if cut.ndim != 2 or cut.shape[1] != 3:
        raise ValueError("its faces are not polygons")
    return cut


def _without_materials(text: bytes) -> StringIO:
    """Return the vertices and faces of an OBJ; other lines name files, or slow the parser."""
    lines = text.decode("utf-8", errors="replace").replace("\\\n", " ").splitlines()
    kept = [line for line in lines if line.startswith(("v ", "f ", "v\t", "f\t"))]
    # Of `f 1/7/3` only the vertex counts.
    return StringIO(re.sub(r"/\S*", "", "\n".join(kept)) + "\n")
