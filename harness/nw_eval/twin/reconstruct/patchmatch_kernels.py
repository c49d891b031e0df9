"""The compiled loops of PatchMatch stereo: planes of pixels, compared, spread and perturbed.

Each pixel of a picture carries a plane: its depth and its normal in the camera's frame (Bleyer,
Rhemann and Rother, "PatchMatch Stereo - Stereo Matching with Slanted Support Windows", 2011).
Planes spread from eight regions of a checkerboard, and each pixel weighs the pictures that it is
compared with (Galliani, Lasinger and Schindler, "Massively Parallel Multiview Stereopsis by Surface
Normal Diffusion", 2015; Xu and Tao, "Multi-Scale Geometric Consistency Guided Multi-View Stereo",
2019). Windows are weighted by colour, and planes by how they agree with those of other pictures
(Schoenberger et al., "Pixelwise View Selection for Unstructured Multi-View Stereo", 2016). Where
there is little texture, a plane through what is known around it counts (Xu and Tao, "Planar Prior
Assisted PatchMatch Multi-View Stereo", 2020).

Pixels have their centres at whole numbers here. Random numbers are hashed from pixel, round and
picture: no order of work changes them. None of it knows of files.

A camera's lens is (fx, fy, cx, cy). A link (28,) float32 leads from a picture to one that it is
compared with: K' R K^-1 (9), K' t (3), the same two back (12), and the other's lens (4).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_eval.machine_code import fast_kernel, fast_part

F = np.float32

_TAPS = [(x, y) for y in range(-5, 6, 2) for x in range(-5, 6, 2)]
SAMPLES = len(_TAPS)
"""Of a window of 11 x 11 pixels, every second one in both directions."""
_LANES = 40
"""Samples with some of no weight: whole vectors."""
_DX = np.array([x for x, _ in _TAPS] + [0] * (_LANES - SAMPLES), F)
_DY = np.array([y for _, y in _TAPS] + [0] * (_LANES - SAMPLES), F)
_REACH = F(5.0)

_NEAR = np.array([(0, -1), (-1, -2), (1, -2), (-2, -3), (2, -3), (-3, -4), (3, -4)], np.int32)
_FAR = np.array([(0, -d) for d in range(3, 25, 2)], np.int32)
"""Pixels above that a region has; turned by quarters for the other sides."""

_ALIKE = F(12.0)
"""Grey levels by which a pixel of the window may differ and count."""
_WIDE = F(5.0)
"""Pixels, likewise."""
NOISE = F(3.0)
"""Variance of a photograph's noise, grey levels squared."""
_TEXTURE = F(20.0)
"""Variance at which a plane of what is around counts half, grey levels squared."""
_PRIOR = F(0.5)
"""Cost of being off that plane where nothing can be compared."""
_PRIOR_DEPTH = F(0.02)
"""Share of its depth by which a plane is quite off."""
_AGREE = F(0.2)
"""Cost of a pixel by which a point comes back from the other picture's plane beside itself."""
CAP = F(3.0)
"""Such pixels that count at most."""
WORST = F(2.0)
"""Cost of a plane that cannot be compared."""
_SHIFT = F(3.0)
"""Pixels to both sides at which a distinct match is worse."""
_WORSE = F(0.1)
"""Cost by which it is."""
_NONE = F(9.0)
_TINY = F(1e-6)
_ZERO, _HALF, _ONE, _TWO = F(0.0), F(0.5), F(1.0), F(2.0)


@fast_part
def _random(pixel: Any, turn: Any, picture: Any, which: Any) -> Any:
    """Return a number of 0 to 1, a hash of four whole numbers."""
    h = (
        np.uint32(pixel) * np.uint32(0x9E3779B1)
        ^ np.uint32(turn) * np.uint32(0x85EBCA77)
        ^ np.uint32(picture) * np.uint32(0xC2B2AE3D)
        ^ np.uint32(which) * np.uint32(0x27D4EB2F)
    )
    h = np.uint32(h ^ (h >> np.uint32(15))) * np.uint32(0x2C1B3C6D)
    h = np.uint32(h ^ (h >> np.uint32(12))) * np.uint32(0x297A2D39)
    h = np.uint32(h ^ (h >> np.uint32(15)))
    return F(h >> np.uint32(8)) * F(1.0 / 16777216.0)


