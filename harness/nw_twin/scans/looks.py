"""Appearance of a scan: Gaussians in a mesh's colours, or a splat beside the mesh."""

from __future__ import annotations

import math
import shutil
import warnings
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import SceneError, UsageError
from nw_base.files.inside import regular, what_is
from nw_base.files.pictures import open_picture
from nw_scenes.limits import TEXTURE_PIXELS, check_similarity
from nw_scenes.mesh_file import PaintedMesh
from nw_scenes.saving import SPLAT, similarity_entry
from nw_splat.files import read_splat, write_splat
from nw_splat.gaussians import Gaussians
from nw_twin.gaussians.initial import FLAT, distances, gaussians_at
from nw_twin.place import moved_points

Values = NDArray[np.float64]

_KEPT = (".ply", ".spz", ".sog", ".splat")
"""Files of Gaussians that are copied as they are; others are written as PLY."""
_SPACING = 0.02
"""Between Gaussians on a mesh at least, metres."""
_NEAR, _COARSEST = 3.0, 8.0
"""Metres from the course up to which Gaussians are finest; beyond, they are larger
in proportion to the distance, up to so many times."""
_SIZE, _OPACITY = 0.85, 0.98
"""Standard deviation of one along the surface, as a share of their distance, and its opacity."""
_TEXTURE = ("JPEG", "PNG", "WEBP")
_OFF_MESH = 0.1
"""Median distance of a splat's Gaussians from the mesh that it lies on, at most, metres."""
_ELSEWHERE = 1.0
"""Metres, from which on a splat that a matrix lays is of another place: half of its Gaussians are
farther from the mesh, and half of the mesh from them. A splat shows what is far behind a mesh,
or less than all of it; either alone says nothing."""


def write_looks(
    staged: Path,
    text: dict[str, Any],
    painted: PaintedMesh,
    T: Values,
    *,
    splat: Path | None,
    splat_transform: Path | None,
    is_own: bool = False,
    most: int,
    way: Values,
) -> list[str]:
    """Write the splat of a scene and name it in scene.yaml.

    Args:
        staged: the scene's folder.
        text: of scene.yaml, which gets `splat` and `T_world_splat`.
        painted: the scene's mesh.
        T: (4, 4) similarity from its file to the world.
        splat: Gaussians of the same scene; None = they are made of the mesh's colours.
        splat_transform: as `ScanOptions` has it.
        is_own: whether the mesh was drawn through this splat, and so is in its frame.
        most: Gaussians that are made of colours.
        way: (K, 3) start and waypoints, world, m, along which they lie finest.

    Returns:
        What is said of it, line by line.

    Raises:
        SceneError: a splat cannot be read, or does not lie on the mesh.
        UsageError: as `painted_gaussians`.
        OSError, StoreError: it cannot be written.
    """
    if splat is not None:
        gaussians = read_splat(splat)
        T_mesh_splat, words = np.eye(4), "the splat shows itself"
        if not is_own:
            T_mesh_splat, words = _beside(painted, T, gaussians, splat, splat_transform)
        if what_is(splat) == "file" and splat.suffix.lower() in _KEPT:
            name = SPLAT.replace(".ply", splat.suffix.lower())
            shutil.copyfile(splat, staged / name)
        else:
            name = SPLAT
            write_splat(staged / name, gaussians)
        text["splat"] = name
        text["T_world_splat"] = similarity_entry(T @ T_mesh_splat)
        return [words]
    if not painted.is_painted:
        return ["no colours in it, so no splat: policies with splat_rgb do not run there"]
    gaussians, spacing, remarks = painted_gaussians(
        painted,
        most=most,
        unit=check_similarity(T, "the scan"),
        way=moved_points(np.linalg.inv(T).astype(np.float64), way),
    )
    write_splat(staged / SPLAT, gaussians)
    text["splat"] = SPLAT
    text["T_world_splat"] = similarity_entry(T)
    return [
        (
            f"splat of the mesh's colours: {len(gaussians.means):,} Gaussians, one every "
            f"{1000 * spacing:.0f} mm near the course; finer detail and gloss are lost"
        ),
        *remarks,
    ]


