"""From Gaussians in the world to records on the screen, a group at a time.

EWA splatting (Zwicker et al. 2001) as gsplat 1.5 does it. With camera point (x, y, z), view
rotation rows r0, r1, r2, and a = clamp(x / z), b = clamp(y / z), the rows of J R are
t = fx / z (r0 - a r2) and u = fy / z (r1 - b r2); the footprint's covariance is
[[t' S t, t' S u], [., u' S u]] + eps2d I. Antialiased mode multiplies opacity by
sqrt(max(floor**2, det before / det after)), the part of the energy that the blur did not add.

Opacity and exponent are kept as base-2 logarithms: alpha = 2**(lo - A dx^2 - B dx dy - C dy^2)
with (A, B, C) = log2(e) / 2 * (conic xx, 2 conic xy, conic yy). The pixels with alpha >= 1/255
lie within sqrt(q cov_xx) by sqrt(q cov_yy) of the centre, q = 2 ln 2 (lo - log2(1/255)): a box
that encloses the ellipse exactly. It is widened a little, since the blend tests each pixel and
its verdict alone must count.

EWA replaces perspective by its tangent at the centre. Along the ray a pixel sees the greatest
response of the 3D Gaussian on its own half ray, as in 3DGUT and 3DGRT. With t and u as above but
not clamped, and w = r2 / z, let xz = t' S w, yz = u' S w, zz = w' S w: with the footprint's
covariance the Gaussian's in the frame (a pixel right, a pixel down, the whole depth on). The pixel
at (dx, dy) from the centre sees the points l (dx, dy, 1), and the least squared Mahalanobis
distance of those with l >= 0 is

    d2 = e / (k e + m**2),  e = EWA's quadratic form,  m = max(0, 1 + a dx + b dy),
    (a, b) = -inv(cov) (xz, yz),  k = zz + a xz + b yz.

No 3x3 inverse appears, so needles and flat discs are as safe in float32 as in EWA, and
a = b = k = 0 is EWA. The low-pass eps2d acts in the image plane at the centre's depth. The pixels
with d2 <= q lie in [-(s + q xz) / h, (s - q xz) / h] along x, with h = 1 - q zz and
s = sqrt(q (cov_xx h + q xz**2)); where h <= 0 the Gaussian reaches the plane of the eye.

A record is one cache line for each splat on the screen; records are written eight at a time.

The colour of sixteen Gaussians, each seen along its own direction, is a sum of real spherical
harmonics with the signs and the order of 3DGS (Condon-Shortley phase), as in "Efficient Spherical
Harmonic Evaluation" (Sloan 2013) and gsplat. With d = (x, y, z): degree 1: -c y, c z, -c x; degree
2 and 3: see the code, one line each.
"""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from nw_base.machine_code import inlined, kernel
from nw_base.simd.lanes import (
    F8,
    I64,
    LANES,
    address,
    ceil,
    floor,
    fma,
    intrinsic,
    lane_list,
    mask_bits,
    maximum,
    minimum,
    negate,
    sqrt,
    where,
)
from nw_base.simd.memory import elements, load_group, load_halves, prefetch_early
from nw_splat.kernels import view as at
from nw_splat.kernels.cull import BOUNDS, REACH
from nw_splat.kernels.math8 import log2, pack_range, taken_below

GEOMETRY = 10
"""Floats per Gaussian: centre (3), covariance xx xy xz yy yz zz, log2 opacity."""

THRESHOLD = math.log2(1.0 / 255.0)
"""log2 of the least alpha that is blended."""

# Places in a record of 16 floats.
U, V, A, B, C, LOG_OPACITY, COLUMNS, ROWS = 0, 1, 2, 3, 4, 5, 6, 7
RED, GREEN, BLUE, DEPTH = 8, 9, 10, 11
SLOPE_X, SLOPE_Y, BEND = 12, 13, 14
"""a, b and k of the module's text, k for base 2; not written for EWA."""

_LOG2E = 1.4426950408889634
_TWO_LN2 = 2.0 * math.log(2.0)
_WIDEN, _WIDEN_PIXELS = 1.00002, 0.002
_RAY_WIDEN, _RAY_WIDEN_PIXELS = 1.0001, 0.01

STEEPEST = 30.0**2
"""Square of the slope from the axis (88 degrees) from which on a centre counts as beside the eye,
like one behind it: there the frame is so skew that float32 loses what the closed form needs."""

