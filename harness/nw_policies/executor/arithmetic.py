"""Operators that compute by element or by row: sums, activations, normalisation, reductions, pools.

Functions that are made of others are so here: SiLU is x times a sigmoid, GELU uses erf.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from nw_policies.executor import program as rows
from nw_policies.executor.graph import MICROSOFT, Node, UnsupportedError
from nw_policies.executor.moves import axes_of, padded
from nw_policies.executor.planning import BIAS_FIELD, RELU_FIELD, Array, Planner, operator
from nw_policies.executor.products import window_pads
from nw_policies.executor.views import View, merged

_SOFTMAX_BY_AXIS = 13

_EXACT: dict[str, Callable[..., Any]] = {
    "Add": np.add, "Sub": np.subtract, "Mul": np.multiply, "Equal": np.equal, "Less": np.less,
    "Greater": np.greater, "LessOrEqual": np.less_equal, "GreaterOrEqual": np.greater_equal,
    "And": np.logical_and, "Or": np.logical_or, "Xor": np.logical_xor, "Max": np.maximum,
    "Min": np.minimum,
}  # fmt: skip
"""One IEEE operation or none by element: NumPy's bits are every machine's."""
_CODES = {
    "Add": rows.ADD, "Sub": rows.SUB, "Mul": rows.MUL, "Div": rows.DIV, "Max": rows.MAX,
    "Min": rows.MIN,
}  # fmt: skip


@operator("Add", "Sub", "Mul", "Div", "Max", "Min", "Sum")
def _combine(plan: Planner, node: Node) -> None:
    name, *others = node.inputs
    code = _CODES.get(node.operator, rows.ADD)
    operation = "Add" if node.operator == "Sum" else node.operator
    values = [plan.values[each] for each in node.inputs]
    if not any(isinstance(value, View) for value in values):
        result = values[0]
        for value in values[1:]:
            result = _exactly(operation, result, value)
        plan.values[node.outputs[0]] = result
        return
    if code == rows.ADD and len(others) == 1 and _joins_product(plan, node, name, others[0]):
        return
    result = _number(plan, name)
    for other in others:
        result = plan.combine(code, result, _number(plan, other))
    plan.values[node.outputs[0]] = result


def _exactly(operation: str, x: Any, y: Any) -> Array:
    if operation != "Div":
        return np.asarray(_EXACT[operation](x, y))
    if x.dtype.kind in "iu":  # Towards zero, as in C.
        whole = np.abs(x) // np.abs(y)
        return np.asarray(whole * np.sign(x) * np.sign(y), x.dtype)
    return np.asarray(np.divide(x, y))


def _number(plan: Planner, name: str) -> View:
    view = plan.view(name)
    if view.kind != "float" and not view.is_fixed:
        raise UnsupportedError(f"`{name}`, a {view.kind} that is computed")
    return view


def _joins_product(plan: Planner, node: Node, first: str, second: str) -> bool:
    """Let a product begin with the constant row that is added to it, if nothing else sees it."""
    for name, other in ((first, second), (second, first)):
        made, added = plan.of_product(name), plan.values[other]
        value = plan.values[name]
        if made is None or isinstance(added, View) or not isinstance(value, View):
            continue
        columns = made[10]
        is_row = added.size == columns and added.shape[-1:] in {(columns,), ()}
        if not is_row or value.shape[-1] != columns or made[RELU_FIELD]:
            continue
        if made[BIAS_FIELD] != plan.bias(None, columns):
            continue
        made[BIAS_FIELD] = plan.put_columns(added, columns)
        plan.values[node.outputs[0]] = value
        plan.renamed_product(name, node.outputs[0])
        return True
    return False


@operator("Mod")
def _mod(plan: Planner, node: Node) -> None:
    x, y = (plan.constant(name) for name in node.inputs)
    operation = np.fmod if node.attributes.get("fmod") else np.mod
    plan.values[node.outputs[0]] = np.asarray(operation(x, y))


@operator(
    "Equal", "Less", "Greater", "LessOrEqual", "GreaterOrEqual", "And", "Or", "Xor"
)  # fmt: skip
def _compare(plan: Planner, node: Node) -> None:
    values = [plan.values[name] for name in node.inputs]
    if not any(isinstance(value, View) for value in values):
        plan.values[node.outputs[0]] = np.asarray(_EXACT[node.operator](*values))
        return
    x, y = (plan.view(name) for name in node.inputs)

    def combined(code: int, a: View, b: View) -> View:
        return plan.combine(code, a, b, kind="bool")

    match node.operator:
        case "Equal":
            result = combined(rows.EQUAL, x, y)
        case "Less":
            result = combined(rows.LESS, x, y)
        case "Greater":
            result = combined(rows.LESS, y, x)
        case "LessOrEqual":  # Not the opposite of greater: of NaN neither holds.
            result = combined(rows.MAX, combined(rows.LESS, x, y), combined(rows.EQUAL, x, y))
        case "GreaterOrEqual":
            result = combined(rows.MAX, combined(rows.LESS, y, x), combined(rows.EQUAL, x, y))
        case "And":
            result = combined(rows.MUL, x, y)
        case "Or":
            result = combined(rows.MAX, x, y)
        case _:
            equal = combined(rows.EQUAL, x, y)
            result = combined(rows.SUB, plan.scalar(1.0), equal)
    plan.values[node.outputs[0]] = result


@operator("Not")
def _not(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    plan.values[node.outputs[0]] = (
        plan.combine(rows.SUB, plan.scalar(1.0), value, kind="bool")
        if isinstance(value, View)
        else np.logical_not(value)
    )


@operator("Where")
def _where(plan: Planner, node: Node) -> None:
    arrays = [v for name in node.inputs if not isinstance(v := plan.values[name], View)]
    if len(arrays) == len(node.inputs):
        condition, yes, no = arrays
        plan.values[node.outputs[0]] = np.where(condition, yes, no)
        return
    c, x, y = (plan.view(name) for name in node.inputs)
    shape = np.broadcast_shapes(c.shape, x.shape, y.shape)
    target = plan.new(shape, c, x, y, kind=x.kind)
    views = [view.broadcast(shape) for view in (c, x, y)] + [target]
    sizes, strides = merged(shape, *(view.strides for view in views))
    flat = [step for each in strides for step in each]
    plan.row(
        rows.SELECT, 0, *sizes, *flat, *(view.offset for view in views), is_fixed=target.is_fixed
    )
    plan.values[node.outputs[0]] = target


@operator("Clip")
def _clip(plan: Planner, node: Node) -> None:
    x = _number(plan, node.inputs[0])
    for index, (code, key) in enumerate(((rows.MAX, "min"), (rows.MIN, "max")), 1):
        if plan.has(node, index):
            x = plan.combine(code, x, plan.view(node.inputs[index]))
        elif key in node.attributes:
            x = plan.combine(code, x, plan.scalar(node.attributes[key]))
    plan.values[node.outputs[0]] = x


_FUNCTIONS = {
    "Tanh": rows.TANH, "Sigmoid": rows.SIGMOID, "Exp": rows.EXP, "Log": rows.LOG,
    "Sqrt": rows.SQRT, "Neg": rows.NEG, "Abs": rows.ABS, "Erf": rows.ERF,
    "Softplus": rows.SOFTPLUS, "Floor": rows.FLOOR, "Ceil": rows.CEIL, "Round": rows.ROUND,
    "Sign": rows.SIGN, "Sin": rows.SIN, "Cos": rows.COS,
}  # fmt: skip


@operator(*_FUNCTIONS)
def _function(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    if node.operator in {"Neg", "Abs", "Sign"} and not isinstance(value, View):
        exact = {"Neg": np.negative, "Abs": np.abs, "Sign": np.sign}[node.operator]
        plan.values[node.outputs[0]] = np.asarray(exact(value))
        return
    x = _number(plan, node.inputs[0])
    plan.values[node.outputs[0]] = plan.apply(_FUNCTIONS[node.operator], x)


@operator("Relu")
def _relu(plan: Planner, node: Node) -> None:
    name = node.inputs[0]
    made = plan.of_product(name)
    if made is not None and not made[RELU_FIELD]:
        made[RELU_FIELD] = 1
        plan.values[node.outputs[0]] = plan.values[name]
        plan.renamed_product(name, node.outputs[0])
        return
    plan.values[node.outputs[0]] = plan.apply(rows.RELU, _number(plan, name))


@operator("Elu", "LeakyRelu", "Celu")
def _with_slope(plan: Planner, node: Node) -> None:
    x = _number(plan, node.inputs[0])
    if node.operator == "LeakyRelu":
        result = plan.apply(rows.LEAKY, x, node.attributes.get("alpha", 0.01))
    else:
        alpha = node.attributes.get("alpha", 1.0)
        if node.operator == "Celu" and alpha != 1.0:
            raise UnsupportedError(f"alpha {alpha}")
        result = plan.apply(rows.ELU, x, alpha)
    plan.values[node.outputs[0]] = result


@operator("Selu")
def _selu(plan: Planner, node: Node) -> None:
    alpha = node.attributes.get("alpha", 1.67326319217681884765625)
    gamma = node.attributes.get("gamma", 1.05070102214813232421875)
    x = plan.apply(rows.ELU, _number(plan, node.inputs[0]), alpha)
    plan.values[node.outputs[0]] = plan.combine(rows.MUL, x, plan.scalar(gamma))


@operator("PRelu")
def _prelu(plan: Planner, node: Node) -> None:
    x, slope = (_number(plan, name) for name in node.inputs)
    above = plan.apply(rows.RELU, x)
    below = plan.combine(rows.MIN, x, plan.scalar(0.0))
    scaled = plan.combine(rows.MUL, below, slope)
    plan.values[node.outputs[0]] = plan.combine(rows.ADD, above, scaled)


@operator("HardSigmoid", "HardSwish")
def _hard(plan: Planner, node: Node) -> None:
    x = _number(plan, node.inputs[0])
    is_swish = node.operator == "HardSwish"
    alpha = 1.0 / 6.0 if is_swish else node.attributes.get("alpha", 0.2)
    beta = 0.5 if is_swish else node.attributes.get("beta", 0.5)
    line = plan.combine(rows.MUL, x, plan.scalar(alpha))
    line = plan.combine(rows.ADD, line, plan.scalar(beta))
    line = plan.combine(rows.MAX, line, plan.scalar(0.0))
    line = plan.combine(rows.MIN, line, plan.scalar(1.0))
    plan.values[node.outputs[0]] = plan.combine(rows.MUL, x, line) if is_swish else line


@operator("Softsign", "Mish", "Swish", "Reciprocal")
def _composed(plan: Planner, node: Node) -> None:
    x = _number(plan, node.inputs[0])
    one = plan.scalar(1.0)
    match node.operator:
        case "Softsign":
            below = plan.combine(rows.ADD, plan.apply(rows.ABS, x), one)
            result = plan.combine(rows.DIV, x, below)
        case "Mish":
            inner = plan.apply(rows.TANH, plan.apply(rows.SOFTPLUS, x))
            result = plan.combine(rows.MUL, x, inner)
        case "Swish":
            scaled = plan.combine(rows.MUL, x, plan.scalar(node.attributes.get("alpha", 1.0)))
            result = plan.combine(rows.MUL, x, plan.apply(rows.SIGMOID, scaled))
        case _:
            result = plan.combine(rows.DIV, one, x)
    plan.values[node.outputs[0]] = result


@operator("QuickGelu", domain=MICROSOFT)
def _quick_gelu(plan: Planner, node: Node) -> None:
    x = _number(plan, node.inputs[0])
    scaled = plan.combine(rows.MUL, x, plan.scalar(node.attributes.get("alpha", 1.702)))
    plan.values[node.outputs[0]] = plan.combine(rows.MUL, x, plan.apply(rows.SIGMOID, scaled))


@operator("Gelu", domain=MICROSOFT)
@operator("Gelu")
def _gelu(plan: Planner, node: Node) -> None:
    x = _number(plan, node.inputs[0])
    if node.attributes.get("approximate", b"none") == b"tanh":
        cube = plan.combine(rows.MUL, plan.combine(rows.MUL, x, x), x)
        inner = plan.combine(rows.MUL, cube, plan.scalar(0.044715))
        inner = plan.combine(rows.ADD, x, inner)
        inner = plan.combine(rows.MUL, inner, plan.scalar(math.sqrt(2.0 / math.pi)))
        inner = plan.apply(rows.TANH, inner)
    else:
        inner = plan.apply(rows.ERF, plan.combine(rows.MUL, x, plan.scalar(math.sqrt(0.5))))
    inner = plan.combine(rows.ADD, inner, plan.scalar(1.0))
    half = plan.combine(rows.MUL, x, plan.scalar(0.5))
    plan.values[node.outputs[0]] = plan.combine(rows.MUL, half, inner)


@operator("Pow")
def _pow(plan: Planner, node: Node) -> None:
    x, exponent = _number(plan, node.inputs[0]), plan.constant(node.inputs[1])
    if exponent.size != 1:
        raise UnsupportedError(f"{exponent.size} exponents")
    power = float(exponent.ravel()[0])
    if power == 0.5:
        result = plan.apply(rows.SQRT, x)
    elif power in {1.0, 2.0, 3.0, 4.0}:
        result = x
        for _ in range(int(power) - 1):
            result = plan.combine(rows.MUL, result, x)
    elif power in {-1.0, -0.5}:
        below = x if power == -1.0 else plan.apply(rows.SQRT, x)
        result = plan.combine(rows.DIV, plan.scalar(1.0), below)
    else:
        raise UnsupportedError(f"exponent {power}")
    plan.values[node.outputs[0]] = result


# --- rows ---------------------------------------------------------------------------------------


def _axis_last(plan: Planner, view: View, axis: int) -> tuple[View, list[int]]:
    """Return a dense view with an axis last, and the order that takes it back."""
    axis %= len(view.shape)
    order = [a for a in range(len(view.shape)) if a != axis] + [axis]
    return plan.dense(view.transposed(order)), [order.index(a) for a in range(len(order))]


@operator("Softmax", "LogSoftmax")
def _softmax(plan: Planner, node: Node) -> None:
    x = _number(plan, node.inputs[0])
    is_old = plan.version < _SOFTMAX_BY_AXIS
    axis = node.attributes.get("axis", 1 if is_old else -1) % len(x.shape)
    if is_old:  # All axes from this one on are one row.
        size = math.prod(x.shape[:axis])
        last = plan.dense(plan.reshaped(x, (size, x.size // size)))
        back = [0, 1]
    else:
        last, back = _axis_last(plan, x, axis)
    target = plan.new(last.shape, last)
    n = last.shape[-1]
    plan.row(
        rows.SOFTMAX, last.offset, last.size // n, n, target.offset,
        int(node.operator == "LogSoftmax"), is_fixed=target.is_fixed,
    )  # fmt: skip
    plan.values[node.outputs[0]] = (
        plan.reshaped(target, x.shape) if is_old else target.transposed(back)
    )


@operator("LayerNormalization")
def _layer_norm(plan: Planner, node: Node) -> None:
    x = plan.dense(_number(plan, node.inputs[0]))
    axis = node.attributes.get("axis", -1) % len(x.shape)
    n = math.prod(x.shape[axis:])
    gamma, beta = (
        np.broadcast_to(plan.constant_or(node, place, default), x.shape[axis:])
        for place, default in ((1, np.ones(())), (2, np.zeros(())))
    )
    plan.values[node.outputs[0]] = _normalised(
        plan, x, n, node.attributes.get("epsilon", 1e-5), gamma, beta
    )


def _normalised(plan: Planner, x: View, n: int, eps: float, gamma: Any, beta: Any) -> View:
    target = plan.new(x.shape, x)
    numbers = plan.put(np.array([eps, n], np.float32))
    plan.row(
        rows.NORM, x.offset, x.size // n, n, plan.put_columns(gamma, n), plan.put_columns(beta, n),
        numbers, target.offset, is_fixed=target.is_fixed,
    )  # fmt: skip
    return target


@operator("InstanceNormalization", "GroupNormalization")
def _group_norm(plan: Planner, node: Node) -> None:
    x = plan.dense(_number(plan, node.inputs[0]))
    scale, shift = (plan.constant(name).ravel() for name in node.inputs[1:3])
    batch, channels = x.shape[:2]
    groups = node.attributes.get("num_groups", channels)
    if groups < 1 or channels % groups or (scale.size not in {channels, groups}):
        raise UnsupportedError(f"{groups} groups of {channels} channels")
    scale, shift = (np.repeat(each, channels // each.size) for each in (scale, shift))
    n = x.size // (batch * groups)
    eps = node.attributes.get("epsilon", 1e-5)
    plain = _normalised(plan, x, n, eps, np.ones(1), np.zeros(1))
    plan.values[node.outputs[0]] = _by_channel(plan, plain, scale, shift)


@operator("BatchNormalization")
def _batch_norm(plan: Planner, node: Node) -> None:
    x = _number(plan, node.inputs[0])
    if node.attributes.get("training_mode"):
        raise UnsupportedError("training_mode")
    scale, shift, mean, variance = (
        plan.constant(name).astype(np.float64) for name in node.inputs[1:5]
    )
    factor = scale / np.sqrt(variance + node.attributes.get("epsilon", 1e-5))
    plan.values[node.outputs[0]] = _by_channel(plan, x, factor, shift - mean * factor)


def _by_channel(plan: Planner, x: View, factor: Array, shift: Array) -> View:
    shape = (1, -1, *[1] * (len(x.shape) - 2))
    for code, numbers in ((rows.MUL, factor), (rows.ADD, shift)):
        array = numbers.astype(np.float32).reshape(shape)
        strides = (0, 1, *[0] * (len(x.shape) - 2))
        x = plan.combine(code, x, View(plan.put(array), array.shape, strides, True))
    return x


_REDUCTIONS = {
    "ReduceMean": rows.ADD, "ReduceSum": rows.ADD, "ReduceL1": rows.ADD, "ReduceL2": rows.ADD,
    "ReduceSumSquare": rows.ADD, "ReduceMax": rows.MAX, "ReduceMin": rows.MIN,
    "ReduceProd": rows.MUL,
}  # fmt: skip


_WHOLE: dict[str, Callable[..., Any]] = {
    "ReduceProd": np.prod, "ReduceSum": np.sum, "ReduceMax": np.max, "ReduceMin": np.min,
}  # fmt: skip
"""Reductions of constant whole numbers, which shapes are computed by."""


@operator(*_REDUCTIONS)
def _reduce(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    axes = axes_of(plan, node, 1)
    if not axes and node.attributes.get("noop_with_empty_axes"):
        plan.values[node.outputs[0]] = value
        return
    keeps = bool(node.attributes.get("keepdims", 1))
    if not isinstance(value, View) and value.dtype.kind in "iu":
        exact = {
            "ReduceProd": np.prod,
            "ReduceSum": np.sum,
            "ReduceMax": np.max,
            "ReduceMin": np.min,
        }
        reduced = exact[node.operator](value, axis=tuple(axes) or None, keepdims=keeps)
        plan.values[node.outputs[0]] = np.asarray(reduced, value.dtype)
        return
    x = _number(plan, node.inputs[0])
    if node.operator in {"ReduceL2", "ReduceSumSquare"}:
        x = plan.combine(rows.MUL, x, x)
    if node.operator == "ReduceL1":
        x = plan.apply(rows.ABS, x)
    result = _reduced(plan, x, axes, _REDUCTIONS[node.operator], keeps=keeps)
    if node.operator == "ReduceMean":
        result = plan.combine(rows.DIV, result, plan.scalar(x.size // max(result.size, 1)))
    if node.operator == "ReduceL2":
        result = plan.apply(rows.SQRT, result)
    plan.values[node.outputs[0]] = result


def _reduced(plan: Planner, x: View, axes: list[int], code: int, *, keeps: bool) -> View:
    rank = len(x.shape)
    gone = sorted({axis % rank for axis in axes} or set(range(rank)))
    kept = [axis for axis in range(rank) if axis not in gone]
    last = plan.dense(x.transposed([*kept, *gone]))
    n = math.prod(x.shape[axis] for axis in gone)
    target = plan.new([x.shape[axis] for axis in kept], x)
    if n == 0:
        raise UnsupportedError("no elements")
    plan.row(rows.REDUCE, code, last.offset, target.size, n, target.offset, is_fixed=x.is_fixed)
    shape = [1 if axis in gone else x.shape[axis] for axis in range(rank)]
    return plan.reshaped(target, shape) if keeps else target


@operator("GlobalAveragePool", "GlobalMaxPool")
def _global_pool(plan: Planner, node: Node) -> None:
    x = _number(plan, node.inputs[0])
    axes = list(range(2, len(x.shape)))
    is_max = node.operator == "GlobalMaxPool"
    result = _reduced(plan, x, axes, rows.MAX if is_max else rows.ADD, keeps=True)
    if not is_max:
        result = plan.combine(rows.DIV, result, plan.scalar(math.prod(x.shape[2:])))
    plan.values[node.outputs[0]] = result


@operator("MaxPool", "AveragePool")
def _pool(plan: Planner, node: Node) -> None:
    at = node.attributes
    x = _number(plan, node.inputs[0])
    name, *others = node.outputs
    if others or at.get("ceil_mode") or at.get("storage_order"):
        raise UnsupportedError("indices, or sizes rounded up")
    is_line = len(x.shape) == 3
    if is_line:
        x = plan.reshaped(x, (*x.shape[:2], 1, x.shape[2]))
    batch, channels, _, _ = x.shape
    ones = [1] * is_line
    kernel = ones + list(at["kernel_shape"])
    strides = ones + list(at.get("strides", [1] * (2 - is_line)))
    dilations = ones + list(at.get("dilations", [1] * (2 - is_line)))
    pads = window_pads(at, x.shape[2:], kernel, strides, dilations, is_line=is_line)
    is_max = node.operator == "MaxPool"
    sizes = x.shape[2:]
    border = ([0, 0, *pads[:2]], [0, 0, *pads[2:]])
    x = padded(plan, x, *border, -np.inf if is_max else 0.0)
    high, wide = (
        (n - (k - 1) * d - 1) // s + 1
        for n, k, s, d in zip(x.shape[2:], kernel, strides, dilations, strict=True)
    )
    target = plan.new((batch, channels, high, wide), x)
    for image in range(batch):
        plan.row(
            rows.POOL, rows.MAX if is_max else rows.ADD, channels, high, wide, *kernel,
            x.strides[1], x.strides[2] * strides[0], x.strides[3] * strides[1],
            x.strides[2] * dilations[0], x.strides[3] * dilations[1], *target.strides[1:],
            x.offset + image * x.strides[0], target.offset + image * target.strides[0],
            is_fixed=target.is_fixed,
        )  # fmt: skip
    if not is_max:
        counts = np.full((high, wide), math.prod(kernel), np.float32)
        if not at.get("count_include_pad") and any(pads):
            counts = _inside(sizes, (high, wide), kernel, strides, dilations, pads)
        place = View(plan.put(counts), (high, wide), (wide, 1), True)
        target = plan.combine(rows.DIV, target, place)
    shape = (batch, channels, wide) if is_line else (batch, channels, high, wide)
    plan.values[name] = plan.reshaped(target, shape)


def _inside(
    sizes: Any, windows: Any, kernel: Any, strides: Any, dilations: Any, pads: Any
) -> Array:
    """Return how many elements of each window are none of the border's."""
    counts = [
        [
            sum(0 <= k * stride - pad + t * dilation < size for t in range(reach))
            for k in range(count)
        ]
        for size, count, reach, stride, dilation, pad in zip(
            sizes, windows, kernel, strides, dilations, pads, strict=False
        )
    ]
    rows_, columns = counts
    return np.outer(rows_, columns).astype(np.float32)
