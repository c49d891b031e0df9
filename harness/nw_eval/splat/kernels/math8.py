"""Elementary functions on lanes, and the arithmetic of pixel sets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from numba.core import cgutils

from nw_eval.machine_code.jit import inlined
from nw_eval.splat.kernels.bits import exponent_shift, split_exponent
from nw_eval.splat.kernels.simd import call_llvm, constant, floor, fma, intrinsic, minimum

EXP2 = (
    1.5 * 2.0**23,
    1.0,
    0.6931469776,
    0.2402224209,
    0.05550733743,
    0.009671512645,
    0.001326472712,
)
"""What `exp2` works with. First what makes a float32 round to a whole number, as there are no bits
for a fraction at its size; then the series, constant term first: least maximum relative error
(9.1e-8) for 2**f on [-1/2, 1/2] with 2**0 exact, by Lawson's iteration."""

# log2(m) = 2 / ln 2 * atanh(s), s = (m - 1) / (m + 1); |s| < 0.172, so the first term left out
# is below 1e-10. Factors of s, s**3, ..., s**9.
_LOG2 = tuple(2.0 / math.log(2.0) / odd for odd in (1, 3, 5, 7, 9))


def _horner(builder: Any, x: Any, coefficients: Sequence[Any]) -> Any:
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = call_llvm(builder, "fmuladd", total, x, coefficient)
    return total


@intrinsic
def exp2(_typing: Any, x: Any, numbers: Any) -> Any:
    """Return 2**x for x in [-126, 126]; relative error below 2e-7.

    `numbers` are those of `EXP2` in lanes. They come from outside a loop, since LLVM would write
    constants into it, each with an address of eight bytes to be loaded anew for every vector.
    """

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        whole, *series = cgutils.unpack_tuple(builder, args[1])
        shifted = builder.fadd(args[0], whole)
        fraction = builder.fsub(args[0], builder.fsub(shifted, whole))
        return exponent_shift(builder, _horner(builder, fraction, series), shifted)

    return x(x, numbers), generate


@intrinsic
def log2(_typing: Any, x: Any) -> Any:
    """Return the base-2 logarithm of normal x > 0; absolute error below 2e-7 + 1e-7 |log2 x|."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        exponent, mantissa = split_exponent(builder, args[0])
        one = constant(1.0, x.lanes)
        s = builder.fdiv(builder.fsub(mantissa, one), builder.fadd(mantissa, one))
        factors = [constant(factor, x.lanes) for factor in _LOG2]
        series = _horner(builder, builder.fmul(s, s), factors)
        return call_llvm(builder, "fmuladd", s, series, exponent)

    return x(x), generate


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
