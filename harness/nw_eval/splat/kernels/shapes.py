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


@dataclass(frozen=True, kw_only=True)
class LaneShape:
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


def _row_places(builder: Any, place: Any, stride: Any, rows: int) -> list[Any]:
    places = [place]
    for _ in range(1, rows):
        places.append(builder.add(places[-1], stride))
    return places


def _laying(count: int, lanes: list[int]) -> Any:
    """Return the intrinsic that takes `count` floats of an array to lanes."""

    @intrinsic
    def lay(_typing: Any, array: Any, index: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            place = address(context, builder, signature.args[0], args[0], args[1])
            return _spread(builder, builder.load(_floats_at(builder, place, count), align=4), lanes)

        return Floats16(array, types.intp), generate

    return lay


def _loading(rows: int) -> Any:
    @intrinsic
    def load(_typing: Any, light: Any, place: Any, stride: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            parts: list[Any] = []
            for start in _row_places(builder, args[1], args[2], rows):
                pointer = address(context, builder, signature.args[0], args[0], start)
                parts.append(builder.load(_floats_at(builder, pointer, PIXELS // rows), align=4))
            return _joined(builder, parts)

        return Floats16(light, types.intp, types.intp), generate

    return load


def _storing(rows: int) -> Any:
    width = PIXELS // rows

    @intrinsic
    def store(_typing: Any, light: Any, place: Any, stride: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            for row, start in enumerate(_row_places(builder, args[1], args[2], rows)):
                pointer = address(context, builder, signature.args[0], args[0], start)
                part = _spread(builder, args[3], list(range(row * width, (row + 1) * width)))
                builder.store(part, _floats_at(builder, pointer, width), align=4)
            return context.get_dummy_value()

        return types.void(light, types.intp, types.intp, Floats16), generate

    return store


def _adding(rows: int) -> Any:
    width = PIXELS // rows

    @intrinsic
    def add(_typing: Any, paint: Any, place: Any, stride: Any, weight: Any, colour: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            first, step = (builder.mul(value, ir.Constant(I64, CHANNELS)) for value in args[1:3])
            starts = _row_places(builder, first, step, rows)
            for pixel in range(0, PIXELS, CHANNELS):
                column = ir.Constant(I64, CHANNELS * (pixel % width))
                start = builder.add(starts[pixel // width], column)
                place = address(context, builder, signature.args[0], args[0], start)
                pointer = _floats_at(builder, place, PIXELS)
                lanes = [pixel + lane // CHANNELS for lane in range(PIXELS)]
                there = builder.load(pointer, align=4)
                share = _spread(builder, args[3], lanes)
                value = call_llvm(builder, "fmuladd", share, args[4], there)
                builder.store(value, pointer, align=4)
            return context.get_dummy_value()

        return types.void(paint, types.intp, types.intp, Floats16, Floats16), generate

    return add


def _shape(rows: int) -> LaneShape:
    width = PIXELS // rows
    return LaneShape(
        columns=_laying(width, list(range(width)) * rows),
        rows=_laying(rows, [lane // width for lane in range(PIXELS)]),
        load=_loading(rows),
        store=_storing(rows),
        add=_adding(rows),
    )


repeat4 = _laying(CHANNELS, list(range(CHANNELS)) * (PIXELS // CHANNELS))
"""(array, index): array[index : index + 4] four times."""

SQUARE, FLAT, LINE = _shape(4), _shape(2), _shape(1)
"""4x4, 8x2 and 16x1 pixels."""
