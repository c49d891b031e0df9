"""Operations on the pixels of a finished picture: means of samples, light, drawn objects.

The formulas are those of NumPy in image.py and overlay.py, in NumPy's order and types: float32
where an image meets a Python number, float64 for light. Sums over parts of a picture add up as
`np.add.reduceat` does. So a pixel has the bits that NumPy would give it, on every processor.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_base.machine_code import inlined, kernel

NO_COVERAGE = np.float32(1e-3)
"""Coverage below which a splat's expected depth means nothing."""

_ZERO, _ONE, _LEAST = np.float32(0.0), np.float32(1.0), np.float32(1e-10)
_QUARTER = np.float32(0.25)


@inlined
def _mean(a: Any, b: Any, c: Any, d: Any) -> Any:
    return ((a + b) + (c + d)) * _QUARTER


@kernel
def mean_of_four(
    rgb: Any, depth: Any, alpha: Any, new_rgb: Any, new_depth: Any, new_alpha: Any
) -> None:
    """Average 2x2 samples; depth is weighted by what each of them covers.

    Args:
        rgb: (2H, 2W, 3) float32.
        depth: (2H, 2W) float32.
        alpha: (2H, 2W) float32.
        new_rgb: (H, W, 3) float32, out, and so are the others.
        new_depth: (H, W) float32.
        new_alpha: (H, W) float32.
    """
    for y in range(new_alpha.shape[0]):
        i, k = 2 * y, 2 * y + 1
        for x in range(new_alpha.shape[1]):
            j, m = 2 * x, 2 * x + 1
            for c in range(3):
                new_rgb[y, x, c] = _mean(rgb[i, j, c], rgb[i, m, c], rgb[k, j, c], rgb[k, m, c])
            covered = _mean(alpha[i, j], alpha[i, m], alpha[k, j], alpha[k, m])
            weighted = _mean(
                depth[i, j] * alpha[i, j],
                depth[i, m] * alpha[i, m],
                depth[k, j] * alpha[k, j],
                depth[k, m] * alpha[k, m],
            )
            new_alpha[y, x] = covered
            new_depth[y, x] = weighted / max(covered, _LEAST)


@kernel
def composite(image: Any, objects: Any, background: Any, new: Any) -> None:
    """Blend drawn objects into pixels of a picture: `image.composite`.

    Args:
        image: rgb (N, 3), depth (N,) and alpha (N,), float32.
        objects: as the image; alpha is the share of a pixel that they cover.
        background: (3,) float32.
        new: as the image, out.
    """
    rgb, depth, alpha = image
    colour, object_depth, coverage = objects
    new_rgb, new_depth, new_alpha = new
    for n in range(len(alpha)):
        share, z = _ZERO, _ZERO
        if np.isfinite(object_depth[n]):
            share, z = min(max(coverage[n], _ZERO), _ONE), object_depth[n]
        before = alpha[n] < NO_COVERAGE or z < depth[n]
        through = _ONE - alpha[n]
        for c in range(3):
            shown = colour[n, c]
            if not before:
                shown = rgb[n, c] + through * (colour[n, c] - background[c])
            new_rgb[n, c] = rgb[n, c] + share * (shown - rgb[n, c])
        of_object = share if before else share * through
        of_splat = (_ONE - share) * alpha[n] if before else alpha[n]
        total = of_object + of_splat
        new_alpha[n] = total
        new_depth[n] = (of_object * z + of_splat * depth[n]) / max(total, _LEAST)


