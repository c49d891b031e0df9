"""Operators that move numbers and change none: most become views of what is there already."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from nw_policies.executor.graph import Node, UnsupportedError
from nw_policies.executor.planning import Array, Planner, operator
from nw_policies.executor.views import View

_SPLIT_BY_NUMBER = 18
_FLOATS = {1: np.float32, 10: np.float16, 11: np.float64}
_DTYPES: dict[int, Any] = {
    **_FLOATS, 2: np.uint8, 3: np.int8, 5: np.int16, 6: np.int32, 7: np.int64, 9: np.bool_,
    12: np.uint32, 13: np.uint64,
}  # fmt: skip
"""TensorProto.DataType."""
_ROWS_OF_GATHER = 4096


@operator("Constant")
def _constant(plan: Planner, node: Node) -> None:
    for name, value in node.attributes.items():
        if name not in {"value", "value_float", "value_floats", "value_int", "value_ints"}:
            raise UnsupportedError(f"`{name}`")
        kind = {"value_f": np.float32, "value_i": np.int64}.get(name[:7])
        plan.values[node.outputs[0]] = np.asarray(value, kind)


@operator("ConstantOfShape")
def _constant_of_shape(plan: Planner, node: Node) -> None:
    value = np.asarray(node.attributes.get("value", np.zeros(1, np.float32)))
    shape = _whole(plan.constant(node.inputs[0]))
    plan.values[node.outputs[0]] = np.full(_bounded(shape), value.ravel()[0], value.dtype)


@operator("Range")
def _range(plan: Planner, node: Node) -> None:
    start, stop, step = (plan.constant(name) for name in node.inputs)
    if start.dtype.kind not in "iu":
        raise UnsupportedError("numbers that are not whole")
    _bounded([len(range(int(start), int(stop), int(step)))])
    plan.values[node.outputs[0]] = np.arange(int(start), int(stop), int(step), dtype=start.dtype)


@operator("Shape")
def _shape(plan: Planner, node: Node) -> None:
    shape = plan.values[node.inputs[0]].shape
    start, end = node.attributes.get("start", 0), node.attributes.get("end", len(shape))
    plan.values[node.outputs[0]] = np.array(shape[start:end], np.int64)


@operator("Size")
def _size(plan: Planner, node: Node) -> None:
    plan.values[node.outputs[0]] = np.array(plan.values[node.inputs[0]].size, np.int64)


@operator("Identity", "Dropout", "StopGradient")
def _identity(plan: Planner, node: Node) -> None:
    if plan.has(node, 2) and bool(plan.constant(node.inputs[2])):
        raise UnsupportedError("training_mode")
    plan.values[node.outputs[0]] = plan.values[node.inputs[0]]
    if len(node.outputs) > 1 and node.outputs[1]:
        raise UnsupportedError("a mask")


@operator("Cast")
def _cast(plan: Planner, node: Node) -> None:
    value, to = plan.values[node.inputs[0]], int(node.attributes["to"])
    if to not in _DTYPES:
        raise UnsupportedError(f"type {to}")
    if isinstance(value, View):
        if to == 1 or (to in {6, 7} and value.kind in {"whole", "bool"}):
            kind = "float" if to == 1 else "whole"
            plan.values[node.outputs[0]] = replace(value, kind=kind)
        elif to == 9 and value.kind == "bool":
            plan.values[node.outputs[0]] = value
        else:
            raise UnsupportedError(f"a {value.kind} made a {np.dtype(_DTYPES[to])}")
    else:
        plan.values[node.outputs[0]] = value.astype(_DTYPES[to])


@operator("CastLike")
def _cast_like(plan: Planner, node: Node) -> None:
    value, like = (plan.values[name] for name in node.inputs)
    if isinstance(value, View) or isinstance(like, View):
        kinds = {v.kind if isinstance(v, View) else v.dtype.name for v in (value, like)}
        if kinds - {"float", "float32"}:
            raise UnsupportedError(" and ".join(sorted(kinds)))
        plan.values[node.outputs[0]] = value
    else:
        plan.values[node.outputs[0]] = value.astype(like.dtype)


@operator("Reshape")
def _reshape(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    given = node.attributes.get("shape")
    wanted = _whole(plan.constant(node.inputs[1])) if given is None else list(given)
    keeps = node.attributes.get("allowzero", 0) == 0
    shape = [value.shape[i] if n == 0 and keeps else n for i, n in enumerate(wanted)]
    if -1 in shape:
        rest = math.prod(n for n in shape if n != -1)
        shape[shape.index(-1)] = value.size // rest if rest else 0
    plan.values[node.outputs[0]] = _reshaped(plan, value, shape)


@operator("Flatten")
def _flatten(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    axis = node.attributes.get("axis", 1)
    axis += len(value.shape) if axis < 0 else 0
    shape = math.prod(value.shape[:axis]), math.prod(value.shape[axis:])
    plan.values[node.outputs[0]] = _reshaped(plan, value, shape)


@operator("Unsqueeze")
def _unsqueeze(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    axes = axes_of(plan, node, 1)
    shape = list(value.shape)
    rank = len(shape) + len(axes)
    for axis in sorted(axis % rank for axis in axes):
        shape.insert(axis, 1)
    plan.values[node.outputs[0]] = _reshaped(plan, value, shape)


@operator("Squeeze")
def _squeeze(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    axes = axes_of(plan, node, 1) or [i for i, n in enumerate(value.shape) if n == 1]
    gone = {axis % len(value.shape) for axis in axes}
    if any(value.shape[axis] != 1 for axis in gone):
        raise UnsupportedError(f"axes {sorted(gone)} of {value.shape}")
    shape = [n for axis, n in enumerate(value.shape) if axis not in gone]
    plan.values[node.outputs[0]] = _reshaped(plan, value, shape)


def _reshaped(plan: Planner, value: Array | View, shape: Sequence[int]) -> Array | View:
    return plan.reshaped(value, shape) if isinstance(value, View) else value.reshape(shape)


@operator("Transpose")
def _transpose(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    order = node.attributes.get("perm", list(reversed(range(len(value.shape)))))
    plan.values[node.outputs[0]] = (
        value.transposed(order) if isinstance(value, View) else value.transpose(order)
    )


@operator("Expand")
def _expand(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    shape = np.broadcast_shapes(value.shape, tuple(_whole(plan.constant(node.inputs[1]))))
    _bounded(shape)
    plan.values[node.outputs[0]] = (
        value.broadcast(shape) if isinstance(value, View) else np.broadcast_to(value, shape)
    )


@operator("Tile")
def _tile(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    times = _whole(plan.constant(node.inputs[1]))
    _bounded([n * t for n, t in zip(value.shape, times, strict=True)])
    if not isinstance(value, View):
        plan.values[node.outputs[0]] = np.tile(value, times)
        return
    pairs = list(zip(times, value.shape, strict=True))
    repeated = plan.reshaped(value, [n for _, size in pairs for n in (1, size)])
    repeated = repeated.broadcast(tuple(n for pair in pairs for n in pair))
    plan.values[node.outputs[0]] = plan.reshaped(repeated, [t * n for t, n in pairs])


@operator("Slice")
def _slice(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    if len(node.inputs) == 1:
        at = node.attributes
        starts, ends = list(at["starts"]), list(at["ends"])
        axes, steps = list(at.get("axes", range(len(starts)))), [1] * len(starts)
    else:
        starts, ends = (_whole(plan.constant(name)) for name in node.inputs[1:3])
        axes = _whole(plan.constant_or(node, 3, np.arange(len(starts))))
        steps = _whole(plan.constant_or(node, 4, np.ones(len(starts))))
    taken = [slice(None)] * len(value.shape)
    for start, end, axis, step in zip(starts, ends, axes, steps, strict=True):
        size = value.shape[axis]
        if step < 0:  # ONNX clamps to [0, size - 1] and [-1, size - 1]; None goes on to the first.
            start = min(start + size if start < 0 else start, size - 1)  # noqa: PLW2901
            stop = end + size if end < 0 else end
            taken[axis] = slice(start, None if stop < 0 else stop, step)
        else:
            taken[axis] = slice(start, end, step)
    plan.values[node.outputs[0]] = (
        sliced(value, taken) if isinstance(value, View) else value[tuple(taken)]
    )


def sliced(view: View, taken: Sequence[slice]) -> View:
    """Return the part of a view that a slice for each axis selects."""
    offset, shape, strides = view.offset, list(view.shape), list(view.strides)
    for axis, each in enumerate(taken):
        indices = range(*each.indices(view.shape[axis]))
        offset += (indices.start if indices else 0) * view.strides[axis]
        shape[axis] = len(indices)
        strides[axis] *= indices.step
    return replace(view, offset=offset, shape=tuple(shape), strides=tuple(strides))


def part(view: View, axis: int, start: int, size: int) -> View:
    """Return some of the elements along one axis."""
    taken = [slice(None)] * len(view.shape)
    taken[axis] = slice(start, start + size)
    return sliced(view, taken)


@operator("Split")
def _split(plan: Planner, node: Node) -> None:
    value = plan.values[node.inputs[0]]
    axis = node.attributes.get("axis", 0) % len(value.shape)
    size, count = value.shape[axis], len(node.outputs)
    if plan.has(node, 1):
        sizes = _whole(plan.constant(node.inputs[1]))
    elif "split" in node.attributes:
        sizes = list(node.attributes["split"])
    else:
        if plan.version >= _SPLIT_BY_NUMBER and node.attributes.get("num_outputs", count) != count:
            raise UnsupportedError(f"{count} outputs")
        each = -(-size // count)
        sizes = [min(each, max(size - each * k, 0)) for k in range(count)]
    if sum(sizes) != size or len(sizes) != count:
        raise UnsupportedError(f"parts of {sizes} of {size}")
    start = 0
    for name, each in zip(node.outputs, sizes, strict=True):
        if isinstance(value, View):
            plan.values[name] = part(value, axis, start, each)
        else:
            plan.values[name] = np.take(value, range(start, start + each), axis)
        start += each


@operator("Concat")
def _concat(plan: Planner, node: Node) -> None:
    values = [plan.values[name] for name in node.inputs]
    axis = node.attributes["axis"] % len(values[0].shape)
    arrays = [value for value in values if not isinstance(value, View)]
    if len(arrays) == len(values):
        plan.values[node.outputs[0]] = np.concatenate(arrays, axis)
    else:
        views = [plan.view(name) for name in node.inputs]
        plan.values[node.outputs[0]] = joined(plan, views, axis)


def joined(plan: Planner, views: Sequence[View], axis: int) -> View:
    """Return views one behind the other along an axis."""
    if len(views) == 1:
        return views[0]
    shape = list(views[0].shape)
    shape[axis] = sum(view.shape[axis] for view in views)
    target = plan.new(shape, *views, kind=views[0].kind)
    start = 0
    for view in views:
        place = part(target, axis, start, view.shape[axis])
        if place.shape != view.shape:
            raise UnsupportedError(f"arrays of {view.shape} and {place.shape}")
        plan.copy(view, place)
        start += view.shape[axis]
    return target


@operator("Gather")
def _gather(plan: Planner, node: Node) -> None:
    value, index = plan.values[node.inputs[0]], plan.constant(node.inputs[1])
    axis = node.attributes.get("axis", 0) % len(value.shape)
    size = value.shape[axis]
    if index.size and not -size <= index.min() <= index.max() < size:
        raise UnsupportedError(f"an index outside of {size}")
    if not isinstance(value, View):
        plan.values[node.outputs[0]] = np.take(value, index, axis)
        return
    flat = [int(i) % size for i in index.ravel()]
    steps = {b - a for a, b in pairwise(flat)} or {1}
    if len(steps) == 1:
        (step,) = steps
        start = flat[0] if flat else 0
        taken = replace(
            value,
            offset=value.offset + start * value.strides[axis],
            shape=(*value.shape[:axis], len(flat), *value.shape[axis + 1 :]),
            strides=tuple(s * step if a == axis else s for a, s in enumerate(value.strides)),
        )
    else:
        if len(flat) > _ROWS_OF_GATHER:
            raise UnsupportedError(f"{len(flat)} indices that are not evenly spaced")
        taken = joined(plan, [part(value, axis, i, 1) for i in flat], axis)
    shape = (*value.shape[:axis], *index.shape, *value.shape[axis + 1 :])
    plan.values[node.outputs[0]] = plan.reshaped(taken, shape)


@operator("Pad")
def _pad(plan: Planner, node: Node) -> None:
    at = node.attributes
    mode = at.get("mode", b"constant")
    if mode != b"constant":
        raise UnsupportedError(f"mode {mode.decode('utf-8', 'replace')}")
    view = plan.view(node.inputs[0])
    pads = at["pads"] if "pads" in at else plan.constant(node.inputs[1])
    fill = plan.constant_or(node, 2, np.array(at.get("value", 0.0)))
    axes = _whole(plan.constant_or(node, 3, np.arange(len(view.shape))))
    before, after = [0] * len(view.shape), [0] * len(view.shape)
    for axis, first, last in zip(
        axes, _whole(pads)[: len(axes)], _whole(pads)[len(axes) :], strict=True
    ):
        before[axis], after[axis] = first, last
    plan.values[node.outputs[0]] = padded(plan, view, before, after, float(np.ravel(fill)[0]))


def padded(
    plan: Planner, view: View, before: Sequence[int], after: Sequence[int], fill: float
) -> View:
    """Return a view with constant borders; negative ones cut."""
    taken = [
        slice(max(-first, 0), n - max(-last, 0))
        for n, first, last in zip(view.shape, before, after, strict=True)
    ]
    view = sliced(view, taken)
    first, last = ([max(n, 0) for n in each] for each in (before, after))
    if not any(first) and not any(last):
        return view
    shape = [n + a + b for n, a, b in zip(view.shape, first, last, strict=True)]
    _bounded(shape)
    target = plan.new(shape, view, kind=view.kind)
    if fill != 0.0:
        plan.copy(plan.scalar(fill).broadcast(target.shape), target)  # Once: nothing overwrites it.
    inner = sliced(target, [slice(a, a + n) for a, n in zip(first, view.shape, strict=True)])
    plan.copy(view, inner)
    return target


def axes_of(plan: Planner, node: Node, index: int) -> list[int]:
    """Return axes, an attribute in old operator sets and an input in new ones; empty if absent."""
    if "axes" in node.attributes:
        return [int(axis) for axis in node.attributes["axes"]]
    return _whole(plan.constant_or(node, index, np.zeros(0)))


def _whole(array: Any) -> list[int]:
    return [int(number) for number in np.ravel(array)]


def _bounded(shape: Sequence[int]) -> tuple[int, ...]:
    if math.prod(shape) > 2**24 or min(shape, default=0) < 0:
        raise UnsupportedError(f"an array of {' x '.join(map(str, shape))}")
    return tuple(shape)
