"""Rotations from quaternions w x y z of any length, and gradients back to these."""

from __future__ import annotations

import math
from typing import Any

from nw_eval.machine_code.jit import inlined


@inlined
def rotation(quat: Any) -> Any:
    """Return the rotation of a quaternion row by row, nine numbers: own axes to world."""
    w, x, y, z = float(quat[0]), float(quat[1]), float(quat[2]), float(quat[3])
    k = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * k, x * k, y * k, z * k
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@inlined
def rotation_back(quat: Any, g: Any, out: Any) -> None:
    """Write the gradient with respect to a quaternion; g is that to its rotation's nine numbers.

    The length of the quaternion does not matter to its rotation: the gradient is across it.
    """
    w, x, y, z = float(quat[0]), float(quat[1]), float(quat[2]), float(quat[3])
    k = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * k, x * k, y * k, z * k
    gw = 2.0 * (x * (g[7] - g[5]) + y * (g[2] - g[6]) + z * (g[3] - g[1]))
    gx = 2.0 * (y * (g[1] + g[3]) + z * (g[2] + g[6]) + w * (g[7] - g[5]))
    gx -= 4.0 * x * (g[4] + g[8])
    gy = 2.0 * (x * (g[1] + g[3]) + z * (g[5] + g[7]) + w * (g[2] - g[6]))
    gy -= 4.0 * y * (g[0] + g[8])
    gz = 2.0 * (x * (g[2] + g[6]) + y * (g[5] + g[7]) + w * (g[3] - g[1]))
    gz -= 4.0 * z * (g[0] + g[4])
    along = w * gw + x * gx + y * gy + z * gz
    out[0], out[1] = (gw - w * along) * k, (gx - x * along) * k
    out[2], out[3] = (gy - y * along) * k, (gz - z * along) * k
