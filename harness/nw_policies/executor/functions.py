"""Functions of sixteen float32 lanes that give the same bits on every processor.

Each step is one IEEE operation, rounded as written. `fused` is `llvm.fma`, which rounds once: one
instruction with AVX2, AVX-512 and NEON, and libm's `fmaf`, slow but with the same bits, elsewhere.
Sums over lanes fold halves: 0 + 8, 1 + 9, ..., in one order on every machine.

The approximations are those of Cephes (exp, log; Moshier 1992) and of Eigen and MLAS (tanh, erf),
with at most 2 units in the last place against float64 over the ranges that the tests name.
"""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types

from nw_base.machine_code import inlined
from nw_base.simd.lanes import (
    F16,
    I32,
    I32X16,
    MASKS,
    Floats16,
    floor,
    fused,
    integers,
    intrinsic,
    lane_list,
    negate,
    where,
)

LANES = 16


@intrinsic
def first_lanes(_typing: Any, count: Any) -> Any:
    """Return the mask of the first `count` lanes."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        undefined = ir.Constant(I32X16, ir.Undefined)
        first = builder.insert_element(undefined, builder.trunc(args[0], I32), ir.Constant(I32, 0))
        counts = builder.shuffle_vector(first, undefined, lane_list([0] * LANES))
        return builder.icmp_signed("<", lane_list(list(range(LANES))), counts)

    return MASKS[LANES](types.int64), generate


@intrinsic
def same(_typing: Any, x: Any, y: Any) -> Any:
    """Return the mask of the lanes in which two vectors are equal."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.fcmp_ordered("==", args[0], args[1])

    return MASKS[LANES](x, y), generate


@intrinsic
def _times_power_of_two(_typing: Any, value: Any, whole: Any) -> Any:
    """Return value * 2**n, where n stands in the last bits of the float `whole` (1.5 * 2**23 + n).

    `value` and the result must be normal numbers.
    """

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        shift = integers(23, LANES)
        exponent = builder.shl(builder.bitcast(args[1], I32X16), shift)
        return builder.bitcast(builder.add(builder.bitcast(args[0], I32X16), exponent), F16)

    return value(value, whole), generate


@intrinsic
def _exponent(_typing: Any, x: Any) -> Any:
    """Return, as floats, the exponents of normal positive numbers m * 2**e, with m in [1, 2)."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        bits = builder.lshr(builder.bitcast(args[0], I32X16), integers(23, LANES))
        return builder.sitofp(builder.sub(bits, integers(127, LANES)), F16)

    return x(x), generate


@intrinsic
def _significand(_typing: Any, x: Any) -> Any:
    """Return the m of normal positive numbers m * 2**e, with m in [1, 2)."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        bits = builder.and_(builder.bitcast(args[0], I32X16), integers(0x7FFFFF, LANES))
        return builder.bitcast(builder.or_(bits, integers(0x3F800000, LANES)), F16)

    return x(x), generate


