"""What operators of ATen, torch's own, become in a graph of `executor`: a rule for each.

A rule is a function of the recorder, the operator's arguments by the names that torch's schema
(native_functions.yaml) gives them, and its outputs, of which it uses the shapes. It returns the
names of the outputs; an empty one is not to be had. Whole layers are in `aten_layers`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from nw_policies.executor import UnsupportedError

if TYPE_CHECKING:
    from nw_policies.networks.values import Values

MADE = frozenset(
    {
        "arange", "empty", "empty_like", "empty_strided", "eye", "full", "full_like", "new_empty",
        "new_full", "new_ones", "new_zeros", "ones", "ones_like", "scalar_tensor", "zeros",
        "zeros_like",
    }
)  # fmt: skip
"""What is made without regard to any number that is given."""
EXACT = frozenset(
    {
        "_reshape_alias", "_to_copy", "_unsafe_view", "abs", "add", "alias", "as_strided", "cat",
        "clamp", "clone", "constant_pad_nd", "contiguous", "copy_", "detach", "detach_", "div",
        "expand", "expand_as", "fill_", "flatten", "flip", "floor", "floor_divide", "index",
        "index_select", "lift_fresh", "lift_fresh_copy", "masked_fill", "maximum", "minimum", "mul",
        "neg", "permute", "relu", "repeat", "reshape", "round", "select", "slice", "split",
        "split_with_sizes", "sqrt", "squeeze", "stack", "sub", "t", "to", "transpose", "unbind",
        "unflatten", "unsqueeze", "view", "where", "zero_",
    }
)  # fmt: skip
"""What has the same bits on every processor: numbers that move, or one operation of IEEE 754."""

Rule = Callable[["Values", Any, Sequence[Any]], Any]
RULES: dict[str, Rule] = {}
_INT_MIN = -(2**63)


def rule(*names: str) -> Callable[[Rule], Rule]:
    """Register the rule of operators, by their names without an overload's."""

    def register(each: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, each))
        return each

    return register


# --- by element ----------------------------------------------------------------------------------

_FUNCTIONS = {
    "abs": "Abs", "ceil": "Ceil", "cos": "Cos", "erf": "Erf", "exp": "Exp", "floor": "Floor",
    "hardswish": "HardSwish", "log": "Log", "logical_not": "Not", "mish": "Mish", "neg": "Neg",
    "reciprocal": "Reciprocal", "relu": "Relu", "round": "Round", "sigmoid": "Sigmoid",
    "sign": "Sign", "silu": "Swish", "sin": "Sin", "sqrt": "Sqrt", "tanh": "Tanh",
}  # fmt: skip
_PAIRS = {
    "div": "Div", "eq": "Equal", "floor_divide": "Div", "ge": "GreaterOrEqual", "gt": "Greater",
    "le": "LessOrEqual", "lt": "Less", "maximum": "Max", "minimum": "Min", "mul": "Mul",
    "true_divide": "Div",
}  # fmt: skip
_LOGIC = {
    "bitwise_and": "And", "bitwise_or": "Or", "bitwise_xor": "Xor", "logical_and": "And",
    "logical_or": "Or", "logical_xor": "Xor",
}  # fmt: skip


def _number(r: Values, value: Any) -> str:
    """Return the name of an operand; truth values as 0 and 1."""
    is_truth = isinstance(value, torch.Tensor) and value.dtype == torch.bool
    return r.add("Cast", r.name(value), to=1) if is_truth else r.name(value)


def _by_name(r: Values, a: Any, _: Any) -> str:
    return r.add(_FUNCTIONS[a.operator], _number(r, a.self))


def _pair(r: Values, a: Any, _: Any) -> str:
    rounded = "floor" if a.operator == "floor_divide" else a.get("rounding_mode")
    if rounded not in {None, "floor"}:
        raise UnsupportedError(f"rounding_mode {rounded}")
    result = r.add(_PAIRS[a.operator], _number(r, a.self), _number(r, a.other))
    return r.add("Floor", result) if rounded == "floor" else result


def _logic(r: Values, a: Any, _: Any) -> str:
    if any(isinstance(x, torch.Tensor) and x.dtype != torch.bool for x in (a.self, a.other)):
        raise UnsupportedError("numbers that are not truth values")
    return r.add(_LOGIC[a.operator], r.name(a.self), r.name(a.other))


for _operators, _its_rule in ((_FUNCTIONS, _by_name), (_PAIRS, _pair), (_LOGIC, _logic)):
    RULES.update(dict.fromkeys(_operators, _its_rule))


