"""Eight or sixteen float32 lanes as a Numba type: `Float8`, `Floats16`, and their masks.

The operations are written as LLVM IR on generic types such as <8 x float> and <8 x i1>, so that
LLVM picks the instructions of the machine (AVX2, AVX-512, NEON) and no C compiler is needed. Where
no register holds sixteen lanes, LLVM takes two: a lane gets the same bits either way. No fast-math
flag is set anywhere: results do not depend on what LLVM would like to reassociate.

This file has the types, their operators and masks; memory.py has loads and stores.
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

FLOAT = ir.FloatType()
I1, I8, I32, I64 = ir.IntType(1), ir.IntType(8), ir.IntType(32), ir.IntType(64)
F8, F16 = ir.VectorType(FLOAT, LANES), ir.VectorType(FLOAT, 2 * LANES)
I32X16 = ir.VectorType(I32, 2 * LANES)
I16X16 = ir.VectorType(ir.IntType(16), 2 * LANES)
HALF16 = ir.VectorType(ir.HalfType(), 2 * LANES)


class FloatsType(types.Type):
    """Type of some float32 lanes."""

    def __init__(self, lanes: int) -> None:
        super().__init__(f"Float{lanes}")
        self.lanes = lanes


class MaskType(types.Type):
    """Type of as many booleans, the result of comparing two of them."""

    def __init__(self, lanes: int) -> None:
        super().__init__(f"Mask{lanes}")
        self.lanes = lanes


Float8, Floats16 = FloatsType(8), FloatsType(16)
MASKS = {lanes: MaskType(lanes) for lanes in (4, 8, 16, 32, 64, 128)}


@register_model(FloatsType)
class _FloatsModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, ir.VectorType(FLOAT, fe_type.lanes))


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, ir.VectorType(I1, fe_type.lanes))


# --- pieces of IR ------------------------------------------------------------------------------


def lane_list(values: list[int]) -> Any:
    """Return the IR constant that a shuffle takes."""
    return ir.Constant(ir.VectorType(I32, len(values)), values)


def constant(value: float, lanes: int = LANES) -> Any:
    """Return the IR constant of equal floats."""
    return ir.Constant(ir.VectorType(FLOAT, lanes), [value] * lanes)


def integers(value: int, lanes: int) -> Any:
    """Return the IR constant of equal 32-bit integers."""
    return ir.Constant(ir.VectorType(I32, lanes), [value] * lanes)


def broadcast_ir(builder: Any, scalar: Any, lanes: int = LANES) -> Any:
    """Return lanes of one IR float."""
    undefined = ir.Constant(ir.VectorType(FLOAT, lanes), ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(I32, 0))
    return builder.shuffle_vector(first, undefined, lane_list([0] * lanes))


def joined(builder: Any, parts: list[Any]) -> Any:
    """Return the lanes of equal vectors, a power of two of them, one behind the other (IR)."""
    while len(parts) > 1:
        lanes = lane_list(list(range(2 * parts[0].type.count)))
        pairs = zip(parts[::2], parts[1::2], strict=True)
        parts = [builder.shuffle_vector(a, b, lanes) for a, b in pairs]
    return parts[0]


def _is_vector(value: Any) -> bool:
    return isinstance(value, FloatsType)


def _floats_of(*values: Any) -> Any:
    """Return the vector type among types."""
    return next(value for value in values if _is_vector(value))


def _vector_or_float(value: Any) -> Any:
    return value if _is_vector(value) else types.float32


def _widen(builder: Any, value: Any, numba_type: Any, wanted: Any) -> Any:
    return value if _is_vector(numba_type) else broadcast_ir(builder, value, wanted.lanes)


def address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Return the IR pointer to element `index` of an array or of its `elements`, unchecked."""
    if isinstance(array_type, types.Array):
        array = context.make_array(array_type)(context, builder, array).data
    return builder.gep(array, [index])


def call_llvm(builder: Any, name: str, *values: Any) -> Any:
    """Call an LLVM intrinsic whose operands and result are all of one vector type."""
    kind = values[0].type
    signature = ir.FunctionType(kind, [kind] * len(values))
    name = f"llvm.{name}.v{kind.count}f32"
    function = cgutils.get_or_insert_function(builder.module, signature, name)
    return builder.call(function, list(values))


# --- making, loading, storing ------------------------------------------------------------------