@inlined
def _sum_of(values: Any, start: Any, stride: Any, count: Any) -> Any:
    """Return the sum of numbers as `np.add.reduceat` adds them: the first, and the rest by pairs.

    Up to 128 numbers: eight sums side by side, then what is left.
    """
    first, rest = values[start], count - 1
    at = start + stride
    total = 0.0
    done = 0
    if rest >= 8:
        a, b, c, d = (
            values[at],
            values[at + stride],
            values[at + 2 * stride],
            values[at + 3 * stride],
        )
        at += 4 * stride
        e, f, g, h = (
            values[at],
            values[at + stride],
            values[at + 2 * stride],
            values[at + 3 * stride],
        )
        at += 4 * stride
        done = 8
        while done + 8 <= rest:
            a, b = a + values[at], b + values[at + stride]
            c, d = c + values[at + 2 * stride], d + values[at + 3 * stride]
            at += 4 * stride
            e, f = e + values[at], f + values[at + stride]
            g, h = g + values[at + 2 * stride], h + values[at + 3 * stride]
            at += 4 * stride
            done += 8
        total = ((a + b) + (c + d)) + ((e + f) + (g + h))
    while done < rest:
        total = total + values[at]
        at += stride
        done += 1
    return first + total if count > 1 else first


@kernel
def sum_cells(
    rgb: Any, down: Any, steps: Any, level: Any, elsewhere: Any, starts: Any, sums: Any
) -> None:
    """Sum weighted colours, within 0..1, and weights over parts of a picture.

    Args:
        rgb: (H, W, 3) float32.
        down: (H, W) float64, how far down the pixels' rays go in each metre.
        steps: rows and columns from one pixel that is looked at to the next.
        level: rays that go down more have the weight 1.
        elsewhere: the weight of the others.
        starts: rows and columns, among the pixels looked at, at which parts begin.
        sums: (rows, columns, 4) float64 of parts, out.
    """
    height, width = -(-rgb.shape[0] // steps[0]), -(-rgb.shape[1] // steps[1])
    rows, columns = starts
    line = np.empty(4 * width)
    part = np.empty(4 * width * height)
    for y in range(height):
        for x in range(width):
            i, j = y * steps[0], x * steps[1]
            weight = 1.0 if down[i, j] > level else elsewhere
            place = 4 * (y * width + x)
            for c in range(3):
                part[place + c] = min(max(rgb[i, j, c], _ZERO), _ONE) * weight
            part[place + 3] = weight
    for r in range(len(rows)):
        last = rows[r + 1] if r + 1 < len(rows) else height
        for k in range(4 * width):
            line[k] = _sum_of(part, 4 * width * rows[r] + k, 4 * width, last - rows[r])
        for c in range(len(columns)):
            end = columns[c + 1] if c + 1 < len(columns) else width
            for k in range(4):
                sums[r, c, k] = _sum_of(line, 4 * columns[c] + k, 4, end - columns[c])


@inlined
def _between(index: Any, size: Any, count: Any) -> Any:
    """Return the part before a pixel's place among parts, the one behind, and its share."""
    at = min(max((index + 0.5) * count / size - 0.5, 0.0), count - 1.0)
    low = min(int(at), max(count - 2, 0))
    return low, min(low + 1, count - 1), at - low


@kernel
def light_at(cells: Any, size: Any, row: Any, column: Any, numbers: Any, light: Any) -> None:
    """Return the factors of `overlay.light_around` from mean colours of parts of a picture.

    Args:
        cells: (rows, columns, 3) float64.
        size: height and width of the picture.
        row: (N,) int64 of the pixels.
        column: (N,) int64 of the pixels.
        numbers: luma's three factors, grey, the dimmest, the brightest, tint.
        light: (N, 3) float32, out.
    """
    luma, grey, dimmest, brightest, tint = numbers
    mean = np.empty(3)
    for n in range(len(row)):
        i, k, v = _between(row[n], size[0], cells.shape[0])
        j, m, u = _between(column[n], size[1], cells.shape[1])
        for c in range(3):
            upper = (1.0 - u) * cells[i, j, c] + u * cells[i, m, c]
            lower = (1.0 - u) * cells[k, j, c] + u * cells[k, m, c]
            mean[c] = (1.0 - v) * upper + v * lower
        whole = (mean[0] * luma[0] + mean[1] * luma[1]) + mean[2] * luma[2]
        brightness = min(max(whole / grey, dimmest), brightest)
        for c in range(3):
            lean = 1.0 + tint * (mean[c] / max(whole, 1e-3) - 1.0)
            light[n, c] = np.float32(brightness * lean)


@kernel
def near_any(rays: Any, middles: Any, origin: Any, radius: Any, numbers: Any) -> Any:
    """Note the rays from one point that come as near to one of some middles; return how many.

    Args:
        rays: (N, 3) float64 unit vectors.
        middles: (K, 3) float64.
        origin: (3,) float64; within the radius of a middle, every ray is near.
        radius: the largest distance of a ray from a middle, m.
        numbers: (N,) int64, out: numbers of rays.
    """
    near = np.zeros(len(rays), np.bool_)
    for k in range(len(middles)):
        x, y, z = middles[k, 0] - origin[0], middles[k, 1] - origin[1], middles[k, 2] - origin[2]
        apart = np.sqrt((x * x + y * y) + z * z)
        if apart <= radius:
            near[:] = True
            continue
        share = radius / apart
        limit = np.sqrt(max(1.0 - share * share, 0.0))
        x, y, z = x / apart, y / apart, z / apart
        for n in range(len(rays)):
            near[n] |= rays[n, 0] * x + rays[n, 1] * y + rays[n, 2] * z > limit
    count = 0
    for n in range(len(rays)):
        numbers[count] = n
        count += near[n]
    return count


@kernel
def outline(inside: Any, numbers: Any) -> Any:
    """Note the pixels that lie beside one on the other side of an outline; return how many.

    Args:
        inside: (H, W) whether something is drawn there.
        numbers: (H * W,) int64, out: numbers of pixels, row by row.
    """
    height, width = inside.shape
    count = 0
    for y in range(height):
        for x in range(width):
            drawn = inside[y, x]
            other = (y > 0 and inside[y - 1, x] != drawn) or (x > 0 and inside[y, x - 1] != drawn)
            other |= y + 1 < height and inside[y + 1, x] != drawn
            other |= x + 1 < width and inside[y, x + 1] != drawn
            numbers[count] = y * width + x
            count += other
    return count


@kernel
def rays_around(directions: Any, pixels: Any, offsets: Any, rays: Any) -> None:
    """Turn rays through pixels into several each.

    Args:
        directions: (N, 3) float64 through all pixels, camera axes.
        pixels: (E,) int64, which of them.
        offsets: (9, 3) float64 from a pixel's centre where z is 1.
        rays: (9 E, 3) float64 unit vectors, out.
    """
    for e in range(len(pixels)):
        n = pixels[e]
        z = directions[n, 2]
        for k in range(9):
            x = directions[n, 0] / z + offsets[k, 0]
            y = directions[n, 1] / z + offsets[k, 1]
            w = z / z + offsets[k, 2]
            length = np.sqrt(x * x + y * y + w * w)
            place = 9 * e + k
            rays[place, 0], rays[place, 1], rays[place, 2] = x / length, y / length, w / length


@kernel
def soften(near: Any, seen: Any, pixels: Any, depth: Any, colour: Any, coverage: Any) -> None:
    """Take the means of what nine rays of a pixel met.

    Args:
        near: (9 E,) float64 depth, inf = nothing.
        seen: (9 E, 3) float32 colours.
        pixels: (E,) int64.
        depth: (N,) float64 of all pixels, out; inf where no ray met anything.
        colour: (N, 3) float32, out.
        coverage: (N,) float32, out.
    """
    terms = np.empty(9)
    for e in range(len(pixels)):
        count = 0
        for k in range(9):
            count += np.isfinite(near[9 * e + k])
        weight = 1.0 / max(count, 1)
        red = green = blue = 0.0
        for k in range(9):
            place = 9 * e + k
            terms[k] = 0.0
            if np.isfinite(near[place]):
                terms[k] = near[place] * weight
                red += seen[place, 0] * weight
                green += seen[place, 1] * weight
                blue += seen[place, 2] * weight
        n = pixels[e]
        first = (terms[0] + terms[1]) + (terms[2] + terms[3])
        total = first + ((terms[4] + terms[5]) + (terms[6] + terms[7])) + terms[8]
        depth[n] = total if count > 0 else np.inf
        coverage[n] = np.float32(count / 9)
        colour[n, 0], colour[n, 1], colour[n, 2] = red, green, blue