@rule("add", "sub", "rsub")
def _sum(r: Values, a: Any, _: Any) -> str:
    x, y = _number(r, a.self), _number(r, a.other)
    operator, scaled = "Add" if a.operator == "add" else "Sub", a.get("alpha", 1)
    if a.operator == "rsub":
        return r.add("Sub", y, _times(r, x, scaled))
    return r.add(operator, x, _times(r, y, scaled))


def _times(r: Values, x: str, factor: float) -> str:
    return x if factor == 1 else r.add("Mul", x, r.name(factor))


@rule("bitwise_not")
def _opposite(r: Values, a: Any, _: Any) -> str:
    if a.self.dtype != torch.bool:
        raise UnsupportedError("numbers that are not truth values")
    return r.add("Not", r.name(a.self))


@rule("ne")
def _unequal(r: Values, a: Any, _: Any) -> str:
    return r.add("Not", r.add("Equal", _number(r, a.self), _number(r, a.other)))


@rule("addcmul", "addcdiv")
def _added(r: Values, a: Any, _: Any) -> str:
    operator = "Mul" if a.operator == "addcmul" else "Div"
    part = _times(r, r.add(operator, r.name(a.tensor1), r.name(a.tensor2)), a.value)
    return r.add("Add", r.name(a.self), part)


@rule("square", "rsqrt", "hardsigmoid")
def _short(r: Values, a: Any, _: Any) -> str:
    x = r.name(a.self)
    match a.operator:
        case "square":
            return r.add("Mul", x, x)
        case "rsqrt":
            return r.add("Reciprocal", r.add("Sqrt", x))
        case _:
            return r.add("HardSigmoid", x, alpha=1.0 / 6.0, beta=0.5)


@rule("gelu")
def _gelu(r: Values, a: Any, _: Any) -> str:
    return r.add("Gelu", r.name(a.self), approximate=a.approximate.encode())


@rule("softplus")
def _softplus(r: Values, a: Any, _: Any) -> str:
    return _times(r, r.add("Softplus", _times(r, r.name(a.self), a.beta)), 1.0 / a.beta)


@rule("elu", "celu", "selu", "leaky_relu")
def _elu(r: Values, a: Any, _: Any) -> str:
    x = r.name(a.self)
    match a.operator:
        case "leaky_relu":
            return r.add("LeakyRelu", x, alpha=float(a.negative_slope))
        case "selu":
            return r.add("Selu", x)
        case "celu":
            alpha, scale, inner = float(a.alpha), 1.0, 1.0 / float(a.alpha)
        case _:
            alpha, scale, inner = float(a.alpha), float(a.scale), float(a.input_scale)
    if inner == 1.0:
        return _times(r, r.add("Elu", x, alpha=alpha), scale)
    below = r.add("Elu", _times(r, r.add("Min", x, r.name(0.0)), inner), alpha=alpha)
    return _times(r, r.add("Add", r.add("Relu", x), below), scale)


@rule("prelu", "_prelu_kernel")
def _prelu(r: Values, a: Any, _: Any) -> str:
    slope = r.array(a.weight)
    if slope.size > 1 and slope.ndim == 1 and a.self.ndim > 1:
        slope = slope.reshape(1, -1, *[1] * (a.self.ndim - 2))
    return r.add("PRelu", r.name(a.self), r.graph.constant(slope))


@rule("clamp", "clip", "hardtanh", "clamp_min", "clamp_max", "relu6")
def _clamp(r: Values, a: Any, _: Any) -> str:
    limits = a.get("min", a.get("min_val")), a.get("max", a.get("max_val"))
    limits = (0.0, 6.0) if a.operator == "relu6" else limits
    return r.add("Clip", r.name(a.self), *("" if x is None else r.name(x) for x in limits))


@rule("pow")
def _pow(r: Values, a: Any, _: Any) -> str:
    if not isinstance(a.self, torch.Tensor):
        if a.self <= 0:
            raise UnsupportedError(f"{a.self} to powers")
        return r.add("Exp", _times(r, r.name(a.exponent), math.log(a.self)))
    if isinstance(a.exponent, torch.Tensor):
        return r.add("Pow", r.name(a.self), r.graph.constant(r.array(a.exponent)))
    return r.add("Pow", r.name(a.self), r.name(float(a.exponent)))