def _broadcasting(kind: FloatsType) -> Any:
    @intrinsic
    def fill(_typing: Any, value: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            return broadcast_ir(builder, args[0], kind.lanes)

        return kind(types.float32), generate

    return fill


broadcast8, broadcast = map(_broadcasting, (Float8, Floats16))
"""(value): eight lanes, or sixteen, that all hold one float."""


# --- arithmetic --------------------------------------------------------------------------------


def _arithmetic(python_operator: Callable[..., Any], instruction: str) -> None:
    @intrinsic
    def combine(_typing: Any, left: Any, right: Any) -> Any:
        def generate(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.return_type
            operands = [
                _widen(builder, a, t, kind) for a, t in zip(args, signature.args, strict=True)
            ]
            return getattr(builder, instruction)(*operands)

        kind = _floats_of(left, right)
        return kind(_vector_or_float(left), _vector_or_float(right)), generate

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
            limit = _widen(builder, args[1], signature.args[1], left)
            return builder.fcmp_ordered(sign, args[0], limit)

        return MASKS[left.lanes](left, _vector_or_float(right)), generate

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


def _multiply_add(name: str, text: str) -> Any:
    @intrinsic
    def apply(_typing: Any, x: Any, y: Any, z: Any) -> Any:
        def generate(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = signature.return_type
            pairs = zip(args, signature.args, strict=True)
            return call_llvm(builder, name, *[_widen(builder, a, t, kind) for a, t in pairs])

        kind = _floats_of(x, y, z)
        return kind(_vector_or_float(x), _vector_or_float(y), _vector_or_float(z)), generate

    apply.__doc__ = text
    return apply


fma = _multiply_add("fmuladd", "Return x * y + z, rounded once where the machine can.")
fused = _multiply_add("fma", "Return x * y + z, rounded once: without the instruction, by libm.")


@intrinsic
def negate(_typing: Any, x: Any) -> Any:
    """Return -x; exact."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.fneg(args[0])

    return x(x), generate


@intrinsic
def minus_abs(_typing: Any, x: Any) -> Any:
    """Return -|x|; exact."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        sign = integers(0x80000000, x.lanes)
        signed = builder.or_(builder.bitcast(args[0], sign.type), sign)
        return builder.bitcast(signed, args[0].type)

    return x(x), generate


def _unary(name: str, text: str) -> Any:
    @intrinsic
    def apply(_typing: Any, x: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            return call_llvm(builder, name, args[0])

        return x(x), generate

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
            limit = _widen(builder, args[1], signature.args[1], x)
            return builder.select(builder.fcmp_ordered(sign, args[0], limit), args[0], limit)

        return x(x, _vector_or_float(bound)), generate

    return apply


minimum = _extreme("<")
maximum = _extreme(">")


# --- masks -------------------------------------------------------------------------------------


@intrinsic
def _both(_typing: Any, left: Any, right: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.and_(args[0], args[1])

    return left(left, right), generate


@overload(operator.and_)
def _and(left: Any, right: Any) -> Any:
    if isinstance(left, MaskType) and isinstance(right, MaskType):

        def implement(left: Any, right: Any) -> Any:
            return _both(left, right)

        return implement
    return None


@intrinsic
def mask_bits(_typing: Any, mask: Any) -> Any:
    """Return the lanes of a mask as the low bits of an int64."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(mask.lanes)), I64)

    return types.int64(mask), generate


@intrinsic
def sign_bits(_typing: Any, x: Any) -> Any:
    """Return the signs of lanes as the low bits of an int64; 1 is negative."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        zero = integers(0, x.lanes)
        signs = builder.icmp_signed("<", builder.bitcast(args[0], zero.type), zero)
        return builder.zext(builder.bitcast(signs, ir.IntType(x.lanes)), I64)

    return types.int64(x), generate


@intrinsic
def where(_typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    """Return yes in the lanes that are set, no in the others."""
    kind = _floats_of(yes, no)

    def generate(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
        chosen = [_widen(builder, args[i], signature.args[i], kind) for i in (1, 2)]
        return builder.select(args[0], *chosen)

    return kind(mask, _vector_or_float(yes), _vector_or_float(no)), generate


@intrinsic
def lowest_bit(_typing: Any, bits: Any) -> Any:
    """Return the position of the lowest bit of an int64 that is set; 64 if none is."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(I1, 0))

    return types.int64(types.int64), generate
