"""A mesh as MuJoCo keeps it: the triangles near a place, by the tree of boxes that it has made."""

from __future__ import annotations

from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined, kernel
from nw_eval.scenes.terrain.narrowphase.triangles import CORNERS


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