@rule("where", "masked_fill")
def _where(r: Values, a: Any, _: Any) -> str:
    if a.operator == "masked_fill":
        return r.add("Where", r.name(a.mask), r.name(a.value), r.name(a.self))
    return r.add("Where", r.name(a.condition), r.name(a.self), r.name(a.other))


@rule("_to_copy", "to", "type_as")
def _cast(r: Values, a: Any, outputs: Any) -> str:
    (out,) = outputs
    if out.dtype == a.self.dtype or out.is_floating_point():
        return _number(r, a.self) if a.self.dtype == torch.bool else r.name(a.self)
    if a.self.dtype == torch.bool or not a.self.is_floating_point():
        return r.add("Cast", r.name(a.self), to=7)
    raise UnsupportedError(f"numbers that become {out.dtype}")


@rule("dropout", "feature_dropout", "alpha_dropout")
def _dropout(r: Values, a: Any, _: Any) -> str:
    if a.train and a.p:
        raise UnsupportedError("`train`, which draws numbers")
    return r.name(a.input)


# --- products ------------------------------------------------------------------------------------


@rule("linear")
def _linear(r: Values, a: Any, _: Any) -> str:
    if r.is_constant(a.weight):
        product = r.add("MatMul", r.name(a.input), r.graph.constant(r.array(a.weight).T))
    else:
        product = r.add("MatMul", r.name(a.input), r.add("Transpose", r.name(a.weight)))
    return product if a.bias is None else r.add("Add", product, r.name(a.bias))


@rule("mm", "bmm", "matmul", "mv", "dot")
def _matmul(r: Values, a: Any, _: Any) -> str:
    other = next(x for x in (a.get(n) for n in ("mat2", "other", "vec", "tensor")) if x is not None)
    return r.add("MatMul", r.name(a.self), r.name(other))


@rule("addmm", "baddbmm", "addmv")
def _addmm(r: Values, a: Any, _: Any) -> str:
    names = {"addmm": ("mat1", "mat2"), "baddbmm": ("batch1", "batch2"), "addmv": ("mat", "vec")}
    x, y = (a.get(name) for name in names[a.operator])
    product = _times(r, r.add("MatMul", r.name(x), r.name(y)), a.alpha)
    return r.add("Add", product, _times(r, r.name(a.self), a.beta))


@rule("conv1d", "conv2d", "convolution", "_convolution")
def _conv(r: Values, a: Any, outputs: Any) -> str:
    if a.get("transposed"):
        raise UnsupportedError("transposed kernels")
    axes = a.weight.ndim - 2
    padding = a.padding
    same = {"pads": list(_each(padding, axes)) * 2} if not isinstance(padding, str) else {}
    if isinstance(padding, str):
        same = {"auto_pad": b"SAME_UPPER" if padding == "same" else b"VALID"}
    names = [r.batched(a.input, axes + 2), r.graph.constant(r.array(a.weight))]
    names += [] if a.bias is None else [r.name(a.bias)]
    result = r.add(
        "Conv", *names, **same, group=a.groups, strides=_each(a.stride, axes),
        dilations=_each(a.dilation, axes),
    )  # fmt: skip
    return result if a.input.ndim == axes + 2 else r.reshaped(result, outputs[0].shape)


def _each(value: Any, axes: int) -> list[int]:
    listed = list(value) if isinstance(value, (list, tuple)) else [value]
    return listed * axes if len(listed) == 1 else listed


@rule("scaled_dot_product_attention", "_scaled_dot_product_flash_attention_for_cpu")
def _attention(r: Values, a: Any, outputs: Any) -> list[str]:
    if a.dropout_p or a.get("enable_gqa"):
        raise UnsupportedError("dropout or grouped queries")
    q, k, v = a.query, a.key, a.value
    order = [*range(k.ndim - 2), k.ndim - 1, k.ndim - 2]
    scale = 1.0 / math.sqrt(q.shape[-1]) if a.scale is None else a.scale
    query = _times(r, r.name(q), scale)
    scores = r.add("MatMul", query, r.add("Transpose", r.name(k), perm=order))
    if a.is_causal:
        hidden = np.triu(np.full((q.shape[-2], k.shape[-2]), -np.inf, np.float32), 1)
        scores = r.add("Add", scores, r.graph.constant(hidden))
    if a.attn_mask is not None and a.attn_mask.dtype == torch.bool:
        scores = r.add("Where", r.name(a.attn_mask), scores, r.name(-math.inf))
    elif a.attn_mask is not None:
        scores = r.add("Add", scores, r.name(a.attn_mask))
    attended = r.add("MatMul", r.add("Softmax", scores, axis=-1), r.name(v))
    return [attended, *[""] * (len(outputs) - 1)]


