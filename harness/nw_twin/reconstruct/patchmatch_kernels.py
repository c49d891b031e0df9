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

from nw_base.machine_code import kernel, part

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
"""Pixels, as above."""
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


@part
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


@part
def _facing(nx: Any, ny: Any, nz: Any, rx: Any, ry: Any) -> Any:
    """Return the unit normal turned to the camera, and whether 87 degrees or less off the ray."""
    scale = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz + F(1e-12))
    dot = (nx * rx + ny * ry + nz) * scale
    if dot > _ZERO:
        scale = -scale
        dot = -dot
    shown = dot < F(-0.05) * np.sqrt(rx * rx + ry * ry + _ONE)
    return nx * scale, ny * scale, nz * scale, shown


@part
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


@part
def _unlike(
    px: Any, py: Any, z: Any, nx: Any, ny: Any, nz: Any, lens: Any, values: Any, weights: Any,
    mean: Any, spread: Any, there: Any, sums: Any, s: Any, links: Any, sizes: Any, packed: Any,
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
        there[k] = above + below * (p10 + right_of * (p11 - p10) - above)
    total, square, product = _ZERO, _ZERO, _ZERO
    sums[:] = _ZERO
    for first in range(0, _LANES, 8):  # In eight lanes: the order of the sum is written down.
        for k in range(8):
            w = weights[first + k] * there[first + k]
            sums[0, k] += w
            sums[1, k] += w * there[first + k]
            sums[2, k] += w * values[first + k]
    for k in range(8):
        total += sums[0, k]
        square += sums[1, k]
        product += sums[2, k]
    other = max(square - total * total, _ZERO)
    ncc = (product - total * mean) / np.sqrt((spread + NOISE) * (other + NOISE))
    return min(max(_ONE - ncc, _ZERO), WORST)


@part
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
    slope = nx * (u - cx) / fx + ny * (v - cy) / fy + nz
    off = abs(c * slope - there * own) / c
    if own * slope > _ZERO:
        there *= min(max(own / slope, F(0.8)), F(1.25))
    x = there * (links[s, 12] * u + links[s, 13] * v + links[s, 14]) + links[s, 21]
    y = there * (links[s, 15] * u + links[s, 16] * v + links[s, 17]) + links[s, 22]
    w = there * (links[s, 18] * u + links[s, 19] * v + links[s, 20]) + links[s, 23]
    if w <= _TINY:
        return CAP, _NONE
    x, y = x / w - px, y / w - py
    return min(np.sqrt(x * x + y * y), CAP), off


@part
def _off_prior(z: Any, nx: Any, ny: Any, nz: Any, prior: Any, y: Any, x: Any) -> Any:
    """Return how far a plane is off the one that is expected, 0 to 1."""
    deep = min(abs(z - prior[y, x, 0]) / (_PRIOR_DEPTH * prior[y, x, 0]), _ONE)
    alike = nx * prior[y, x, 1] + ny * prior[y, x, 2] + nz * prior[y, x, 3]
    return max(deep, min(max(_TWO * (_ONE - alike), _ZERO), _ONE))


@kernel
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


@part
def _turned(dx: Any, dy: Any, side: Any) -> Any:
    if side == 0:
        return dx, dy
    if side == 1:
        return -dx, -dy
    if side == 2:
        return dy, dx
    return -dy, -dx


@part
def _best_of(x: Any, y: Any, side: Any, offsets: Any, costs: Any) -> Any:
    """Return column and row of the pixel with the least cost of a region; -1 outside."""
    height, width = costs.shape
    least, column, row = _NONE, -1, -1
    for k in range(len(offsets)):
        dx, dy = _turned(offsets[k, 0], offsets[k, 1], side)
        i, j = x + dx, y + dy
        if 0 <= i < width and 0 <= j < height and costs[j, i] < least:
            least, column, row = costs[j, i], i, j
    return column, row


@part
def _neighbours(
    x: Any, y: Any, lens: Any, near: Any, far: Any, planes: Any, costs: Any, candidates: Any
) -> Any:
    """Write a pixel's plane and each of eight regions' best to `candidates`; return how many."""
    rx, ry, count = (F(x) - lens[2]) / lens[0], (F(y) - lens[3]) / lens[1], 1
    candidates[0] = planes[y, x]
    for region in range(8):
        i, j = _best_of(x, y, region // 2, _NEAR if region % 2 == 0 else _FAR, costs)
        if i < 0:
            continue
        nx, ny, nz = planes[j, i, 1], planes[j, i, 2], planes[j, i, 3]
        along = nx * rx + ny * ry + nz
        if along < F(-0.03):
            there = nx * (F(i) - lens[2]) / lens[0] + ny * (F(j) - lens[3]) / lens[1] + nz
            z = planes[j, i, 0] * there / along
            if near < z < far:
                candidates[count, 0], candidates[count, 1] = z, nx
                candidates[count, 2], candidates[count, 3] = ny, nz
                count += 1
    return count


@part
def _worth(costs: Any, count: Any, good: Any, s: Any) -> Any:
    """Return what picture `s` counts at a pixel, by the planes that match in it."""
    matching, failing, worth = 0, 0, _ZERO
    for h in range(count):
        if costs[h, s] < good:
            matching += 1
            worth += np.exp(-costs[h, s] * costs[h, s] / F(0.18))
        elif costs[h, s] > F(1.2):
            failing += 1
    worth /= F(max(matching, 1))
    return worth if matching > 1 and failing < 4 else F(0.2) * worth


@part
def _keep_best(trust: Any, most: Any) -> None:
    left = 0
    for s in range(len(trust)):
        left += trust[s] > _ZERO
    while left > most:
        least = -1
        for s in range(len(trust)):
            if trust[s] > _ZERO and (least < 0 or trust[s] < trust[least]):
                least = s
        trust[least] = _ZERO
        left -= 1


@part
def _two_best(costs: Any, h: Any) -> Any:
    """Return the sum of the two least costs of a plane."""
    first, second = WORST, WORST
    for s in range(costs.shape[1]):
        second = min(second, max(first, costs[h, s]))
        first = min(first, costs[h, s])
    return first + second


@part
def _trust(costs: Any, count: Any, good: Any, most: Any, trust: Any) -> Any:
    """Weigh the pictures for one pixel by the planes that match in each; return the weights' sum.

    Args:
        costs: (P, S) of planes in pictures.
        count: of planes.
        good: cost below which a plane matches.
        most: pictures that have any weight.
        trust: (S,), out.
    """
    for s in range(len(trust)):
        trust[s] = _worth(costs, count, good, s)
    _keep_best(trust, most)
    total = trust.sum()
    if total > _TINY:
        return total
    # Nothing matches yet: the pictures in which the plane with the best two of them does.
    chosen = 0
    for h in range(1, count):
        if _two_best(costs, h) < _two_best(costs, chosen):
            chosen = h
    for s in range(len(trust)):
        trust[s] = _ONE if costs[chosen, s] < F(1.3) else _ZERO
    if trust.sum() <= _TINY:
        trust[:] = _ONE
    return trust.sum()


@part
def _cost(
    px: Any, py: Any, z: Any, nx: Any, ny: Any, nz: Any, s: Any, window: Any, seen: Any
) -> Any:
    """Return the cost of a plane in picture `s`: of its looks, and of its own plane there."""
    values, weights, there, sums, mean, var = window
    lens, links, sizes, packed, others = seen
    cost = _unlike(
        px,
        py,
        z,
        nx,
        ny,
        nz,
        lens,
        values,
        weights,
        mean,
        var,
        there,
        sums,
        s,
        links,
        sizes,
        packed,
    )
    if len(others) > 0 and cost < WORST:
        cost += _AGREE * _apart(px, py, z, s, links, sizes, others)[0]
    return cost


@part
def _perturbed(
    plane: Any, trial: Any, pixel: Any, turn: Any, picture: Any, near: Any, far: Any
) -> Any:
    """Return another plane to try: at random by the first three trials, nearby by the others."""
    z, nx, ny, nz = plane
    r0 = _random(pixel, turn * 8 + trial, picture, 1)
    r1 = _random(pixel, turn * 8 + trial, picture, 2)
    r2 = _random(pixel, turn * 8 + trial, picture, 3)
    r3 = _random(pixel, turn * 8 + trial, picture, 4)
    if trial > 2:
        lean, step = F(0.35) / F(1 + turn), F(0.04) / F(1 + turn)
        if trial > 3:
            step *= F(0.15)
        z *= _ONE + step * (_TWO * r0 - _ONE)
        return z, nx + lean * (r1 - _HALF), ny + lean * (r2 - _HALF), nz + lean * (r3 - _HALF)
    if trial < 2:
        z = _ONE / (_ONE / far + r0 * (_ONE / near - _ONE / far))
    if trial > 0:
        nx, ny, nz = _TWO * r1 - _ONE, _TWO * r2 - _ONE, -r3
    return z, nx, ny, nz


@part
def _improved(
    x: Any, y: Any, plane: Any, best: Any, number: Any, near: Any, far: Any, trust: Any,
    total: Any, dull: Any, prior: Any, window: Any, seen: Any,
) -> Any:  # fmt: skip
    """Return the best of a plane and five others, and its cost; each ends as soon as it is worse.

    Args: as of `spread`, but for
        number: of the pixel, the round and the picture.
        dull: cost of being off the prior.
    """
    lens, (pixel, turn, picture) = seen[0], number
    px, py = F(x), F(y)
    rx, ry = (px - lens[2]) / lens[0], (py - lens[3]) / lens[1]
    for trial in range(5):
        z, nx, ny, nz = _perturbed(plane, trial, pixel, turn, picture, near, far)
        nx, ny, nz, shown = _facing(nx, ny, nz, rx, ry)
        if not shown or z <= near or z >= far:
            continue
        cost = _ZERO
        if dull > _ZERO:
            cost = dull * total * _off_prior(z, nx, ny, nz, prior, y, x)
        for s in range(len(trust)):
            if trust[s] > _ZERO and cost < best * total:
                cost += trust[s] * _cost(px, py, z, nx, ny, nz, s, window, seen)
        if cost < best * total:
            best, plane = cost / total, (z, nx, ny, nz)
    return plane, best


@kernel
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
    count = len(links)
    values, weights = np.zeros(_LANES, np.float32), np.zeros(_LANES, np.float32)
    there, sums = np.zeros(_LANES, np.float32), np.zeros((3, 8), np.float32)
    candidates, each = np.zeros((10, 4), np.float32), np.zeros((10, count), np.float32)
    trust, seen = np.zeros(count, np.float32), (lens, links, sizes, packed, others)
    good = F(0.8) * F(np.exp(-turn * turn / 90.0))
    for y in range(height):
        for x in range((y + colour) % 2, width, 2):
            mean, var = _window(x, y, grey, values, weights)
            window, dull = (values, weights, there, sums, mean, var), _ZERO
            n = _neighbours(x, y, lens, near, far, planes, costs, candidates)
            if len(prior) > 0 and prior[y, x, 0] > _ZERO:
                dull, candidates[n] = _PRIOR * _TEXTURE / (_TEXTURE + var), prior[y, x]
                n += 1
            for h in range(n):
                z, nx, ny, nz = (
                    candidates[h, 0],
                    candidates[h, 1],
                    candidates[h, 2],
                    candidates[h, 3],
                )
                for s in range(count):
                    each[h, s] = _cost(F(x), F(y), z, nx, ny, nz, s, window, seen)
            total = _trust(each, n, good, most, trust)
            best, chosen = _NONE, 0
            for h in range(n):
                cost = _ZERO
                for s in range(count):
                    cost += trust[s] * each[h, s]
                cost /= total
                if dull > _ZERO:
                    z, nx, ny, nz = (
                        candidates[h, 0],
                        candidates[h, 1],
                        candidates[h, 2],
                        candidates[h, 3],
                    )
                    cost += dull * _off_prior(z, nx, ny, nz, prior, y, x)
                if cost < best:
                    best, chosen = cost, h
            plane = (
                candidates[chosen, 0],
                candidates[chosen, 1],
                candidates[chosen, 2],
                candidates[chosen, 3],
            )
            number = (x + y * width, turn, picture)
            plane, best = _improved(
                x, y, plane, best, number, near, far, trust, total, dull, prior, window, seen
            )
            planes[y, x, 0], planes[y, x, 1], planes[y, x, 2], planes[y, x, 3] = plane
            costs[y, x] = best


@part
def _step(px: Any, py: Any, z: Any, s: Any, links: Any) -> Any:
    """Return the share of a depth by which its point moves by `_SHIFT` pixels in picture `s`."""
    a = z * (links[s, 0] * px + links[s, 1] * py + links[s, 2])
    b = z * (links[s, 3] * px + links[s, 4] * py + links[s, 5])
    c = z * (links[s, 6] * px + links[s, 7] * py + links[s, 8])
    u, v, w = a + links[s, 9], b + links[s, 10], c + links[s, 11]
    # By the derivative of (u / w, v / w) with respect to the logarithm of the depth.
    x, y = (a * w - u * c) / (w * w), (b * w - v * c) / (w * w)
    return min(_SHIFT / max(np.sqrt(x * x + y * y), _TINY), _HALF)


@part
def _angle_is(px: Any, py: Any, z: Any, sine: Any, lens: Any, s: Any, links: Any) -> Any:
    """Return whether picture `s` sees a point from another side, by an angle of that sine."""
    rx, ry = (px - lens[2]) / lens[0], (py - lens[3]) / lens[1]
    # The other camera's centre, and the cross product of it with the ray.
    tz = links[s, 23]
    tx, ty = (links[s, 21] - lens[2] * tz) / lens[0], (links[s, 22] - lens[3] * tz) / lens[1]
    a, b, c = ry * tz - ty, tx - rx * tz, rx * ty - ry * tx
    dx, dy, dz = z * rx - tx, z * ry - ty, z - tz
    away = (rx * rx + ry * ry + _ONE) * (dx * dx + dy * dy + dz * dz)
    return a * a + b * b + c * c >= sine * sine * away


@kernel
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
    there, sums = np.zeros(_LANES, np.float32), np.zeros((3, 8), np.float32)
    # Looks alone: `_cost` is to have no planes of others.
    seen = (lens, links, sizes, packed, others[:0])
    for y in range(planes.shape[0]):
        for x in range(planes.shape[1]):
            count[y, x], distinct[y, x], z = 0, 0, planes[y, x, 0]
            if z <= _ZERO:
                continue
            px, py = F(x), F(y)
            nx, ny, nz = planes[y, x, 1], planes[y, x, 2], planes[y, x, 3]
            mean, var = _window(x, y, grey, values, weights)
            window = (values, weights, there, sums, mean, var)
            for s in range(len(links)):
                beside, off = _apart(px, py, z, s, links, sizes, others)
                if beside < pixels and off < share and _angle_is(px, py, z, sine, lens, s, links):
                    count[y, x] += 1
                    step = _ONE + _step(px, py, z, s, links)
                    cost = _cost(px, py, z, nx, ny, nz, s, window, seen)
                    before = _cost(px, py, z / step, nx, ny, nz, s, window, seen)
                    behind = _cost(px, py, z * step, nx, ny, nz, s, window, seen)
                    distinct[y, x] += cost + _WORSE < min(before, behind)
