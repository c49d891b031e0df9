"""Bit patterns of floats: sort keys, packed ranges, exponents; and the clock of the stages."""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils

from nw_eval.splat.kernels.simd import FLOAT, I32, I64, address, integers, intrinsic


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