_LEAST_DEPTH = 0.01
_UNBOUNDED = 1.0e9
"""Pixels, for a side of the box that has no bound."""

CHUNK, GROUP = 256, 16
"""Gaussians in a chunk and in a group of it; a group holds each value sixteen times in a row."""

RECORD = 16
"""Floats in a record: one cache line."""


@kernel
def project_chunk(  # noqa: C901, PLR0912 - two projections in one loop.
    geometry: Any,
    dc: Any,
    sh: Any,
    sh_count: Any,
    bounds: Any,
    chunk: Any,
    following: Any,
    view: Any,
    eps2d: Any,
    antialiased: Any,
    least_compensation: Any,
    ray: Any,
    lens: Any,
    records: Any,
    count: Any,
) -> Any:
    """Append the records of a chunk's Gaussians that touch a pixel of the window.

    Args:
        geometry: (chunks * 256 * GEOMETRY,) float32, group by group, value by value.
        dc: (chunks * 256 * 3,) float32, 0.5 + constant harmonic, as above.
        sh: (chunks * 256 * 3 * (sh_count - 1),) float16 bits, as above.
        sh_count: coefficients per channel: 1, 4, 9 or 16.
        bounds: (chunks * BOUNDS,) float32.
        chunk: which chunk.
        following: which one comes next: it is fetched meanwhile.
        view: (SIZE,) float32 of view.py.
        eps2d: variance added to the footprint, pixels squared.
        antialiased: whether opacity is compensated for it.
        least_compensation: floor of the compensation's square.
        ray: None for EWA, anything else along the ray: two compiled kernels.
        lens: None, or float32 `blur` of render.py: then boxes are of whole pinhole pixels.
        records: float32, 16 per record, with eight records of slack.
        count: records that are there already.

    Returns:
        The new count.
    """
    geometry, dc, sh = elements(geometry), elements(dc), elements(sh)
    r0, r1, r2 = view[at.R], view[at.R + 1], view[at.R + 2]
    r3, r4, r5 = view[at.R + 3], view[at.R + 4], view[at.R + 5]
    r6, r7, r8 = view[at.R + 6], view[at.R + 7], view[at.R + 8]
    eye_x, eye_y, eye_z = view[at.EYE], view[at.EYE + 1], view[at.EYE + 2]
    fx, fy, cx, cy = view[at.FX], view[at.FY], view[at.CX], view[at.CY]
    near, far = view[at.NEAR], view[at.FAR]
    stride, inverse = view[at.STRIDE], view[at.INVERSE_STRIDE]
    offset, block = view[at.OFFSET], view[at.BLOCK]
    column0, column1, row0, row1 = (
        view[at.COLUMN0],
        view[at.COLUMN1],
        view[at.ROW0],
        view[at.ROW1],
    )
    blur = REACH * math.sqrt(widest(eps2d, lens)) + 1.0
    left, right = cx - view[at.LEFT] + blur, view[at.RIGHT] - cx + blur
    top, bottom = cy - view[at.TOP] + blur, view[at.BOTTOM] - cy + blur
    two = np.float32(2.0)
    largest = bounds[chunk * BOUNDS + 6]
    reach_x = REACH * view[at.SPREAD_X] * largest
    reach_y = REACH * view[at.SPREAD_Y] * largest
    first = chunk * (CHUNK * GEOMETRY)
    first_dc = chunk * (CHUNK * 3)
    first_sh = chunk * (CHUNK * 3) * (sh_count - 1)
    later = (following - chunk) * CHUNK
    harmonics = 3 * (sh_count - 1)
    for i in range(0, CHUNK, GROUP):
        g = first + i * GEOMETRY
        # A chunk lies anywhere: memory is slower than this loop if it is first asked when needed.
        _fetch(geometry, g + later * GEOMETRY, GROUP * GEOMETRY, 16)
        _fetch(dc, first_dc + (i + later) * 3, GROUP * 3, 16)
        _fetch(sh, first_sh + (i + later) * harmonics, GROUP * harmonics, 32)
        px = load_group(geometry, g)
        py = load_group(geometry, g + GROUP)
        pz = load_group(geometry, g + 2 * GROUP)
        # From the eye first: the rounding then is that of the distance, not of the position.
        dx, dy, dz = px - eye_x, py - eye_y, pz - eye_z
        z = fma(dx, r6, fma(dy, r7, dz * r8))
        x = fma(dx, r0, fma(dy, r1, dz * r2))
        y = fma(dx, r3, fma(dy, r4, dz * r5))
        fx_x, fy_y = x * fx, y * fy
        ok = (
            (z >= near)
            & (z <= far)
            & (fma(z, left, fx_x) > -reach_x)
            & (fma(z, right, negate(fx_x)) > -reach_x)
            & (fma(z, top, fy_y) > -reach_y)
            & (fma(z, bottom, negate(fy_y)) > -reach_y)
        )
        if mask_bits(ok) == 0:
            continue
        inverse_z = 1.0 / z
        slope_x, slope_y = x * inverse_z, y * inverse_z
        a, b = negate(slope_x), negate(slope_y)
        if ray is None:
            a = negate(minimum(maximum(slope_x, view[at.X_LOW]), view[at.X_HIGH]))
            b = negate(minimum(maximum(slope_y, view[at.Y_LOW]), view[at.Y_HIGH]))
        sx, sy = inverse_z * fx, inverse_z * fy
        t0, t1, t2 = sx * fma(a, r6, r0), sx * fma(a, r7, r1), sx * fma(a, r8, r2)
        u0, u1, u2 = sy * fma(b, r6, r3), sy * fma(b, r7, r4), sy * fma(b, r8, r5)
        c00 = load_group(geometry, g + 3 * GROUP)
        c01 = load_group(geometry, g + 4 * GROUP)
        c02 = load_group(geometry, g + 5 * GROUP)
        c11 = load_group(geometry, g + 6 * GROUP)
        c12 = load_group(geometry, g + 7 * GROUP)
        c22 = load_group(geometry, g + 8 * GROUP)
        s0 = fma(c00, t0, fma(c01, t1, c02 * t2))
        s1 = fma(c01, t0, fma(c11, t1, c12 * t2))
        s2 = fma(c02, t0, fma(c12, t1, c22 * t2))
        xx = fma(t0, s0, fma(t1, s1, t2 * s2))
        xy = fma(u0, s0, fma(u1, s1, u2 * s2))
        xz = inverse_z * fma(r6, s0, fma(r7, s1, r8 * s2))
        s0 = fma(c00, u0, fma(c01, u1, c02 * u2))
        s1 = fma(c01, u0, fma(c11, u1, c12 * u2))
        s2 = fma(c02, u0, fma(c12, u1, c22 * u2))
        yy = fma(u0, s0, fma(u1, s1, u2 * s2))
        yz = inverse_z * fma(r6, s0, fma(r7, s1, r8 * s2))
        before = fma(xx, yy, negate(xy * xy))
        xx, xy, yy = _low_pass(lens, xx, xy, yy, eps2d, slope_x, slope_y)
        after = fma(xx, yy, negate(xy * xy))
        inverse_det = 1.0 / after
        log_opacity = load_group(geometry, g + 9 * GROUP)
        if antialiased:
            kept = maximum(maximum(before * inverse_det, least_compensation), 1e-30)
            log_opacity = fma(log2(kept), 0.5, log_opacity)
        q = (log_opacity - THRESHOLD) * _TWO_LN2
        ok = ok & (after > 0.0) & (q >= 0.0)
        u, v = fma(slope_x, fx, cx), fma(slope_y, fy, cy)
        zz = z
        if ray is None:
            to_left = fma(sqrt(q * xx), _WIDEN, _WIDEN_PIXELS)
            above = fma(sqrt(q * yy), _WIDEN, _WIDEN_PIXELS)
            to_right, below = to_left, above
        else:
            r66, r67, r68 = r6 * r6, r6 * r7 * two, r6 * r8 * two
            r77, r78, r88 = r7 * r7, r7 * r8 * two, r8 * r8
            zz = fma(
                c00, r66, fma(c01, r67, fma(c02, r68, fma(c11, r77, fma(c12, r78, c22 * r88))))
            )
            zz = maximum(zz, 0.0) * (inverse_z * inverse_z)
            ok = ok & (fma(slope_x, slope_x, slope_y * slope_y) < STEEPEST)
            q = fma(q, _RAY_WIDEN, 1e-6)
            depth = fma(q, negate(zz), 1.0)
            if mask_bits(ok & (depth <= _LEAST_DEPTH)) == 0:
                scale = 1.0 / depth
                to_left, to_right = _ray_side(q, xx, xz, depth, scale)
                above, below = _ray_side(q, yy, yz, depth, scale)
            else:
                to_left, to_right = _ray_side_nearby(q, xx, xz, depth)
                above, below = _ray_side_nearby(q, yy, yz, depth)
        c_low, c_high = _within(lens, u - to_left, u + to_right)
        r_low, r_high = _within(lens, v - above, v + below)
        if stride != 1.0:  # Where every pixel is taken, an index is its own.
            c_low = taken_below(c_low, stride, inverse, offset, block)
            c_high = taken_below(c_high, stride, inverse, offset, block)
            r_low = taken_below(r_low, stride, inverse, offset, block)
            r_high = taken_below(r_high, stride, inverse, offset, block)
        c_low, c_high = maximum(c_low, column0), minimum(c_high - 1.0, column1 - 1.0)
        r_low, r_high = maximum(r_low, row0), minimum(r_high - 1.0, row1 - 1.0)
        ok = ok & (c_low <= c_high) & (r_low <= r_high)
        bits = mask_bits(ok)
        if bits == 0:
            continue
        half = inverse_det * (0.5 * _LOG2E)
        d = first_dc + i * 3
        red = load_group(dc, d)
        green = load_group(dc, d + GROUP)
        blue = load_group(dc, d + 2 * GROUP)
        if sh_count > 1:
            unit = 1.0 / sqrt(fma(dx, dx, fma(dy, dy, dz * dz)))
            red, green, blue = shade(
                sh,
                first_sh + i * 3 * (sh_count - 1),
                sh_count,
                dx * unit,
                dy * unit,
                dz * unit,
                (red, green, blue),
            )
        fields = (
            u,
            v,
            yy * half,
            xy * half * -2.0,
            xx * half,
            log_opacity,
            pack_range(c_low - column0, c_high - column0),
            pack_range(r_low - row0, r_high - row0),
            maximum(red, 0.0),
            maximum(green, 0.0),
            maximum(blue, 0.0),
            z,
        )
        if ray is None:
            if bits & 0xFF:
                count = append_lower(records, count, bits, fields)
            if bits >> LANES:
                count = append_upper(records, count, bits, fields)
        else:
            lean_x = fma(xy, yz, negate(yy * xz)) * inverse_det
            lean_y = fma(xy, xz, negate(xx * yz)) * inverse_det
            bend = maximum(fma(xz, lean_x, fma(yz, lean_y, zz)), 0.0)
            bent = (*fields, lean_x, lean_y, bend * (2.0 / _LOG2E))
            if bits & 0xFF:
                count = append_lower(records, count, bits, bent)
            if bits >> LANES:
                count = append_upper(records, count, bits, bent)
    return count


