"""Depth maps with plain areas filled in by planes that several views agree on.

What has no texture has no depth of its own, but floors, platforms and walls end at edges that have.
Planes are found where depth is known; each pixel is given the one that fits it and its neighbours
best (Sinha, Steedly and Szeliski, "Piecewise planar stereo for image-based rendering", 2009; and
Gallup, Frahm and Pollefeys, "Piecewise planar and non-planar stereo for urban scene
reconstruction", 2010).

What speaks for each plane is counted, and labels seldom change: compiled loops, which know of no
files.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.machine_code import inlined, kernel
from nw_twin.packages import package
from nw_twin.reconstruct.depth import LEAST_AGREEING, DepthMap, darkness
from nw_twin.reconstruct.planes import SupposedPlane
from nw_twin.reconstruct.views import F32, F64, WorkingView

COST = 1000.0
"""Cost of 1 in a volume of costs, which holds whole numbers."""

NOISE = 2.0
"""Variance of a photograph's noise, grey levels squared: what varies less is not compared."""

_NEAR = 0.03
"""Share of its depth within which a surface is the one that is seen there."""


@kernel
def count_agreeing(
    depth: Any, other: Any, move: Any, shift: Any, tolerance: Any, count: Any
) -> None:
    """Count one for each pixel that a second depth map says the same of.

    Args:
        depth: (H, W) float32, 0 where not known.
        other: (h, w) float32, as above.
        move: (3, 3) float64: K' R K^-1, pixels times depth of the first to the second's.
        shift: (3,) float64: K' t.
        tolerance: largest difference, a share of the depth.
        count: (H, W) uint8, in and out.
    """
    height, width = other.shape
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            d = float(depth[y, x])
            if d <= 0.0:
                continue
            u, v = x + 0.5, y + 0.5
            c = d * (move[2, 0] * u + move[2, 1] * v + move[2, 2]) + shift[2]
            if c <= 0.0:
                continue
            a = (d * (move[0, 0] * u + move[0, 1] * v + move[0, 2]) + shift[0]) / c
            b = (d * (move[1, 0] * u + move[1, 1] * v + move[1, 2]) + shift[1]) / c
            if not (0.0 <= a < width and 0.0 <= b < height):
                continue
            seen = float(other[int(b), int(a)])
            if seen > 0.0 and abs(seen - c) <= tolerance * c:
                count[y, x] += np.uint8(1)


@kernel
def count_seen(depth: Any, other: Any, move: Any, shift: Any, seen: Any, through: Any) -> None:
    """Count for each pixel whether a second depth map sees its surface, or looks through it.

    Args:
        depth: (H, W) float32, 0 where not known.
        other: (h, w) float32, as above.
        move: (3, 3) float64: K' R K^-1, pixels times depth of the first to the second's.
        shift: (3,) float64: K' t.
        seen: (H, W) uint8, in and out.
        through: (H, W) uint8, in and out: what is farther was seen there.
    """
    height, width = other.shape
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            d = float(depth[y, x])
            if d <= 0.0:
                continue
            u, v = x + 0.5, y + 0.5
            c = d * (move[2, 0] * u + move[2, 1] * v + move[2, 2]) + shift[2]
            if c <= 0.0:
                continue
            a = (d * (move[0, 0] * u + move[0, 1] * v + move[0, 2]) + shift[0]) / c
            b = (d * (move[1, 0] * u + move[1, 1] * v + move[1, 2]) + shift[1]) / c
            if not (0.0 <= a < width and 0.0 <= b < height):
                continue
            there = float(other[int(b), int(a)])
            if there > c * (1.0 + _NEAR):
                through[y, x] += np.uint8(1)
            elif there > c * (1.0 - _NEAR):
                seen[y, x] += np.uint8(1)


@kernel
def keep_best(
    own: Any, own_mean: Any, product: Any, square: Any, mean: Any, first: Any, second: Any
) -> None:
    """Compare a picture with a warped neighbour and keep each pixel's two best scores.

    Args:
        own: (H, W) float32, 1 / standard deviation of the picture's windows.
        own_mean: (H, W) float32, their mean.
        product: (H, W) float32, mean of picture times neighbour.
        square: (H, W) float32, mean of the neighbour's square.
        mean: (H, W) float32, mean of the neighbour.
        first: (H, W) float32, in and out: the best normalised cross correlation so far.
        second: (H, W) float32, in and out: the second best.
    """
    noise = np.float32(NOISE)
    for y in range(own.shape[0]):
        for x in range(own.shape[1]):
            m = mean[y, x]
            spread = max(square[y, x] - m * m, np.float32(0.0))
            share = product[y, x] - own_mean[y, x] * m
            score = share * own[y, x] / np.float32(math.sqrt(spread + noise))
            low = min(score, first[y, x])
            first[y, x] = max(score, first[y, x])
            second[y, x] = max(low, second[y, x])


