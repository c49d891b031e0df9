"""Depth maps of all shots: each is matched, and kept where others see the same surface.

Arrays on disk say what they are of, so that a second call takes up what the first left.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError, UsageError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import OutsideError, inside
from nw_twin.capture import Capture
from nw_twin.options import DepthOptions
from nw_twin.packages import package
from nw_twin.reconstruct.patchmatch import Matched, agreed, confirming, expected, matched
from nw_twin.reconstruct.views import (
    F32,
    F64,
    SparsePlanes,
    WorkingView,
    depth_range,
    neighbours_of,
    read_view,
)

_SURE, _WORST = 0.1, 0.7
"""Cost that needs no less, and up to which a pixel is known: 1 less the normalised correlation."""
LEAST_AGREEING = 2
"""Neighbours that must see the same surface."""
_LEAST_CONFIDENCE = 0.05
_NEARER, _FARTHER = 0.7, 1.5
"""Times the nearest and the farthest depth of the calibration's points, that are matched."""
_ISLE = 1.0 / 1300.0
"""Share of a picture below which pixels that hang together are an accident."""
_BY_POINTS = 1.2
"""Cost of a pixel at most that lies on a plane of the calibration's points."""
_TEXTURE = 16.0
"""Variance about such a pixel at least, grey levels squared: a sky changes less."""

_ALIKE = float(np.cos(np.deg2rad(15.0)))
"""Cosine of the angle by which a plain pixel's normal may be off the plane around it."""
_OWN = 100.0
"""Variance about a pixel, grey levels squared, from which on it has texture of its own."""
DARKER = 0.15
"""Logarithm by which a pixel is darker than those about it, and may be no part of theirs."""
_FEW = 0.02
"""Share of the square about a pixel that has to be known for a colour."""
_PLAIN_OFF = 0.01
"""Share of its depth, as above."""

_FORMAT = 1
"""Changes with what a round does."""

