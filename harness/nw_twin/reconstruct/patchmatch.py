"""PatchMatch stereo with slanted windows: the plane that each pixel of a picture lies on.

A picture is first matched alone, from planes at random, in half its size and then in its own. Then
rounds compare its planes with those of the pictures that it is matched with, and expect planes
through what is known around where there is little texture. `patchmatch_kernels` names the papers.

Pixels have their centres at whole numbers here, at halves in a `WorkingView`.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_twin.packages import package
from nw_twin.reconstruct.patchmatch_kernels import count_confirming, draw, spread
from nw_twin.reconstruct.views import F32, WorkingView

Kind = TypeVar("Kind", np.float32, np.uint32)

_LEVELS = ((0.5, 4), (1.0, 2))
"""Shares of a picture's size, and rounds of each, in which it is matched alone."""
_LATER = 3
"""Rounds that the first one in a picture's own size counts as: less is perturbed."""
_COUNT = 2
"""Pictures that count at a pixel."""
_CELL = 6
"""Pixels: edge of the square of which one point is of the triangles."""
_SURE = 0.5
"""Cost of such a point at most."""
_ALONG = float(np.cos(np.deg2rad(30.0)))
"""Cosine of the angle by which a point's normal may be off its triangle's."""
_SINE = np.float32(np.sin(np.deg2rad(1.0)))
"""Of the angle between the two views of a point; less says nothing of its depth."""
_BESIDE, _OFF = np.float32(2.0), np.float32(0.005)
"""A point confirms another up to so far from its plane, a share of depth, and so many pixels beside
where it comes back from."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Matched:
    """The planes of a picture's pixels, right or wrong.

    Attributes:
        planes: (H, W, 4) float32: depth along the optical axis, in the capture's unit, and the unit
            normal in the camera's frame, turned to the camera.
        costs: (H, W) float32: 0 for windows that are the same, 1 for unlike ones, 2 at most.
    """

    planes: F32
    costs: F32


def matched(
    view: WorkingView,
    others: Sequence[WorkingView],
    reach: tuple[float, float],
) -> Matched:
    """Match a picture with others, from planes at random.

    Args:
        view: of which planes are asked.
        others: at least one.
        reach: nearest and farthest depth.
    """
    near, far = (np.float32(each) for each in reach)
    planes, costs = np.zeros((0, 0, 4), np.float32), np.zeros((0, 0), np.float32)
    for share, rounds in _LEVELS:
        own, seen = _Picture.of(view, share), _Seen.of(view, others, share)
        size = own.grey.shape
        if planes.size:
            planes, costs = _enlarged(planes, size), _enlarged(costs, size)
        else:
            planes, costs = np.empty((*size, 4), np.float32), np.empty(size, np.float32)
            draw(planes, costs, own.lens, own.number, near, far)
        for turn in range(rounds):
            later = turn + (_LATER if share == 1.0 else 0)
            own.spread(later, (near, far), seen, _NO_PLANES, _NO_PRIOR, planes, costs)
    return Matched(planes=planes, costs=costs)


def agreed(
    view: WorkingView,
    others: Sequence[WorkingView],
    reach: tuple[float, float],
    own: Matched,
    theirs: Sequence[Matched],
    turn: int,
) -> Matched:
    """Match a picture again, by the planes of the others too.

    Args:
        view: of which planes are asked.
        others: that it is matched with.
        reach: nearest and farthest depth.
        own: what was matched so far.
        theirs: as above, of the others.
        turn: number of the round, from 1.
    """
    picture, seen = _Picture.of(view), _Seen.of(view, others)
    planes = _stacked([each.planes for each in theirs])
    _, distinct = confirming(view, others, own, theirs)
    known = (distinct >= min(2, len(others))) & (own.costs < _SURE)
    prior = expected(view, own, known, reach)
    chosen, costs = own.planes.copy(), own.costs.copy()
    limits = (np.float32(reach[0]), np.float32(reach[1]))
    picture.spread(_LATER + 1 + turn, limits, seen, planes, prior, chosen, costs)
    return Matched(planes=chosen, costs=costs)


def confirming(
    view: WorkingView,
    others: Sequence[WorkingView],
    own: Matched,
    theirs: Sequence[Matched],
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return in how many of the others each pixel's point lies on their own plane, (H, W).

    And in how many of these it matches worse at another depth.
    """
    picture, seen = _Picture.of(view), _Seen.of(view, others)
    count, distinct = np.zeros(view.size, np.uint8), np.zeros(view.size, np.uint8)
    planes = _stacked([each.planes for each in theirs])
    count_confirming(
        own.planes, picture.grey, picture.lens, seen.links, seen.sizes, seen.packed, planes, _SINE,
        _BESIDE, _OFF, count, distinct,
    )  # fmt: skip
    return count, distinct


