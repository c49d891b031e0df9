"""Eight float32 lanes as a Numba type: `Float8`, its comparison result `Mask8`, and their moves.

The operations are written as LLVM IR on the generic types <8 x float> and <8 x i1>, so that LLVM
picks the instructions of the machine (AVX2, AVX-512, NEON) and no C compiler is needed. No
fast-math flag is set anywhere: results do not depend on what LLVM would like to reassociate.

Arrays are one-dimensional; loads and stores are unaligned and unchecked, and indices count
elements. Callers leave eight elements of slack behind every array that they read in vectors.
"""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numba.extending
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import models, overload, register_model

intrinsic: Any = numba.extending.intrinsic

LANES = 8

_FLOAT = ir.FloatType()
_I1, _I8, _I32, _I64 = ir.IntType(1), ir.IntType(8), ir.IntType(32), ir.IntType(64)
_F4 = ir.VectorType(_FLOAT, 4)
_F8 = ir.VectorType(_FLOAT, LANES)
_I32x8 = ir.VectorType(_I32, LANES)
_HALF8 = ir.VectorType(ir.HalfType(), LANES)
_MASK8 = ir.VectorType(_I1, LANES)


class Float8Type(types.Type):
    """Type of eight float32 lanes."""

    def __init__(self) -> None:
        super().__init__("Float8")


class Mask8Type(types.Type):
    """Type of eight booleans, the result of comparing two Float8."""

    def __init__(self) -> None:
        super().__init__("Mask8")


Float8 = Float8Type()
Mask8 = Mask8Type()


@register_model(Float8Type)
class _Float8Model(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _F8)


@register_model(Mask8Type)
class _Mask8Model(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _MASK8)


# --- pieces of IR ------------------------------------------------------------------------------


def _indices(values: list[int]) -> Any:
    return ir.Constant(ir.VectorType(_I32, len(values)), values)


def constant8(value: float) -> Any:
    """Return the IR constant of eight equal floats."""
    return ir.Constant(_F8, [value] * LANES)


def _broadcast(builder: Any, scalar: Any) -> Any:
    undefined = ir.Constant(_F8, ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(_I32, 0))
    return builder.shuffle_vector(first, undefined, _indices([0] * LANES))


def _is_vector(value: Any) -> bool:
    return isinstance(value, Float8Type)


def _vector_or_float(value: Any) -> Any:
    return Float8 if _is_vector(value) else types.float32


def _widen(builder: Any, value: Any, numba_type: Any) -> Any:
    return value if _is_vector(numba_type) else _broadcast(builder, value)


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


def call_llvm(builder: Any, name: str, *values: Any) -> Any:
    """Call an LLVM intrinsic whose operands and result are all Float8."""
    signature = ir.FunctionType(_F8, [_F8] * len(values))
    function = cgutils.get_or_insert_function(builder.module, signature, f"llvm.{name}.v8f32")
    return builder.call(function, list(values))


# --- making, loading, storing ------------------------------------------------------------------


@intrinsic
def broadcast(_typing: Any, value: Any) -> Any:
    """Return a Float8 whose lanes all hold one float."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return _broadcast(builder, args[0])

    return Float8(types.float32), generate


@intrinsic
def halves(_typing: Any, upper: Any, lower: Any) -> Any:
    """Return a Float8 with one float in lanes 0..3 and another in 4..7."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        pair = builder.insert_element(_broadcast(builder, args[0]), args[1], ir.Constant(_I32, 1))
        undefined = ir.Constant(_F8, ir.Undefined)
        return builder.shuffle_vector(pair, undefined, _indices([0] * 4 + [1] * 4))

    return Float8(types.float32, types.float32), generate


@intrinsic
def lane_numbers(_typing: Any) -> Any:
    """Return the Float8 (0, 1, ..., 7)."""

    def generate(_context: Any, _builder: Any, _signature: Any, _args: Any) -> Any:
        return ir.Constant(_F8, [float(lane) for lane in range(LANES)])

    return Float8(), generate


