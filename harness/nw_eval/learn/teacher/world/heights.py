"""Heights of the ground under many points at once, read from the grids of lanes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.learn.teacher.courses.lane import CELL, ORIGIN
from nw_eval.machine_code.jit import kernel

_X, _Y, _PER_CELL = ORIGIN[0], ORIGIN[1], 1.0 / CELL


@kernel
def read_cells(grids: Any, lanes: Any, points: Any, out: Any) -> None:
    """Read the cell under each point.

    Args:
        grids: (L, X, Y) of all lanes.
        lanes: (N,) the lane of each robot.
        points: (N, P, 2) x and y, m.
        out: (N, P) is written.
    """
    across, along = grids.shape[2], grids.shape[1]
    for i in range(points.shape[0]):
        lane = lanes[i]
        for k in range(points.shape[1]):
            a = min(max(int((points[i, k, 0] - _X) * _PER_CELL), 0), along - 1)
            b = min(max(int((points[i, k, 1] - _Y) * _PER_CELL), 0), across - 1)
            out[i, k] = grids[lane, a, b]


@kernel
def read_scandots(
    grids: Any, lanes: Any, positions: Any, yaws: Any, grid: Any, offset: Any, out: Any
) -> None:
    """Read the scandots of robots: clip(z + offset - ground, -1, 1).

    Args:
        grids: (L, X, Y) heights of all lanes, m.
        lanes: (N,) the lane of each robot.
        positions: (N, 3) of the trunks, m.
        yaws: (N,) rad.
        grid: (P, 2) points in the frame that turns with the yaw, m.
        offset: m.
        out: (N, P) is written.
    """
    across, along = grids.shape[2], grids.shape[1]
    for i in range(positions.shape[0]):
        c, s, lane = np.cos(yaws[i]), np.sin(yaws[i]), lanes[i]
        for k in range(grid.shape[0]):
            x = positions[i, 0] + c * grid[k, 0] - s * grid[k, 1]
            y = positions[i, 1] + s * grid[k, 0] + c * grid[k, 1]
            a = min(max(int((x - _X) * _PER_CELL), 0), along - 1)
            b = min(max(int((y - _Y) * _PER_CELL), 0), across - 1)
            value = positions[i, 2] + offset - grids[lane, a, b]
            out[i, k] = min(max(value, -1.0), 1.0)


def heights_under(
    grids: NDArray[np.float32], lanes: NDArray[np.intp], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the heights under points (N, P, 2), (N, P) m."""
    out = np.empty(points.shape[:2])
    read_cells(grids, lanes, points, out)
    return out
