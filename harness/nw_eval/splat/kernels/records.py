"""Records: one cache line for each splat on the screen, written eight at a time."""

# ruff: noqa: ARG001 - an intrinsic sees the types of its arguments; their values reach `generate`.
from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils

from nw_eval.splat.kernels.simd import F8, I64, LANES, address, intrinsic, lane_list

RECORD = 16
"""Floats in a record: one cache line."""


def _transpose(builder: Any, rows: list[Any]) -> list[Any]:
    """Transpose an 8x8 matrix held in eight vectors: three rounds of pairwise shuffles."""

    def mix(a: Any, b: Any, lanes: list[int]) -> Any:
        return builder.shuffle_vector(a, b, lane_list(lanes))

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


def _appending(first_lane: int) -> Any:
    @intrinsic
    def append(_typing: Any, records: Any, count: Any, bits: Any, fields: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            lanes = lane_list(list(range(first_lane, first_lane + LANES)))
            values: list[Any] = [
                builder.shuffle_vector(value, value, lanes)
                for value in cgutils.unpack_tuple(builder, args[3])
            ]
            values += [ir.Constant(F8, ir.Undefined)] * (RECORD - len(values))
            first, second = _transpose(builder, values[:8]), _transpose(builder, values[8:])
            end, one = args[1], ir.Constant(I64, 1)
            for lane in range(LANES):
                start = builder.shl(end, ir.Constant(I64, 4))
                place = address(context, builder, signature.args[0], args[0], start)
                builder.store(first[lane], builder.bitcast(place, F8.as_pointer()), align=4)
                place = builder.gep(place, [ir.Constant(I64, LANES)])
                builder.store(second[lane], builder.bitcast(place, F8.as_pointer()), align=4)
                place = ir.Constant(I64, first_lane + lane)
                end = builder.add(end, builder.and_(builder.lshr(args[2], place), one))
            return end

        return types.int64(records, types.int64, types.int64, fields), generate

    return append


append_lower, append_upper = _appending(0), _appending(LANES)
"""(records, count, bits, fields): write one record of 16 floats behind `count` records for each
lane that is set in `bits`, of the lower or the upper eight; return the new count. `fields` are
twelve Floats16, the first twelve floats of a record. Every lane is written and the end advances for
the set ones only: no branch. Leave eight records of slack."""
