"""Reads an ONNX file as a graph of `nw_policies.executor`, without the onnx package.

The file has passed `check_onnx`: it has the fields of onnx.proto, tensors as large as their
numbers, and no functions that call themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from nw_policies.executor import Graph, GraphInput, Node, UnsupportedError
from nw_policies.safety.onnx import ONNX, ProtobufMessage, Reader, integers

_DTYPES: dict[int, str] = {
    1: "<f4", 2: "u1", 3: "i1", 4: "<u2", 5: "<i2", 6: "<i4", 7: "<i8", 9: "?", 10: "<f2",
    11: "<f8", 12: "<u4", 13: "<u8",
}  # fmt: skip
"""TensorProto.DataType."""
_WORDS = {8: "string", 16: "bfloat16"}
_MOST = 2**24
_STANDARD = "ai.onnx"


def read_graph(data: bytes) -> Graph:
    """Return the main graph of a file.

    Args:
        data: the whole file, which `check_onnx` has passed.

    Raises:
        UnsupportedError: it has functions, graphs inside of operators, or types that are no
            numbers.
        ValueError: it is damaged.
    """
    return _GraphReader(data).graph()


class DeclaredArray(NamedTuple):
    """An input or output as a file declares it."""

    name: str
    shape: tuple[int | None, ...]
    """None is a free axis."""
    dtype: str
    """As NumPy calls it; empty where the file does not say."""


@dataclass(frozen=True, kw_only=True)
class DeclaredGraph:
    """Declarations of a file's main graph."""

    inputs: tuple[DeclaredArray, ...]
    outputs: tuple[DeclaredArray, ...]
    metadata: dict[str, str]
    weights: tuple[str, ...] = ()
    """Names of its constants."""


def read_declared(data: bytes) -> DeclaredGraph:
    """Return a file's declarations. An output without a shape gets the shape of its plan, if any.

    Args:
        data: the whole file, which `check_onnx` has passed.

    Raises:
        ValueError: it is damaged.
    """
    return _GraphReader(data).declared()