def expected(
    view: WorkingView, own: Matched, known: NDArray[np.bool_], reach: tuple[float, float]
) -> F32:
    """Return the planes of triangles between pixels that are known, (H, W, 4).

    Depth is 0 outside of them, and where the triangle does not lie as two of its corners do: it
    would span from one thing to another.

    Args:
        view: a picture.
        own: its planes.
        known: (H, W) whose planes are taken for right.
        reach: nearest and farthest depth.
    """
    (height, width), lens = view.size, _Picture.of(view).lens
    prior = np.zeros((height, width, 4), np.float32)
    rows, columns = np.nonzero(known)
    cell = rows // _CELL * (width // _CELL + 1) + columns // _CELL
    order = np.lexsort((own.costs[rows, columns], cell))
    _, first = np.unique(cell[order], return_index=True)
    rows, columns = rows[order[first]], columns[order[first]]
    if len(rows) < 4:
        return prior
    spatial = package("scipy.spatial")
    try:
        mesh = spatial.Delaunay(np.column_stack([columns, rows]).astype(np.float64))
    except spatial.QhullError:  # All on one line.
        return prior
    corners, normals = mesh.simplices, own.planes[rows, columns, 1:].astype(np.float64)
    x, y = (columns - lens[2]) / lens[0], (rows - lens[3]) / lens[1]
    points = np.stack([x, y, np.ones_like(x)], -1) * own.planes[rows, columns, :1]
    a, b, c = (points[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    offset = (normal * a).sum(axis=1)
    normal[offset > 0.0] *= -1.0
    offset = -np.abs(offset)
    alike = (normals[corners] * normal[:, None]).sum(axis=-1) > _ALONG
    lies = alike.sum(axis=1) >= 2
    across, down = np.meshgrid(np.arange(width), np.arange(height))
    which = mesh.find_simplex(np.column_stack([across.ravel(), down.ravel()]).astype(np.float64))
    inside = np.flatnonzero(which >= 0)
    inside = inside[lies[which[inside]]]
    which = which[inside]
    rays = np.stack([(across - lens[2]) / lens[0], (down - lens[3]) / lens[1]], -1).reshape(-1, 2)
    facing = (normal[which, :2] * rays[inside]).sum(axis=1) + normal[which, 2]
    depth = offset[which] / np.minimum(facing, -1e-9)
    shown = (facing < -0.03) & (depth > reach[0]) & (depth < reach[1])
    flat = prior.reshape(-1, 4)
    flat[inside[shown], 0] = depth[shown]
    flat[inside[shown], 1:] = normal[which[shown]]
    return prior


_NO_PLANES = np.zeros((0, 1, 1, 4), np.float32)
_NO_PRIOR = np.zeros((0, 1, 4), np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Picture:
    """A picture as kernels want it: grey levels (H, W) from 0 on, lens (4,), and a number."""

    grey: F32
    lens: F32
    number: np.uint32

    @classmethod
    def of(cls, view: WorkingView, share: float = 1.0) -> _Picture:
        cv2, grey = package("cv2"), view.grey + np.float32(128.0)
        K = view.K
        lens = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
        if share != 1.0:
            height, width = (max(16, round(side * share)) for side in grey.shape)
            lens *= np.array([width, height] * 2) / np.array([*grey.shape[::-1]] * 2)
            grey = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
        lens[2:] -= 0.5
        number = np.uint32(zlib.crc32(view.name.encode()))
        return cls(grey=grey, lens=lens.astype(np.float32), number=number)

    def spread(
        self,
        turn: int,
        reach: tuple[np.float32, np.float32],
        seen: _Seen,
        theirs: F32,
        prior: F32,
        planes: F32,
        costs: F32,
    ) -> None:
        """Spread planes over both colours of the checkerboard; `planes` and `costs` change."""
        for colour in range(2):
            spread(
                colour, turn, self.number, self.grey, self.lens, *reach, seen.links, seen.sizes,
                seen.packed, theirs, prior, _COUNT, planes, costs,
            )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """The pictures that one is matched with: links (S, 28), sizes (S, 2), packed (S, h, w)."""

    links: F32
    sizes: NDArray[np.int32]
    packed: NDArray[np.uint32]

    @classmethod
    def of(cls, view: WorkingView, others: Sequence[WorkingView], share: float = 1.0) -> _Seen:
        own, pictures = _Picture.of(view, share), [_Picture.of(each, share) for each in others]
        links = [
            _link(own.lens, one.lens, other.T_camera_world @ np.linalg.inv(view.T_camera_world))
            for one, other in zip(pictures, others, strict=True)
        ]
        return cls(
            links=np.array(links, np.float32),
            sizes=np.array([one.grey.shape for one in pictures], np.int32),
            packed=_stacked([packed(one.grey) for one in pictures]),
        )


def packed(grey: F32) -> NDArray[np.uint32]:
    """Return the four pixels of each bilinear sample in one word: one look instead of four."""
    levels = np.clip(np.round(grey), 0, 255).astype(np.uint32)
    low = np.roll(levels, -1, 0)
    right, low_right = np.roll(levels, -1, 1), np.roll(low, -1, 1)
    return levels | right << np.uint32(8) | low << np.uint32(16) | low_right << np.uint32(24)


def _link(lens: F32, other: F32, T_other_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    K, L = (
        np.array([[each[0], 0.0, each[2]], [0.0, each[1], each[3]], [0.0, 0.0, 1.0]], np.float64)
        for each in (lens, other)
    )
    there, back = T_other_camera, np.linalg.inv(T_other_camera)
    parts = (
        L @ there[:3, :3] @ np.linalg.inv(K), L @ there[:3, 3],
        K @ back[:3, :3] @ np.linalg.inv(L), K @ back[:3, 3], other,
    )  # fmt: skip
    return np.concatenate([np.ravel(part).astype(np.float64) for part in parts])


def _stacked(arrays: Sequence[NDArray[Kind]]) -> NDArray[Kind]:
    """Return arrays (h, w, ...) of one kind as one, filled up with 0 to the largest."""
    size = np.max([each.shape for each in arrays], axis=0)
    whole = np.zeros((len(arrays), *size), arrays[0].dtype)
    for index, each in enumerate(arrays):
        whole[index, : each.shape[0], : each.shape[1]] = each
    return whole


def _enlarged(array: F32, size: tuple[int, ...]) -> F32:
    """Return the nearest values of an array (h, w, ...) at another size."""
    rows, columns = (
        np.minimum(((np.arange(new) + 0.5) * old / new).astype(np.int64), old - 1)
        for new, old in zip(size, array.shape, strict=False)
    )
    return np.ascontiguousarray(array[rows][:, columns])