@intrinsic
def load(_typing: Any, array: Any, index: Any) -> Any:
    """Return eight floats of a float32 array, the first at `index`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _address(context, builder, signature.args[0], args[0], args[1])
        return builder.load(builder.bitcast(place, _F8.as_pointer()), align=4)

    return Float8(array, types.intp), generate


@intrinsic
def store(_typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Write a Float8 to array[index : index + 8]."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _address(context, builder, signature.args[0], args[0], args[1])
        builder.store(args[2], builder.bitcast(place, _F8.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, Float8), generate


@intrinsic
def load_rows(_typing: Any, array: Any, upper: Any, lower: Any) -> Any:
    """Return array[upper : upper + 4] in lanes 0..3 and array[lower : lower + 4] in 4..7."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        halves: list[Any] = []
        for index in args[1:]:
            place = _address(context, builder, signature.args[0], args[0], index)
            halves.append(builder.load(builder.bitcast(place, _F4.as_pointer()), align=4))
        return builder.shuffle_vector(halves[0], halves[1], _indices(list(range(LANES))))

    return Float8(array, types.intp, types.intp), generate


@intrinsic
def store_rows(_typing: Any, array: Any, upper: Any, lower: Any, value: Any) -> Any:
    """Write lanes 0..3 to array[upper : upper + 4] and 4..7 to array[lower : lower + 4]."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        undefined = ir.Constant(_F8, ir.Undefined)
        for index, lanes in ((args[1], [0, 1, 2, 3]), (args[2], [4, 5, 6, 7])):
            half = builder.shuffle_vector(args[3], undefined, _indices(lanes))
            place = _address(context, builder, signature.args[0], args[0], index)
            builder.store(half, builder.bitcast(place, _F4.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, Float8), generate


@intrinsic
def load_halves(_typing: Any, array: Any, index: Any) -> Any:
    """Return eight float16, held as bits in a uint16 array, as a Float8."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _address(context, builder, signature.args[0], args[0], args[1])
        halves = builder.load(builder.bitcast(place, _HALF8.as_pointer()), align=2)
        return builder.fpext(halves, _F8)

    return Float8(array, types.intp), generate


@intrinsic
def peek(_typing: Any, array: Any, index: Any) -> Any:
    """Return array[index] without the wrap-around of negative indices."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _address(context, builder, signature.args[0], args[0], args[1])
        return context.unpack_value(builder, signature.args[0].dtype, place)

    return array.dtype(array, types.intp), generate


@intrinsic
def poke(_typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Write array[index] without the wrap-around of negative indices."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _address(context, builder, signature.args[0], args[0], args[1])
        context.pack_value(builder, signature.args[0].dtype, args[2], place)
        return context.get_dummy_value()

    return types.void(array, types.intp, array.dtype), generate


@intrinsic
def prefetch(_typing: Any, array: Any, index: Any) -> Any:
    """Ask for the cache line that holds array[index]; any index is harmless."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _address(context, builder, signature.args[0], args[0], args[1])
        byte = builder.bitcast(place, _I8.as_pointer())
        function = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(ir.VoidType(), [byte.type, _I32, _I32, _I32]),
            "llvm.prefetch.p0",
        )
        read, keep, data = ir.Constant(_I32, 0), ir.Constant(_I32, 3), ir.Constant(_I32, 1)
        builder.call(function, [byte, read, keep, data])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


# --- arithmetic --------------------------------------------------------------------------------


