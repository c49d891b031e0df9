"""Elementary functions on lanes, bit patterns of floats, and the clock of the stages.

Bit patterns: sort keys, packed ranges, exponents. Functions: exp2, log2, and the arithmetic of
pixel sets.
"""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils

from nw_base.machine_code import inlined
from nw_base.simd.lanes import (
    FLOAT,
    I32,
    I64,
    address,
    call_llvm,
    constant,
    floor,
    fma,
    integers,
    intrinsic,
    minimum,
)

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


@intrinsic
def bits_of(_typing: Any, value: Any) -> Any:
    """Return the bit pattern of a float32 as int32; order-preserving for non-negative floats."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], I32)

    return types.int32(types.float32), generate


@intrinsic
def float_of(_typing: Any, bits: Any) -> Any:
    """Return the float32 whose bit pattern is the low half of an int64."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(builder.trunc(args[0], I32), FLOAT)

    return types.float32(types.int64), generate


@intrinsic
def count_bits(_typing: Any, value: Any) -> Any:
    """Return how many bits of an int64 are set."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(I64, [I64]), "llvm.ctpop.i64"
        )
        return builder.call(function, [args[0]])

    return types.int64(types.int64), generate


@intrinsic
def word_at(_typing: Any, array: Any, place: Any) -> Any:
    """Return the 32 bits that begin with byte `place` of a uint8 array, as a non-negative int64."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        byte = address(context, builder, signature.args[0], args[0], args[1])
        word = builder.load(builder.bitcast(byte, I32.as_pointer()), align=1)
        return builder.zext(word, I64)

    return types.int64(array, types.intp), generate


@intrinsic
def pack_range(_typing: Any, first: Any, last: Any) -> Any:
    """Return int(first) | int(last) << 16 as bits; both whole and within 0..32767."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        shift = integers(16, first.lanes)
        low, high = (builder.fptosi(value, shift.type) for value in args)
        return builder.bitcast(builder.or_(low, builder.shl(high, shift)), args[0].type)

    return first(first, last), generate


def exponent_shift(builder: Any, value: Any, whole: Any) -> Any:
    """Return value * 2**n by adding to the exponent bits; n stands in the last bits of `whole`."""
    shift = integers(23, value.type.count)
    exponent = builder.shl(builder.bitcast(whole, shift.type), shift)
    return builder.bitcast(builder.add(builder.bitcast(value, shift.type), exponent), value.type)


def split_exponent(builder: Any, value: Any) -> tuple[Any, Any]:
    """Return (e, m) with value = m * 2**e and m in [sqrt(1/2), sqrt(2)) (IR; value is normal)."""
    lanes = value.type.count
    lift = integers(0x3F800000 - 0x3F3504F3, lanes)
    bits = builder.add(builder.bitcast(value, lift.type), lift)
    exponent = builder.sub(builder.ashr(bits, integers(23, lanes)), integers(127, lanes))
    fraction = builder.and_(bits, integers(0x7FFFFF, lanes))
    mantissa = builder.add(fraction, integers(0x3F3504F3, lanes))
    return builder.sitofp(exponent, value.type), builder.bitcast(mantissa, value.type)


@intrinsic
def clock_nanoseconds(_typing: Any, clock: Any) -> Any:
    """Return POSIX clock_gettime(clock) in nanoseconds, for the table of stages."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        spec = cgutils.alloca_once(builder, ir.ArrayType(I64, 2))
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(I32, [I32, spec.type]), "clock_gettime"
        )
        builder.call(function, [builder.trunc(args[0], I32), spec])
        seconds, nanoseconds = (builder.extract_value(builder.load(spec), i) for i in (0, 1))
        return builder.add(builder.mul(seconds, ir.Constant(I64, 1_000_000_000)), nanoseconds)

    return types.int64(types.int64), generate


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
