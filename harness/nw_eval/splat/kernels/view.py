"""One camera, one pixel set and one window of it as the flat float32 vector that kernels read."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nw_eval.splat.cameras.camera import Camera
from nw_eval.splat.cameras.pixels import Pixels

# Places in the vector. R and t: the view matrix by rows (world to camera, its scale included).
R, T = 0, 9
FX, FY, CX, CY = 12, 13, 14, 15
X_LOW, X_HIGH, Y_LOW, Y_HIGH = 16, 17, 18, 19  # bounds of x/z and y/z in the Jacobian
NEAR, FAR = 20, 21
STRIDE, INVERSE_STRIDE, OFFSET, BLOCK = 22, 23, 24, 25
COLUMN0, COLUMN1, ROW0, ROW1 = 26, 27, 28, 29  # window, in taken pixels, end exclusive
LEFT, RIGHT, TOP, BOTTOM = 30, 31, 32, 33  # window, in pixels of the full image
EYE = 34  # camera centre in the world
SPREAD_X, SPREAD_Y = 37, 38  # most pixels that a unit length at depth 1 spans
SIZE = 40

Window = tuple[int, int, int, int]
"""(first column, end column, first row, end row) in taken pixels."""


def view_vector(camera: Camera, pixels: Pixels, window: Window) -> NDArray[np.float32]:
    """Return the (SIZE,) float32 vector of a camera and a window of its pixel set.

    Bounds of the Jacobian are gsplat's: the image and 15 % of its width on either side.
    """
    # Few calls of NumPy: it is done for every frame, and between frames all code is cold.
    T_camera_world = camera.T_camera_world[:3]
    rows = T_camera_world.tolist()
    margin_x = 0.15 * camera.width / camera.fx
    margin_y = 0.15 * camera.height / camera.fy
    x_low = -(camera.cx / camera.fx + margin_x)
    x_high = (camera.width - camera.cx) / camera.fx + margin_x
    y_low = -(camera.cy / camera.fy + margin_y)
    y_high = (camera.height - camera.cy) / camera.fy + margin_y
    scale = float(np.linalg.norm(T_camera_world[:, 0]))
    steepest_x, steepest_y = max(abs(x_low), abs(x_high)), max(abs(y_low), abs(y_high))
    column0, column1, row0, row1 = window
    return np.array(
        [
            *(number for row in rows for number in row[:3]),
            *(row[3] for row in rows),
            *(camera.fx, camera.fy, camera.cx, camera.cy),
            *(x_low, x_high, y_low, y_high),
            *(camera.near, camera.far),
            *(pixels.stride, 1.0 / pixels.stride, pixels.offset, pixels.block),
            *window,
            *(pixels.index(column0), pixels.index(column1 - 1) + 1),
            *(pixels.index(row0), pixels.index(row1 - 1) + 1),
            *camera.T_world_camera[:3, 3].tolist(),
            scale * camera.fx * math.sqrt(1.0 + steepest_x**2),
            scale * camera.fy * math.sqrt(1.0 + steepest_y**2),
            0.0,
        ],
        dtype=np.float32,
    )
