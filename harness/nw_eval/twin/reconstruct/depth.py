"""Depth maps of all shots: each is swept, and kept where neighbours see the same surface.

Arrays on disk say what they are of, so that a second call takes up what the first left.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError, UsageError
from nw_eval.files.cache import atomic_path
from nw_eval.files.inside import OutsideError, inside
from nw_eval.twin.capture import Capture
from nw_eval.twin.reconstruct.options import DepthOptions
from nw_eval.twin.reconstruct.packages import package
from nw_eval.twin.reconstruct.plane_kernels import count_agreeing
from nw_eval.twin.reconstruct.sweep import Sweep, sweep
from nw_eval.twin.reconstruct.views import F32, WorkingView, depth_range, neighbours_of, read_view

_SURE = 0.9
"""Correlation that needs no more."""
_UNIQUE = 0.1
"""Of all other depths being worse, likewise."""
_LEAST_CONFIDENCE = 0.05

_FORMAT = 1
"""Changes with what a sweep does."""

_NAMES = ("depth", "likeness", "unique")
_DAMAGE = (OSError, ValueError, LookupError, TypeError, EOFError, BadZipFile, zlib.error)
"""What NumPy raises at damaged files."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthMap:
    """What is known of one view's depth, at the size that it was worked at.

    Attributes:
        view: of the capture.
        depth: (H, W) float32 along the optical axis, 0 where not known.
        confidence: (H, W) float32, 0 (not known) to 1.
    """

    view: WorkingView
    depth: F32
    confidence: F32


def depth_maps(
    capture: Capture,
    folder: Path,
    out: Path,
    options: DepthOptions,
    say: Callable[[str], None],
    threads: int = 2,
) -> list[DepthMap]:
    """Measure the depth of each shot.

    A sweep is kept in `out/sweep/`; a second call with the same capture and options goes on.

    Args:
        capture: as read from its folder.
        folder: of the capture.
        out: of the mesh.
        options: see there.
        say: is told of each shot.
        threads: shots at once, each with about 0.25 GB at 640 x 360; no result depends on them.

    Returns:
        One map for each shot that shows enough points, in the capture's order.

    Raises:
        SceneError: a picture cannot be read, or no shot has a neighbour.
        PrerequisiteError: OpenCV is not installed.
        StoreError: a file cannot be written.
    """
    pairs = neighbours_of(capture, options.neighbours)
    views = [read_view(shot, folder, options.side) for shot in capture.shots]
    swept: dict[int, Sweep] = {}
    places = [place for place, near in enumerate(pairs) if near and depth_range(capture, place)]
    if not places:
        raise SceneError(
            f"none of {len(views)} shots shares enough points with another",
            fix="take more photographs, each showing much of what the one before shows",
        )

    def one(place: int) -> Sweep:
        return depth_of(capture, views, pairs[place], place, out, options)

    with _single_threaded(), ThreadPoolExecutor(threads) as pool:
        for place, found in zip(places, pool.map(one, places), strict=True):
            swept[place] = found
            say(f"depth of {views[place].name}: {len(swept)} of {len(places)}")
        kept = pool.map(lambda place: _agreed(views, swept, pairs[place], place, options), places)
        return list(kept)


def near_of(capture: Capture, maps: list[DepthMap], options: DepthOptions) -> list[list[int]]:
    """Return for each map the numbers of those that it is compared with."""
    numbers = {each.view.name: number for number, each in enumerate(maps)}
    names = [shot.name for shot in capture.shots]
    pairs = dict(zip(names, neighbours_of(capture, options.neighbours), strict=True))
    return [
        [numbers[names[other]] for other in pairs[name] if names[other] in numbers]
        for name in numbers
    ]


def depth_of(
    capture: Capture,
    views: list[WorkingView],
    near: list[int],
    place: int,
    out: Path,
    options: DepthOptions,
) -> Sweep:
    """Return one shot's depth as swept, from `out/sweep/` if it is there.

    Args:
        capture: of the shots.
        views: all of them.
        near: numbers of those that it is compared with.
        place: its number; it shows enough points for `depth_range`.
        out: of the mesh.
        options: see there.
    """
    reach = depth_range(capture, place)
    if reach is None:
        raise ValueError(f"shot {place} shows too few points")
    others, path = [views[j] for j in near], array_file(out / "sweep", views[place].name)
    key = key_of(views[place], others, reach, options)
    found = read_sweep(path, key)
    if found is None or found.depth.shape != views[place].size:
        write_sweep(path, sweep(views[place], others, reach, options), key)
        found = read_sweep(path, key)  # As a second call reads it, to the same bits.
    if found is None:
        raise SceneError(f"{path} cannot be read again", fix="free disk space")
    return found