@kernel
def keep_least(values: Any, first: Any, second: Any) -> None:
    """Keep each pixel's two least values.

    Args:
        values: (H, W) float32.
        first: (H, W) float32, in and out: the least so far.
        second: (H, W) float32, in and out: the second.
    """
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            high = max(values[y, x], first[y, x])
            first[y, x] = min(values[y, x], first[y, x])
            second[y, x] = min(high, second[y, x])


@kernel
def agree(volume: Any, grey: Any, jump: Any, total: Any) -> None:
    """Sum costs along eight paths on which labels seldom change, (Hirschmueller, 2008).

    Costs are whole numbers in single precision: their sums are exact.

    Args:
        volume: (H, W, L) uint16 costs of the labels.
        grey: (H, W) float32: where it changes, a label may change at less cost.
        jump: cost of another label than the pixel's before.
        total: (H, W, L) float32, zero before.
    """
    height, width, count = volume.shape
    rows = np.zeros((2, width + 2, count), np.float32)
    for backwards in range(2):
        for sideways in range(-1, 2):
            rows[:] = 0.0
            for n in range(height):
                y = height - 1 - n if backwards else n
                came = y + 1 if backwards else y - 1
                for x in range(width):
                    from_x = x - sideways
                    inside = n > 0 and 0 <= from_x < width
                    change = _jump(jump, grey, y, x, came, from_x) if inside else np.float32(0.0)
                    _step(
                        volume[y, x], total[y, x], rows[1 - n % 2, from_x + 1],
                        rows[n % 2, x + 1], change, inside,
                    )  # fmt: skip
        for y in range(height):
            for n in range(width):
                x = width - 1 - n if backwards else n
                came = x + 1 if backwards else x - 1
                inside = n > 0
                change = _jump(jump, grey, y, x, y, came) if inside else np.float32(0.0)
                _step(volume[y, x], total[y, x], rows[0, came + 1], rows[0, x + 1], change, inside)


@inlined
def _step(costs: Any, total: Any, before: Any, after: Any, change: Any, inside: Any) -> None:
    count = costs.shape[0]
    if not inside:
        for k in range(count):
            after[k] = np.float32(costs[k])
            total[k] += after[k]
        return
    least = before[0]
    for k in range(1, count):
        least = min(least, before[k])
    for k in range(count):
        path = np.float32(costs[k]) + min(before[k] - least, change)
        after[k] = path
        total[k] += path


@inlined
def _jump(jump: Any, grey: Any, y: Any, x: Any, from_y: Any, from_x: Any) -> Any:
    """Return what another label costs between two pixels: less, the more they differ."""
    change = np.float32(abs(grey[y, x] - grey[from_y, from_x]))
    return np.float32(int(np.float32(jump) / (np.float32(1.0) + change * np.float32(0.4))))


_FARTHEST = 3.0
"""Times the typical depth: beyond, a pixel is broader than a voxel."""
_CONFIDENCE = 0.5
"""Of a plane that views agree on, at least."""
_CARVED = 1.0 / 3.0
"""Share of the views of a point that may look through it; one is forgiven."""

_WINDOW, _PATCH = 5, 3
"""Sides of the squares whose likeness and whose colours are compared, pixels."""
_ON = 0.01
"""Share of its depth by which a known pixel may be off a plane and be of it."""
_SUPPORT = 400
"""Known pixels, of a view and its neighbours, that a plane has to have there."""
_COLOUR, _LEVELS = 0.5, 25.0
"""Cost of another colour, and the difference from which on it is quite another."""
_OFF = 0.5
"""Cost of a depth that is known and off the plane."""
_LOOKS, _SHADE = 0.4, 0.15
"""Cost of being darker than a plane is about there, and the logarithm from which it counts."""
_THROUGH, _SEEN = 0.6, 0.15
"""Cost of two neighbours that look through, and what two that see the same surface take off."""
_NEVER = 5.0
"""Cost of a plane that a pixel cannot show."""
_KNOWN, _PLAIN, _TEXTURED = 0.55, 0.75, 0.40
"""Cost of no plane: where depth is known, where nothing can be compared, and where it could."""
_TEXTURE = 8.0
"""Variance at which half of that is had, grey levels squared."""
_CHANGE = 1.0
"""Cost of another label than the neighbour's."""
_LEAST_SHARED = 100
"""Pixels by which two exposures are compared."""
_TOLERANCE = 0.01
"""Largest difference of what two pictures say of a plane's depth, a share of it."""