def painted_gaussians(
    painted: PaintedMesh, *, most: int, unit: float = 1.0, way: Values | None = None
) -> tuple[Gaussians, float, list[str]]:
    """Return flat Gaussians in the surface of a mesh, in its colours and its file's frame.

    Args:
        painted: the mesh.
        most: Gaussians at most; they lie 2 cm apart if that takes fewer.
        unit: metres in one unit of the file.
        way: (K, 3) points in the file's frame, around which they lie finest; None = everywhere.

    Returns:
        Gaussians, how far the finest are apart in metres, and what could not be read.

    Raises:
        SceneError: a texture is not a picture, or too large.
        UsageError: `most` is too small.
    """
    if not 1000 <= most <= 5_000_000:
        raise UsageError(f"--gaussians {most} is out of range", fix="give 1,000 to 5,000,000")
    corners = painted.vertices[painted.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(normal, axis=1)
    middles = corners.mean(axis=1)
    coarse = np.ones(len(middles))
    if way is not None:
        along = np.linspace(way[:-1], way[1:], 20, axis=1).reshape(-1, 3)
        coarse = np.clip(distances(middles, along) * unit / _NEAR, 1.0, _COARSEST)
    shares = twice / coarse**2
    total = float(shares.sum()) / 2
    count = int(min(max(total * unit**2 / _SPACING**2, 1000), most))
    face, weights = _spread(middles, shares, count)
    spacing = math.sqrt(total / count)
    points = np.einsum("nk,nkd->nd", weights, corners[face])
    colours, remarks = _colours_at(painted, face, weights, twice, spacing)
    gaussians = gaussians_at(
        points, colours, normal[face] / twice[face, None], sh_degree=0, opacity=_OPACITY
    )
    # Each is as wide as those of its face are apart.
    sizes = np.log(_SIZE * spacing * coarse[face, None] * np.array([1.0, 1.0, FLAT]))
    return replace(gaussians, log_scales=sizes.astype(np.float32)), spacing * unit, remarks


def _spread(middles: Values, areas: Values, count: int) -> tuple[NDArray[np.int64], Values]:
    """Return the face (N,) of evenly spread points on a mesh, and their weights of corners (N, 3).

    Faces come along a curve that fills space (Morton), each point after the same area; within a
    face they follow the R2 sequence (Roberts 2018).
    """
    low, high = middles.min(axis=0), middles.max(axis=0)
    grid = ((middles - low) / max(float((high - low).max()), 1e-300) * 1023.0).astype(np.uint64)
    code = np.zeros(len(middles), np.uint64)
    for bit in range(10):
        for axis in range(3):
            one = (grid[:, axis] >> np.uint64(bit)) & np.uint64(1)
            code |= one << np.uint64(3 * bit + axis)
    order = np.argsort(code, kind="stable")
    ends = np.cumsum(areas[order])
    places = (np.arange(count) + 0.5) * (ends[-1] / count)
    slot = np.minimum(np.searchsorted(ends, places), len(order) - 1)
    begins = np.concatenate([[0], np.flatnonzero(np.diff(slot)) + 1])
    run = np.arange(count) - np.repeat(begins, np.diff(np.append(begins, count)))
    u = (1 / 3 + 0.7548776662466927 * run) % 1.0
    v = (1 / 3 + 0.5698402909980532 * run) % 1.0
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    return order[slot], np.stack([1.0 - u - v, u, v], axis=-1)


def _colours_at(
    painted: PaintedMesh,
    face: NDArray[np.int64],
    weights: Values,
    twice_area: Values,
    spacing: float,
) -> tuple[Values, list[str]]:
    """Return colours (N, 3), as displayed, of points on a mesh."""
    shade = np.ones((len(face), 3))
    if painted.colours is not None:
        shade = np.einsum("nk,nkd->nd", weights, painted.colours[face].astype(np.float64))
    uv = None
    if painted.uv is not None:
        uv = np.einsum("nk,nkd->nd", weights, painted.uv[face].astype(np.float64))
    remarks: list[str] = []
    colours = np.empty_like(shade)
    of = painted.material[face]
    for number, material in enumerate(painted.materials):
        rows = np.flatnonzero(of == number)
        if len(rows) == 0:
            continue
        colour = shade[rows] * np.array(material.factor)
        if material.texture is not None and uv is not None:
            faces = np.flatnonzero(painted.material == number)
            assert painted.uv is not None
            width = _width(painted.uv[faces].astype(np.float64), twice_area[faces])
            try:
                seen = _looked_up(_texture(material.texture, width, spacing), uv[rows])
            except SceneError as error:
                remarks.append(f"texture {number + 1} left out: {error.message}")
            else:
                colour *= _linear(seen) if material.is_linear else seen
        colours[rows] = _displayed(colour) if material.is_linear else colour
    return np.clip(colours, 0.0, 1.0), remarks


def _width(uv: Values, twice_area: Values) -> float:
    """Return how wide a whole texture is on the surface, in the file's unit: the faces' median."""
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    laid = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    known: NDArray[np.bool_] = np.asarray(laid > 0)  # Not that of nan.
    if not known.any():
        return 0.0
    return math.sqrt(float(np.median(twice_area[known] / laid[known])))


def _texture(content: bytes, width: float, spacing: float) -> NDArray[np.uint8]:
    """Return the pixels (H, W, 3) of a texture, no finer than half of the Gaussians' distance.

    Raises:
        SceneError: it is not a picture, damaged, or too large.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            picture = open_picture(BytesIO(content), _TEXTURE)
        across, down = picture.size
        if across * down <= TEXTURE_PIXELS:
            texels = int(spacing / 2 * max(across, down) / width) if width > 0 else 1
            if picture.format == "JPEG" and texels > 1:
                picture.draft("RGB", (across // texels, down // texels))
            left = max(texels * picture.size[0] // across, 1)
            # Charts of an atlas lie apart by few pixels, and must not run into each other.
            return np.asarray(picture.convert("RGB").reduce(min(left, 16)))
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 - Pillow raises of many kinds at damaged files.
        raise SceneError(f"no picture that is read ({clean(str(error), at_most=80)})") from None
    raise SceneError(f"{across} x {down} pixels, over {TEXTURE_PIXELS // 10**6} million")


def _looked_up(picture: NDArray[np.uint8], uv: Values) -> Values:
    """Return colours (N, 3), 0 to 1, of a texture that repeats; white where there is no place."""
    rows, columns = picture.shape[:2]
    known = np.isfinite(uv).all(axis=1, keepdims=True)
    u, v = (np.where(known, uv, 0.0) % 1.0).T
    c = np.minimum((u * columns).astype(np.int64), columns - 1)
    r = np.minimum((v * rows).astype(np.int64), rows - 1)
    return np.where(known, picture[r, c] / 255.0, 1.0)


def _linear(shown: Values) -> Values:
    """Return sRGB values as linear ones (IEC 61966-2-1)."""
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def _displayed(linear: Values) -> Values:
    low = np.clip(linear, 0.0, 1.0)
    return np.where(low <= 0.0031308, 12.92 * low, 1.055 * low ** (1 / 2.4) - 0.055)


# --- A splat beside a mesh ---------------------------------------------------------------------


def _beside(
    painted: PaintedMesh, T: Values, gaussians: Gaussians, splat: Path, splat_transform: Path | None
) -> tuple[Values, str]:
    """Return (4, 4) from a splat's numbers to its mesh's, and how far it lies off the mesh."""
    unit = check_similarity(T, "the scan")
    corners = painted.vertices[painted.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(normal, axis=1)
    face, weights = _spread(corners.mean(axis=1), twice, 30_000)
    surface = np.einsum("nk,nkd->nd", weights, corners[face])
    solid = np.flatnonzero(
        (gaussians.opacity_logits > 0.0) & np.isfinite(gaussians.means).all(axis=1)
    )
    if len(solid) == 0:
        raise SceneError(f"{splat}: no Gaussian is opaque", fix="give another splat")
    means = gaussians.means[solid[:: max(len(solid) // 2000, 1)]].astype(np.float64)

    def off(T_mesh_splat: Values) -> float:
        return unit * float(np.median(distances(moved_points(T_mesh_splat, means), surface)))

    if splat_transform is not None:
        given = _matrix(splat_transform)
        metres = off(given)
        apart = unit * math.sqrt(float(twice.sum()) / 2 / len(surface))
        if metres > (most := max(_ELSEWHERE, 2.0 * apart)):
            some = moved_points(given, gaussians.means[solid[:: max(len(solid) // 30_000, 1)]])
            bare = unit * float(np.median(distances(surface[::15], some)))
            if bare > most:
                raise SceneError(
                    f"{splat_transform}: it lays half of the Gaussians of {splat} {metres:.2f} m "
                    f"from the mesh or more, and leaves half of the mesh {bare:.2f} m from them",
                    fix="give the matrix from the splat's numbers to the mesh's, both in the units "
                    "and axes of their files; the inverse leads the other way",
                )
        return given, f"splat laid by {splat_transform.name}: {_half(metres)}"
    ways = sorted(((off(turn), i) for i, turn in enumerate(_TURNS)), key=lambda one: one[0])
    (least, best), (next_best, _) = ways[:2]
    if least > _OFF_MESH or next_best < 2.0 * least:
        raise SceneError(
            f"{splat}: no turn by right angles alone lays it on the mesh: the best leaves "
            f"half of its Gaussians {least:.2f} m away or more, the next {next_best:.2f} m",
            fix="give the 4 x 4 matrix from its numbers to the mesh's: --splat-transform FILE",
        )
    rows = ["".join(_signed(row)) for row in _TURNS[best][:3, :3]]
    return _TURNS[best], (
        f"splat: (x, y, z) of it is ({', '.join(rows)}) of the mesh; {_half(least)}, and "
        f"{next_best:.2f} m by the next best turn"
    )


def _half(metres: float) -> str:
    return f"half of its Gaussians lie within {metres:.3f} m of the mesh"


def _signed(row: Values) -> tuple[str, str]:
    axis = int(np.abs(row).argmax())
    return ("-" if row[axis] < 0 else "", "xyz"[axis])


def _turns() -> list[Values]:
    """Return the 24 turns by right angles, (4, 4); the first leaves everything as it is."""
    turns: list[Values] = []
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        for signs in np.ndindex(2, 2, 2):
            T = np.eye(4)
            T[:3, :3] = np.eye(3)[list(order)] * (1.0 - 2.0 * np.array(signs))[:, None]
            if np.linalg.det(T[:3, :3]) > 0:
                turns.append(T)
    return turns


_TURNS = _turns()


def _matrix(path: Path) -> Values:
    """Return the (4, 4) similarity that a text file holds, row after row."""
    try:
        with regular(path).open(encoding="utf-8", errors="replace") as file:
            words = file.read(10_000).replace(",", " ").translate(_BRACKETS).split()
        values = np.array([float(word) for word in words])
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}", fix="give a text file") from None
    except ValueError as error:
        raise SceneError(f"{path}: {error}", fix="give 16 numbers, row after row") from None
    if len(values) != 16 or not np.isfinite(values).all() or (values[12:] != (0, 0, 0, 1)).any():
        raise SceneError(
            f"{path}: {len(values)} numbers, or a last row that is not 0 0 0 1",
            fix="give the 4 x 4 matrix, row after row",
        )
    T = values.reshape(4, 4)
    check_similarity(T, str(path))
    return T


_BRACKETS = str.maketrans("[]();", "     ")