def _agreed(
    views: list[WorkingView],
    swept: dict[int, Sweep],
    near: list[int],
    place: int,
    options: DepthOptions,
) -> DepthMap:
    view, found = views[place], swept[place]
    count = np.zeros(view.size, np.uint8)
    compared = [j for j in near if j in swept]
    for j in compared:
        move, shift = view.to(views[j])
        count_agreeing(found.depth, swept[j].depth, move, shift, options.tolerance, count)
    # What is plain looks like little; where one neighbour more agrees on its depth, that is enough.
    least = np.where(count > options.least_agreeing, 0.0, options.least_likeness)
    known = (found.likeness > least) & (count >= options.least_agreeing)
    if view.mask is not None:
        known &= view.mask
    alike = (found.likeness - least) / (_SURE - least)
    sure = np.clip(alike, 0.0, 1.0) * np.clip(0.5 + 0.5 * found.unique / _UNIQUE, 0.0, 1.0)
    sure *= np.minimum(count / min(4, max(len(compared), 1)), 1.0)
    confidence = np.where(known, np.maximum(sure, _LEAST_CONFIDENCE), 0.0).astype(np.float32)
    depth = np.where(known, found.depth, 0.0).astype(np.float32)
    return DepthMap(view=view, depth=depth, confidence=confidence)


def write_map(capture: Capture, found: DepthMap, out: Path) -> None:
    """Write `out/depth/<shot>.npz`: depth and confidence at the size of the shot's own picture.

    Raises:
        StoreError: the file cannot be written.
    """
    (shot,) = (shot for shot in capture.shots if shot.name == found.view.name)
    size = (shot.camera.height, shot.camera.width)
    depth, confidence = found.depth, found.confidence
    if depth.shape != size:
        depth, confidence = _enlarged(depth, size), _nearest(confidence, size)
    path = array_file(out / "depth", shot.name)
    write_arrays(path, depth=depth, confidence=np.where(depth > 0, confidence, np.float32(0)))


def _nearest(picture: F32, size: tuple[int, int]) -> F32:
    cv2 = package("cv2")
    return cv2.resize(picture, size[::-1], interpolation=cv2.INTER_NEAREST)


def _enlarged(depth: F32, size: tuple[int, int]) -> F32:
    """Return depth at a larger size: between pixels of one surface, and not across an edge."""
    cv2 = package("cv2")
    nearest = _nearest(depth, size)
    between = cv2.resize(depth, size[::-1], interpolation=cv2.INTER_LINEAR)
    smooth = np.abs(between - nearest) <= np.float32(0.02) * nearest
    return np.where(smooth, between, nearest).astype(np.float32)


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


def write_sweep(path: Path, found: Sweep, key: str) -> None:
    """Keep a sweep under the key of what it is of.

    Raises:
        StoreError: the file cannot be written.
    """
    likeness, unique = (np.round(a * 255).astype(np.int16) for a in (found.likeness, found.unique))
    write_arrays(path, depth=found.depth, likeness=likeness, unique=unique, key=np.array(key))


def read_sweep(path: Path, key: str) -> Sweep | None:
    """Return what `write_sweep` kept; None if there is nothing, or of something else."""
    try:
        found, depth, likeness, unique = _arrays(path, ("key", *_NAMES))
    except _DAMAGE:
        return None
    if str(found) != key:
        return None
    scale = np.float32(1.0 / 255.0)
    return Sweep(depth=depth, likeness=likeness * scale, unique=unique * scale)


def _arrays(path: Path, names: Sequence[str]) -> list[NDArray[Any]]:
    """Return arrays of a file; whatever it raises is in `_DAMAGE`."""
    with np.load(path, allow_pickle=False) as arrays:
        return [np.asarray(arrays[name]) for name in names]


def key_of(
    view: WorkingView, others: list[WorkingView], reach: tuple[float, float], options: DepthOptions
) -> str:
    """Return the hex SHA-256 of all that a sweep depends on."""
    # What is done with a sweep afterwards makes no other one.
    chosen = {k: v for k, v in asdict(options).items() if k not in {"least_agreeing", "tolerance"}}
    content = hashlib.sha256(json.dumps([_FORMAT, chosen, reach], sort_keys=True).encode())
    for each in (view, *others):
        content.update(repr(each.size).encode())
        for array in (each.K, each.T_camera_world, each.rgb):
            content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()
