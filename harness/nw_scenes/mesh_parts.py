"""What the readers of mesh files share: colours, remarks, and checks of numbers and faces.

It cuts polygons into triangles, too; a notch stays open.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import SceneError
from nw_base.files.inside import OutsideError, bounded_bytes, inside, what_is
from nw_scenes.finding import SceneFinding
from nw_scenes.limits import MESH_FACES, TEXTURE_BYTES

_EVEN = 1e-9
"""A corner is a notch if it turns back by more than this share of the polygon's area."""
_LOOKS = 4_000_000
"""Corners that are held against ears in one file: some seconds."""


class PolygonError(ValueError):
    """A polygon cannot be cut.

    Attributes:
        face: which one, counted from 0.
    """

    def __init__(self, face: int, reason: str) -> None:
        super().__init__(reason)
        self.face = face


def triangulated(
    vertices: NDArray[np.float64], counts: NDArray[np.int64], corners: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return (F, 3) triangles of polygons, in their order and with their winding.

    A polygon without a notch is cut as a fan from its first corner, one with a single notch as a
    fan from there, any other by ear clipping (Meisters 1975) in the plane of its Newell normal.

    Args:
        vertices: (V, 3) finite coordinates.
        counts: (P,) corners of each polygon, 3 at least.
        corners: (sum of counts,) numbers of vertices, polygon after polygon.

    Raises:
        PolygonError: a polygon with several notches crosses itself, or there are too many such.
    """
    firsts = np.cumsum(counts) - counts
    rows = np.cumsum(counts - 2) - (counts - 2)
    out = np.empty((int((counts - 2).sum()), 3), dtype=np.int64)
    looks = _LOOKS
    for n in np.unique(counts).tolist():
        faces = np.flatnonzero(counts == n)
        polygons = corners[firsts[faces, None] + np.arange(n)]
        if n > 3:
            notches = _notches(vertices[polygons])
            several = notches.sum(axis=1) > 1
            start = np.where(several, 0, notches.argmax(axis=1))
            turned = (start[:, None] + np.arange(n)) % n
            polygons = np.take_along_axis(polygons, turned, axis=1)
        else:
            several = np.zeros(len(faces), dtype=bool)
        fan = np.stack(
            [np.broadcast_to(polygons[:, :1], (len(faces), n - 2)), polygons[:, 1:-1],
             polygons[:, 2:]], axis=-1,
        )  # fmt: skip
        out[rows[faces, None] + np.arange(n - 2)] = fan
        for number in np.flatnonzero(several).tolist():
            face = int(faces[number])
            cut, looks = _clipped(vertices[polygons[number]], face, looks)
            out[rows[face] : rows[face] + n - 2] = polygons[number][cut]
    return out


def _normals(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P, 3) of polygons (P, n, 3), as long as twice their area (Newell)."""
    local = points - points[:, :1]
    return np.cross(local, np.roll(local, -1, axis=1)).sum(axis=1)


def _notches(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(P, n) corners at which polygons (P, n, 3) turn the other way."""
    normal = _normals(points)
    before = points - np.roll(points, 1, axis=1)
    after = np.roll(points, -1, axis=1) - points
    turn = np.einsum("pnk,pk->pn", np.cross(before, after), normal)
    return turn < -_EVEN * (normal**2).sum(axis=1, keepdims=True)


def _clipped(points: NDArray[np.float64], face: int, looks: int) -> tuple[list[list[int]], int]:
    """Return the triangles of one polygon (n, 3) as corners of it, and the looks that are left."""
    normal = _normals(points[None])[0]
    axis = int(np.abs(normal).argmax())
    u, v = ((1, 2), (2, 0), (0, 1))[axis]
    sign = 1.0 if normal[axis] > 0 else -1.0
    flat = [(p[u], p[v] * sign) for p in (points - points[0]).tolist()]
    even = _EVEN * float(np.abs(normal[axis]))

    def twice(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = flat[a], flat[b], flat[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    left = list(range(len(points)))
    cut: list[list[int]] = []
    at = failed = 0
    while len(left) > 3:
        looks -= len(left)
        if looks < 0:
            raise PolygonError(face, "its polygons have too many notches")
        at %= len(left)
        a, b, c = left[at - 1], left[at], left[(at + 1) % len(left)]
        size = twice(a, b, c)
        tips = (flat[a], flat[b], flat[c])
        ear = abs(size) <= even or (
            size > 0
            and not any(
                twice(a, b, p) >= -even and twice(b, c, p) >= -even and twice(c, a, p) >= -even
                for p in left
                if flat[p] not in tips
            )
        )
        if ear:
            cut.append([a, b, c])
            del left[at]
            failed = 0
            at -= 1
        else:
            failed += 1
            at += 1
            if failed > len(left):
                raise PolygonError(face, "a polygon crosses itself")
    cut.append(left)
    return cut, looks


AGAIN = "open it in a mesh viewer and export it again"
CUT_SHORT = "the file is cut short; export it again"

_FAR = 1e6
"""Of a point in a texture that repeats: beyond, single precision knows no point in it."""

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Vertices (V, 3) and triangles (F, 3)."""


@dataclass(frozen=True, kw_only=True)
class Material:
    """What colours some triangles.

    Attributes:
        factor: red, green, blue, 0 to 1; a texture's colours are multiplied by it.
        texture: bytes of a picture file, unchecked; None = the factor alone.
        is_linear: the factor, and colours of vertices, are linear; as displayed (sRGB) if not.
    """

    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: bytes | None = None
    is_linear: bool = False


@dataclass
class Paint:
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
        """Give some faces their colours.

        Args:
            faces: how many, F.
            colours: (F, 3, 3) of their corners; None = white.
            uv: (F, 3, 2) places in the texture, v down; None = none.
            material: (F,) or one index into `materials`.
        """
        self.parts.append((faces, colours, uv, material))

    def joined(self, faces: int) -> tuple[Any, Any, NDArray[np.int32]]:
        """Return colours, uv (None where no face has any) and material of all faces, in order."""
        count = sum(part[0] for part in self.parts)
        if count != faces:
            self.parts.append((faces - count, None, None, 0))
        colours = uv = None
        if any(part[1] is not None for part in self.parts):
            colours = np.concatenate(
                [np.ones((n, 3, 3), np.float32) if c is None else c for n, c, _, _ in self.parts]
            ).astype(np.float32)
            colours = np.nan_to_num(colours, nan=1.0)
        if any(part[2] is not None for part in self.parts):
            nowhere = np.float32(np.nan)
            uv = np.concatenate(
                [np.full((n, 3, 2), nowhere) if t is None else t for n, _, t, _ in self.parts]
            )
            uv = np.where(np.abs(uv) < _FAR, uv, nowhere).astype(np.float32)
        material = np.concatenate(
            [np.zeros(0, np.int32)] + [np.broadcast_to(m, n) for n, _, _, m in self.parts]
        ).astype(np.int32)
        return colours, uv, material


class Remarks:
    """What is left out of a file, and its colours where they are asked for.

    Attributes:
        path: of the file.
        paint: gets the colours; None = they are not wanted.
        dropped: surfaces and the like that are left out, and how many.
        unread: fields that are not read, and what contradicts in the file, in words.
        turned: whether its axes were turned.
    """

    def __init__(self, path: Path, paint: Paint | None = None) -> None:
        self.path = path
        self.paint = paint
        self.dropped: Counter[str] = Counter()
        self.unread: list[str] = []
        self.turned = False

    def words(self) -> str:
        """Return what was left out, in words."""
        return ", ".join(f"{count} {what}" for what, count in sorted(self.dropped.items()))

    def findings(self) -> tuple[SceneFinding, ...]:
        """Return a finding for each kind of remark."""
        findings: list[SceneFinding] = []
        if self.turned:
            findings.append(
                SceneFinding(
                    code="mesh_turned",
                    severity="note",
                    message=f"{self.path.name}: +y is up in glTF; it is turned so that +z is: "
                    "(x, y, z) of the file is (x, -z, y) of the world",
                    fix=(
                        "if the file has +z up already, `nw-eval scenes import` finds it, or write "
                        "it as .ply or .obj"
                    ),
                )
            )
        if self.dropped:
            findings.append(
                SceneFinding(
                    code="mesh_partly_read",
                    severity="note",
                    message=f"{self.path.name}: only triangles are used; left out: {self.words()}",
                    fix="export these as triangles if a robot can touch them",
                )
            )
        if self.unread:
            findings.append(
                SceneFinding(
                    code="mesh_partly_read",
                    severity="note",
                    message=f"{self.path.name}: not read: {'; '.join(self.unread)}",
                    fix="nothing, unless the surface or its colours depend on it",
                )
            )
        return tuple(findings)


def check_count(origin: object, count: int) -> None:
    """Check how many vertices or faces there are.

    Raises:
        SceneError: more than are read.
    """
    if count > MESH_FACES:
        raise SceneError(
            f"{origin}: {count} vertices or faces", fix=f"decimate it below {MESH_FACES}"
        )


def cut_faces(
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
    check_count(path, int((counts - 2).sum()))
    if (counts == 3).all():
        return corners.reshape(-1, 3)
    if corners.min() < 0 or corners.max() >= len(vertices):
        wrong = corners[(corners < 0) | (corners >= len(vertices))]
        raise SceneError(
            f"{path}: a face names vertex {int(wrong[0])} of {len(vertices)}", fix=CUT_SHORT
        )
    if not np.isfinite(vertices).all():  # `checked_mesh` names it.
        vertices = np.zeros_like(vertices)
    try:
        with np.errstate(all="ignore"):
            return triangulated(vertices, counts, corners)
    except PolygonError as error:
        where = f"{path}:{place[error.face]}" if place else f"{path}: face {error.face}"
        raise SceneError(f"{where}: {error}", fix="triangulate it before it is exported") from None


def bytes_beside(path: Path, name: str, remarks: Remarks) -> bytes | None:
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


def numbers_of(path: Path, rows: list[str], lines: list[int], what: str) -> NDArray[np.float64]:
    """(rows, 3) float64: the first three numbers of each row.

    Raises:
        SceneError: naming the line of the first row that has not so many.
    """
    if not rows:
        return np.zeros((0, 3))
    widths = {len(row.split()) for row in rows}
    wide = max(widths)
    if len(widths) == 1 and wide >= 3:
        values = fast_numbers(rows, np.float64)
        if values is not None and len(values) == len(rows) * wide:
            return np.ascontiguousarray(values.reshape(-1, wide)[:, :3])
    out = np.empty((len(rows), 3))
    for i, row in enumerate(rows):
        parsed = fast_numbers([row], np.float64)
        if parsed is not None and len(parsed) >= 3:
            out[i] = parsed[:3]
        else:
            raise SceneError(
                f"{path}:{lines[i]}: `{what}` is not followed by three numbers: "
                f"{clean(row, at_most=60)!r}",
                fix=AGAIN,
            ) from None
    return out


def fast_numbers(rows: list[str], kind: type[np.float64 | np.int64]) -> NDArray[Any] | None:
    """Return all numbers of some lines, None if there is another word among them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # Older NumPy warns where it stops.
        try:
            return np.fromstring(" ".join(rows), dtype=kind, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def strips(corners: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """(F, 3) triangles of strips: each list is one or more, -1 ends one."""
    run = np.insert(corners, np.cumsum(counts)[:-1], -1)
    place = np.arange(len(run))
    place -= np.maximum.accumulate(np.where(run == -1, place, -1)) + 1  # In its strip.
    last = np.flatnonzero(place >= 2)
    a, b, c = run[last - 2], run[last - 1], run[last]
    # Every other triangle of a strip is wound the other way.
    odd = (place[last] % 2 == 1)[:, None]
    return np.where(odd, np.stack([b, a, c], -1), np.stack([a, b, c], -1))