@inlined
def widest(eps2d: Any, lens: Any) -> Any:
    """Return the largest variance of the low-pass."""
    if lens is None:
        return eps2d
    return eps2d * lens[11]


@inlined
def _low_pass(lens: Any, xx: Any, xy: Any, yy: Any, eps2d: Any, x: Any, y: Any) -> Any:
    """Return a footprint's covariance behind the low-pass; through a lens by render.py's text."""
    if lens is None:
        return xx + eps2d, xy, yy + eps2d
    square = fma(x, x, y * y)
    w = minimum(square / (square + 1.0), lens[10])
    times = eps2d / (1.0 - w)
    t = fma(fma(fma(fma(w, lens[4], lens[3]), w, lens[2]), w, lens[1]), w, lens[0])
    d = fma(fma(fma(fma(w, lens[9], lens[8]), w, lens[7]), w, lens[6]), w, lens[5])
    t, d = maximum(t, 1e-6) * times, d * times
    return fma(d * x, x, xx + t), fma(d * x, y, xy), fma(d * y, y, yy + t)


@inlined
def _within(lens: Any, low: Any, high: Any) -> Any:
    """Return the first and the end of the pixels whose centres lie between; of a lens, any part."""
    if lens is None:
        return ceil(low - 0.5), floor(high + 0.5)
    return floor(low), floor(high) + 1.0