def _folding(operation: str) -> Any:
    @intrinsic
    def fold(_typing: Any, x: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            value, width = args[0], LANES
            while width > 1:
                half = width // 2
                undefined = ir.Constant(value.type, ir.Undefined)
                low = builder.shuffle_vector(value, undefined, lane_list(list(range(half))))
                high = builder.shuffle_vector(value, undefined, lane_list(list(range(half, width))))
                if operation == "sum":
                    value = builder.fadd(low, high)
                elif operation == "product":
                    value = builder.fmul(low, high)
                else:
                    is_low = builder.fcmp_ordered(operation, low, high)
                    value = builder.select(is_low, low, high)
                width = half
            return builder.extract_element(value, ir.Constant(I32, 0))

        return types.float32(Floats16), generate

    return fold


fold_sum, fold_product = _folding("sum"), _folding("product")
fold_max, fold_min = _folding(">"), _folding("<")


@inlined
def magnitude(x: Any) -> Any:
    """Return |x|; 0 of -0."""
    return where(x > 0.0, x, 0.0 - x)


@inlined
def exp16(x: Any) -> Any:
    """Return e**x: 0 below -87.3, inf above 88.7, NaN of NaN."""
    t = fused(x, 1.44269504088896341, 12582912.0)
    n = t - 12582912.0
    r = fused(n, -0.693359375, x)
    r = fused(n, 2.12194440e-4, r)
    p = fused(r, 1.9875691500e-4, 1.3981999507e-3)
    p = fused(p, r, 8.3334519073e-3)
    p = fused(p, r, 4.1665795894e-2)
    p = fused(p, r, 1.6666665459e-1)
    p = fused(p, r, 5.0000001201e-1)
    p = fused(p, r * r, r) + 1.0
    y = _times_power_of_two(p, t)
    y = where(x > 88.7, x * 1e38, y)
    y = where(x < -87.3, 0.0, y)
    return where(same(x, x), y, x)


@inlined
def log16(x: Any) -> Any:
    """Return the natural logarithm: -inf of 0 and of denormals, NaN below 0, inf of inf."""
    e, m = _exponent(x), _significand(x)
    large = m > 1.41421356
    m = where(large, m * 0.5, m) - 1.0
    e = where(large, e + 1.0, e)
    p = fused(m, 7.0376836292e-2, -1.1514610310e-1)
    p = fused(p, m, 1.1676998740e-1)
    p = fused(p, m, -1.2420140846e-1)
    p = fused(p, m, 1.4249322787e-1)
    p = fused(p, m, -1.6668057665e-1)
    p = fused(p, m, 2.0000714765e-1)
    p = fused(p, m, -2.4999993993e-1)
    p = fused(p, m, 3.3333331174e-1)
    square = m * m
    y = p * m * square
    y = fused(e, -2.12194440e-4, y)
    y = fused(square, -0.5, y)
    y = fused(e, 0.693359375, m + y)
    zero = x - x
    y = where(x < 1.17549435e-38, -1.0 / zero, y)  # -inf
    y = where(x < 0.0, zero / zero, y)  # NaN
    return where(x <= 3.4028234e38, y, x)  # inf and NaN stay


@inlined
def expm1_16(x: Any) -> Any:
    """Return e**x - 1 for x <= 0, without cancellation near 0."""
    # Up to -0.25 the difference loses at most two bits; nearer to 0 the series is used.
    p = fused(x, 1.9841270e-4, 1.3888889e-3)
    p = fused(p, x, 8.3333333e-3)
    p = fused(p, x, 4.1666667e-2)
    p = fused(p, x, 1.6666667e-1)
    p = fused(p, x, 0.5)
    near = fused(p * x, x, x)
    return where(x > -0.25, near, exp16(x) - 1.0)


@inlined
def tanh16(x: Any) -> Any:
    """Return the hyperbolic tangent by the rational function of Eigen."""
    c = where(x < -9.0, -9.0, x)
    c = where(c > 9.0, 9.0, c)
    s = c * c
    p = fused(s, -2.76076847742355e-16, 2.00018790482477e-13)
    p = fused(p, s, -8.60467152213735e-11)
    p = fused(p, s, 5.12229709037114e-08)
    p = fused(p, s, 1.48572235717979e-05)
    p = fused(p, s, 6.37261928875436e-04)
    p = fused(p, s, 4.89352455891786e-03)
    q = fused(s, 1.19825839466702e-06, 1.18534705686654e-04)
    q = fused(q, s, 2.26843463243900e-03)
    q = fused(q, s, 4.89352518554385e-03)
    return c * p / q


@inlined
def sigmoid16(x: Any) -> Any:
    """Return 1 / (1 + e**-x)."""
    return 1.0 / (exp16(0.0 - x) + 1.0)


@inlined
def softplus16(x: Any) -> Any:
    """Return log(1 + e**x), without overflow."""
    # log1p(u) = log(1 + u) * u / ((1 + u) - 1): exact where 1 + u loses bits of u.
    u = exp16(0.0 - magnitude(x))
    w = u + 1.0
    d = w - 1.0
    tiny = same(d, d - d)
    y = where(tiny, u, log16(w) * u / where(tiny, 1.0 + d, d))
    return where(x > 0.0, x, 0.0 * u) + y


@inlined
def erf16(x: Any) -> Any:
    """Return the error function, by the polynomials of MLAS."""
    a = magnitude(x)
    a = where(a > 3.925, 3.925, a)
    s = a * a
    # |x| <= 0.921875: x + x * P(x**2).
    p = fused(s, -5.99104969e-4, 4.99339588e-3)
    p = fused(p, s, -2.67667342e-2)
    p = fused(p, s, 1.12818025e-1)
    p = fused(p, s, -3.76124859e-1)
    p = fused(p, s, 1.28379151e-1)
    small = fused(p, a, a)
    # Above: 1 - exp(-Q(|x|)).
    q = fused(a, 1.72948930e-5, -3.83208680e-4)
    q = fused(q, a, 3.88393435e-3)
    q = fused(q, a, -2.42545605e-2)
    q = fused(q, a, 1.06777847e-1)
    q = fused(q, a, 6.34846687e-1)
    q = fused(q, a, 1.28717512e-1)
    q = fused(q, a, a)
    big = 1.0 - exp16(negate(q))
    y = where(a <= 0.921875, small, big)
    y = where(x < 0.0, negate(y), y)
    return where(same(x, x), y, x)


@inlined
def round16(x: Any) -> Any:
    """Return the nearest whole number, half to even; large numbers are whole already."""
    whole = (magnitude(x) + 8388608.0) - 8388608.0
    whole = where(magnitude(x) < 8388608.0, whole, magnitude(x))
    y = where(x < 0.0, negate(whole), whole)
    return where(same(x, x), y, x)


@inlined
def _quarter(x: Any) -> Any:
    """Return what is left of angles beside whole quarter turns, and which quarter, modulo 4."""
    n = round16(x * 0.636619772)
    r = fused(n, -1.5707963705062866, x)
    r = fused(n, 4.371138828673793e-08, r)
    r = fused(n, 1.7151245100058819e-15, r)
    return r, n - 4.0 * floor(n * 0.25)


@inlined
def _sine_of(r: Any, quarter: Any) -> Any:
    s = r * r
    p = fused(s, -1.9515295891e-4, 8.3321608736e-3)
    p = fused(p, s, -1.6666654611e-1)
    sine = fused(p * s, r, r)
    q = fused(s, 2.443315711809948e-5, -1.388731625493765e-3)
    q = fused(q, s, 4.166664568298827e-2)
    cosine = fused(q * s, s, fused(s, -0.5, 1.0))
    is_odd = where(quarter > 1.5, quarter - 2.0, quarter) > 0.5
    y = where(is_odd, cosine, sine)
    return where(quarter > 1.5, negate(y), y)


@inlined
def sin16(x: Any) -> Any:
    """Return the sine; angles of over 10**6 rad lose bits."""
    r, quarter = _quarter(x)
    return _sine_of(r, quarter)


@inlined
def cos16(x: Any) -> Any:
    """Return the cosine; angles of over 10**6 rad lose bits."""
    r, quarter = _quarter(x)
    return _sine_of(r, where(quarter > 2.5, quarter - 3.0, quarter + 1.0))


@inlined
def floor16(x: Any) -> Any:
    """Return the greatest whole number not above x."""
    return floor(x)
