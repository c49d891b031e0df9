"""Elementary functions on eight lanes, and the arithmetic of pixel sets."""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

import math
from typing import Any

from nw_eval.machine_code.jit import inlined
from nw_eval.splat.kernels.bits import exponent_shift, split_exponent
from nw_eval.splat.kernels.simd import Float8, call_llvm, constant8, floor, fma, intrinsic, minimum

# Least maximum relative error (9.1e-8) for 2**f on [-1/2, 1/2] with 2**0 exact, by Lawson's
# iteration; constant term first.
_EXP2 = (1.0, 0.6931469776, 0.2402224209, 0.05550733743, 0.009671512645, 0.001326472712)

# log2(m) = 2 / ln 2 * atanh(s), s = (m - 1) / (m + 1); |s| < 0.172, so the first term left out
# is below 1e-10. Factors of s, s**3, ..., s**9.
_LOG2 = tuple(2.0 / math.log(2.0) / odd for odd in (1, 3, 5, 7, 9))


def _horner(builder: Any, x: Any, coefficients: tuple[float, ...]) -> Any:
    total = constant8(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = call_llvm(builder, "fmuladd", total, x, constant8(coefficient))
    return total


@intrinsic
def exp2(_typing: Any, x: Any) -> Any:
    """Return 2**x for x in [-126, 126]; relative error below 2e-7."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        whole = call_llvm(builder, "rint", args[0])
        fraction = builder.fsub(args[0], whole)
        return exponent_shift(builder, _horner(builder, fraction, _EXP2), whole)

    return Float8(Float8), generate


@intrinsic
def log2(_typing: Any, x: Any) -> Any:
    """Return the base-2 logarithm of normal x > 0; absolute error below 2e-7 + 1e-7 |log2 x|."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        exponent, mantissa = split_exponent(builder, args[0])
        one = constant8(1.0)
        s = builder.fdiv(builder.fsub(mantissa, one), builder.fadd(mantissa, one))
        series = _horner(builder, builder.fmul(s, s), _LOG2)
        return call_llvm(builder, "fmuladd", s, series, exponent)

    return Float8(Float8), generate


@inlined
def taken_below(pixel: Any, stride: Any, inverse_stride: Any, offset: Any, block: Any) -> Any:
    """Return how many pixels of a pixel set lie before the whole-valued index `pixel`.

    The set takes `block` pixels from `offset` on in each cell of `stride` (all floats). The half
    added before the division keeps the quotient off whole numbers, where rounding would decide.
    """
    within = pixel - offset
    cell = floor((within + 0.5) * inverse_stride)
    rest = minimum(fma(cell, -stride, within), block)
    return fma(cell, block, rest)
