"""The compiled half of rays: a tree of boxes over triangles, and the first one that a ray meets.

A tree is one array of int32 words, eight children to a node and eight triangles to a leaf, so that
one vector operation tests all of them. Floats lie in it bit by bit:

* word 0: how many entries the stack of a search needs. The root follows at `ROOT`.
* a node: low x of its eight boxes, low y, low z, high x, high y, high z; then eight references,
  the word of a node, or minus the word of a leaf.
* a leaf: first corners' x of its triangles, y, z, second corners' x ...; then their faces.

Triangles are met as Woop, Benthin and Wald do ("Watertight Ray/Triangle Intersection", JCGT 2013):
corners are sheared into the frame of the ray, by arithmetic that a corner's triangles share, and
the sign of an edge's function is that of the difference of two products, each rounded once. Of two
triangles at an edge, one has that difference and one its negative; it rounds to the right sign or
to zero, and zero counts as inside. So no ray passes between neighbours.

A search leaves no triangle out that this test accepts: boxes are wider by more than corners are
rounded, and limits along the ray by more than divisions are. Of equal distances the lowest face
counts. What a ray meets is therefore a property of the triangles, not of the tree.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_base.machine_code import inlined, kernel, part
from nw_base.simd.lanes import fused, lowest_bit, mask_bits, maximum, minimum
from nw_base.simd.memory import elements, load, peek, poke, store

WIDTH = 8
NODE, LEAF, ROOT = 7 * WIDTH, 10 * WIDTH, WIDTH
_REFERENCES, _FACES = 6 * WIDTH, 9 * WIDTH
_BINS = 16
_WIDER = 2.0**-20  # of a triangle's size, by which its box is wider
_LATER = np.float32(1.0 + 2.0**-20)  # times the distance at which a ray leaves a box
_INF = np.float32(np.inf)


@part
def _area(box: Any, row: Any) -> Any:
    x = float(box[row, 3]) - box[row, 0]
    y = float(box[row, 4]) - box[row, 1]
    z = float(box[row, 5]) - box[row, 2]
    return x * y + y * z + z * x


@inlined
def _leaves(count: Any) -> Any:
    return (count + WIDTH - 1) // WIDTH


@part
def _clear(box: Any, row: Any) -> None:
    for axis in range(3):
        box[row, axis] = _INF
        box[row, 3 + axis] = -_INF


@part
def _include(box: Any, row: Any, other: Any, of: Any) -> None:
    for axis in range(3):
        box[row, axis] = min(box[row, axis], other[of, axis])
        box[row, 3 + axis] = max(box[row, 3 + axis], other[of, 3 + axis])


@part
def _bounds(vertices: Any, faces: Any, boxes: Any, order: Any) -> int:
    """Fill in the boxes of triangles and the indices of finite ones; return their number."""
    used = 0
    for face in range(len(faces)):
        _clear(boxes, face)
        is_finite = True
        for corner in range(3):
            for axis in range(3):
                value = vertices[faces[face, corner], axis]
                is_finite = is_finite and abs(value) < _INF
                boxes[face, axis] = min(boxes[face, axis], value)
                boxes[face, 3 + axis] = max(boxes[face, 3 + axis], value)
        if not is_finite:
            continue
        size = np.float32(0.0)
        for axis in range(3):
            size = max(size, boxes[face, 3 + axis] - boxes[face, axis])
        size *= np.float32(_WIDER)
        for axis in range(3):
            boxes[face, axis] -= size
            boxes[face, 3 + axis] += size
        order[used] = face
        used += 1
    return used


@part
def _best_bin(bins: Any, counts: Any, rights: Any) -> Any:
    """Return the least cost of two parts, and the last bin of the first; inf if there are none."""
    _clear(bins, _BINS)
    behind = 0
    for row in range(_BINS - 1, 0, -1):
        behind += counts[row]
        _include(bins, _BINS, bins, row)
        rights[row] = _area(bins, _BINS) * _leaves(behind) if behind else np.inf
    _clear(bins, _BINS)
    least, last, before = np.inf, 0, 0
    for row in range(_BINS - 1):
        before += counts[row]
        _include(bins, _BINS, bins, row)
        if before:
            cost = _area(bins, _BINS) * _leaves(before) + rights[row + 1]
            if cost < least:
                least, last = cost, row
    return least, last


@part
def _split(
    boxes: Any, order: Any, begin: Any, end: Any, bins: Any, counts: Any, rights: Any
) -> int:
    """Sort order[begin:end] into two parts by the surface area heuristic; return where they meet.

    Boxes are sorted by twice their middles, low + high, into equal bins along each axis.
    """
    least, along, last, first, scale = np.inf, 0, 0, 0.0, np.inf
    for axis in range(3):
        low, high = np.inf, -np.inf
        for i in range(begin, end):
            middle = float(boxes[order[i], axis]) + boxes[order[i], 3 + axis]
            low, high = min(low, middle), max(high, middle)
        each = _BINS / (high - low)
        if not each < np.inf:
            continue
        for row in range(_BINS):
            _clear(bins, row)
            counts[row] = 0
        for i in range(begin, end):
            middle = float(boxes[order[i], axis]) + boxes[order[i], 3 + axis]
            row = min(_BINS - 1, int((middle - low) * each))
            counts[row] += 1
            _include(bins, row, boxes, order[i])
        cost, row = _best_bin(bins, counts, rights)
        if cost < least:
            least, along, last, first, scale = cost, axis, row, low, each
    if not scale < np.inf:
        return (begin + end) // 2
    i, j = begin, end - 1
    while i <= j:
        middle = float(boxes[order[i], along]) + boxes[order[i], 3 + along]
        if min(_BINS - 1, int((middle - first) * scale)) <= last:
            i += 1
        else:
            order[i], order[j] = order[j], order[i]
            j -= 1
    return i


@part
def _enclose(boxes: Any, order: Any, begin: Any, end: Any, children: Any, child: Any) -> None:
    _clear(children, child)
    for i in range(begin, end):
        _include(children, child, boxes, order[i])


@part
def _write_leaf(
    tree: Any, floats: Any, at: Any, vertices: Any, faces: Any, order: Any, begin: Any, end: Any
) -> None:
    for i in range(WIDTH):
        tree[at + _FACES + i] = order[begin + i] if begin + i < end else -1
        for corner in range(3):
            for axis in range(3):
                value = np.float32(np.nan)  # No ray meets what has no corners.
                if begin + i < end:
                    value = vertices[faces[order[begin + i], corner], axis]
                floats[at + (3 * corner + axis) * WIDTH + i] = value


@kernel
def build(vertices: Any, faces: Any, boxes: Any, order: Any, tree: Any, floats: Any) -> int:
    """Build a tree; return how many words it takes.

    Args:
        vertices: (V, 3) float32.
        faces: (F, 3) int32.
        boxes: (F, 6) float32, memory to work in.
        order: (F,) int32, the same.
        tree: (ROOT + (F + 1) * (NODE + LEAF),) int32, written.
        floats: the same memory as float32.
    """
    count = _bounds(vertices, faces, boxes, order)
    bins = np.empty((_BINS + 1, 6), np.float32)
    counts = np.empty(_BINS, np.int64)
    rights = np.empty(_BINS)
    children = np.empty((WIDTH, 6), np.float32)
    starts = np.empty(WIDTH, np.int64)
    ends = np.empty(WIDTH, np.int64)
    # Nodes to write, first come first served: their triangles, place and depth.
    waiting = np.empty((len(faces) + 1, 4), np.int64)
    waiting[0, 0], waiting[0, 1], waiting[0, 2], waiting[0, 3] = 0, count, ROOT, 1
    first, behind, used, deepest = 0, 1, ROOT + NODE, 1
    while first < behind:
        begin, end = waiting[first, 0], waiting[first, 1]
        at, depth = waiting[first, 2], waiting[first, 3]
        first += 1
        deepest = max(deepest, depth)
        starts[0], ends[0], n = begin, end, 1
        _enclose(boxes, order, begin, end, children, 0)
        while n < WIDTH:
            widest, chosen = -1.0, -1
            for child in range(n):
                if ends[child] - starts[child] > WIDTH and _area(children, child) > widest:
                    widest, chosen = _area(children, child), child
            if chosen < 0:
                break
            middle = _split(boxes, order, starts[chosen], ends[chosen], bins, counts, rights)
            starts[n], ends[n] = middle, ends[chosen]
            ends[chosen] = middle
            _enclose(boxes, order, starts[chosen], middle, children, chosen)
            _enclose(boxes, order, middle, ends[n], children, n)
            n += 1
        for child in range(WIDTH):
            if child >= n or starts[child] == ends[child]:
                _clear(children, child)
                tree[at + _REFERENCES + child] = 0
            elif ends[child] - starts[child] > WIDTH:
                tree[at + _REFERENCES + child] = used
                waiting[behind, 0], waiting[behind, 1] = starts[child], ends[child]
                waiting[behind, 2], waiting[behind, 3] = used, depth + 1
                behind += 1
                used += NODE
            else:
                tree[at + _REFERENCES + child] = -used
                _write_leaf(tree, floats, used, vertices, faces, order, starts[child], ends[child])
                used += LEAF
            for side in range(6):
                floats[at + side * WIDTH + child] = children[child, side]
    tree[:ROOT] = 0
    tree[0] = (WIDTH - 1) * deepest + 1
    return used


@inlined
def _corner(words: Any, at: Any, x: Any, y: Any, z: Any, start: Any, shear: Any) -> Any:
    """Return x and y where a ray along z from the origin meets them at zero, and z."""
    far = load(words, at + z) - start[2]
    return (
        fused(far, shear[0], load(words, at + x) - start[0]),
        fused(far, shear[1], load(words, at + y) - start[1]),
        far,
    )


@kernel
def cast(  # noqa: C901, PLR0912 - kinds of words and of axes, in the loop that all time is spent in.
    tree: Any, origins: Any, step: int, directions: Any, distance: Any, face: Any
) -> None:
    """Find what each ray meets first.

    Args:
        tree: by `build`.
        origins: float32, three for each ray, or for all.
        step: 3, or 0 where one origin serves all rays.
        directions: (N * 3,) float32, of any length.
        distance: (N,) float64, written: in lengths of the direction, inf for a miss.
        face: (N,) int32, written: -1 for a miss.
    """
    words = elements(tree)
    stack = np.empty(tree[0], np.int32)
    nears = np.empty(tree[0] + WIDTH, np.float32)
    lanes = np.empty(WIDTH, np.float32)
    waiting, near_of, lane = elements(stack), elements(nears), elements(lanes)
    for ray in range(len(distance)):
        o, d = ray * step, 3 * ray
        ox, oy, oz = origins[o], origins[o + 1], origins[o + 2]
        dx, dy, dz = directions[d], directions[d + 1], directions[d + 2]
        best, met = _INF, -1
        z = 0 if abs(dx) >= abs(dy) and abs(dx) >= abs(dz) else (1 if abs(dy) >= abs(dz) else 2)
        x, y = (z + 1) % 3, (z + 2) % 3
        start = (origins[o + x], origins[o + y], origins[o + z])
        along = np.float32(1.0) / directions[d + z]
        shear = (-directions[d + x] * along, -directions[d + y] * along)
        x, y, z = x * WIDTH, y * WIDTH, z * WIDTH
        ix, iy, iz = np.float32(1.0) / dx, np.float32(1.0) / dy, np.float32(1.0) / dz
        in_x, in_y, in_z = 0, WIDTH, 2 * WIDTH
        if ix < 0:
            in_x += 3 * WIDTH
        if iy < 0:
            in_y += 3 * WIDTH
        if iz < 0:
            in_z += 3 * WIDTH
        out_x, out_y, out_z = 3 * WIDTH - in_x, 5 * WIDTH - in_y, 7 * WIDTH - in_z
        top = 0
        if (ox + oy + oz + dx + dy + dz) * np.float32(0.0) == 0:  # Else some are not finite.
            top = 1
            poke(waiting, 0, np.int32(ROOT))
            poke(near_of, 0, np.float32(0.0))
        while top > 0:
            top -= 1
            at = np.int64(peek(waiting, top))
            if peek(near_of, top) > best * _LATER:
                continue
            if at > 0:
                # A plane that a ray lies in gives NaN, which the bound replaces.
                near = maximum((load(words, at + in_x) - ox) * ix, np.float32(0.0))
                near = maximum((load(words, at + in_y) - oy) * iy, near)
                near = maximum((load(words, at + in_z) - oz) * iz, near)
                far = minimum((load(words, at + out_x) - ox) * ix, best)
                far = minimum((load(words, at + out_y) - oy) * iy, far)
                far = minimum((load(words, at + out_z) - oz) * iz, far)
                bits = mask_bits(near <= far * _LATER)
                store(lane, 0, near)
                bottom = top
                while bits != 0:
                    child = lowest_bit(bits)
                    bits &= bits - 1
                    reach = peek(lane, child)
                    place = top
                    while place > bottom and peek(near_of, place - 1) < reach:
                        poke(near_of, place, peek(near_of, place - 1))
                        poke(waiting, place, peek(waiting, place - 1))
                        place -= 1
                    poke(near_of, place, reach)
                    poke(waiting, place, peek(words, at + _REFERENCES + child))
                    top += 1
                continue
            at = -at
            ax, ay, az = _corner(words, at, x, y, z, start, shear)
            bx, by, bz = _corner(words, at + 3 * WIDTH, x, y, z, start, shear)
            cx, cy, cz = _corner(words, at + 6 * WIDTH, x, y, z, start, shear)
            u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
            bits = mask_bits(minimum(u, minimum(v, w)) >= np.float32(0.0))
            bits |= mask_bits(maximum(u, maximum(v, w)) <= np.float32(0.0))
            if bits == 0:
                continue
            t = fused(u, az, fused(v, bz, w * cz)) * along / (u + v + w)
            bits &= mask_bits((t > np.float32(0.0)) & (t <= best))
            store(lane, 0, t)
            while bits != 0:
                child = lowest_bit(bits)
                bits &= bits - 1
                reach = peek(lane, child)
                number = peek(words, at + _FACES + child)
                if reach < best or (reach == best and number < met):
                    best, met = reach, number
        distance[ray] = best
        face[ray] = met
