"""The ground as MuJoCo keeps it: heights and triangles near a point.

Coordinates of a height field are those of its own frame, metres: x along the columns, y along the
rows, the origin in the middle. A cell is two triangles, divided from its lower left to its upper
right sample, as `nw_eval.scenes.scene.HeightField` says. Triangles of a mesh are found by the tree
of boxes that MuJoCo has made.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code import inlined, kernel
from nw_eval.scenes.narrowphase.triangles import CORNERS


@kernel
def field_height(heights: Any, half: Any, x: Any, y: Any) -> Any:
    """Return the height at a point and the unit normal there; -inf and upwards beyond the rim.

    Args:
        heights: (R, C) float32 shares of `half[2]`.
        half: half extents along x and y, and the height of a share of 1, metres.
        x: metres.
        y: metres.
    """
    rows, columns = heights.shape
    dx, dy = 2.0 * half[0] / (columns - 1), 2.0 * half[1] / (rows - 1)
    u, v = (x + half[0]) / dx, (y + half[1]) / dy
    if not (u >= 0.0 and u <= columns - 1 and v >= 0.0 and v <= rows - 1):
        return -math.inf, 0.0, 0.0, 1.0
    c, r = min(int(u), columns - 2), min(int(v), rows - 2)
    a, b = u - c, v - r
    near, far = half[2] * heights[r, c], half[2] * heights[r + 1, c + 1]
    if a >= b:
        right = half[2] * heights[r, c + 1]
        along, across = right - near, far - right
    else:
        up = half[2] * heights[r + 1, c]
        along, across = far - up, up - near
    slope_x, slope_y = along / dx, across / dy
    scale = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return near + a * along + b * across, -slope_x * scale, -slope_y * scale, scale


@inlined
def _cells(low: Any, high: Any, half: Any, count: Any) -> Any:
    """Return the first cell that an interval of one axis touches, and the one after the last."""
    scale = (count - 1) / (2.0 * half)
    first = min(max(math.floor((low + half) * scale), 0.0), count - 1.0)
    last = min(max(math.floor((high + half) * scale), -1.0), count - 2.0)
    return int(first), int(last) + 1


@kernel
def field_top(heights: Any, half: Any, x: Any, y: Any, reach_x: Any, reach_y: Any) -> Any:
    """Return the largest height over a rectangle, metres; -inf beyond the rim.

    Args:
        heights: (R, C) shares.
        half: as `field_height`.
        x: of the rectangle's middle, metres.
        y: as above.
        reach_x: half its width, metres.
        reach_y: half its depth.
    """
    rows, columns = heights.shape
    c0, c1 = _cells(x - reach_x, x + reach_x, half[0], columns)
    r0, r1 = _cells(y - reach_y, y + reach_y, half[1], rows)
    top = -math.inf
    if c1 > c0 and r1 > r0:
        for r in range(r0, r1 + 1):
            for c in range(c0, c1 + 1):
                top = max(top, heights[r, c])
    return top * half[2]


@kernel
def field_triangles(heights: Any, half: Any, low: Any, high: Any) -> Any:
    """Return the triangles of the cells that touch a box, (T, CORNERS) float64.

    Args:
        heights: (R, C) shares.
        half: as `field_height`.
        low: x, y and z of the box's lower corner.
        high: of its upper corner.
    """
    rows, columns = heights.shape
    dx, dy = 2.0 * half[0] / (columns - 1), 2.0 * half[1] / (rows - 1)
    c0, c1 = _cells(low[0], high[0], half[0], columns)
    r0, r1 = _cells(low[1], high[1], half[1], rows)
    found = np.empty((2 * max(c1 - c0, 0) * max(r1 - r0, 0), CORNERS))
    count = 0
    for r in range(r0, r1):
        y = r * dy - half[1]
        for c in range(c0, c1):
            x = c * dx - half[0]
            near, right = half[2] * heights[r, c], half[2] * heights[r, c + 1]
            up, far = half[2] * heights[r + 1, c], half[2] * heights[r + 1, c + 1]
            if max(near, right, up, far) < low[2]:
                continue
            if min(near, right, up, far) > high[2]:
                continue
            for half_cell in range(2):
                t = found[count]
                t[0], t[1], t[2] = x, y, near
                if half_cell == 0:
                    t[3], t[4], t[5] = x + dx, y, right
                    t[6], t[7], t[8] = x + dx, y + dy, far
                else:
                    t[3], t[4], t[5] = x + dx, y + dy, far
                    t[6], t[7], t[8] = x, y + dy, up
                count += 1
    return found[:count]


@inlined
def _apart(box: Any, low: Any, high: Any) -> Any:
    apart = False
    for axis in range(3):
        if box[axis] - box[3 + axis] > high[axis] or box[axis] + box[3 + axis] < low[axis]:
            apart = True
    return apart


@kernel
def mesh_triangles(
    vertices: Any, faces: Any, boxes: Any, children: Any, leaves: Any, low: Any, high: Any
) -> Any:
    """Return the triangles whose boxes touch a box, (T, CORNERS) float64, in the mesh's frame.

    Args:
        vertices: (V, 3) float32, metres.
        faces: (F, 3) int32.
        boxes: (N, 6) centre and half extents of the tree's nodes, metres.
        children: (N, 2) int32, numbers of nodes, -1 where there is none.
        leaves: (N,) int32, number of the face of a leaf, -1 for other nodes.
        low: (3,) lower corner, metres.
        high: (3,) upper corner.
    """
    waiting = np.empty(64, dtype=np.int64)
    found = np.empty((64, CORNERS))
    count = 0
    number = 1
    waiting[0] = 0
    while number > 0:
        number -= 1
        node = waiting[number]
        if _apart(boxes[node], low, high):
            continue
        if leaves[node] >= 0:
            if count == len(found):
                more = np.empty((2 * count, CORNERS))
                more[:count] = found
                found = more
            for corner in range(3):
                vertex = faces[leaves[node], corner]
                for axis in range(3):
                    found[count, 3 * corner + axis] = vertices[vertex, axis]
            count += 1
            continue
        if number + 2 > len(waiting):
            longer = np.empty(2 * len(waiting), dtype=np.int64)
            longer[:number] = waiting[:number]
            waiting = longer
        for side in range(2):
            if children[node, side] >= 0:
                waiting[number] = children[node, side]
                number += 1
    return found[:count]
