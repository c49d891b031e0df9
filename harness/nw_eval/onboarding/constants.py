"""Outputs of a network file that are constants, such as gains, read without running it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from nw_eval.errors import PolicyError
from nw_eval.onboarding.checkpoint import forward_code
from nw_eval.policies.safety import FileKind, FileLimits, open_archive
from nw_eval.policies.safety.objects import TensorRef, read_index
from nw_eval.policies.safety.onnx_format import ONNX, ProtobufMessage, Reader
from nw_eval.policies.safety.tensors import check_references

_MOST = 1000
"""Numbers of one output; gains are one for each joint."""
_FLOAT = 1
"""TensorProto.DataType.FLOAT."""
Constants = dict[str, tuple[float, ...]]


def constant_outputs(data: bytes, where: str, kind: FileKind, names: Sequence[str]) -> Constants:
    """Return the float32 numbers of the outputs that no input changes, as far as they are plain.

    Args:
        data: an ONNX or TorchScript file that has been checked; of others nothing is read.
        where: its path, for errors.
        kind: which of them it is.
        names: the outputs of a TorchScript file, in order.
    """
    try:
        if kind == "onnx":
            return _of_graph(data)
        return _of_script(data, where, names) if kind == "torchscript" else {}
    except (ValueError, PolicyError):
        return {}  # What is no plain constant is not said.


def _of_graph(data: bytes) -> Constants:
    """Return outputs that are initialisers, or copies of them."""
    reader = Reader(ONNX)
    model = reader.read(memoryview(data), "Model")
    graph = reader.read(model.views("graph")[0], "Graph")
    stored: dict[str, ProtobufMessage] = {}
    for view in graph.views("initializer"):
        tensor = reader.read(view, "Tensor")
        stored[tensor.text("name")] = tensor
    copied: dict[str, str] = {}
    for view in graph.views("node"):
        node = reader.read(view, "Node")
        if node.text("op_type") == "Identity":
            copied[node.text("output")] = node.text("input")
    outputs = [reader.read(view, "ValueInfo").text("name") for view in graph.views("output")]
    found = {name: stored.get(copied.get(name, name)) for name in outputs}
    return {name: n for name, tensor in found.items() if tensor and (n := _numbers(tensor))}


def _numbers(tensor: ProtobufMessage) -> tuple[float, ...]:
    raw = b"".join([*tensor.views("raw_data"), *tensor.views("float_data")])
    if tensor.integer("data_type") != _FLOAT or len(raw) % 4 or len(raw) > 4 * _MOST:
        return ()
    return _finite(np.frombuffer(raw, "<f4"))


def _of_script(data: bytes, where: str, names: Sequence[str]) -> Constants:
    """Return what `forward` returns as `CONSTANTS.c7`: the tensor 7 of the file's constants."""
    body = forward_code(data, where)
    returned = re.search(r"\n    return (.+)", body)
    text = returned[1] if returned else ""
    bound = re.search(rf"\n    {text} = (.+)", body) if re.fullmatch(r"\w+", text) else None
    items = _items(bound[1] if bound else text)
    if len(items) != len(names):
        return {}
    archive, limits = open_archive(data, where), FileLimits()
    index = read_index(archive.read("constants.pkl", at_most=limits.index_bytes), where, limits)
    check_references(index, archive, "constants", limits)
    tree = index.tree if isinstance(index.tree, tuple | list) else ()
    found: Constants = {}
    for name, item in zip(names, items, strict=True):
        place = re.fullmatch(r"CONSTANTS\.c(\d{1,6})", item)
        ref = tree[int(place[1])] if place and int(place[1]) < len(tree) else None
        if not isinstance(ref, TensorRef) or ref.storage.dtype != "float32":
            continue
        if math.prod(ref.shape) == ref.storage.count <= _MOST:
            raw = archive.read(f"constants/{ref.storage.key}", at_most=4 * _MOST)
            found[name] = _finite(np.frombuffer(raw, "<f4"))
    return found


def _items(text: str) -> list[str]:
    """Return the entries of a tuple as TorchScript writes it; calls in it keep their commas."""
    items, depth = [""], 0
    for letter in text.strip().removeprefix("(").removesuffix(")"):
        depth += (letter in "([") - (letter in ")]")
        if letter == "," and depth == 0:
            items.append("")
        else:
            items[-1] += letter
    return [item.strip() for item in items if item.strip()]


def _finite(numbers: np.ndarray) -> tuple[float, ...]:
    return tuple(numbers.tolist()) if np.isfinite(numbers).all() else ()