@fast_part
def _facing(nx: Any, ny: Any, nz: Any, rx: Any, ry: Any) -> Any:
    """Return the unit normal turned to the camera, and whether 87 degrees or less off the ray."""
    scale = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz + F(1e-12))
    dot = (nx * rx + ny * ry + nz) * scale
    if dot > _ZERO:
        scale = -scale
        dot = -dot
    shown = dot < F(-0.05) * np.sqrt(rx * rx + ry * ry + _ONE)
    return nx * scale, ny * scale, nz * scale, shown


@fast_part
def _window(x: Any, y: Any, grey: Any, values: Any, weights: Any) -> Any:
    """Fill a window's grey levels and weights, whose sum is 1; return its mean and its variance."""
    height, width = grey.shape
    centre, total = grey[y, x], _ZERO
    for k in range(SAMPLES):
        column = min(max(x + np.int32(_DX[k]), 0), width - 1)
        row = min(max(y + np.int32(_DY[k]), 0), height - 1)
        value = grey[row, column]
        off = (value - centre) / _ALIKE
        values[k] = value
        far = (_DX[k] * _DX[k] + _DY[k] * _DY[k]) / (_WIDE * _WIDE)
        weights[k] = np.exp(-_HALF * (off * off + far))
        total += weights[k]
    mean, square = _ZERO, _ZERO
    for k in range(SAMPLES):
        weights[k] /= total
        mean += weights[k] * values[k]
        square += weights[k] * values[k] * values[k]
    return mean, max(square - mean * mean, _ZERO)


@fast_part
def _unlike(
    px: Any, py: Any, z: Any, nx: Any, ny: Any, nz: Any, lens: Any, values: Any, weights: Any,
    mean: Any, spread: Any, s: Any, links: Any, sizes: Any, packed: Any,
) -> Any:  # fmt: skip
    """Return 1 - NCC of a window with its image in picture `s` by a plane; WORST outside it."""
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    distance = z * (nx * (px - cx) / fx + ny * (py - cy) / fy + nz)
    if distance > -_TINY:
        return WORST
    # The plane's homography: K' (R + t n' / distance) K^-1.
    ax, ay = nx / fx / distance, ny / fy / distance
    az = nz / distance - ax * cx - ay * cy
    t0, t1, t2 = links[s, 9], links[s, 10], links[s, 11]
    h00, h01, h02 = links[s, 0] + t0 * ax, links[s, 1] + t0 * ay, links[s, 2] + t0 * az
    h10, h11, h12 = links[s, 3] + t1 * ax, links[s, 4] + t1 * ay, links[s, 5] + t1 * az
    h20, h21, h22 = links[s, 6] + t2 * ax, links[s, 7] + t2 * ay, links[s, 8] + t2 * az
    a, b = h00 * px + h01 * py + h02, h10 * px + h11 * py + h12
    c = h20 * px + h21 * py + h22
    if c <= _REACH * (abs(h20) + abs(h21)) + _TINY:
        return WORST
    u, v = a / c, b / c
    right, low = F(sizes[s, 1] - 1), F(sizes[s, 0] - 1)
    if u < _TWO or v < _TWO or u > right - _TWO or v > low - _TWO:
        return WORST
    right -= F(0.01)
    low -= F(0.01)
    total, square, product = _ZERO, _ZERO, _ZERO
    for k in range(_LANES):
        dx, dy = _DX[k], _DY[k]
        r = _ONE / (c + h20 * dx + h21 * dy)
        x = min(max((a + h00 * dx + h01 * dy) * r, _ZERO), right)
        y = min(max((b + h10 * dx + h11 * dy) * r, _ZERO), low)
        i, j = np.int32(x), np.int32(y)
        right_of, below = x - F(i), y - F(j)
        four = packed[s, j, i]
        p00 = F(np.int32(four & np.uint32(255)))
        p01 = F(np.int32((four >> np.uint32(8)) & np.uint32(255)))
        p10 = F(np.int32((four >> np.uint32(16)) & np.uint32(255)))
        p11 = F(np.int32(four >> np.uint32(24)))
        above = p00 + right_of * (p01 - p00)
        value = above + below * (p10 + right_of * (p11 - p10) - above)
        w = weights[k]
        total += w * value
        square += w * value * value
        product += w * value * values[k]
    other = max(square - total * total, _ZERO)
    ncc = (product - total * mean) / np.sqrt((spread + NOISE) * (other + NOISE))
    return min(max(_ONE - ncc, _ZERO), WORST)