# --- normalisation, reductions, pools ------------------------------------------------------------


@rule("softmax", "_softmax", "log_softmax", "_log_softmax")
def _softmax(r: Values, a: Any, _: Any) -> str:
    operator = "LogSoftmax" if "log" in a.operator else "Softmax"
    return r.add(operator, r.name(a.self), axis=a.dim)


def _or_ones(r: Values, value: Any, size: int, *, zeros: bool = False) -> str:
    made = np.zeros if zeros else np.ones
    return r.graph.constant(made(size, np.float32)) if value is None else r.name(value)


@rule("layer_norm", "native_layer_norm")
def _layer_norm(r: Values, a: Any, outputs: Any) -> list[str]:
    shape = list(a.normalized_shape)
    scale = _or_ones(r, a.weight, math.prod(shape))
    shift = _or_ones(r, a.bias, math.prod(shape), zeros=True)
    if len(shape) > 1:
        scale, shift = (r.reshaped(each, shape) for each in (scale, shift))
    name = r.add(
        "LayerNormalization", r.name(a.input), scale, shift, axis=-len(shape), epsilon=a.eps
    )
    return [name, *[""] * (len(outputs) - 1)]


@rule("rms_norm", "_fused_rms_norm")
def _rms_norm(r: Values, a: Any, outputs: Any) -> list[str]:
    x, axes = r.name(a.input), list(range(-len(a.normalized_shape), 0))
    eps = torch.finfo(a.input.dtype).eps if a.eps is None else a.eps
    mean = r.add("ReduceMean", r.add("Mul", x, x), axes=axes)
    result = r.add("Div", x, r.add("Sqrt", r.add("Add", mean, r.name(float(eps)))))
    result = result if a.weight is None else r.add("Mul", result, r.name(a.weight))
    return [result, *[""] * (len(outputs) - 1)]


@rule("batch_norm", "native_batch_norm", "_native_batch_norm_legit_no_training")
def _batch_norm(r: Values, a: Any, outputs: Any) -> list[str]:
    if a.get("training") or a.running_mean is None:
        raise UnsupportedError("statistics of the batch")
    size = a.input.shape[1]
    names = [
        _or_ones(r, a.weight, size),
        _or_ones(r, a.bias, size, zeros=True),
        r.name(a.running_mean),
        r.name(a.running_var),
    ]
    name = r.add("BatchNormalization", r.name(a.input), *names, epsilon=a.eps)
    return [name, *[""] * (len(outputs) - 1)]


@rule("group_norm", "native_group_norm", "instance_norm")
def _group_norm(r: Values, a: Any, outputs: Any) -> list[str]:
    if a.operator == "instance_norm" and not a.use_input_stats:
        raise UnsupportedError("running statistics")
    channels = a.input.shape[1]
    groups = a.get("num_groups", a.get("group", channels))
    names = [_or_ones(r, a.weight, channels), _or_ones(r, a.bias, channels, zeros=True)]
    name = r.add("GroupNormalization", r.name(a.input), *names, num_groups=groups, epsilon=a.eps)
    return [name, *[""] * (len(outputs) - 1)]


_REDUCTIONS = {
    "mean": "ReduceMean", "sum": "ReduceSum", "amax": "ReduceMax", "amin": "ReduceMin",
    "max": "ReduceMax", "min": "ReduceMin", "prod": "ReduceProd",
}  # fmt: skip


@rule(*_REDUCTIONS)
def _reduced(r: Values, a: Any, outputs: Any) -> list[str]:
    if isinstance(a.get("other"), torch.Tensor):  # `torch.max(x, y)`.
        return [r.add("Max" if a.operator == "max" else "Min", r.name(a.self), r.name(a.other))]
    name = _reduce(r, _REDUCTIONS[a.operator], _number(r, a.self), a)
    return [name, *[""] * (len(outputs) - 1)]


def _reduce(r: Values, operator: str, x: str, a: Any) -> str:
    axes = a.get("dim")
    axes = [axes] if isinstance(axes, int) else list(axes or [])
    axes = axes or list(range(a.self.ndim))
    return r.add(operator, x, axes=axes, keepdims=int(bool(a.get("keepdim"))))


