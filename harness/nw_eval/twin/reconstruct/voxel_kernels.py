"""The compiled loops of a volume: signed distances in blocks of voxels, truncated.

After Curless and Levoy 1996. How surfaces of a depth map lean is told by inverse depth, which is
linear across the picture of a plane. None of it knows of files.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined, kernel

SIDE = 8
"""Voxels along a block."""
VOXELS = SIDE**3

_FINEST = 0.1
"""Voxels: a pixel that is finer than that counts no more."""
_BESIDE, _GRAZED = 2.0, 20.0
"""Slant, 1 / cosine, where none is known, as beside an edge, and at most."""
_ONE_SURFACE = 0.02
"""Depths of neighbouring pixels that differ by less are one surface, a share of the depth."""

_BEND = 0.01
"""Of inverse depths two pixels apart, a share: what bends more is no plane."""


@kernel
def mark(points: Any, origin: Any, size: Any, reach: Any, grid: Any) -> None:
    """Mark the blocks that points lie in, or as near as `reach` along each axis.

    Args:
        points: (N, 3) float64.
        origin: (3,) of the grid.
        size: of a block.
        reach: at most `size`.
        grid: (X, Y, Z) int32, out: 0 where marked.
    """
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(points.shape[0]):
        for k in range(3):
            at = points[n, k] - origin[k]
            low[k] = max(math.floor((at - reach) / size), 0)
            high[k] = min(math.floor((at + reach) / size), grid.shape[k] - 1)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    grid[i, j, k] = 0


@inlined
def _depth_at(depth: Any, u: Any, v: Any) -> Any:
    """Return the depth at a place of the picture: between four pixels if they are one surface."""
    height, width = depth.shape
    x, y = min(int(u), width - 1), min(int(v), height - 1)
    nearest = float(depth[y, x])
    a, b = u - 0.5, v - 0.5
    x0, y0 = math.floor(a), math.floor(b)
    if nearest <= 0.0 or x0 < 0 or y0 < 0 or x0 + 1 >= width or y0 + 1 >= height:
        return nearest
    d00, d01 = float(depth[y0, x0]), float(depth[y0, x0 + 1])
    d10, d11 = float(depth[y0 + 1, x0]), float(depth[y0 + 1, x0 + 1])
    least = min(d00, d01, d10, d11)
    most = max(d00, d01, d10, d11)
    if least <= 0.0 or most - least > _ONE_SURFACE * nearest:
        return nearest
    a, b = a - x0, b - y0
    # Inverse depth is what is linear across the picture of a plane.
    top = (1.0 - a) / d00 + a / d01
    bottom = (1.0 - a) / d10 + a / d11
    return 1.0 / ((1.0 - b) * top + b * bottom)


@inlined
def _seen(T: Any, lens: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the depth of a point, and where the picture shows it: u and v, pixels."""
    ahead = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    right = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    down = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    return ahead, lens[0] * right / ahead + lens[2], lens[1] * down / ahead + lens[3]


@inlined
def _may_show(size: Any, lens: Any, place: Any, radius: Any) -> Any:
    """Return whether a picture (H, W) may show some of a ball about a place that was `_seen`."""
    ahead, u, v = place
    if ahead <= 2.0 * radius:
        return ahead >= -radius
    # Towards a corner of a wide picture a ball looks larger than at its centre.
    margin = 3.0 * max(lens[0], lens[1]) * radius / (ahead - radius)
    return -margin <= u <= size[1] + margin and -margin <= v <= size[0] + margin


