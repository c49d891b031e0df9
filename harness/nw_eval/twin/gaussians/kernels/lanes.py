"""What the gradient needs of vectors beside the renderer's operators."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types

from nw_eval.splat.kernels.simd import I32, intrinsic, lane_list


@intrinsic
def total(_typing: Any, x: Any) -> Any:
    """Return the sum of the lanes: halves are added until one is left, always in this order."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        value, lanes = args[0], x.lanes
        while lanes > 1:
            lanes //= 2
            undefined = ir.Constant(value.type, ir.Undefined)
            low = builder.shuffle_vector(value, undefined, lane_list(list(range(lanes))))
            high = builder.shuffle_vector(
                value, undefined, lane_list(list(range(lanes, 2 * lanes)))
            )
            value = builder.fadd(low, high)
        return builder.extract_element(value, ir.Constant(I32, 0))

    return types.float32(x), generate