@rule("linalg_vector_norm", "norm", "frobenius_norm")
def _norm(r: Values, a: Any, _: Any) -> str:
    order = a.get("ord", a.get("p"))
    order = 2.0 if order is None else float(order)
    if order == math.inf:
        return _reduce(r, "ReduceMax", r.add("Abs", r.name(a.self)), a)
    if order not in {1.0, 2.0}:
        raise UnsupportedError(f"order {order}")
    return _reduce(r, f"ReduceL{int(order)}", r.name(a.self), a)


@rule("var", "std")
def _spread(r: Values, a: Any, outputs: Any) -> str:
    axes = a.get("dim")
    axes = [axes] if isinstance(axes, int) else list(axes or range(a.self.ndim))
    x = r.name(a.self)
    centred = r.add("Sub", x, r.add("ReduceMean", x, axes=axes))
    total = _reduce(r, "ReduceSumSquare", centred, a)
    unbiased = a.get("unbiased")
    correction = a.get("correction")
    less = 1 if correction is None else correction
    less = less if unbiased is None else int(unbiased)
    count = a.self.numel() // max(outputs[0].numel(), 1) - less
    spread = r.add("Div", total, r.name(float(count)))
    return spread if a.operator == "var" else r.add("Sqrt", spread)


@rule("max_pool1d", "max_pool2d", "max_pool2d_with_indices", "avg_pool1d", "avg_pool2d")
def _pool(r: Values, a: Any, outputs: Any) -> list[str]:
    axes = 1 if "1d" in a.operator else 2
    if a.ceil_mode or a.get("divisor_override"):
        raise UnsupportedError("sizes rounded up, or a divisor")
    kernel = _each(a.kernel_size, axes)
    at: dict[str, Any] = {"kernel_shape": kernel, "pads": _each(a.padding, axes) * 2}
    at["strides"] = _each(a.stride, axes) if a.stride not in ([], None) else kernel
    if "max" in a.operator:
        at["dilations"] = _each(a.dilation, axes)
    else:
        at["count_include_pad"] = int(a.count_include_pad)
    operator = "MaxPool" if "max" in a.operator else "AveragePool"
    name = r.reshaped(r.add(operator, r.batched(a.self, axes + 2), **at), outputs[0].shape)
    return [name, *[""] * (len(outputs) - 1)]


