"""COLLADA meshes of robots as STL, as ROS reads them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from io import BytesIO
from itertools import chain
from typing import Any

import numpy as np

SUFFIX = ".dae"
_PARTS, _TRIANGLES = 10_000, 1_000_000
"""Of one file, as its scene shows them."""


def as_stl(content: bytes) -> bytes:
    """Return the triangles of a COLLADA file as binary STL, in m.

    Lengths are scaled by the file's unit, and its up axis is ignored, as rviz does it: a URDF's
    `origin` places the mesh. Lines, materials and textures have no triangles.

    Args:
        content: of the file.

    Raises:
        ValueError: it is no COLLADA file, or has no triangles.
    """
    import collada  # It takes a tenth of a second.

    if not content.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        raise ValueError("it is no XML, as COLLADA is")
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise ValueError("it declares a document type or entities")
    _check(content)
    try:
        read: Any = collada.Collada(BytesIO(content), ignore=[collada.DaeError])
        unit = float(read.assetInfo.unitmeter or 1.0)
        corners = np.concatenate([np.zeros((0, 3, 3)), *_parts(read)]) * unit
    except _TooLargeError as error:
        raise ValueError(str(error)) from None
    except Exception as error:  # noqa: BLE001 - whatever a damaged file makes of a parser.
        raise ValueError(f"it cannot be read: {type(error).__name__}") from None
    if len(read.geometries) < content.count(b"<geometry "):
        raise ValueError("one of its geometries cannot be read")
    if not len(corners) or not np.isfinite(corners).all() or unit <= 0.0:
        raise ValueError("it has no triangles, or corners or a unit that are no numbers")
    rows = np.zeros(
        len(corners),
        dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")],
    )
    rows["corners"] = corners
    return bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()


class _TooLargeError(Exception):
    """A mesh has more parts than a robot's may have."""


def _check(content: bytes) -> None:
    """Refuse what a parser would follow or make room for without an end.

    Raises:
        ValueError: it refers to another file, or counts more corners than it has bytes.
    """
    urls = re.findall(rb"<instance_geometry[^>]*\burl\s*=\s*[\"']([^\"']*)", content)
    if any(not url.startswith(b"#") for url in urls):
        raise ValueError("it refers to a geometry of another file")
    for counts in re.findall(rb"<vcount[^>]*>([^<]*)<", content):
        if any(len(number) > 9 or int(number) > len(content) for number in counts.split()):
            raise ValueError("it counts more corners than it has")


def _parts(read: Any) -> Iterator[np.ndarray]:
    """Give the corners of what the scene has, where it has it; of all, where there is no scene.

    Raises:
        _TooLargeError: it has very many parts, as by nodes that stand in each other, or triangles.
    """
    shown: Any = () if read.scene is None else read.scene.objects("geometry")
    count, total = 0, 0
    for geometry in chain(shown, read.geometries):
        if count and geometry in read.geometries:
            return  # The scene has shown them.
        primitives: Any = geometry.primitives
        listed: Any = primitives() if callable(primitives) else primitives
        for part in listed:
            count, corners = count + 1, _corners(part)
            total += len(corners)
            if count > _PARTS or total > _TRIANGLES:
                raise _TooLargeError(f"it has over {_PARTS} parts or {_TRIANGLES} triangles")
            yield corners


def _corners(part: Any) -> np.ndarray:
    """Return the corners of a primitive's triangles, (N, 3, 3); lines have none."""
    made = part.triangleset() if hasattr(part, "triangleset") else part
    index = np.asarray(made.vertex_index)
    if made.vertex is None or index.ndim != 2 or index.shape[1] != 3:
        return np.zeros((0, 3, 3))
    if len(index) and index.min() < 0:
        raise ValueError("a corner has a number below 0")
    return np.asarray(made.vertex, dtype=np.float64)[index]