@fast_part
def _apart(px: Any, py: Any, z: Any, s: Any, links: Any, sizes: Any, planes: Any) -> Any:
    """Return how far a point is off the plane that picture `s` has there.

    Pixels by which it comes back beside itself (CAP where there is no plane), and its distance from
    the plane, a share of its depth.
    """
    a = z * (links[s, 0] * px + links[s, 1] * py + links[s, 2]) + links[s, 9]
    b = z * (links[s, 3] * px + links[s, 4] * py + links[s, 5]) + links[s, 10]
    c = z * (links[s, 6] * px + links[s, 7] * py + links[s, 8]) + links[s, 11]
    if c <= _TINY:
        return CAP, _NONE
    u, v = a / c, b / c
    if u < _ZERO or v < _ZERO:
        return CAP, _NONE
    i, j = np.int32(u + _HALF), np.int32(v + _HALF)
    if i >= sizes[s, 1] or j >= sizes[s, 0]:
        return CAP, _NONE
    there = planes[s, j, i, 0]
    if there <= _ZERO:
        return CAP, _NONE
    nx, ny, nz = planes[s, j, i, 1], planes[s, j, i, 2], planes[s, j, i, 3]
    fx, fy, cx, cy = links[s, 24], links[s, 25], links[s, 26], links[s, 27]
    own = nx * (F(i) - cx) / fx + ny * (F(j) - cy) / fy + nz
    here = nx * (u - cx) / fx + ny * (v - cy) / fy + nz
    off = abs(c * here - there * own) / c
    if own * here > _ZERO:
        there *= min(max(own / here, F(0.8)), F(1.25))
    x = there * (links[s, 12] * u + links[s, 13] * v + links[s, 14]) + links[s, 21]
    y = there * (links[s, 15] * u + links[s, 16] * v + links[s, 17]) + links[s, 22]
    w = there * (links[s, 18] * u + links[s, 19] * v + links[s, 20]) + links[s, 23]
    if w <= _TINY:
        return CAP, _NONE
    x, y = x / w - px, y / w - py
    return min(np.sqrt(x * x + y * y), CAP), off


@fast_part
def _off_prior(z: Any, nx: Any, ny: Any, nz: Any, prior: Any, y: Any, x: Any) -> Any:
    """Return how far a plane is off the one that is expected, 0 to 1."""
    deep = min(abs(z - prior[y, x, 0]) / (_PRIOR_DEPTH * prior[y, x, 0]), _ONE)
    alike = nx * prior[y, x, 1] + ny * prior[y, x, 2] + nz * prior[y, x, 3]
    return max(deep, min(max(_TWO * (_ONE - alike), _ZERO), _ONE))


@fast_kernel
def draw(planes: Any, costs: Any, lens: Any, picture: Any, near: Any, far: Any) -> None:
    """Give each pixel a plane at random, even in inverse depth, that faces the camera.

    Args:
        planes: (H, W, 4) float32, out: depth, and the normal.
        costs: (H, W) float32, out: WORST.
        lens: (4,) float32.
        picture: its number.
        near: least depth, float32.
        far: largest depth, float32.
    """
    height, width = costs.shape
    for y in range(height):
        for x in range(width):
            pixel = x + y * width
            share = _random(pixel, 977, picture, 1)
            nx = _TWO * _random(pixel, 977, picture, 2) - _ONE
            ny = _TWO * _random(pixel, 977, picture, 3) - _ONE
            nz = -_random(pixel, 977, picture, 4) - F(0.1)
            rx, ry = (F(x) - lens[2]) / lens[0], (F(y) - lens[3]) / lens[1]
            nx, ny, nz, shown = _facing(nx, ny, nz, rx, ry)
            if not shown:
                nx, ny, nz = _ZERO, _ZERO, -_ONE
            planes[y, x, 0] = _ONE / (_ONE / far + share * (_ONE / near - _ONE / far))
            planes[y, x, 1], planes[y, x, 2], planes[y, x, 3] = nx, ny, nz
            costs[y, x] = WORST