@inlined
def _off(depth: Any, slope: Any, lens: Any, place: Any, truncation: Any) -> Any:
    """Return how far before the surface a place is, in truncations; below -1 if not known.

    The distance is square to the surface: along a ray that grazes it, a voxel just behind would
    be far away. What lies behind is not known where the picture shows something farther square
    above it: a ray that goes down through the top of a platform comes out below its edge.
    """
    ahead, u, v = place
    if not (ahead > 0.0 and 0.0 <= u < depth.shape[1] and 0.0 <= v < depth.shape[0]):
        return -2.0
    d = _depth_at(depth, u, v)
    if d <= 0.0:
        return -2.0
    a, b = float(slope[int(v), int(u), 0]), float(slope[int(v), int(u), 1])
    inverse = 1.0 / d
    if a != 0.0 or b != 0.0:  # Inverse depth is what is linear across the picture of a plane.
        inverse = 1.0 / float(depth[int(v), int(u)])
        inverse += a * (u - int(u) - 0.5) + b * (v - int(v) - 0.5)
    # The surface is m . x = 1 about there, and m points away from the camera.
    mx, my = lens[0] * a, lens[1] * b
    mz = inverse - a * (u - lens[2]) - b * (v - lens[3])
    square = mx * mx + my * my + mz * mz
    before = 1.0 - ahead * inverse
    off = before / (math.sqrt(square) * truncation)
    if off >= 0.0 or off < -1.0:
        return off
    z = ahead + mz * before / square
    if z <= 0.0:
        return -2.0
    x = ((u - lens[2]) * ahead + lens[0] * mx * before / square) / z + lens[2]
    y = ((v - lens[3]) * ahead + lens[1] * my * before / square) / z + lens[3]
    if not (0.0 <= x < depth.shape[1] and 0.0 <= y < depth.shape[0]):
        return -2.0
    above = float(depth[int(y), int(x)])
    if above <= 0.0:  # Nobody knows; a ray is not followed farther than the surface is thick.
        return off if ahead * inverse - 1.0 < truncation * inverse else -2.0
    there = inverse + a * (int(x) + 0.5 - u) + b * (int(y) + 0.5 - v)
    return off if above * there - 1.0 <= _ONE_SURFACE else -2.0


@inlined
def _breadth(depth: Any, slope: Any, lens: Any, place: Any) -> Any:
    """Return how much a pixel shows, along the slant, of a surface as it sees that was at a place.

    On a surface m . x = 1 it would be |m| |x|^2 / f: the more, the farther and the more grazing.
    """
    ahead, u, v = place
    d = float(depth[int(v), int(u)])
    a, b = float(slope[int(v), int(u), 0]), float(slope[int(v), int(u), 1])
    right, down = (u - lens[2]) / lens[0], (v - lens[3]) / lens[1]
    mx, my = lens[0] * a, lens[1] * b
    mz = 1.0 / d - mx * right - my * down
    far = ahead * math.sqrt(right * right + down * down + 1.0)
    slant = _BESIDE
    if a != 0.0 or b != 0.0:
        slant = min(max(math.sqrt(mx * mx + my * my + mz * mz) * far, 1.0), _GRAZED)
    return slant * far / lens[0]


@kernel
def integrate(
    blocks: Any,
    first: Any,
    end: Any,
    lattice: Any,
    depth: Any,
    slope: Any,
    confidence: Any,
    rgb: Any,
    lens: Any,
    T: Any,
    distance: Any,
    weight: Any,
    colour: Any,
    pull: Any,
) -> None:
    """Add one depth map to the blocks first..end-1.

    In the mean a pixel counts by how finely it shows its surface: from afar and at a slant those
    beside an edge are a decimetre of it, and there are many such views of whatever is photographed
    on a walk.

    Args:
        blocks: (N, 3) int32 places in the grid of blocks.
        first: first block.
        end: behind the last.
        lattice: (5,) float64: centre of the first voxel (3), edge of a voxel, truncation.
        depth: (H, W) float32, 0 where not known.
        slope: (H, W, 2) float32, of `slopes.slopes`.
        confidence: (H, W) float32.
        rgb: (H, W, 3) uint8.
        lens: (fx, fy, cx, cy).
        T: (4, 4) float64, world to camera.
        distance: (N, VOXELS) float32, in and out: mean distance in units of the truncation.
        weight: (N, VOXELS) float32, in and out: sum of confidences.
        colour: (N, VOXELS, 3) float32, in and out: mean.
        pull: (N, VOXELS) float32, in and out: sum of what the means are weighted by.
    """
    voxel, truncation = lattice[3], lattice[4]
    half = 0.5 * (SIDE - 1) * voxel
    radius = 0.5 * math.sqrt(3.0) * SIDE * voxel
    for n in range(first, end):
        x = lattice[0] + blocks[n, 0] * SIDE * voxel
        y = lattice[1] + blocks[n, 1] * SIDE * voxel
        z = lattice[2] + blocks[n, 2] * SIDE * voxel
        middle = _seen(T, lens, x + half, y + half, z + half)
        if not _may_show(depth.shape, lens, middle, radius):
            continue
        for m in range(VOXELS):
            i, j, k = m // (SIDE * SIDE), m // SIDE % SIDE, m % SIDE
            place = _seen(T, lens, x + i * voxel, y + j * voxel, z + k * voxel)
            off = _off(depth, slope, lens, place, truncation)
            if off < -1.0:
                continue
            u, v = int(place[1]), int(place[2])
            # What lies behind a surface is known the less, the deeper.
            w = float(confidence[v, u]) * min(1.0 + off, 1.0)
            if w <= 0.0:
                continue
            weight[n, m] += np.float32(w)
            w /= max(_FINEST, _breadth(depth, slope, lens, place) / voxel) ** 2
            total = float(pull[n, m]) + w
            share = w / total
            distance[n, m] += np.float32(share * (min(off, 1.0) - distance[n, m]))
            pull[n, m] = np.float32(total)
            for c in range(3):
                colour[n, m, c] += np.float32(share * (rgb[v, u, c] - colour[n, m, c]))