@rule("adaptive_avg_pool1d", "adaptive_avg_pool2d", "_adaptive_avg_pool2d")
def _adaptive_pool(r: Values, a: Any, outputs: Any) -> str:
    axes = 1 if "1d" in a.operator else 2
    given, wanted = a.self.shape[-axes:], outputs[0].shape[-axes:]
    if any(n % m for n, m in zip(given, wanted, strict=True)):
        raise UnsupportedError(f"sizes {list(given)} to {list(wanted)}")
    kernel = [n // m for n, m in zip(given, wanted, strict=True)]
    pooled = r.add("AveragePool", r.batched(a.self, axes + 2), kernel_shape=kernel, strides=kernel)
    return r.reshaped(pooled, outputs[0].shape)


# --- what moves numbers --------------------------------------------------------------------------


@rule(
    "alias", "clone", "contiguous", "detach", "detach_", "lift_fresh", "lift_fresh_copy",
    "positive", "view", "view_as", "reshape", "_unsafe_view", "_reshape_alias", "flatten",
    "unflatten", "unsqueeze", "squeeze", "ravel",
)  # fmt: skip
def _reshape(r: Values, a: Any, outputs: Any) -> str:
    (out,) = outputs
    if out.dtype != a.self.dtype:
        raise UnsupportedError(f"{a.self.dtype} read as {out.dtype}")
    return r.reshaped(r.name(a.self), out.shape) if out.shape != a.self.shape else r.name(a.self)


@rule("t", "transpose", "permute", "swapaxes", "numpy_T")
def _transpose(r: Values, a: Any, _: Any) -> str:
    axes = list(range(a.self.ndim))
    if a.operator == "permute":
        axes = [axis % a.self.ndim for axis in a.dims]
    elif a.operator in {"t", "numpy_T"}:
        axes.reverse()
    else:
        one, other = a.get("dim0", a.get("axis0")), a.get("dim1", a.get("axis1"))
        axes[one], axes[other] = axes[other], axes[one]
    return r.add("Transpose", r.name(a.self), perm=axes)


@rule("expand", "expand_as", "broadcast_to")
def _expand(r: Values, a: Any, outputs: Any) -> str:
    return r.add("Expand", r.name(a.self), r.whole(outputs[0].shape))


@rule("repeat")
def _repeat(r: Values, a: Any, _: Any) -> str:
    shape = [1] * (len(a.repeats) - a.self.ndim) + list(a.self.shape)
    return r.add("Tile", r.reshaped(r.name(a.self), shape), r.whole(a.repeats))


@rule("slice")
def _slice(r: Values, a: Any, _: Any) -> str:
    size = a.self.shape[a.dim]
    return r.slice(
        r.name(a.self), a.dim % a.self.ndim, *slice(a.start, a.end, a.step).indices(size)
    )


@rule("select")
def _select(r: Values, a: Any, outputs: Any) -> str:
    axis = a.dim % a.self.ndim
    at = a.index % a.self.shape[axis]
    return r.reshaped(r.slice(r.name(a.self), axis, at, at + 1), outputs[0].shape)


@rule("split", "split_with_sizes", "chunk", "unsafe_split", "unsafe_chunk", "unbind", "narrow")
def _parts(r: Values, a: Any, outputs: Any) -> list[str]:
    axis = a.dim % a.self.ndim
    start, parts = a.get("start", 0), list[str]()
    for out in outputs:
        size = 1 if a.operator == "unbind" else out.shape[axis]
        parts.append(r.reshaped(r.slice(r.name(a.self), axis, start, start + size), out.shape))
        start += size
    return parts


@rule("cat", "concat", "stack")
def _cat(r: Values, a: Any, outputs: Any) -> str:
    (out,) = outputs
    axis = a.dim % out.ndim
    tensors = [each for each in a.tensors if a.operator == "stack" or each.numel()]
    shapes = [list(each.shape) for each in tensors]
    if a.operator == "stack":
        shapes = [[*shape[:axis], 1, *shape[axis:]] for shape in shapes]
    names = [r.reshaped(r.name(x), shape) for x, shape in zip(tensors, shapes, strict=True)]
    return r.add("Concat", *names, axis=axis)


@rule("flip")
def _flip(r: Values, a: Any, _: Any) -> str:
    name = r.name(a.self)
    for axis in a.dims:
        name = r.slice(name, axis % a.self.ndim, -1, _INT_MIN, -1)
    return name


@rule("roll")
def _roll(r: Values, a: Any, outputs: Any) -> str:
    name, axes = r.name(a.self), list(a.dims)
    if not axes:
        name, axes = r.reshaped(name, [a.self.numel()]), [0]
    for axis, shift in zip(axes, _each(a.shifts, len(axes)), strict=True):
        size = a.self.numel() if not a.dims else a.self.shape[axis]
        cut = -shift % size
        parts = r.slice(name, axis, cut, size), r.slice(name, axis, 0, cut)
        name = r.add("Concat", *parts, axis=axis) if cut else name
    return r.reshaped(name, outputs[0].shape)


@rule("constant_pad_nd")
def _pad(r: Values, a: Any, _: Any) -> str:
    pairs = list(zip(a.pad[::2], a.pad[1::2], strict=True))[::-1]
    pairs = [(0, 0)] * (a.self.ndim - len(pairs)) + pairs
    pads = r.whole([pair[side] for side in (0, 1) for pair in pairs])
    return r.add("Pad", r.name(a.self), pads, r.name(float(a.get("value") or 0.0)))


@rule("index_select", "embedding", "index")
def _gather(r: Values, a: Any, _: Any) -> str:
    if a.operator == "embedding":
        return r.add("Gather", r.name(a.weight), r.graph.constant(r.array(a.indices)))
    if a.operator == "index_select":
        return r.add("Gather", r.name(a.self), r.graph.constant(r.array(a.index)), axis=a.dim)
    used = [axis for axis, index in enumerate(a.indices) if index is not None]
    if len(used) != 1:
        raise UnsupportedError("indices for more than one axis")
    index = r.array(a.indices[used[0]])
    if index.dtype == np.bool_:
        index = np.flatnonzero(index) if index.ndim == 1 else None
    if index is None:
        raise UnsupportedError("a mask of several axes")
    return r.add("Gather", r.name(a.self), r.graph.constant(index), axis=used[0])


@rule("copy_", "copy", "fill_", "zero_", "fill")
def _fill(r: Values, a: Any, _: Any) -> str:
    value = a.get("src", a.get("value", 0.0))
    value = value if isinstance(value, torch.Tensor) else float(value)
    return r.add("Expand", _number(r, value), r.whole(a.self.shape))