@fast_part
def _neighbours(
    x: Any, y: Any, rx: Any, ry: Any, lens: Any, near: Any, far: Any, planes: Any, costs: Any,
    found: Any, count: Any,
) -> Any:  # fmt: skip
    """Add the best plane of each of eight regions to `found`; return how many there are."""
    height, width = costs.shape
    for side in range(4):
        for away in range(2):
            offsets = _NEAR if away == 0 else _FAR
            least, best_x, best_y = _NONE, -1, -1
            for k in range(len(offsets)):
                dx, dy = offsets[k, 0], offsets[k, 1]
                if side == 1:
                    dx, dy = -dx, -dy
                elif side == 2:
                    dx, dy = dy, dx
                elif side == 3:
                    dx, dy = -dy, -dx
                column, row = x + dx, y + dy
                inside = 0 <= column < width and 0 <= row < height
                if inside and costs[row, column] < least:
                    least, best_x, best_y = costs[row, column], column, row
            if best_x < 0:
                continue
            nx, ny = planes[best_y, best_x, 1], planes[best_y, best_x, 2]
            nz = planes[best_y, best_x, 3]
            across = nx * (F(best_x) - lens[2]) / lens[0] + ny * (F(best_y) - lens[3]) / lens[1]
            along = nx * rx + ny * ry + nz
            if along < F(-0.03):
                z = planes[best_y, best_x, 0] * (across + nz) / along
                if near < z < far:
                    found[count, 0], found[count, 1] = z, nx
                    found[count, 2], found[count, 3] = ny, nz
                    count += 1
    return count


@fast_part
def _trust(costs: Any, count: Any, good: Any, most: Any, trust: Any) -> Any:
    """Weigh the pictures for one pixel by the planes that match in each; return the weights' sum.

    Args:
        costs: (P, S) of planes in pictures.
        count: of planes.
        good: cost below which a plane matches.
        most: pictures that have any weight.
        trust: (S,), out.
    """
    pictures, left = len(trust), 0
    for s in range(pictures):
        matching, failing, worth = 0, 0, _ZERO
        for h in range(count):
            if costs[h, s] < good:
                matching += 1
                worth += np.exp(-costs[h, s] * costs[h, s] / F(0.18))
            elif costs[h, s] > F(1.2):
                failing += 1
        trust[s] = worth / F(max(matching, 1))
        if matching < 2 or failing > 3:
            trust[s] *= F(0.2)
        if trust[s] > _ZERO:
            left += 1
    while left > most:
        least = -1
        for s in range(pictures):
            if trust[s] > _ZERO and (least < 0 or trust[s] < trust[least]):
                least = s
        trust[least] = _ZERO
        left -= 1
    total = _ZERO
    for s in range(pictures):
        total += trust[s]
    if total > _TINY:
        return total
    # Nothing matches yet: the pictures in which the plane with the best two of them does.
    best, chosen = _NONE, 0
    for h in range(count):
        first, second = _TWO, _TWO
        for s in range(pictures):
            if costs[h, s] < first:
                first, second = costs[h, s], first
            elif costs[h, s] < second:
                second = costs[h, s]
        if first + second < best:
            best, chosen = first + second, h
    total = _ZERO
    for s in range(pictures):
        trust[s] = _ONE if costs[chosen, s] < F(1.3) else _ZERO
        total += trust[s]
    if total <= _TINY:
        trust[:] = _ONE
        total = F(pictures)
    return total