@inlined
def _ray_side(q: Any, variance: Any, lean: Any, depth: Any, scale: Any) -> Any:
    """Return how far a Gaussian reaches before and behind its centre along a side of the image.

    Args:
        q: squared Mahalanobis distance.
        variance: xx, or yy.
        lean: xz, or yz.
        depth: 1 - q zz, over 0.
        scale: its inverse.
    """
    along = q * lean
    root = sqrt(q * fma(variance, depth, lean * along))
    slack = fma(root * scale, 2e-6, _RAY_WIDEN_PIXELS)
    return fma(root + along, scale, slack), fma(root - along, scale, slack)


@inlined
def _ray_side_nearby(q: Any, variance: Any, lean: Any, depth: Any) -> Any:
    """Return the same of Gaussians that may reach the plane of the eye, and have no bound there.

    The shorter side is q variance / (root + |q lean|), too, where nothing cancels.
    """
    along = q * lean
    square = fma(variance, depth, lean * along)
    wide = sqrt(q * maximum(square, 0.0)) + maximum(along, negate(along))
    # Where rounding might decide whether there is a bound, there is none.
    is_sure = square > variance * fma(negate(depth), 1e-5, 2e-5)
    short = where(is_sure, q * variance / wide, _UNBOUNDED)
    long = where(is_sure & (depth > _LEAST_DEPTH), wide / depth, _UNBOUNDED)
    is_before = along > 0.0
    before = where(is_before, long, short) + _RAY_WIDEN_PIXELS
    return before, where(is_before, short, long) + _RAY_WIDEN_PIXELS