@kernel
def cut(
    grid: Any, first: Any, distance: Any, weight: Any, least: Any, dense: Any, known: Any
) -> None:
    """Copy voxels of many blocks to one array.

    Args:
        grid: (X, Y, Z) int32 number of each block, -1 without.
        first: (3,) int64 voxel that comes first.
        distance: of the blocks.
        weight: of the blocks.
        least: weight of a voxel that is known.
        dense: (A, B, C) float32, out.
        known: (A, B, C) bool, out.
    """
    for i in range(dense.shape[0]):
        x = first[0] + i
        for j in range(dense.shape[1]):
            y = first[1] + j
            for k in range(dense.shape[2]):
                z = first[2] + k
                dense[i, j, k] = 1.0
                known[i, j, k] = False
                a, b, c = x // SIDE, y // SIDE, z // SIDE
                if a >= grid.shape[0] or b >= grid.shape[1] or c >= grid.shape[2]:
                    continue
                n = grid[a, b, c]
                if n < 0:
                    continue
                m = (x % SIDE * SIDE + y % SIDE) * SIDE + z % SIDE
                if weight[n, m] > least:
                    dense[i, j, k] = distance[n, m]
                    known[i, j, k] = True


@kernel
def colours_at(places: Any, grid: Any, weight: Any, colour: Any, out: Any) -> None:
    """Return colours between voxels, each as it is known.

    Args:
        places: (N, 3) float64, in voxels.
        grid: (X, Y, Z) int32 number of each block.
        weight: of the blocks.
        colour: of the blocks.
        out: (N, 3) float64, out.
    """
    for n in range(places.shape[0]):
        total = 1e-12
        for corner in range(8):
            w = 1.0
            m = 0
            cell = np.empty(3, np.int64)
            for k in range(3):
                low = math.floor(places[n, k])
                share = places[n, k] - low
                up = corner >> k & 1
                w *= share if up else 1.0 - share
                at = int(low) + up
                cell[k] = at // SIDE
                m = m * SIDE + at % SIDE
            if w <= 0.0 or not (
                cell[0] < grid.shape[0] and cell[1] < grid.shape[1] and cell[2] < grid.shape[2]
            ):
                continue
            block = grid[cell[0], cell[1], cell[2]]
            if block >= 0:
                w *= float(weight[block, m])
                total += w
                for k in range(3):
                    out[n, k] += w * float(colour[block, m, k])
        for k in range(3):
            out[n, k] /= total


@kernel
def slopes(depth: Any, out: Any) -> None:
    """Return how inverse depth changes across the picture, which is the same all over a plane.

    Args:
        depth: (H, W) float32, 0 where not known.
        out: (H, W, 2) float32, out: per pixel to the right and down; 0 where nobody knows.
    """
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            if depth[y, x] > 0.0:
                out[y, x, 0] = np.float32(_slope(depth, y, x, 0, 1))
                out[y, x, 1] = np.float32(_slope(depth, y, x, 1, 0))


@inlined
def _slope(depth: Any, y: Any, x: Any, down: Any, right: Any) -> Any:
    """Return the change of inverse depth per pixel one way: of both sides, or of one."""
    here = 1.0 / float(depth[y, x])
    for turn in range(3):
        first = -2 if turn != 1 else 0
        last = 2 if turn != 2 else 0
        middle = (first + last) // 2
        one = _inverse(depth, y + first * down, x + first * right)
        two = _inverse(depth, y + middle * down, x + middle * right)
        three = _inverse(depth, y + last * down, x + last * right)
        # What bends is another surface, or noise.
        if one > 0.0 and two > 0.0 and three > 0.0 and abs(one + three - 2.0 * two) < _BEND * here:
            return (three - one) / (last - first)
    return 0.0


@inlined
def _inverse(depth: Any, y: Any, x: Any) -> Any:
    """Return a pixel's inverse depth; 0 outside and where not known."""
    if not (0 <= y < depth.shape[0] and 0 <= x < depth.shape[1]):
        return 0.0
    d = float(depth[y, x])
    return 1.0 / d if d > 0.0 else 0.0