@fast_kernel
def spread(
    colour: Any, turn: Any, picture: Any, grey: Any, lens: Any, near: Any, far: Any, links: Any,
    sizes: Any, packed: Any, others: Any, prior: Any, most: Any, planes: Any, costs: Any,
) -> None:  # fmt: skip
    """Let the planes of half of the pixels be better ones of their neighbours, or perturbed ones.

    Args:
        colour: of the checkerboard's pixels, 0 or 1.
        turn: number of the round: the later, the less is perturbed.
        picture: its number.
        grey: (H, W) float32, grey levels.
        lens: (4,) float32.
        near: least depth, float32.
        far: largest depth, float32.
        links: (S, 28) float32 to the pictures that this one is compared with.
        sizes: (S, 2) int32, their heights and widths.
        packed: (S, h, w) uint32 of `patchmatch.packed`, filled up to the largest.
        others: (S, h, w, 4) float32, their planes; (0, 1, 1, 4) to leave them out of it.
        prior: (H, W, 4) float32 planes that are expected where there is little texture, of depth 0
            where none is; (0, 1, 4) for none at all.
        most: pictures that count at a pixel.
        planes: (H, W, 4) float32, in and out.
        costs: (H, W) float32, in and out.
    """
    height, width = costs.shape
    count, agree, expect = len(links), len(others) > 0, len(prior) > 0
    values, weights = np.zeros(_LANES, np.float32), np.zeros(_LANES, np.float32)
    found, each = np.zeros((16, 4), np.float32), np.zeros((16, count), np.float32)
    trust = np.zeros(count, np.float32)
    good = F(0.8) * F(np.exp(-turn * turn / 90.0))
    reach, lean = F(0.04) / F(1 + turn), F(0.35) / F(1 + turn)
    for y in range(height):
        for x in range((y + colour) % 2, width, 2):
            px, py, pixel = F(x), F(y), x + y * width
            rx, ry = (px - lens[2]) / lens[0], (py - lens[3]) / lens[1]
            mean, var = _window(x, y, grey, values, weights)
            dull = _ZERO
            found[0] = planes[y, x]
            n = _neighbours(x, y, rx, ry, lens, near, far, planes, costs, found, 1)
            if expect and prior[y, x, 0] > _ZERO:
                dull = _PRIOR * _TEXTURE / (_TEXTURE + var)
                found[n] = prior[y, x]
                n += 1
            regions = n
            total, best, chosen = _ZERO, _NONE, 0
            z, nx, ny, nz = found[0, 0], found[0, 1], found[0, 2], found[0, 3]
            # First the planes of the regions, all in all pictures; then five new ones, of which
            # each is given up as soon as it is no better.
            for h in range(regions + 5):
                if h < regions:
                    z2, ax, ay, az = found[h, 0], found[h, 1], found[h, 2], found[h, 3]
                else:
                    trial = h - regions
                    if trial == 0:
                        total = _trust(each, regions, good, most, trust)
                        for one in range(regions):
                            value = _ZERO
                            for s in range(count):
                                value += trust[s] * each[one, s]
                            value /= total
                            if dull > _ZERO:
                                value += dull * _off_prior(
                                    found[one, 0], found[one, 1], found[one, 2], found[one, 3],
                                    prior, y, x,
                                )  # fmt: skip
                            if value < best:
                                best, chosen = value, one
                        z, nx, ny = found[chosen, 0], found[chosen, 1], found[chosen, 2]
                        nz = found[chosen, 3]
                    r0 = _random(pixel, turn * 8 + trial, picture, 1)
                    r1 = _random(pixel, turn * 8 + trial, picture, 2)
                    r2 = _random(pixel, turn * 8 + trial, picture, 3)
                    r3 = _random(pixel, turn * 8 + trial, picture, 4)
                    z2, ax, ay, az = z, nx, ny, nz
                    if trial < 2:  # A depth at random, with the normal or a new one.
                        z2 = _ONE / (_ONE / far + r0 * (_ONE / near - _ONE / far))
                    if trial == 1 or trial == 2:
                        ax, ay, az = _TWO * r1 - _ONE, _TWO * r2 - _ONE, -r3
                    if trial > 2:
                        step = reach if trial == 3 else F(0.15) * reach
                        z2 = z * (_ONE + step * (_TWO * r0 - _ONE))
                        ax, ay = nx + lean * (r1 - _HALF), ny + lean * (r2 - _HALF)
                        az = nz + lean * (r3 - _HALF)
                    ax, ay, az, shown = _facing(ax, ay, az, rx, ry)
                    if not shown or z2 <= near or z2 >= far:
                        continue
                value = _ZERO
                if h >= regions and dull > _ZERO:
                    value = dull * total * _off_prior(z2, ax, ay, az, prior, y, x)
                for s in range(count):
                    if h >= regions and trust[s] <= _ZERO:
                        continue
                    cost = _unlike(
                        px, py, z2, ax, ay, az, lens, values, weights, mean, var, s, links, sizes,
                        packed,
                    )  # fmt: skip
                    if agree and cost < WORST:
                        cost += _AGREE * _apart(px, py, z2, s, links, sizes, others)[0]
                    if h < regions:
                        each[h, s] = cost
                    else:
                        value += trust[s] * cost
                        if value >= best * total:
                            break
                if h >= regions and value < best * total:
                    best, z, nx, ny, nz = value / total, z2, ax, ay, az
            planes[y, x, 0], planes[y, x, 1], planes[y, x, 2], planes[y, x, 3] = z, nx, ny, nz
            costs[y, x] = best


