"""Printed tags of known edge: found in the pictures, placed by all shots that show them.

Points follow from pixels in several shots, whatever some of the shots say.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PrerequisiteError
from nw_base.plural import plural
from nw_splat.camera import Camera
from nw_twin.capture import Capture, read_picture

_PAIRS = 150
"""Pairs of shots that are tried at most."""
_LEAST_ANGLE = math.radians(1.0)
"""Between rays, for a point that is worth something."""
_STEPS = 8


@dataclass(frozen=True, kw_only=True)
class Triangulated:
    """Points that shots agree on.

    Attributes:
        points: (K, 3) in the cameras' world.
        used: (V,) which shots agree.
        pixels: root mean square of what they are off, pixels.
    """

    points: Values
    used: NDArray[np.bool_]
    pixels: float


def triangulate(
    cameras: Sequence[Camera], pixels: Values, *, tolerance: float = 2.0
) -> Triangulated | None:
    """Return the K points that V shots see, by least squares over the shots that agree.

    Points of each pair of shots are tried; the pair that most shots agree with wins, and they are
    fitted to all of those.

    Args:
        cameras: V of them.
        pixels: (V, K, 2) of the points; the centre of the first pixel is at (0.5, 0.5).
        tolerance: how far off a shot may be at any of its points, pixels.

    Returns:
        None where no two shots agree, or their rays are parallel.
    """
    if len(cameras) < 2:
        return None
    T = np.array([camera.T_camera_world for camera in cameras])
    lens = np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras])
    centres = np.array([camera.T_world_camera[:3, 3] for camera in cameras])
    rays = _rays(T, lens, pixels)
    best: tuple[float, Values] | None = None
    for one, other in _pairs(rays):
        chosen = [one, other]
        points = _nearest(centres[chosen], rays[chosen])
        off = _worst(T, lens, pixels, points)
        cost = float((np.minimum(off, tolerance) ** 2).sum())
        if best is None or cost < best[0]:
            best = (cost, points)
    if best is None:
        return None
    points = best[1]
    used = _worst(T, lens, pixels, points) <= tolerance
    for _ in range(3):
        if np.count_nonzero(used) < 2:
            return None
        points = _refined(T[used], lens[used], pixels[used], points)
        agree = _worst(T, lens, pixels, points) <= tolerance
        if (agree == used).all():
            break
        used = agree
    if np.count_nonzero(used) < 2 or not _pairs(rays[used]):
        return None
    off = _project(T[used], lens[used], points)[0] - pixels[used]
    return Triangulated(
        points=points, used=used, pixels=float(np.sqrt((off**2).sum(axis=-1).mean()))
    )


def _rays(T: Values, lens: Values, pixels: Values) -> Values:
    """Return unit vectors (V, K, 3) in the world."""
    fx, fy, cx, cy = (lens[:, i, None] for i in range(4))
    x, y = (pixels[..., 0] - cx) / fx, (pixels[..., 1] - cy) / fy
    local = np.stack([x, y, np.ones_like(x)], axis=-1)
    rays = np.einsum("vji,vkj->vki", T[:, :3, :3], local)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def _pairs(rays: Values) -> list[tuple[int, int]]:
    first, second = np.triu_indices(len(rays), 1)
    cosine = (rays[first, 0] * rays[second, 0]).sum(axis=1)
    apart = np.flatnonzero(np.abs(cosine) < math.cos(_LEAST_ANGLE))
    # The wider ones place points better; with too many of them, a regular choice of all angles.
    apart = apart[np.argsort(np.abs(cosine[apart]), kind="stable")]
    if len(apart) > _PAIRS:
        apart = apart[np.linspace(0, len(apart) - 1, _PAIRS).astype(int)]
    return list(zip(first[apart].tolist(), second[apart].tolist(), strict=True))


def _nearest(centres: Values, rays: Values) -> Values:
    """Return the points (K, 3) nearest to the rays (V, K, 3) from centres (V, 3)."""
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    right = np.einsum("vkij,vj->ki", across, centres)
    return np.linalg.solve(across.sum(axis=0), right[..., None])[..., 0]


def _project(T: Values, lens: Values, points: Values) -> tuple[Values, Values]:
    """Return pixels (V, K, 2) and points in the cameras' axes (V, K, 3)."""
    local = np.einsum("vij,kj->vki", T[:, :3, :3], points) + T[:, None, :3, 3]
    depth = np.where(np.abs(local[..., 2]) < 1e-12, 1e-12, local[..., 2])
    x = lens[:, None, 0] * local[..., 0] / depth + lens[:, None, 2]
    y = lens[:, None, 1] * local[..., 1] / depth + lens[:, None, 3]
    return np.stack([x, y], axis=-1), local


def _worst(T: Values, lens: Values, pixels: Values, points: Values) -> Values:
    """Return how far off each shot is at its worst point, pixels; inf behind it."""
    seen, local = _project(T, lens, points)
    off = np.linalg.norm(seen - pixels, axis=-1)
    return np.where(local[..., 2] > 0, off, np.inf).max(axis=1)