_DAMAGE = (OSError, ValueError, LookupError, TypeError, EOFError, BadZipFile, zlib.error)
"""What NumPy raises at damaged files."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthMap:
    """Depth, normals and confidence of one view, at its working size.

    Attributes:
        view: of the capture.
        depth: (H, W) float32 along the optical axis, 0 where not known.
        confidence: (H, W) float32, 0 (not known) to 1.
        normal: (H, W, 3) float32 unit normals of the surface, turned to the camera, in the view's
            camera frame (x right, y down, z along the optical axis); 0 where depth is.
    """

    view: WorkingView
    depth: F32
    confidence: F32
    normal: F32


def depth_maps(
    capture: Capture,
    folder: Path,
    out: Path,
    options: DepthOptions,
    say: Callable[[str], None],
    threads: int = 2,
) -> list[DepthMap]:
    """Measure the depth of each shot.

    What is matched is kept in `out/matched/`; a second call with the same capture and options goes
    on.

    Args:
        capture: as read from its folder.
        folder: of the capture.
        out: of the mesh.
        options: see there.
        say: receives a message for each shot.
        threads: shots at once; no result depends on them.

    Returns:
        One map for each shot that shows enough points, in the capture's order.

    Raises:
        SceneError: a picture cannot be read, or no shot has a neighbour.
        PrerequisiteError: OpenCV or SciPy is not installed.
        StoreError: a file cannot be written.
    """
    pairs = neighbours_of(capture, options.neighbours)
    views = [read_view(shot, folder, options.side) for shot in capture.shots]
    reaches = _reaches(capture, pairs)
    places = list(reaches)
    if not places:
        raise SceneError(
            f"none of {len(views)} shots shares enough points with another",
            fix="take more photographs, each showing much of what the one before shows",
        )
    near = {place: [other for other in pairs[place] if other in places] for place in places}
    keys = {place: _key_of(views, place, near[place], reaches[place]) for place in places}
    matches: dict[int, Matched] = {}
    with _single_threaded(), _pool(threads) as pool:
        for turn in range(1 + options.rounds):
            before, matches = matches, {}
            if turn:
                keys = {
                    place: _joined(turn, keys[place], *(keys[j] for j in near[place]))
                    for place in places
                }

            def one(
                place: int,
                turn: int = turn,
                before: dict[int, Matched] = before,
                keys: dict[int, str] = keys,
            ) -> Matched:
                path = array_file(out / "matched" / str(turn), views[place].name)
                kept = read_matched(path, keys[place], views[place].size)
                if kept is not None:
                    return kept
                view, others, reach = views[place], [views[j] for j in near[place]], reaches[place]
                if turn:
                    theirs = [before[j] for j in near[place]]
                    new = agreed(view, others, reach, before[place], theirs, turn)
                else:
                    new = matched(view, others, reach)
                return write_matched(path, new, keys[place])

            for place, each in zip(places, pool.map(one, places), strict=True):
                matches[place] = each
                done = f"{len(matches)} of {len(places)}"
                what = "is compared with its neighbours" if turn else "is matched"
                say(f"depth of {views[place].name} {what}: {done}")
        ground = SparsePlanes.of(capture)
        whole = pool.map(
            lambda place: _known(views, matches, near, place, reaches[place], ground),
            places,
        )
        return list(whole)


@contextmanager
def _pool(threads: int) -> Generator[ThreadPoolExecutor]:
    """Give threads; whoever is interrupted waits for what has begun, and for nothing else."""
    with ThreadPoolExecutor(threads) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _reaches(capture: Capture, pairs: list[list[int]]) -> dict[int, tuple[float, float]]:
    """Return the nearest and the farthest depth of each shot that can be matched.

    Ground before a camera has few points or none, and another camera is held as high: the nearest
    depth is that of all of them.
    """
    ranges = {place: depth_range(capture, place) for place, near in enumerate(pairs) if near}
    whole = {place: reach for place, reach in ranges.items() if reach}
    least = min((near for near, _ in whole.values()), default=0.0) * _NEARER
    return {place: (least, far * _FARTHER) for place, (_, far) in whole.items()}


def near_of(capture: Capture, maps: list[DepthMap], options: DepthOptions) -> list[list[int]]:
    """Return for each map the numbers of those that it is compared with."""
    numbers = {each.view.name: number for number, each in enumerate(maps)}
    names = [shot.name for shot in capture.shots]
    pairs = dict(zip(names, neighbours_of(capture, options.neighbours), strict=True))
    return [
        [numbers[names[other]] for other in pairs[name] if names[other] in numbers]
        for name in numbers
    ]


def _known(
    views: list[WorkingView],
    matches: dict[int, Matched],
    near: dict[int, list[int]],
    index: int,
    reach: tuple[float, float],
    ground: SparsePlanes,
) -> DepthMap:
    """Return what of a picture's planes is taken for right."""
    cv2, view, own = package("cv2"), views[index], matches[index]
    others, theirs = [views[j] for j in near[index]], [matches[j] for j in near[index]]
    count, distinct = confirming(view, others, own, theirs)
    known = (distinct >= LEAST_AGREEING) & (own.costs <= _WORST)
    # What is plain lies as what is known around it does, and the others say so too.
    prior = expected(view, own, known, reach)
    off = np.abs(own.planes[..., 0] - prior[..., 0])
    alike = (own.planes[..., 1:] * prior[..., 1:]).sum(axis=-1) > _ALIKE
    grey, side = view.grey, (11, 11)
    texture = cv2.blur(grey * grey, side) - cv2.blur(grey, side) ** 2
    same = darkness(view, known) < DARKER
    known &= same | (_variance(grey, 5) > _OWN)
    known |= (count >= LEAST_AGREEING) & alike & (off <= _PLAIN_OFF * prior[..., 0]) & same
    one = (count > 0) & (own.costs <= _BY_POINTS) & (texture > _TEXTURE) & ~known & same
    known[one] = ground.near(view, own.planes, one)
    _, label, facts, _ = cv2.connectedComponentsWithStats(known.astype(np.uint8), connectivity=8)
    known &= facts[label, cv2.CC_STAT_AREA] >= _ISLE * known.size
    if view.mask is not None:
        known &= view.mask
    sure = np.clip((_WORST - own.costs) / (_WORST - _SURE), 0.0, 1.0)
    sure *= np.minimum(count / min(4, max(len(others), 1)), 1.0)
    confidence = np.where(known, np.maximum(sure, _LEAST_CONFIDENCE), 0.0).astype(np.float32)
    depth = np.where(known, own.planes[..., 0], np.float32(0.0))
    normal = np.where(known[..., None], own.planes[..., 1:], np.float32(0.0))
    return DepthMap(view=view, depth=depth, confidence=confidence, normal=normal)


