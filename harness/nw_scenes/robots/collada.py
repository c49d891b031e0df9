"""COLLADA meshes of robots as STL, as ROS reads them."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np

SUFFIX = ".dae"


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
    try:
        read: Any = collada.Collada(BytesIO(content), ignore=[collada.DaeError])
        unit = float(read.assetInfo.unitmeter or 1.0)
        parts = [_corners(part) for part in _primitives(read)]
    except Exception as error:  # noqa: BLE001 - whatever a damaged file makes of a parser.
        raise ValueError(f"it cannot be read: {type(error).__name__}") from None
    corners = np.concatenate([np.zeros((0, 3, 3)), *parts]) * unit
    if not len(corners) or not np.isfinite(corners).all():
        raise ValueError("it has no triangles, or corners that are no numbers")
    rows = np.zeros(
        len(corners),
        dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")],
    )
    rows["corners"] = corners
    return bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()


def _primitives(read: Any) -> list[Any]:
    """Return what the scene has, where it has it; all as it is, where there is no scene."""
    shown = [] if read.scene is None else list(read.scene.objects("geometry"))
    if shown:
        return [part for geometry in shown for part in geometry.primitives()]
    return [part for geometry in read.geometries for part in geometry.primitives]


def _corners(part: Any) -> np.ndarray:
    """Return the corners of a primitive's triangles, (N, 3, 3); lines have none."""
    made = part.triangleset() if hasattr(part, "triangleset") else part
    index = np.asarray(made.vertex_index)
    if made.vertex is None or index.ndim != 2 or index.shape[1] != 3:
        return np.zeros((0, 3, 3))
    return np.asarray(made.vertex, dtype=np.float64)[index]