class _GraphReader:
    def __init__(self, data: bytes) -> None:
        self._reader = Reader(ONNX)
        self._model = self._reader.read(memoryview(data), "Model")

    def graph(self) -> Graph:
        if "functions" in self._model:
            raise UnsupportedError("functions of the file")
        (main,) = self._inside(self._model, "graph", "Graph")
        graph = Graph()
        for each in self._inside(self._model, "opset_import", "Opset"):
            if each.text("domain") in {"", _STANDARD}:
                graph.version = each.integer("version")
        for tensor in self._inside(main, "initializer", "Tensor"):
            graph.constants[tensor.text("name")] = self._tensor(tensor)
        for value in self._inside(main, "input", "ValueInfo"):
            if value.text("name") not in graph.constants:  # As files of before 2019 have them.
                graph.inputs.append(self._input(value))
        graph.nodes = [self._node(node) for node in self._inside(main, "node", "Node")]
        graph.outputs = [value.text("name") for value in self._inside(main, "output", "ValueInfo")]
        return graph

    def declared(self) -> DeclaredGraph:
        (main,) = self._inside(self._model, "graph", "Graph")
        tensors = self._inside(main, "initializer", "Tensor")
        weights = dict.fromkeys(tensor.text("name") for tensor in tensors)
        inputs = [self._declared(value) for value in self._inside(main, "input", "ValueInfo")]
        outputs = [self._declared(value) for value in self._inside(main, "output", "ValueInfo")]
        if not all(each.dtype and each.shape for each in outputs):
            outputs = self._inferred(outputs)
        entries = self._inside(self._model, "metadata_props", "Entry")
        return DeclaredGraph(
            inputs=tuple(each for each in inputs if each.name not in weights),
            outputs=tuple(outputs),
            metadata={entry.text("key"): entry.text("value") for entry in entries},
            weights=tuple(weights),
        )

    def _inferred(self, outputs: list[DeclaredArray]) -> list[DeclaredArray]:
        from nw_policies.executor.plan import plan

        try:
            known = plan(self.graph()).outputs
        except (UnsupportedError, ValueError):
            return outputs
        return [
            DeclaredArray(each.name, tuple(slot.shape), np.dtype(slot.dtype).name)
            for each in outputs
            for slot in [known[each.name]]
        ]

    def _declared(self, value: ProtobufMessage) -> DeclaredArray:
        for type_ in self._inside(value, "type", "Type"):
            for tensor in self._inside(type_, "tensor_type", "TensorType"):
                number = tensor.integer("elem_type")
                dtype = np.dtype(_DTYPES[number]).name if number in _DTYPES else ""
                sides = [
                    axis.integer("dim_value")
                    for shape in self._inside(tensor, "shape", "Shape")
                    for axis in self._inside(shape, "dim", "Dim")
                ]
                shape = tuple(side or None for side in sides)
                return DeclaredArray(value.text("name"), shape, dtype or _WORDS.get(number, ""))
        return DeclaredArray(value.text("name"), (), "")

    def _inside(self, message: ProtobufMessage, field: str, kind: str) -> list[ProtobufMessage]:
        return [self._reader.read(view, kind) for view in message.views(field)]

    def _input(self, value: ProtobufMessage) -> GraphInput:
        name = value.text("name")
        for type_ in self._inside(value, "type", "Type"):
            for tensor in self._inside(type_, "tensor_type", "TensorType"):
                shapes = self._inside(tensor, "shape", "Shape")
                if tensor.integer("elem_type") not in _DTYPES or len(shapes) != 1:
                    break
                sides = [
                    axis.integer("dim_value") for axis in self._inside(shapes[0], "dim", "Dim")
                ]
                dtype = np.dtype(_DTYPES[tensor.integer("elem_type")])
                shape = tuple(side or None for side in sides)
                return GraphInput(name=name, shape=shape, dtype=dtype)
        raise UnsupportedError(f"the input {name!r}, which is not an array of numbers")

    def _node(self, node: ProtobufMessage) -> Node:
        domain = node.text("domain")
        attributes = {
            each.text("name"): self._attribute(each)
            for each in self._inside(node, "attribute", "Attribute")
        }
        return Node(
            operator=node.text("op_type"),
            inputs=_names(node, "input"),
            outputs=_names(node, "output"),
            attributes=attributes,
            domain="" if domain == _STANDARD else domain,
        )

    def _attribute(self, attribute: ProtobufMessage) -> Any:
        match attribute.integer("type"):  # AttributeProto.AttributeType.
            case 1:
                return float(np.frombuffer(b"".join(attribute.views("f")) or bytes(4), "<f4")[0])
            case 2:
                return attribute.integer("i")
            case 3:
                return b"".join(attribute.views("s"))
            case 4:
                return self._tensor(self._inside(attribute, "t", "Tensor")[0])
            case 6:
                return np.frombuffer(b"".join(attribute.views("floats")), "<f4").tolist()
            case 7:
                return integers(attribute.get("ints", []), _MOST)
            case 8:
                return [bytes(view) for view in attribute.views("strings")]
            case kind:
                name = attribute.text("name")
                raise UnsupportedError(f"the attribute {name!r} of type {kind}, such as a graph")

    def _tensor(self, tensor: ProtobufMessage) -> NDArray[Any]:
        kind = tensor.integer("data_type")
        if kind not in _DTYPES:
            raise UnsupportedError(f"numbers of type {kind}")
        dtype = np.dtype(_DTYPES[kind])
        shape = integers(tensor.get("dims", []), _MOST)
        if "raw_data" in tensor:
            numbers = np.frombuffer(tensor.views("raw_data")[0], dtype)
        else:
            numbers = _typed(tensor, dtype)
        return numbers[: math.prod(shape)].reshape(shape)


def _typed(tensor: ProtobufMessage, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return numbers that stand in a field of their type."""
    if dtype in {np.dtype("<f4"), np.dtype("<f8")}:
        field = "float_data" if dtype.itemsize == 4 else "double_data"
        return np.frombuffer(b"".join(tensor.views(field)), dtype)
    field = {"<i8": "int64_data", "<u8": "uint64_data", "<u4": "uint64_data"}
    whole = np.array(integers(tensor.get(field.get(dtype.str, "int32_data"), []), _MOST), np.int64)
    if dtype == np.dtype("<f2"):  # Bits of halves, as whole numbers.
        return whole.astype("<u2").view("<f2")
    return whole.astype(dtype)


def _names(message: ProtobufMessage, field: str) -> tuple[str, ...]:
    return tuple(cast("list[str]", message.get(field, [])))