def _variance(grey: F32, side: int) -> F32:
    cv2, size = package("cv2"), (side, side)
    return cv2.blur(grey * grey, size) - cv2.blur(grey, size) ** 2


def darker(depth_map: DepthMap) -> NDArray[np.bool_]:
    """Return which pixels (H, W) are darker than the known ones about them."""
    return darkness(depth_map.view, depth_map.depth > 0.0) >= DARKER


def darkness(view: WorkingView, known: NDArray[np.bool_]) -> F32:
    """Return how much darker each pixel is than the known ones about it, a logarithm (H, W).

    0 where none is near. A dark stripe between two edges may be painted on what lies on both sides
    of it, or be what shows in the gap between: without texture of its own nothing tells.

    Args:
        view: a picture.
        known: (H, W) pixels of one surface.
    """
    cv2 = package("cv2")
    colour = np.log(cv2.blur(view.rgb, (3, 3)).astype(np.float32) + np.float32(4.0)).mean(axis=-1)
    side = 2 * (max(view.size) // 16) + 1
    weight = cv2.blur(known.astype(np.float32), (side, side))
    about = cv2.blur(colour * known, (side, side)) / np.maximum(weight, np.float32(1e-6))
    return np.where(weight > _FEW, about - colour, np.float32(0.0))


def write_map(capture: Capture, depth_map: DepthMap, out: Path) -> None:
    """Write `out/depth/<shot>.npz`: depth, confidence, normal at the size of the shot's picture.

    Normals are float16.

    Raises:
        StoreError: the file cannot be written.
    """
    (shot,) = (shot for shot in capture.shots if shot.name == depth_map.view.name)
    camera = shot.camera
    depth, confidence, normal = depth_map.depth, depth_map.confidence, depth_map.normal
    size = (camera.height, camera.width)
    if depth.shape != size:
        lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        depth, confidence, normal = _enlarged(depth_map, lens, size)
    path = array_file(out / "depth", shot.name)
    write_arrays(path, depth=depth, confidence=confidence, normal=normal.astype(np.float16))


def _enlarged(depth_map: DepthMap, lens: F64, size: tuple[int, int]) -> tuple[F32, F32, F32]:
    """Return depth, confidence and normal at a larger size: each pixel on its nearest plane."""
    K, (height, width) = depth_map.view.K, depth_map.view.size
    rows = np.minimum(((np.arange(size[0]) + 0.5) * height / size[0]).astype(np.int64), height - 1)
    columns = np.minimum(((np.arange(size[1]) + 0.5) * width / size[1]).astype(np.int64), width - 1)
    depth, confidence, normal = (
        each[rows][:, columns] for each in (depth_map.depth, depth_map.confidence, depth_map.normal)
    )
    x = (columns + 0.5 - K[0, 2]) / K[0, 0]
    y = (rows[:, None] + 0.5 - K[1, 2]) / K[1, 1]
    there = normal[..., 0] * x + normal[..., 1] * y + normal[..., 2]
    x = (np.arange(size[1]) + 0.5 - lens[2]) / lens[0]
    y = (np.arange(size[0])[:, None] + 0.5 - lens[3]) / lens[1]
    slope = np.minimum(normal[..., 0] * x + normal[..., 1] * y + normal[..., 2], -1e-6)
    depth = depth * np.clip(there / slope, 0.9, 1.1)
    return depth.astype(np.float32), confidence, normal


@contextmanager
def _single_threaded() -> Generator[None]:
    """Keep OpenCV from adding threads to ours, and from waiting for them."""
    cv2 = package("cv2")
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def array_file(folder: Path, shot: str) -> Path:
    """Return where the arrays of a shot are: `<folder>/<shot>.npz`, e.g. IMG_0012.jpg.npz.

    Raises:
        UsageError: the shot's name leads out of the folder.
    """
    try:
        return inside(folder, f"{shot}.npz")
    except OutsideError as error:
        raise UsageError(
            f"a shot is called {shot!r}: {error}", fix="give it another name and calibrate again"
        ) from None


def write_arrays(path: Path, **arrays: NDArray[Any]) -> None:
    """Write arrays; a reader sees the old file or the new one whole.

    Raises:
        StoreError: the file cannot be written.
    """
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **arrays)


