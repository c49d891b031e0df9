"""Loads and stores of lanes and of single elements.

Arrays are one-dimensional; loads and stores are unaligned and unchecked, and indices count
elements. Callers leave eight elements of slack behind every array that they read in vectors.
"""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

import platform
from typing import Any

import numba.core.config
from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba import types
from numba.core import cgutils

from nw_base.simd.lanes import (
    F8,
    F16,
    HALF16,
    I8,
    I16X16,
    I32,
    I32X16,
    Float8,
    Floats16,
    address,
    constant,
    integers,
    intrinsic,
)


def _converts_halves() -> bool:
    """Tell whether the target has an instruction for float16; without one LLVM calls a library."""
    if platform.machine().lower() in {"aarch64", "arm64"}:
        return True
    config: Any = numba.core.config
    features = config.CPU_FEATURES
    if features is None:
        features = get_host_cpu_features().flatten()
    return "+f16c" in features.split(",")


_CONVERTS_HALVES = _converts_halves()


def _widen_halves(builder: Any, bits: Any) -> Any:
    """Return finite float16 bits as float32 by integer operations (IR).

    Exponent and fraction move to their places in a float32; the exponent then is 112 too small,
    which a multiplication mends, for denormals too.
    """
    lanes = bits.type.count
    factor = constant(2.0**112, lanes)
    magnitude = builder.shl(builder.and_(bits, integers(0x7FFF, lanes)), integers(13, lanes))
    value = builder.fmul(builder.bitcast(magnitude, factor.type), factor)
    sign = builder.shl(builder.and_(bits, integers(0x8000, lanes)), integers(16, lanes))
    return builder.bitcast(builder.or_(builder.bitcast(value, bits.type), sign), factor.type)


@intrinsic
def elements(_typing: Any, array: Any) -> Any:
    """Return where the elements of an array lie: the functions here take it for the array.

    Numba counts references to an array where an inlined function takes it, which in a loop costs
    two calls a turn, with all vectors saved around each. Whoever calls keeps the array alive.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, args[0]).data

    return types.CPointer(array.dtype)(array), generate


@intrinsic
def load(_typing: Any, array: Any, index: Any) -> Any:
    """Return eight floats of a float32 array, the first at `index`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = address(context, builder, signature.args[0], args[0], args[1])
        return builder.load(builder.bitcast(place, F8.as_pointer()), align=4)

    return Float8(array, types.intp), generate


def _storing(kind: Any, vector: Any) -> Any:
    @intrinsic
    def store(_typing: Any, array: Any, index: Any, value: Any) -> Any:
        """Write lanes to a float32 array, the first at `index`."""

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            place = address(context, builder, signature.args[0], args[0], args[1])
            builder.store(args[2], builder.bitcast(place, vector.as_pointer()), align=4)
            return context.get_dummy_value()

        return types.void(array, types.intp, kind), generate

    return store


store, store_group = _storing(Float8, F8), _storing(Floats16, F16)
"""Write eight floats, or sixteen."""


@intrinsic
def load_group(_typing: Any, array: Any, index: Any) -> Any:
    """Return sixteen floats of a float32 array, the first at `index`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _loaded(context, builder, signature, args, F16, 4)

    return Floats16(array, types.intp), generate


@intrinsic
def load_halves(_typing: Any, array: Any, index: Any) -> Any:
    """Return sixteen float16, held as bits in a uint16 array, the first at `index`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if _CONVERTS_HALVES:
            return builder.fpext(_loaded(context, builder, signature, args, HALF16, 2), F16)
        words = _loaded(context, builder, signature, args, I16X16, 2)
        return _widen_halves(builder, builder.zext(words, I32X16))

    return Floats16(array, types.intp), generate


def _loaded(context: Any, builder: Any, signature: Any, args: Any, kind: Any, align: int) -> Any:
    place = address(context, builder, signature.args[0], args[0], args[1])
    return builder.load(builder.bitcast(place, kind.as_pointer()), align=align)


@intrinsic
def peek(_typing: Any, array: Any, index: Any) -> Any:
    """Return array[index] without the wrap-around of negative indices."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = address(context, builder, signature.args[0], args[0], args[1])
        return context.unpack_value(builder, signature.args[0].dtype, place)

    return array.dtype(array, types.intp), generate


@intrinsic
def poke(_typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Write array[index] without the wrap-around of negative indices."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = address(context, builder, signature.args[0], args[0], args[1])
        context.pack_value(builder, signature.args[0].dtype, args[2], place)
        return context.get_dummy_value()

    return types.void(array, types.intp, array.dtype), generate


def _prefetching(locality: int) -> Any:
    @intrinsic
    def prefetch(_typing: Any, array: Any, index: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            place = address(context, builder, signature.args[0], args[0], args[1])
            byte = builder.bitcast(place, I8.as_pointer())
            function = cgutils.get_or_insert_function(
                builder.module,
                ir.FunctionType(ir.VoidType(), [byte.type, I32, I32, I32]),
                "llvm.prefetch.p0",
            )
            read, keep, data = (ir.Constant(I32, value) for value in (0, locality, 1))
            builder.call(function, [byte, read, keep, data])
            return context.get_dummy_value()

        return types.void(array, types.intp), generate

    return prefetch


prefetch, prefetch_early = _prefetching(3), _prefetching(2)
"""(array, index): ask for the cache line that holds array[index]; any index is harmless. The first
brings it to the nearest cache, for use at once; the second to the one behind, where more can wait.
"""
