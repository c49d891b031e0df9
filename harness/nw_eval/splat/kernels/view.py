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
    v = np.zeros(SIZE, dtype=np.float64)
    T_camera_world = camera.T_camera_world
    v[R : R + 9] = T_camera_world[:3, :3].reshape(-1)
    v[T : T + 3] = T_camera_world[:3, 3]
    v[[FX, FY, CX, CY]] = camera.fx, camera.fy, camera.cx, camera.cy
    margin_x = 0.15 * camera.width / camera.fx
    margin_y = 0.15 * camera.height / camera.fy
    v[X_LOW] = -(camera.cx / camera.fx + margin_x)
    v[X_HIGH] = (camera.width - camera.cx) / camera.fx + margin_x
    v[Y_LOW] = -(camera.cy / camera.fy + margin_y)
    v[Y_HIGH] = (camera.height - camera.cy) / camera.fy + margin_y
    v[[NEAR, FAR]] = camera.near, camera.far
    v[[STRIDE, INVERSE_STRIDE, OFFSET, BLOCK]] = (
        pixels.stride,
        1.0 / pixels.stride,
        pixels.offset,
        pixels.block,
    )
    v[[COLUMN0, COLUMN1, ROW0, ROW1]] = window
    columns, rows = pixels.indices(camera.width), pixels.indices(camera.height)
    v[[LEFT, RIGHT]] = columns[window[0]], columns[window[1] - 1] + 1
    v[[TOP, BOTTOM]] = rows[window[2]], rows[window[3] - 1] + 1
    v[EYE : EYE + 3] = camera.T_world_camera[:3, 3]
    scale = float(np.linalg.norm(T_camera_world[:3, 0]))
    steepest_x = max(abs(float(v[X_LOW])), abs(float(v[X_HIGH])))
    steepest_y = max(abs(float(v[Y_LOW])), abs(float(v[Y_HIGH])))
    v[SPREAD_X] = scale * camera.fx * math.sqrt(1.0 + steepest_x**2)
    v[SPREAD_Y] = scale * camera.fy * math.sqrt(1.0 + steepest_y**2)
    return v.astype(np.float32)