def read_depth(folder: Path, shot: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a shot's depth along the optical axis and its confidence, (H, W), 0 where not known.

    Raises:
        SceneError: the folder has none of that shot, or it is damaged.
    """
    path = array_file(folder, shot)
    try:
        depth, confidence = (a.astype(np.float32) for a in _arrays(path, ("depth", "confidence")))
        if depth.ndim != 2 or depth.shape != confidence.shape:
            raise ValueError(f"arrays of shapes {depth.shape} and {confidence.shape}")
    except _DAMAGE as error:
        raise SceneError(f"{path} holds no depth: {error}", fix="reconstruct again") from None
    known = np.isfinite(depth) & (depth > 0.0) & np.isfinite(confidence)
    sure = np.clip(confidence, 0.0, 1.0)
    return (np.where(known, depth, np.float32(0.0)), np.where(known, sure, np.float32(0.0)))


def write_matched(path: Path, matched: Matched, key: str) -> Matched:
    """Write planes with the key of their inputs; return them as a later read gives them.

    Raises:
        StoreError: the file cannot be written.
    """
    normals = np.round(matched.planes[..., 1:] * _NORMAL).astype(np.int16)
    costs = np.round(matched.costs * _COST).astype(np.uint16)
    depth = matched.planes[..., 0]
    write_arrays(path, depth=depth, normals=normals, costs=costs, key=np.array(key))
    return _matched(depth, normals, costs)


def read_matched(path: Path, key: str, size: tuple[int, int]) -> Matched | None:
    """Return what `write_matched` kept; None if there is nothing, or of something else."""
    try:
        stored_key, depth, normals, costs = _arrays(path, ("key", "depth", "normals", "costs"))
    except _DAMAGE:
        return None
    if str(stored_key) != key or depth.shape != size or normals.shape != (*size, 3):
        return None
    return _matched(depth, normals, costs)


_NORMAL, _COST = 32767.0, 30000.0
"""Steps of 1 in what is kept."""


def _matched(
    depth: NDArray[np.float32], normals: NDArray[np.int16], costs: NDArray[np.uint16]
) -> Matched:
    unit = normals.astype(np.float32)
    unit /= np.maximum(np.linalg.norm(unit, axis=-1, keepdims=True), np.float32(1.0))
    return Matched(
        planes=np.concatenate([depth[..., None], unit], axis=-1),
        costs=costs.astype(np.float32) / np.float32(_COST),
    )


def _arrays(path: Path, names: Sequence[str]) -> list[NDArray[Any]]:
    """Return arrays of a file; whatever it raises is in `_DAMAGE`."""
    with np.load(path, allow_pickle=False) as arrays:
        return [np.asarray(arrays[name]) for name in names]


def _key_of(
    views: list[WorkingView], index: int, near: list[int], reach: tuple[float, float]
) -> str:
    """Return the hex SHA-256 of all that matching a picture alone depends on."""
    content = hashlib.sha256(json.dumps([_FORMAT, views[index].name, reach]).encode())
    for each in (views[index], *(views[j] for j in near)):
        content.update(repr(each.size).encode())
        for array in (each.K, each.T_camera_world, each.rgb):
            content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()


def _joined(turn: int, *keys: str) -> str:
    """Return the key of a later round by those of what it begins with."""
    return hashlib.sha256(json.dumps([turn, *keys]).encode()).hexdigest()