@inlined
def _fetch(array: Any, first: Any, count: Any, line: Any) -> None:
    """Ask for `count` elements from `first` on, `line` of them in a cache line."""
    for index in range(first, first + count, line):
        prefetch_early(array, index)


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


@inlined
def _add(sh: Any, place: Any, channel: Any, basis: Any, colour: Any) -> Any:
    r, g, b = colour
    return (
        fma(basis, load_halves(sh, place), r),
        fma(basis, load_halves(sh, place + channel), g),
        fma(basis, load_halves(sh, place + channel + channel), b),
    )


def _transpose(builder: Any, rows: list[Any]) -> list[Any]:
    """Transpose an 8x8 matrix held in eight vectors: three rounds of pairwise shuffles."""

    def mix(a: Any, b: Any, lanes: list[int]) -> Any:
        return builder.shuffle_vector(a, b, lane_list(lanes))

    pairs: list[Any] = []
    for i in range(0, LANES, 2):
        pairs.append(mix(rows[i], rows[i + 1], [0, 8, 1, 9, 4, 12, 5, 13]))
        pairs.append(mix(rows[i], rows[i + 1], [2, 10, 3, 11, 6, 14, 7, 15]))
    quads: list[Any] = []
    for base in (0, 4):
        for i in (0, 1):
            a, b = pairs[base + i], pairs[base + i + 2]
            quads.append(mix(a, b, [0, 1, 8, 9, 4, 5, 12, 13]))
            quads.append(mix(a, b, [2, 3, 10, 11, 6, 7, 14, 15]))
    low = [mix(quads[i], quads[i + 4], [0, 1, 2, 3, 8, 9, 10, 11]) for i in range(4)]
    high = [mix(quads[i], quads[i + 4], [4, 5, 6, 7, 12, 13, 14, 15]) for i in range(4)]
    return low + high


def _appending(first_lane: int) -> Any:
    @intrinsic
    def append(_typing: Any, records: Any, count: Any, bits: Any, fields: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            lanes = lane_list(list(range(first_lane, first_lane + LANES)))
            values: list[Any] = [
                builder.shuffle_vector(value, value, lanes)
                for value in cgutils.unpack_tuple(builder, args[3])
            ]
            values += [ir.Constant(F8, ir.Undefined)] * (RECORD - len(values))
            first, second = _transpose(builder, values[:8]), _transpose(builder, values[8:])
            end, one = args[1], ir.Constant(I64, 1)
            for lane in range(LANES):
                start = builder.shl(end, ir.Constant(I64, 4))
                place = address(context, builder, signature.args[0], args[0], start)
                builder.store(first[lane], builder.bitcast(place, F8.as_pointer()), align=4)
                place = builder.gep(place, [ir.Constant(I64, LANES)])
                builder.store(second[lane], builder.bitcast(place, F8.as_pointer()), align=4)
                place = ir.Constant(I64, first_lane + lane)
                end = builder.add(end, builder.and_(builder.lshr(args[2], place), one))
            return end

        return types.int64(records, types.int64, types.int64, fields), generate

    return append


append_lower, append_upper = _appending(0), _appending(LANES)
"""(records, count, bits, fields): write one record of 16 floats behind `count` records for each
lane that is set in `bits`, of the lower or the upper eight; return the new count. `fields` are
Floats16, the first floats of a record. Every lane is written and the end advances for the set ones
only: no branch. Leave eight records of slack."""
