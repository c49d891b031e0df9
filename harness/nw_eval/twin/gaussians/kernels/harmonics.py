"""Real spherical harmonics of one direction, and their slopes along x, y and z.

In the order and with the signs of the renderer's harmonics.py. The polynomials are taken as they
stand, off the unit sphere too: whoever uses the slopes leaves out what points along the direction.
"""

from __future__ import annotations

from typing import Any

from nw_eval.machine_code.jit import inlined

C0 = 0.28209479177387814
_C1 = 0.4886025119029199
_XY, _ZZ, _XX_YY = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
_C33, _C32, _C31, _C30 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
)
_C3Z = 1.445305721320277


@inlined
def basis(x: Any, y: Any, z: Any, count: Any, values: Any) -> None:
    """Write the first `count` (1, 4, 9 or 16) harmonics of a unit direction into `values`."""
    values[0] = C0
    if count > 1:
        values[1], values[2], values[3] = -_C1 * y, _C1 * z, -_C1 * x
    if count > 4:
        xx, yy, zz = x * x, y * y, z * z
        values[4], values[5], values[7] = _XY * x * y, -_XY * y * z, -_XY * x * z
        values[6] = _ZZ * (3.0 * zz - 1.0)
        values[8] = _XX_YY * (xx - yy)
        if count > 9:
            ring = 1.0 - 5.0 * zz
            values[9] = -_C33 * y * (3.0 * xx - yy)
            values[10] = _C32 * x * y * z
            values[11] = _C31 * y * ring
            values[12] = _C30 * z * (5.0 * zz - 3.0)
            values[13] = _C31 * x * ring
            values[14] = _C3Z * z * (xx - yy)
            values[15] = -_C33 * x * (xx - 3.0 * yy)


@inlined
def slope(x: Any, y: Any, z: Any, count: Any, g: Any) -> Any:
    """Return the gradient of sum_k g[k] Y_k with respect to (x, y, z); Y_0 has none."""
    gx, gy, gz = -_C1 * g[3], -_C1 * g[1], _C1 * g[2]
    if count > 4:
        gx += _XY * (g[4] * y - g[7] * z) + 2.0 * _XX_YY * g[8] * x
        gy += _XY * (g[4] * x - g[5] * z) - 2.0 * _XX_YY * g[8] * y
        gz += 6.0 * _ZZ * g[6] * z - _XY * (g[5] * y + g[7] * x)
        if count > 9:
            xx, yy, zz = x * x, y * y, z * z
            ring, rest = 1.0 - 5.0 * zz, 3.0 * (xx - yy)
            gx += -6.0 * _C33 * g[9] * x * y + _C32 * g[10] * y * z + _C31 * g[13] * ring
            gx += 2.0 * _C3Z * g[14] * x * z - _C33 * g[15] * rest
            gy += -_C33 * g[9] * rest + _C32 * g[10] * x * z + _C31 * g[11] * ring
            gy += -2.0 * _C3Z * g[14] * y * z + 6.0 * _C33 * g[15] * x * y
            gz += _C32 * g[10] * x * y - 10.0 * _C31 * z * (g[11] * y + g[13] * x)
            gz += _C30 * g[12] * (15.0 * zz - 3.0) + _C3Z * g[14] * (xx - yy)
    return gx, gy, gz