def _refined(T: Values, lens: Values, pixels: Values, points: Values) -> Values:
    """Return points (K, 3) that are least off in all shots: Gauss and Newton."""
    for _ in range(_STEPS):
        seen, local = _project(T, lens, points)
        depth = local[..., 2, None]
        focal = lens[:, None, :2]
        turned = T[:, None, :3, :3]
        # d(f x / z) = f (dx - x dz / z) / z, for x and for y.
        slope = local[..., :2] / depth
        jacobian = turned[..., :2, :] - slope[..., None] * turned[..., 2:, :]
        jacobian = (focal / depth)[..., None] * jacobian
        off = pixels - seen
        normal = np.einsum("vkai,vkaj->kij", jacobian, jacobian)
        right = np.einsum("vkai,vka->ki", jacobian, off)
        points = points + np.linalg.solve(normal, right[..., None])[..., 0]
    return points


Values = NDArray[np.float64]
Detect = Callable[[NDArray[np.uint8]], list[tuple[int, Values]]]

FAMILY = "tag36h11"
"""Of the AprilTags that are found."""
_LEAST_SIDE = 8  # pixels of a picture: a tag has more squares
_SURE = 25.0
"""Least margin of a tag's black over its white, of 255."""
_UNEVEN = 0.05
"""Largest relative difference between the edges of a tag that was placed well."""


@dataclass(frozen=True, kw_only=True)
class PlacedTag:
    """A tag in the capture's frame.

    Attributes:
        number: which tag it is.
        edge: mean of its four edges, in the capture's unit.
        uneven: largest difference of an edge from the mean, relative.
        shots: that agree on it.
        pixels: root mean square of what they are off.
    """

    number: int
    edge: float
    uneven: float
    shots: int
    pixels: float


def find_tags(
    capture: Capture, folder: Path, say: Callable[[str], None]
) -> dict[int, list[tuple[int, Values]]]:
    """Return for each tag the shots that show it and its corners there, (4, 2) pixels.

    Corners are those of the black border's outer edge, to a fraction of a pixel.

    Raises:
        PrerequisiteError: what finds tags is not installed.
        SceneError: a picture cannot be read.
    """
    detect = detector()
    by_tag: dict[int, list[tuple[int, Values]]] = {}
    for index, shot in enumerate(capture.shots):
        red, green, blue = np.moveaxis(read_picture(shot, folder).astype(np.float32), 2, 0)
        grey = np.ascontiguousarray(0.299 * red + 0.587 * green + 0.114 * blue).astype(np.uint8)
        sightings = detect(grey)
        numbers = [number for number, _ in sightings]
        for number, corners in sightings:
            if numbers.count(number) == 1:  # Two of the same in one picture cannot be told apart.
                by_tag.setdefault(number, []).append((index, corners))
    for number, seen in sorted(by_tag.items()):
        say(f"tag {number} is in {plural(len(seen), 'picture')}")
    return dict(sorted(by_tag.items()))


def place_tags(capture: Capture, sightings: dict[int, list[tuple[int, Values]]]) -> list[PlacedTag]:
    """Return the tags that two shots or more agree on, and that came out square.

    Args:
        capture: whose shots they are.
        sightings: what `find_tags` returned.
    """
    placed: list[PlacedTag] = []
    for number, seen in sightings.items():
        cameras = [capture.shots[place].camera for place, _ in seen]
        answer = triangulate(cameras, np.array([c for _, c in seen]))
        if answer is None:
            continue
        corners = answer.points
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
        uneven = float(np.abs(edges / edges.mean() - 1.0).max())
        if uneven <= _UNEVEN:
            placed.append(
                PlacedTag(
                    number=number,
                    edge=float(edges.mean()),
                    uneven=uneven,
                    shots=int(answer.used.sum()),
                    pixels=answer.pixels,
                )
            )
    return placed


def detector() -> Detect:
    """Return what finds tags in a grey picture (H, W) uint8: numbers and corners (4, 2), pixels.

    Raises:
        PrerequisiteError: what finds tags is not installed.
    """
    try:
        from pupil_apriltags import Detector
    except ImportError:
        raise PrerequisiteError(
            "finding tags needs pupil-apriltags, which is not installed",
            fix="pip install 'nw-eval[twin]'",
        ) from None

    class LastingDetector(Detector):
        """Lives on: the library's own end frees its families first, and crashes now and then."""

        def __del__(self) -> None:
            pass

    detector: Any = LastingDetector(families=FAMILY, nthreads=1, quad_decimate=1.0, refine_edges=1)

    def detect(grey: NDArray[np.uint8]) -> list[tuple[int, Values]]:
        if min(grey.shape) < _LEAST_SIDE:
            return []  # The library reads beyond pictures of few pixels.
        return [
            (int(tag.tag_id), np.asarray(tag.corners, dtype=np.float64))
            for tag in detector.detect(grey)
            if tag.hamming <= 1 and tag.decision_margin >= _SURE
        ]

    return detect
