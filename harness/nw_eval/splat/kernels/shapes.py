"""Sixteen pixels of the framebuffer at a time: 4x4, 8x2 or 16x1.

A framebuffer is two arrays, row by row with `stride` pixels in a row: `light`, one float for each
pixel, and `paint`, four: red, green, blue, depth. `place` counts pixels.
"""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from llvmlite import ir
from numba import types

from nw_eval.splat.kernels.simd import (
    FLOAT,
    I64,
    Floats16,
    address,
    call_llvm,
    intrinsic,
    lane_list,
)

PIXELS = 16
CHANNELS = 4


def _vector(lanes: int) -> Any:
    return ir.VectorType(FLOAT, lanes)


def _floats_at(builder: Any, pointer: Any, lanes: int) -> Any:
    return builder.bitcast(pointer, _vector(lanes).as_pointer())


def _joined(builder: Any, parts: list[Any]) -> Any:
    """Return the lanes of equal vectors, a power of two of them, one behind the other."""
    while len(parts) > 1:
        lanes = lane_list(list(range(2 * parts[0].type.count)))
        pairs = zip(parts[::2], parts[1::2], strict=True)
        parts = [builder.shuffle_vector(a, b, lanes) for a, b in pairs]
    return parts[0]


def _spread(builder: Any, vector: Any, lanes: list[int]) -> Any:
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), lane_list(lanes))


@intrinsic
def repeat4(_typing: Any, array: Any, index: Any) -> Any:
    """Return array[index : index + 4] four times."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = address(context, builder, signature.args[0], args[0], args[1])
        four = builder.load(_floats_at(builder, place, 4), align=4)
        return _spread(builder, four, list(range(4)) * 4)

    return Floats16(array, types.intp), generate


@dataclass(frozen=True, kw_only=True)
class Shape:
    """What is done to a block of pixels; each member is an intrinsic.

    Attributes:
        columns: (array, x): the columns' values, from x on, of all pixels.
        rows: (array, y): likewise of the rows.
        load: (light, place, stride): the light of the pixels.
        store: (light, place, stride, value): write it.
        add: (paint, place, stride, weight, colour): add weight * colour to the paint; `colour`
            holds the four channels four times, as `repeat4` returns them.
    """

    columns: Any
    rows: Any
    load: Any
    store: Any
    add: Any


def _shape(rows: int) -> Shape:
    width = PIXELS // rows

    def row_places(builder: Any, place: Any, stride: Any) -> list[Any]:
        places = [place]
        for _ in range(1, rows):
            places.append(builder.add(places[-1], stride))
        return places

    @intrinsic
    def columns_of(_typing: Any, array: Any, x: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            place = address(context, builder, signature.args[0], args[0], args[1])
            values = builder.load(_floats_at(builder, place, width), align=4)
            return _spread(builder, values, list(range(width)) * rows)

        return Floats16(array, types.intp), generate

    @intrinsic
    def rows_of(_typing: Any, array: Any, y: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            place = address(context, builder, signature.args[0], args[0], args[1])
            values = builder.load(_floats_at(builder, place, rows), align=4)
            return _spread(builder, values, [lane // width for lane in range(PIXELS)])

        return Floats16(array, types.intp), generate

    @intrinsic
    def load(_typing: Any, light: Any, place: Any, stride: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            parts: list[Any] = []
            for start in row_places(builder, args[1], args[2]):
                pointer = address(context, builder, signature.args[0], args[0], start)
                parts.append(builder.load(_floats_at(builder, pointer, width), align=4))
            return _joined(builder, parts)

        return Floats16(light, types.intp, types.intp), generate

    @intrinsic
    def store(_typing: Any, light: Any, place: Any, stride: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            for row, start in enumerate(row_places(builder, args[1], args[2])):
                pointer = address(context, builder, signature.args[0], args[0], start)
                part = _spread(builder, args[3], list(range(row * width, (row + 1) * width)))
                builder.store(part, _floats_at(builder, pointer, width), align=4)
            return context.get_dummy_value()

        return types.void(light, types.intp, types.intp, Floats16), generate

    @intrinsic
    def add(_typing: Any, paint: Any, place: Any, stride: Any, weight: Any, colour: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            channels = ir.Constant(I64, CHANNELS)
            starts = row_places(
                builder, builder.mul(args[1], channels), builder.mul(args[2], channels)
            )
            for first in range(0, PIXELS, 4):
                start = builder.add(
                    starts[first // width], ir.Constant(I64, CHANNELS * (first % width))
                )
                place = address(context, builder, signature.args[0], args[0], start)
                pointer = _floats_at(builder, place, PIXELS)
                lanes = [first + lane // CHANNELS for lane in range(PIXELS)]
                weight = _spread(builder, args[3], lanes)
                there = builder.load(pointer, align=4)
                builder.store(
                    call_llvm(builder, "fmuladd", weight, args[4], there), pointer, align=4
                )
            return context.get_dummy_value()

        return types.void(paint, types.intp, types.intp, Floats16, Floats16), generate

    return Shape(columns=columns_of, rows=rows_of, load=load, store=store, add=add)


SQUARE, FLAT, LINE = _shape(4), _shape(2), _shape(1)
"""4x4, 8x2 and 16x1 pixels."""