def _arithmetic(python_operator: Callable[..., Any], instruction: str) -> None:
    @intrinsic
    def combine(_typing: Any, left: Any, right: Any) -> Any:
        def generate(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
            operands = [_widen(builder, a, t) for a, t in zip(args, signature.args, strict=True)]
            return getattr(builder, instruction)(*operands)

        return Float8(_vector_or_float(left), _vector_or_float(right)), generate

    @overload(python_operator)
    def choose(left: Any, right: Any) -> Any:
        if _is_vector(left) or _is_vector(right):

            def implement(left: Any, right: Any) -> Any:
                return combine(left, right)

            return implement
        return None


_arithmetic(operator.add, "fadd")
_arithmetic(operator.sub, "fsub")
_arithmetic(operator.mul, "fmul")
_arithmetic(operator.truediv, "fdiv")


def _comparison(python_operator: Callable[..., Any], sign: str) -> None:
    @intrinsic
    def compare(_typing: Any, left: Any, right: Any) -> Any:
        def generate(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.fcmp_ordered(sign, args[0], _widen(builder, args[1], signature.args[1]))

        return Mask8(Float8, _vector_or_float(right)), generate

    @overload(python_operator)
    def choose(left: Any, right: Any) -> Any:
        if _is_vector(left):

            def implement(left: Any, right: Any) -> Any:
                return compare(left, right)

            return implement
        return None


_comparison(operator.lt, "<")
_comparison(operator.le, "<=")
_comparison(operator.gt, ">")
_comparison(operator.ge, ">=")


@intrinsic
def fma(_typing: Any, x: Any, y: Any, z: Any) -> Any:
    """Return x * y + z, rounded once where the machine can."""

    def generate(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
        operands = [_widen(builder, a, t) for a, t in zip(args, signature.args, strict=True)]
        return call_llvm(builder, "fmuladd", *operands)

    return Float8(_vector_or_float(x), _vector_or_float(y), _vector_or_float(z)), generate


@intrinsic
def negate(_typing: Any, x: Any) -> Any:
    """Return -x; exact."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.fneg(args[0])

    return Float8(Float8), generate


def _unary(name: str, text: str) -> Any:
    @intrinsic
    def apply(_typing: Any, x: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            return call_llvm(builder, name, args[0])

        return Float8(Float8), generate

    apply.__doc__ = text
    return apply


sqrt = _unary("sqrt", "Return the square root, correctly rounded.")
ceil = _unary("ceil", "Return the least integer not below x.")
floor = _unary("floor", "Return the greatest integer not above x.")


def _extreme(sign: str) -> Any:
    # The one-instruction minimum: the second operand is returned when the first is NaN, so that
    # clamping a NaN gives the bound.
    @intrinsic
    def apply(_typing: Any, x: Any, bound: Any) -> Any:
        def generate(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
            limit = _widen(builder, args[1], signature.args[1])
            return builder.select(builder.fcmp_ordered(sign, args[0], limit), args[0], limit)

        return Float8(Float8, _vector_or_float(bound)), generate

    return apply


minimum = _extreme("<")
maximum = _extreme(">")


# --- masks -------------------------------------------------------------------------------------


@intrinsic
def _both(_typing: Any, left: Any, right: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.and_(args[0], args[1])

    return Mask8(Mask8, Mask8), generate


@overload(operator.and_)
def _and(left: Any, right: Any) -> Any:
    if isinstance(left, Mask8Type) and isinstance(right, Mask8Type):

        def implement(left: Any, right: Any) -> Any:
            return _both(left, right)

        return implement
    return None


@intrinsic
def and_not(_typing: Any, left: Any, right: Any) -> Any:
    """Return the lanes set in left and not in right."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.and_(args[0], builder.not_(args[1]))

    return Mask8(Mask8, Mask8), generate


@intrinsic
def mask_bits(_typing: Any, mask: Any) -> Any:
    """Return the lanes of a Mask8 as the low eight bits of an int64."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], _I8), _I64)

    return types.int64(Mask8), generate


@intrinsic
def where(_typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    """Return yes in the lanes that are set, no in the others."""

    def generate(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
        chosen = [_widen(builder, args[i], signature.args[i]) for i in (1, 2)]
        return builder.select(args[0], *chosen)

    return Float8(Mask8, _vector_or_float(yes), _vector_or_float(no)), generate


# --- bits --------------------------------------------------------------------------------------


@intrinsic
def bits_of(_typing: Any, value: Any) -> Any:
    """Return the bit pattern of a float32 as int32; order-preserving for non-negative floats."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], _I32)

    return types.int32(types.float32), generate


@intrinsic
def float_of(_typing: Any, bits: Any) -> Any:
    """Return the float32 whose bit pattern is the low half of an int64."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(builder.trunc(args[0], _I32), _FLOAT)

    return types.float32(types.int64), generate


@intrinsic
def lowest_bit(_typing: Any, value: Any) -> Any:
    """Return the position of the lowest set bit of a non-zero int64."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_I64, [_I64, _I1]), "llvm.cttz.i64"
        )
        return builder.call(function, [args[0], ir.Constant(_I1, 1)])

    return types.int64(types.int64), generate


@intrinsic
def pack_range(_typing: Any, first: Any, last: Any) -> Any:
    """Return int(first) | int(last) << 16 as bits; both whole and within 0..32767."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        low, high = (builder.fptosi(value, _I32x8) for value in args)
        shift = ir.Constant(_I32x8, [16] * LANES)
        return builder.bitcast(builder.or_(low, builder.shl(high, shift)), _F8)

    return Float8(Float8, Float8), generate


def exponent_shift(builder: Any, value: Any, whole: Any) -> Any:
    """Return value * 2**whole by adding to the exponent bits (IR; whole is integral)."""
    shift = ir.Constant(_I32x8, [23] * LANES)
    exponent = builder.shl(builder.fptosi(whole, _I32x8), shift)
    return builder.bitcast(builder.add(builder.bitcast(value, _I32x8), exponent), _F8)


def split_exponent(builder: Any, value: Any) -> tuple[Any, Any]:
    """Return (e, m) with value = m * 2**e and m in [sqrt(1/2), sqrt(2)) (IR; value is normal)."""
    lift = ir.Constant(_I32x8, [0x3F800000 - 0x3F3504F3] * LANES)
    bits = builder.add(builder.bitcast(value, _I32x8), lift)
    bias = ir.Constant(_I32x8, [127] * LANES)
    exponent = builder.sub(builder.ashr(bits, ir.Constant(_I32x8, [23] * LANES)), bias)
    fraction = builder.and_(bits, ir.Constant(_I32x8, [0x7FFFFF] * LANES))
    mantissa = builder.add(fraction, ir.Constant(_I32x8, [0x3F3504F3] * LANES))
    return builder.sitofp(exponent, _F8), builder.bitcast(mantissa, _F8)


# --- records -----------------------------------------------------------------------------------

RECORD = 16
"""Floats in a record: one cache line."""


def _transpose(builder: Any, rows: list[Any]) -> list[Any]:
    """Transpose an 8x8 matrix held in eight vectors: three rounds of pairwise shuffles."""

    def mix(a: Any, b: Any, lanes: list[int]) -> Any:
        return builder.shuffle_vector(a, b, _indices(lanes))

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


@intrinsic
def append_records(_typing: Any, records: Any, count: Any, lanes: Any, fields: Any) -> Any:
    """Write one record of 16 floats for each set lane behind `count` records; return the new count.

    `fields` is a tuple of twelve Float8, the first twelve floats of a record. Every lane is
    written and the end advances for the set ones only: no branch. Leave eight records of slack.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values = list(cgutils.unpack_tuple(builder, args[3]))
        values += [ir.Constant(_F8, ir.Undefined)] * (RECORD - len(values))
        first, second = _transpose(builder, values[:8]), _transpose(builder, values[8:])
        end, one = args[1], ir.Constant(_I64, 1)
        for lane in range(LANES):
            start = builder.shl(end, ir.Constant(_I64, 4))
            place = _address(context, builder, signature.args[0], args[0], start)
            builder.store(first[lane], builder.bitcast(place, _F8.as_pointer()), align=4)
            place = builder.gep(place, [ir.Constant(_I64, LANES)])
            builder.store(second[lane], builder.bitcast(place, _F8.as_pointer()), align=4)
            chosen = builder.and_(builder.lshr(args[2], ir.Constant(_I64, lane)), one)
            end = builder.add(end, chosen)
        return end

    return types.int64(records, types.int64, types.int64, fields), generate


# --- time --------------------------------------------------------------------------------------


@intrinsic
def clock_nanoseconds(_typing: Any, clock: Any) -> Any:
    """Return POSIX clock_gettime(clock) in nanoseconds, for the table of stages."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        spec = cgutils.alloca_once(builder, ir.ArrayType(_I64, 2))
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_I32, [_I32, spec.type]), "clock_gettime"
        )
        builder.call(function, [builder.trunc(args[0], _I32), spec])
        seconds, nanoseconds = (builder.extract_value(builder.load(spec), i) for i in (0, 1))
        return builder.add(builder.mul(seconds, ir.Constant(_I64, 1_000_000_000)), nanoseconds)

    return types.int64(types.int64), generate
