"""Operators that multiply matrices, convolutions among them, and attention made of them."""

from __future__ import annotations

from dataclasses import replace
from itertools import product as every
from typing import Any

import numpy as np

from nw_policies.executor import program as rows
from nw_policies.executor.graph import MICROSOFT, Node, UnsupportedError
from nw_policies.executor.moves import padded
from nw_policies.executor.planning import (
    ROW_FIELD,
    TARGET_FIELD,
    TIMES_STEP_FIELD,
    Array,
    Planner,
    operator,
    panels,
)
from nw_policies.executor.program import PANEL
from nw_policies.executor.views import View


@operator("Gemm")
def _gemm(plan: Planner, node: Node) -> None:
    at = node.attributes
    x = plan.view(node.inputs[0])
    x = x.transposed((1, 0)) if at.get("transA") else x
    weights = plan.values[node.inputs[1]]
    alpha, beta = np.float32(at.get("alpha", 1.0)), np.float32(at.get("beta", 1.0))
    extra = plan.values[node.inputs[2]] if plan.has(node, 2) else None
    name = node.outputs[0]
    if isinstance(weights, View):
        weights = weights.transposed((1, 0)) if at.get("transB") else weights
        result = multiply(plan, x, weights)
        if alpha != 1.0:
            result = plan.combine(rows.MUL, result, plan.scalar(float(alpha)))
        bias = None
    else:
        matrix = (weights.T if at.get("transB") else weights).astype(np.float32)
        bias = None
        if isinstance(extra, np.ndarray) and extra.size in {1, matrix.shape[1]}:
            bias = (extra * beta).astype(np.float32)
        result = plan.product(name, x, matrix if alpha == 1.0 else matrix * alpha, bias)
    if extra is not None and bias is None:
        added = plan.view(node.inputs[2])
        if beta != 1.0:
            added = plan.combine(rows.MUL, added, plan.scalar(float(beta)))
        result = plan.combine(rows.ADD, result, added)
    plan.values[name] = result


@operator("MatMul")
def _matmul(plan: Planner, node: Node) -> None:
    weights = plan.values[node.inputs[1]]
    x = plan.view(node.inputs[0])
    is_row, is_column = len(x.shape) == 1, len(weights.shape) == 1
    if is_row:
        x = plan.reshaped(x, (1, *x.shape))
    if not isinstance(weights, View) and weights.ndim <= 2:
        matrix = weights[:, None] if is_column else weights
        name = "" if is_row or is_column else node.outputs[0]
        result = plan.product(name, x, matrix.astype(np.float32), None)
    else:
        y = plan.view(node.inputs[1])
        result = multiply(plan, x, plan.reshaped(y, (*y.shape, 1)) if is_column else y)
    shape = list(result.shape)
    if is_column:
        shape.pop()
    if is_row:
        shape.pop(-1 if is_column else -2)
    plan.values[node.outputs[0]] = plan.reshaped(result, shape)


