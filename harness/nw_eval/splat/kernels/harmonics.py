"""Colour of sixteen Gaussians, each seen along its own direction.

Real spherical harmonics with the signs and the order of 3DGS (Condon-Shortley phase), as in
"Efficient Spherical Harmonic Evaluation" (Sloan 2013) and gsplat. With d = (x, y, z):
degree 1: -c y, c z, -c x; degree 2 and 3: see the code, one line each.
"""

from __future__ import annotations

from typing import Any

from nw_eval.machine_code.jit import inlined
from nw_eval.splat.kernels.memory import load_halves
from nw_eval.splat.kernels.simd import fma

CHUNK, GROUP = 256, 16
"""Gaussians in a chunk and in a group of it; a group holds each value sixteen times in a row."""


@inlined
def _add(sh: Any, place: Any, channel: Any, basis: Any, colour: Any) -> Any:
    r, g, b = colour
    return (
        fma(basis, load_halves(sh, place), r),
        fma(basis, load_halves(sh, place + channel), g),
        fma(basis, load_halves(sh, place + channel + channel), b),
    )


@inlined
def shade(sh: Any, place: Any, count: Any, x: Any, y: Any, z: Any, colour: Any) -> Any:
    """Add the harmonics of degree 1 and above to a colour.

    Args:
        sh: float16 bits; for each group, channel by channel, coefficient by coefficient.
        place: index of the group's first coefficient, red.
        count: coefficients per channel with the constant one: 4, 9 or 16.
        x: with y and z, unit directions from the eye (Floats16).
        y: see x.
        z: see x.
        colour: (r, g, b) Floats16, the constant part.

    Returns:
        (r, g, b), not clamped.
    """
    channel = GROUP * (count - 1)
    colour = _add(sh, place, channel, y * -0.4886025119029199, colour)
    colour = _add(sh, place + GROUP, channel, z * 0.4886025119029199, colour)
    colour = _add(sh, place + 2 * GROUP, channel, x * -0.4886025119029199, colour)
    if count > 4:
        xx, yy, zz = x * x, y * y, z * z
        place += 3 * GROUP
        colour = _add(sh, place, channel, x * y * 1.0925484305920792, colour)
        colour = _add(sh, place + GROUP, channel, y * z * -1.0925484305920792, colour)
        basis = zz * 0.9461746957575601 - 0.3153915652525201
        colour = _add(sh, place + 2 * GROUP, channel, basis, colour)
        colour = _add(sh, place + 3 * GROUP, channel, x * z * -1.0925484305920792, colour)
        colour = _add(sh, place + 4 * GROUP, channel, (xx - yy) * 0.5462742152960396, colour)
        if count > 9:
            place += 5 * GROUP
            basis = y * -0.5900435899266435 * (xx * 3.0 - yy)
            colour = _add(sh, place, channel, basis, colour)
            basis = x * y * z * 2.890611442640554
            colour = _add(sh, place + GROUP, channel, basis, colour)
            ring = zz * -2.2852289973223288 + 0.4570457994644658
            colour = _add(sh, place + 2 * GROUP, channel, ring * y, colour)
            basis = z * (zz * 1.865881662950577 - 1.119528997770346)
            colour = _add(sh, place + 3 * GROUP, channel, basis, colour)
            colour = _add(sh, place + 4 * GROUP, channel, ring * x, colour)
            basis = z * 1.445305721320277 * (xx - yy)
            colour = _add(sh, place + 5 * GROUP, channel, basis, colour)
            basis = x * -0.5900435899266435 * (xx - yy * 3.0)
            colour = _add(sh, place + 6 * GROUP, channel, basis, colour)
    return colour