HALF_PIXEL = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
"""From OpenCV's pixels, where the first one's centre is (0, 0), to ours."""


def planar_maps(
    maps: Sequence[DepthMap],
    near: Sequence[Sequence[int]],
    planes: Sequence[SupposedPlane],
    say: Callable[[str], None],
    threads: int = 2,
) -> list[DepthMap]:
    """Return the maps with the planes that their pixels show, where views agree.

    A pixel keeps its plane if as many neighbours as `LEAST_AGREEING` show the same surface
    there, and of all views few look through it. What is of no plane stays as it was measured.

    Args:
        maps: as measured.
        near: numbers of the maps that each is compared with.
        planes: that they may show.
        say: receives progress messages.
        threads: maps at once, each with about 0.2 GB at 640 x 360; no result depends on them.
    """
    known = np.concatenate([each.depth[each.depth > 0] for each in maps])
    if not planes or len(known) == 0:
        return list(maps)
    farthest = _FARTHEST * float(np.median(known))

    def label(number: int) -> Labels:
        others = [maps[other] for other in near[number]]
        if not others:
            own = maps[number]
            none = np.zeros(own.view.size, dtype=bool)
            return Labels(depth=own.depth, normal=own.normal, planar=none)
        return labelled(maps[number], others, planes, farthest)

    labelled_views: list[Labels] = []
    with ThreadPoolExecutor(threads) as pool:
        for number, labels in enumerate(pool.map(label, range(len(maps)))):
            labelled_views.append(labels)
            say(f"planes of {maps[number].view.name}: {number + 1} of {len(maps)}")
        whole = pool.map(
            lambda number: _agreed(maps, near[number], labelled_views, number), range(len(maps))
        )
        return list(whole)


