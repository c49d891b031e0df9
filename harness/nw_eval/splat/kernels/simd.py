"""Eight float32 lanes as a Numba type: `Float8`, its comparison result `Mask8`, and their moves.

The operations are written as LLVM IR on the generic types <8 x float> and <8 x i1>, so that LLVM
picks the instructions of the machine (AVX2, AVX-512, NEON) and no C compiler is needed. No
fast-math flag is set anywhere: results do not depend on what LLVM would like to reassociate.

This room has the types, their operators and masks; memory.py, bits.py and records.py have the rest.
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
F4 = ir.VectorType(FLOAT, 4)
F8 = ir.VectorType(FLOAT, LANES)
I32X8 = ir.VectorType(I32, LANES)
I16X8 = ir.VectorType(ir.IntType(16), LANES)
HALF8 = ir.VectorType(ir.HalfType(), LANES)
_MASK8 = ir.VectorType(I1, LANES)


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
        super().__init__(manager, fe_type, F8)


@register_model(Mask8Type)
class _Mask8Model(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _MASK8)


# --- pieces of IR ------------------------------------------------------------------------------


def lane_list(values: list[int]) -> Any:
    """Return the IR constant that a shuffle takes."""
    return ir.Constant(ir.VectorType(I32, len(values)), values)


def constant8(value: float) -> Any:
    """Return the IR constant of eight equal floats."""
    return ir.Constant(F8, [value] * LANES)


def broadcast_ir(builder: Any, scalar: Any) -> Any:
    """Return eight lanes of one IR float."""
    undefined = ir.Constant(F8, ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(I32, 0))
    return builder.shuffle_vector(first, undefined, lane_list([0] * LANES))


def _is_vector(value: Any) -> bool:
    return isinstance(value, Float8Type)


def _vector_or_float(value: Any) -> Any:
    return Float8 if _is_vector(value) else types.float32


def _widen(builder: Any, value: Any, numba_type: Any) -> Any:
    return value if _is_vector(numba_type) else broadcast_ir(builder, value)


def address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Return the IR pointer to array[index], unchecked."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


def call_llvm(builder: Any, name: str, *values: Any) -> Any:
    """Call an LLVM intrinsic whose operands and result are all Float8."""
    signature = ir.FunctionType(F8, [F8] * len(values))
    function = cgutils.get_or_insert_function(builder.module, signature, f"llvm.{name}.v8f32")
    return builder.call(function, list(values))


# --- making, loading, storing ------------------------------------------------------------------


@intrinsic
def broadcast(_typing: Any, value: Any) -> Any:
    """Return a Float8 whose lanes all hold one float."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return broadcast_ir(builder, args[0])

    return Float8(types.float32), generate


@intrinsic
def halves(_typing: Any, upper: Any, lower: Any) -> Any:
    """Return a Float8 with one float in lanes 0..3 and another in 4..7."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        pair = builder.insert_element(broadcast_ir(builder, args[0]), args[1], ir.Constant(I32, 1))
        undefined = ir.Constant(F8, ir.Undefined)
        return builder.shuffle_vector(pair, undefined, lane_list([0] * 4 + [1] * 4))

    return Float8(types.float32, types.float32), generate


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
        return builder.zext(builder.bitcast(args[0], I8), I64)

    return types.int64(Mask8), generate


@intrinsic
def where(_typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    """Return yes in the lanes that are set, no in the others."""

    def generate(_context: Any, builder: Any, signature: Any, args: Any) -> Any:
        chosen = [_widen(builder, args[i], signature.args[i]) for i in (1, 2)]
        return builder.select(args[0], *chosen)

    return Float8(Mask8, _vector_or_float(yes), _vector_or_float(no)), generate