@fast_part
def _step(px: Any, py: Any, z: Any, s: Any, links: Any) -> Any:
    """Return the share of a depth by which its point moves by `_SHIFT` pixels in picture `s`."""
    a = z * (links[s, 0] * px + links[s, 1] * py + links[s, 2])
    b = z * (links[s, 3] * px + links[s, 4] * py + links[s, 5])
    c = z * (links[s, 6] * px + links[s, 7] * py + links[s, 8])
    u, v, w = a + links[s, 9], b + links[s, 10], c + links[s, 11]
    # By the derivative of (u / w, v / w) with respect to the logarithm of the depth.
    x, y = (a * w - u * c) / (w * w), (b * w - v * c) / (w * w)
    return min(_SHIFT / max(np.sqrt(x * x + y * y), _TINY), _HALF)


@fast_part
def _angle_is(z: Any, rx: Any, ry: Any, sine: Any, lens: Any, s: Any, links: Any) -> Any:
    """Return whether picture `s` sees a point from another side, by an angle of that sine."""
    # The other camera's centre, and the cross product of it with the ray.
    tz = links[s, 23]
    tx, ty = (links[s, 21] - lens[2] * tz) / lens[0], (links[s, 22] - lens[3] * tz) / lens[1]
    a, b, c = ry * tz - ty, tx - rx * tz, rx * ty - ry * tx
    dx, dy, dz = z * rx - tx, z * ry - ty, z - tz
    away = (rx * rx + ry * ry + _ONE) * (dx * dx + dy * dy + dz * dz)
    return a * a + b * b + c * c >= sine * sine * away


@fast_kernel
def count_confirming(
    planes: Any, grey: Any, lens: Any, links: Any, sizes: Any, packed: Any, others: Any, sine: Any,
    pixels: Any, share: Any, count: Any, distinct: Any,
) -> None:  # fmt: skip
    """Count for each pixel the pictures whose own planes its point lies on.

    Args:
        planes: (H, W, 4) float32; depth 0 where nothing is known.
        grey: (H, W) float32, grey levels.
        lens: (4,) float32.
        links: (S, 28) float32.
        sizes: (S, 2) int32.
        packed: (S, h, w) uint32.
        others: (S, h, w, 4) float32.
        sine: of the least angle between the two views of a point, float32.
        pixels: by which a point may come back beside itself, float32.
        share: of its depth by which it may be off the plane, float32.
        count: (H, W) uint8, out.
        distinct: (H, W) uint8, out: those of them that match worse at another depth; what is plain
            or changes evenly, as a sky does, matches at any.
    """
    values, weights = np.zeros(_LANES, np.float32), np.zeros(_LANES, np.float32)
    for y in range(planes.shape[0]):
        for x in range(planes.shape[1]):
            count[y, x], distinct[y, x], z = 0, 0, planes[y, x, 0]
            if z <= _ZERO:
                continue
            px, py = F(x), F(y)
            rx, ry = (px - lens[2]) / lens[0], (py - lens[3]) / lens[1]
            nx, ny, nz = planes[y, x, 1], planes[y, x, 2], planes[y, x, 3]
            mean, var = _ZERO, _ZERO
            for s in range(len(links)):
                beside, off = _apart(px, py, z, s, links, sizes, others)
                if not (beside < pixels and off < share):
                    continue
                if not _angle_is(z, rx, ry, sine, lens, s, links):
                    continue
                if count[y, x] == 0:
                    mean, var = _window(x, y, grey, values, weights)
                count[y, x] += 1
                step = _step(px, py, z, s, links)
                here, least = WORST, WORST
                for k in range(3):
                    z2 = z if k == 0 else (z * (_ONE + step) if k == 1 else z / (_ONE + step))
                    cost = _unlike(
                        px, py, z2, nx, ny, nz, lens, values, weights, mean, var, s, links, sizes,
                        packed,
                    )  # fmt: skip
                    if k == 0:
                        here = cost
                    else:
                        least = min(least, cost)
                if here + _WORSE < least:
                    distinct[y, x] += 1