def _agreed(
    maps: Sequence[DepthMap],
    near: Sequence[int],
    labelled_views: Sequence[Labels],
    number: int,
) -> DepthMap:
    own, labels = maps[number], labelled_views[number]
    size = own.view.size
    count, seen, through = (np.zeros(size, np.uint8) for _ in range(3))
    for other, each in enumerate(maps):
        if other == number:
            continue
        move, shift = own.view.to(each.view)
        if other in near:
            depth = labelled_views[other].depth
            count_agreeing(labels.depth, depth, move, shift, _TOLERANCE, count)
        count_seen(labels.depth, labelled_views[other].depth, move, shift, seen, through)
    few = through <= np.maximum(1.0, _CARVED * seen)
    planar = labels.planar & (count >= LEAST_AGREEING) & few
    depth = np.where(planar, labels.depth, np.where(labels.planar, 0.0, own.depth))
    confidence = np.where(planar, np.maximum(own.confidence, _CONFIDENCE), own.confidence)
    normal = np.where(planar[..., None], labels.normal, own.normal)
    return DepthMap(
        view=own.view,
        depth=depth.astype(np.float32),
        confidence=np.where(depth > 0, confidence, 0.0).astype(np.float32),
        normal=np.where(depth[..., None] > 0, normal, 0.0).astype(np.float32),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Labels:
    """The plane of each pixel of a view.

    Attributes:
        depth: (H, W) float32: of the plane, or as it was known without one.
        normal: (H, W, 3) float32, as above, in the view's camera frame.
        planar: (H, W) whether a plane is shown.
    """

    depth: F32
    normal: F32
    planar: NDArray[np.bool_]


def labelled(
    own: DepthMap, others: Sequence[DepthMap], planes: Sequence[SupposedPlane], farthest: float
) -> Labels:
    """Return which plane each pixel of a view shows.

    Args:
        own: of the view.
        others: that it is compared with, at least one.
        planes: that it may show.
        farthest: depth beyond which no plane is looked for.
    """
    view, (height, width) = own.view, own.view.size
    shown = _shown(own, others, planes, farthest)
    volume = np.empty((height, width, len(shown) + 1), np.uint16)
    likeness = _Likeness(own, others)
    # Edges alone do not tell a surface from a gap between them: it may be no darker than the rest.
    about = darkness(view, own.depth > 0.0)
    for label, (plane, depth, row) in enumerate(shown):
        cost = likeness.cost(depth, row) + plane.prior
        off = np.abs(depth - own.depth) / np.maximum(_ON * own.depth, 1e-9)
        cost += np.where(own.depth > 0.0, _OFF * np.minimum(off, 1.0), 0.0)
        on = (own.depth > 0.0) & (off < 1.0)
        dark = darkness(view, on)
        if not plane.one_sided:
            dark = np.maximum(dark, about)
        cost += _LOOKS * np.clip((dark - _SHADE) / _SHADE, 0.0, 1.0)
        cost[depth <= 0.0] = _NEVER
        volume[..., label] = np.round(COST * np.maximum(cost, 0.0))
    none = np.where(own.depth > 0.0, _KNOWN, _PLAIN - (_PLAIN - _TEXTURED) * likeness.texture)
    volume[..., -1] = np.round(COST * none)
    total = np.zeros(volume.shape, np.float32)
    agree(volume, view.grey, round(_CHANGE * COST), total)
    label = total.argmin(axis=-1)
    depths = np.stack([*(depth for _, depth, _ in shown), own.depth])
    label_depth = np.take_along_axis(depths, label[None], axis=0)[0]
    planar = label < len(shown)
    if view.mask is not None:
        planar &= view.mask
    normals = np.zeros((len(shown) + 1, 3), np.float32)
    for label_of, (plane, _, row) in enumerate(shown):
        # Of the row n' K^-1 / d only the sign of d counts: turned to the camera.
        normal = view.T_camera_world[:3, :3] @ plane.normal
        normals[label_of] = normal * (-1.0 if normal @ (row @ view.K) > 0.0 else 1.0)
    return Labels(
        depth=np.where(planar, label_depth, own.depth),
        normal=np.where(planar[..., None], normals[label], own.normal),
        planar=planar,
    )


def _shown(
    own: DepthMap, others: Sequence[DepthMap], planes: Sequence[SupposedPlane], farthest: float
) -> list[tuple[SupposedPlane, F32, F64]]:
    """Return the planes that a view may show, their depths (H, W) and rows of homographies (3,)."""
    shown = []
    for plane in planes:
        depth, row, in_front = _depth_on(own.view, plane)
        if plane.one_sided and not in_front:
            continue
        support = _on(depth, own)
        for other in others:
            support += _on(_depth_on(other.view, plane)[0], other)
        if support > _SUPPORT:
            shown.append((plane, np.where(depth <= farthest, depth, np.float32(0.0)), row))
    return shown


def _depth_on(view: WorkingView, plane: SupposedPlane) -> tuple[F32, F64, bool]:
    """Return a plane's depth (H, W), 0 behind, the row n' K^-1 / d, and whether it faces us."""
    T = view.T_camera_world
    normal = T[:3, :3] @ plane.normal
    offset = plane.offset + float(normal @ T[:3, 3])
    height, width = view.size
    row = normal @ np.linalg.inv(view.K) / (offset if abs(offset) > 1e-9 else 1e-9)
    inverse = row[0] * (np.arange(width) + 0.5) + row[1] * (np.arange(height)[:, None] + 0.5)
    inverse = inverse + row[2]
    depth = np.where(inverse > 1e-9, 1.0 / np.maximum(inverse, 1e-9), 0.0)
    return depth.astype(np.float32), row, offset < 0.0


def _on(depth: F32, each: DepthMap) -> int:
    return int(((each.depth > 0) & (np.abs(depth - each.depth) < _ON * each.depth)).sum())


class _Likeness:
    """How alike a view and its neighbours are on a plane."""

    def __init__(self, own: DepthMap, others: Sequence[DepthMap]) -> None:
        self._cv2, self._window, view = package("cv2"), PixelWindow(_WINDOW), own.view
        self._view, self._grey = view, view.grey
        self._mean = self._window.mean(self._grey)
        spread = self._window.mean(self._grey * self._grey) - self._mean * self._mean
        spread = np.maximum(spread, 0.0)
        self._scale = (1.0 / np.sqrt(spread + NOISE)).astype(np.float32)
        self.texture = spread / (spread + _TEXTURE)
        self._rgb = view.rgb.astype(np.float32)
        self._others = [
            (other, other.view.grey, _gain(own, other), *view.to(other.view)) for other in others
        ]

    def cost(self, depth: F32, row: F64) -> F32:
        """Return the cost (H, W) of a plane, about 0 where it surely is and 1.5 where it is not.

        Args:
            depth: (H, W) of the plane.
            row: of its homographies.
        """
        shape = depth.shape
        best, second = (np.full(shape, -1.0, np.float32) for _ in range(2))
        least, next_least = (np.ones(shape, np.float32) for _ in range(2))
        seen, through = (np.zeros(shape, np.uint8) for _ in range(2))
        back, mean = np.linalg.inv(HALF_PIXEL), self._window.mean
        for other, grey, gain, move, shift in self._others:
            H = back @ (move + np.outer(shift, row)) @ HALF_PIXEL
            warped = self._window.warp(grey, H, np.empty(shape, np.float32))
            keep_best(
                self._scale, self._mean, mean(self._grey * warped), mean(warped * warped),
                mean(warped), best, second,
            )  # fmt: skip
            keep_least(self._colour_off(other.view, gain, H), least, next_least)
            count_seen(depth, other.depth, move, shift, seen, through)
        cost = 0.5 - 0.25 * (best + second) + _COLOUR * (least + next_least)
        cost += 0.5 * _THROUGH * np.minimum(through, 2)
        return (cost - 0.5 * _SEEN * np.minimum(seen, 2) * (through == 0)).astype(np.float32)

    def _colour_off(self, other: WorkingView, gain: F32, H: F64) -> F32:
        """Return how far the colours about each pixel are off, 0 to 1; 1 outside the other."""
        cv2, size = self._cv2, self._rgb.shape[1::-1]
        linear, nearest = (
            flag | cv2.WARP_INVERSE_MAP for flag in (cv2.INTER_LINEAR, cv2.INTER_NEAREST)
        )
        there = cv2.warpPerspective(other.rgb, H, size, flags=linear)
        whole = np.full(other.size, 255, np.uint8)
        inside = cv2.warpPerspective(whole, H, size, flags=nearest)
        off = np.abs(self._rgb * gain - there).mean(axis=-1) / np.float32(_LEVELS)
        off = cv2.boxFilter(np.minimum(off, np.float32(1.0)), -1, (_PATCH, _PATCH))
        off[inside == 0] = 1.0
        return off


def _gain(own: DepthMap, other: DepthMap) -> F32:
    """Return by what each colour of a view is brighter in another (3,), where both know depth."""
    move, shift = own.view.to(other.view)
    rows, columns = np.nonzero(own.depth > 0)
    local = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    local = own.depth[rows, columns, None] * (local @ move.T) + shift
    z = np.maximum(local[:, 2], 1e-9)
    x, y = local[:, 0] / z, local[:, 1] / z
    height, width = other.view.size
    inside = (local[:, 2] > 0.0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    rows, columns, z = rows[inside], columns[inside], z[inside]
    x, y = x[inside].astype(np.int64), y[inside].astype(np.int64)
    same = np.abs(other.depth[y, x] - z) < 2.0 * _ON * z
    if same.sum() < _LEAST_SHARED:
        return np.ones(3, np.float32)
    own_rgb = own.view.rgb[rows[same], columns[same]].astype(np.float64) + 1.0
    there = other.view.rgb[y[same], x[same]].astype(np.float64) + 1.0
    return np.median(there / own_rgb, axis=0).astype(np.float32)


class PixelWindow:
    """OpenCV's warps and means of windows, into arrays that are there already."""

    def __init__(self, side: int) -> None:
        self._cv2, self._side = package("cv2"), (side, side)

    def warp(self, picture: F32, H: F64, out: F32) -> F32:
        """Return the picture warped by its homography; pixels outside are grey, 0."""
        cv2 = self._cv2
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return cv2.warpPerspective(picture, H, out.shape[::-1], out, flags)

    def mean(self, picture: F32, out: F32 | None = None) -> F32:
        """Return the mean of the window about each pixel."""
        return self._cv2.boxFilter(picture, -1, self._side, out)