def multiply(plan: Planner, x: View, y: View) -> View:
    """Return x @ y for what is computed, such as queries and keys, over any leading axes."""
    rows_, depth, columns = x.shape[-2], x.shape[-1], y.shape[-1]
    if y.shape[-2] != depth:
        raise UnsupportedError(f"{x.shape} times {y.shape}")
    lead = np.broadcast_shapes(x.shape[:-2], y.shape[:-2])
    if x.strides[-1] != 1 and depth > 1:
        x = plan.dense(x)
    x, y = x.broadcast((*lead, rows_, depth)), y.broadcast((*lead, depth, columns))
    target = plan.new((*lead, rows_, columns), x, y)
    bias = plan.bias(None, columns)
    size = -(-columns // PANEL) * PANEL * depth
    packed: dict[int, int] = {}
    # The last leading axis is repeated by the row itself, the others by rows of their own.
    times = lead[-1] if lead else 1
    x_step, y_step, t_step = (v.strides[-3] if lead else 0 for v in (x, y, target))
    for index in every(*[range(n) for n in lead[:-1]]):
        at_x, at_y, at_t = (
            v.offset + sum(i * s for i, s in zip(index, v.strides, strict=False))
            for v in (x, y, target)
        )
        if at_y not in packed:
            count = 1 if y_step == 0 else times
            packed[at_y] = plan.room(count * size)
            plan.row(
                rows.PACK, at_y, y.strides[-2], y.strides[-1], depth, columns, packed[at_y], count,
                y_step, size, is_fixed=y.is_fixed,
            )  # fmt: skip
        plan.row(
            rows.PRODUCT, at_x, x.strides[-2], 1, 0, 1, 0, depth, packed[at_y], bias, columns, at_t,
            columns, rows_, 0, times, x_step, t_step, 0 if y_step == 0 else size,
            is_fixed=target.is_fixed,
        )  # fmt: skip
    return target


@operator("Conv")
def _conv(plan: Planner, node: Node) -> None:
    at = node.attributes
    x = plan.view(node.inputs[0])
    weights = plan.constant(node.inputs[1]).astype(np.float32)
    outputs = weights.shape[0]
    bias = plan.constant_or(node, 2, np.zeros(outputs, np.float32))
    is_line = weights.ndim == 3
    if is_line:
        weights = weights[:, :, None]
        x = plan.reshaped(x, (*x.shape[:2], 1, x.shape[2]))
    if weights.ndim != 4 or len(x.shape) != 4:
        raise UnsupportedError(f"weights of {weights.ndim} axes")
    strides = [1] * is_line + list(at.get("strides", [1] * (2 - is_line)))
    dilations = [1] * is_line + list(at.get("dilations", [1] * (2 - is_line)))
    kernel = weights.shape[2:]
    pads = window_pads(at, x.shape[2:], kernel, strides, dilations, is_line=is_line)
    groups = at.get("group", 1)
    images: list[View] = []
    for image in range(x.shape[0]):
        one = replace(x, offset=x.offset + image * x.strides[0], shape=(1, *x.shape[1:]))
        if groups == 1:
            fuse = node.inputs[0] if x.shape[0] == 1 else ""
            name = node.outputs[0] if x.shape[0] == 1 and not is_line else ""
            images.append(
                _convolved(plan, one, weights, bias, strides, dilations, pads, fuse, name)
            )
        else:
            images.append(_in_groups(plan, one, weights, bias, strides, dilations, pads, groups))
    result = images[0]
    if len(images) > 1:
        shape = (len(images), *result.shape[1:])
        target = plan.new((shape[0], shape[2], shape[3], shape[1]), *images)
        target = target.transposed((0, 3, 1, 2))
        for number, image in enumerate(images):
            at_ = target.offset + number * target.strides[0]
            plan.copy(image, replace(target, offset=at_, shape=image.shape))
        result = target
    if is_line:
        result = plan.reshaped(result, (*result.shape[:2], result.shape[3]))
    plan.values[node.outputs[0]] = result


def window_pads(
    at: Any, sizes: Any, kernel: Any, strides: Any, dilations: Any, *, is_line: bool
) -> list[int]:
    """Return top, left, bottom and right borders of a convolution or pooling."""
    auto = at.get("auto_pad", b"NOTSET")
    if auto in {b"SAME_UPPER", b"SAME_LOWER"}:
        first: list[int] = []
        last: list[int] = []
        for size, k, stride, dilation in zip(sizes, kernel, strides, dilations, strict=True):
            reach = (k - 1) * dilation + 1
            total = max((-(-size // stride) - 1) * stride + reach - size, 0)
            small, large = total // 2, total - total // 2
            first.append(small if auto == b"SAME_UPPER" else large)
            last.append(large if auto == b"SAME_UPPER" else small)
        return [*first, *last]
    if auto == b"VALID":
        return [0, 0, 0, 0]
    pads = list(at.get("pads", [0] * (2 if is_line else 4)))
    return [0, pads[0], 0, pads[1]] if is_line else pads


def _in_groups(
    plan: Planner, x: View, weights: Array, bias: Array, strides: Any, dilations: Any,
    pads: Any, groups: int,
) -> View:  # fmt: skip
    """Return a convolution whose channels go in groups: one convolution each."""
    inputs, outputs = weights.shape[1], weights.shape[0] // groups
    parts: list[View] = []
    for group in range(groups):
        own = slice(group * outputs, (group + 1) * outputs)
        channels = replace(
            x,
            offset=x.offset + group * inputs * x.strides[1],
            shape=(1, inputs, *x.shape[2:]),
        )
        parts.append(
            _convolved(plan, channels, weights[own], bias[own], strides, dilations, pads, "", "")
        )
    _, _, high, wide = parts[0].shape
    target = plan.new((1, high, wide, groups * outputs), x).transposed((0, 3, 1, 2))
    for group, each in enumerate(parts):
        start = target.offset + group * outputs
        plan.copy(each, replace(target, offset=start, shape=each.shape))
    return target


def _convolved(
    plan: Planner, x: View, weights: Array, bias: Array, strides: Any, dilations: Any, pads: Any,
    source: str, name: str,
) -> View:  # fmt: skip
    """Return the convolution of one image, (1, channels, rows, columns), laid out channels last.

    It is a product over windows, without copies of them: a row of the matrix is one row of the
    kernel after another, of channels that lie side by side or of one channel after another.
    """
    outputs, inputs, high, wide = weights.shape
    is_last = x.strides[1] == 1 or inputs == 1
    if dilations[1] != 1 and not is_last:
        x = _channels_last(plan, x)
        is_last = True
    if any(pads) or not (is_last or x.strides[3] == 1):
        x = _bordered(plan, x, pads, source, is_last=is_last)
    _, across, down, along = x.strides
    if inputs == 1 and x.strides[3] == 1:
        is_last = False  # One channel: its columns are what lies side by side.
    rows_ = (x.shape[2] - (high - 1) * dilations[0] - 1) // strides[0] + 1
    columns = (x.shape[3] - (wide - 1) * dilations[1] - 1) // strides[1] + 1
    if is_last and dilations[1] == 1 and along == inputs:
        matrix = weights.transpose(2, 3, 1, 0).reshape(-1, outputs)
        segments = 1, 0, high, down * dilations[0], wide * inputs
    elif is_last:
        matrix = weights.transpose(2, 3, 1, 0).reshape(-1, outputs)
        segments = high, down * dilations[0], wide, along * dilations[1], inputs
    elif dilations[1] == 1:
        matrix = weights.transpose(1, 2, 3, 0).reshape(-1, outputs)
        segments = inputs, across, high, down * dilations[0], wide
    else:
        raise UnsupportedError("dilations")
    result = plan.new((1, rows_, columns, outputs), x)
    number = plan.row(
        rows.PRODUCT, x.offset, strides[1] * along, *segments, plan.put(panels(matrix)),
        plan.bias(bias, outputs), outputs, result.offset, outputs, columns, 0, rows_,
        strides[0] * down, columns * outputs, 0, is_fixed=result.is_fixed,
    )  # fmt: skip
    if name:
        plan.note_image(name, number)
    return result.transposed((0, 3, 1, 2))


def _channels_last(plan: Planner, x: View) -> View:
    last = plan.new((x.shape[0], *x.shape[2:], x.shape[1]), x).transposed((0, 3, 1, 2))
    plan.copy(x, last)
    return last


def _bordered(plan: Planner, x: View, pads: Any, source: str, *, is_last: bool) -> View:
    """Return an image with borders of zeros; the product that makes it writes between them."""
    top, left, bottom, right = pads
    order = (0, 2, 3, 1) if is_last else (0, 1, 2, 3)
    back = (0, 3, 1, 2) if is_last else (0, 1, 2, 3)
    before = [(0, 0, top, left)[axis] for axis in order]
    after = [(0, 0, bottom, right)[axis] for axis in order]
    made = plan.of_product(source, is_image=True)
    own = made is not None and is_last and made[TARGET_FIELD] == x.offset
    if made is None or not own or x.shape[1] == 1:
        if not any(pads):
            return plan.dense(x.transposed(order)).transposed(back)
        return padded(plan, x.transposed(order), before, after, 0.0).transposed(back)
    _, channels, high, wide = x.shape
    room = plan.new((1, high + top + bottom, wide + left + right, channels), x)
    _, down, along, _ = room.strides
    # The row of a convolution makes one line of pixels at a time.
    made[TARGET_FIELD] = room.offset + top * down + left * along
    made[ROW_FIELD], made[TIMES_STEP_FIELD] = along, down
    return room.transposed((0, 3, 1, 2))


@operator("RotaryEmbedding", domain=MICROSOFT)
def _rotary(plan: Planner, node: Node) -> None:
    """Turn pairs of numbers of each head by the angles of their positions.

    Input (batch, tokens, heads x 2 half), not interleaved: number i of a head pairs with i + half.
    """
    at = node.attributes
    if at.get("interleaved") or at.get("rotary_embedding_dim") or at.get("is_packed_batching"):
        raise UnsupportedError("interleaved or partial rotation")
    x = plan.view(node.inputs[0])
    positions = plan.constant(node.inputs[1]).ravel().astype(int)
    cos, sin = (plan.constant(name)[positions] for name in node.inputs[2:4])
    heads, half = int(at["num_heads"]), cos.shape[1]
    batch, tokens, _ = x.shape
    split = plan.reshaped(x, (batch, tokens, heads, 2, half))
    first, second = (
        replace(
            split,
            offset=split.offset + number * split.strides[3],
            shape=(batch, tokens, heads, half),
            strides=(*split.strides[:3], split.strides[4]),
        )
        for number in (0, 1)
    )
    c, s = (_constant_view(plan, each[None, :, None, :]) for each in (cos, sin))
    turned = [
        plan.combine(rows.SUB, plan.combine(rows.MUL, first, c), plan.combine(rows.MUL, second, s)),
        plan.combine(rows.ADD, plan.combine(rows.MUL, second, c), plan.combine(rows.MUL, first, s)),
    ]
    target = plan.new((batch, tokens, heads, 2, half), x)
    for number, each in enumerate(turned):
        place = replace(
            target,
            offset=target.offset + number * half,
            shape=each.shape,
            strides=(*target.strides[:3], 1),
        )
        plan.copy(each, place)
    plan.values[node.outputs[0]] = plan.reshaped(target, x.shape)


def _constant_view(plan: Planner, array: Array) -> View:
    name = f"constant {len(plan.values)}"
    plan.values[name] = array
    return plan.view(name)
