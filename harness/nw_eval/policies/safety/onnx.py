"""ONNX files, checked before onnxruntime sees them.

Every field of every message is looked at: tensors are as large as their numbers in the file, no
numbers lie in another file, operators are known arithmetic or functions of the file itself, and
the graph is small also when its functions are written out. What a graph computes cannot be
foreseen here, a huge `Expand` or a `Loop` without an end: the process that opens and runs it has
limits of time and memory for that.

Functions of a file are written out by onnxruntime where they are called: thirty functions, each of
which calls the one before it twice, are a billion nodes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import NoReturn

from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.policies.safety.archive import FileLimits, file_kind, kind_said
from nw_eval.policies.safety.onnx_format import (
    FUSED,
    MICROSOFT,
    ONNX,
    STANDARD,
    ProtobufMessage,
    Reader,
    integers,
)

_NESTED = 56
"""Messages in messages: 16 graphs within each other. protobuf itself stops at 100."""
_AXES = 64
_DECLARED = 2**24
"""Numbers of all inputs, and of all outputs: 64 MiB of float32. Recurrent state is allocated as it
is declared."""
_STRINGS = 8
_TYPED = {
    "float_data": 4, "int32_data": 1, "string_data": 1, "int64_data": 1, "double_data": 8,
    "uint64_data": 1,
}  # fmt: skip
"""Fields of typed numbers, with the least bytes that one number takes there."""
_ITEM_BYTES = {1: 4, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 8, 9: 1, 10: 2, 11: 8, 12: 4, 13: 8, 16: 2}
"""Bytes of a number by TensorProto.DataType; types that are not here take half a byte or more."""
_REFUSED = {
    "sparse_initializer": "it has sparse tensors",
    "sparse_tensor": "it has sparse tensors",
    "sparse_tensors": "it has sparse tensors",
    "training_info": "it has graphs for training",
    "segment": "a tensor is cut into segments",
}
_EXPORT = "export the policy for inference, with dense weights and standard operators"
Operator = tuple[str, str, str]
"""Domain, name and overload of an operator or function."""

_NESTED_CALLS = 64
"""Functions that call functions: exporters write one for each module of a network."""


def check_onnx(data: bytes, where: str, limits: FileLimits | None = None) -> None:
    """Check that an ONNX file can do nothing but arithmetic of the size that it shows.

    Args:
        data: the whole file.
        where: its path, for errors.
        limits: bounds on number and size of tensors, and on nodes.

    Raises:
        PolicyError: the file is of another kind or damaged; a tensor's header asks for other memory
            than the file holds numbers for, or its numbers lie in another file; an operator is
            unknown; functions call themselves or become too many nodes; inputs or outputs are
            declared larger than any policy's.
    """
    limits = limits or FileLimits()
    if len(data) > limits.file_bytes:
        raise PolicyError(
            f"{where}: the file has {len(data) / 2**20:.0f} MiB, over the limit of "
            f"{limits.file_bytes // 2**20}",
            fix="export the actor alone",
        )
    kind = file_kind(data, where)
    if kind not in {"onnx", "unknown"}:
        raise PolicyError(
            f"{where}: not an ONNX file: {kind_said(kind)}",
            fix="export the policy as ONNX, or change `adapter`",
        )
    try:
        _MessageWalk(where, limits).model(memoryview(data))
    except ValueError as error:
        raise PolicyError(
            f"{where}: not a usable ONNX file, cut short or damaged: {error}",
            fix="copy or download it again, or export it again as one file",
        ) from None


class _MessageWalk:
    """A walk over all messages of one file, with what it has counted so far."""

    def __init__(self, where: str, limits: FileLimits) -> None:
        self._where = where
        self._limits = limits
        self._reader = Reader(ONNX)
        self._nodes = self._tensors = self._bytes = 0
        self._main = Counter[Operator]()
        self._functions: dict[Operator, Counter[Operator]] = {}
        self._calls = self._main
        """Operators of the function or main graph that is being walked."""

    def model(self, data: memoryview) -> None:
        self._visit(data, "Model", 0)
        for key in set(self._main).union(*self._functions.values()) - set(self._functions):
            domain, name, _ = key
            if domain in STANDARD or (domain == MICROSOFT and name in FUSED):
                continue
            self._refuse(f"the operator {_operator_said(key)} is not one that policies may use")
        _check_calls(self._functions, self._main, self._limits.nodes, self._where)

    def _visit(self, data: memoryview, kind: str, depth: int) -> None:
        if depth > _NESTED:
            self._refuse("its graphs or types are nested too deeply")
        message = self._reader.read(data, kind)
        for name, reason in _REFUSED.items():
            if name in message:
                self._refuse(reason)
        match kind:
            case "Tensor":
                self._tensor(message)
            case "Node":
                self._node(message)
            case "Function":
                self._calls = self._functions.setdefault(_operator(message, "name"), Counter())
            case "Graph" if depth == 1:
                self._calls = self._main
                self._declared(message)
            case _:
                pass
        for inner, part in self._reader.inside(message, kind):
            self._visit(part, inner, depth + 1)

    def _node(self, node: ProtobufMessage) -> None:
        self._calls[_operator(node, "op_type")] += 1
        self._nodes += 1
        if self._nodes > self._limits.nodes:
            self._refuse(f"it has over {self._limits.nodes} nodes")

    def _tensor(self, tensor: ProtobufMessage) -> None:
        name = clean(tensor.text("name"), at_most=100)
        if "external_data" in tensor or tensor.integer("data_location"):
            raise PolicyError(
                f"{self._where}: the numbers of tensor {name!r} lie in another file",
                fix="export it again as one file, or fold both into one: `nw-eval policies fold`",
            )
        self._tensors += 1
        if self._tensors > self._limits.tensors:
            raise PolicyError(
                f"{self._where}: more than {self._limits.tensors} tensors",
                fix="export the actor alone",
            )
        dims = integers(tensor.get("dims", []), _AXES)
        count = math.prod(dims)
        item = _ITEM_BYTES.get(tensor.integer("data_type"))
        if "raw_data" in tensor:
            raw = len(tensor.views("raw_data")[0])
            fits = raw == count * item if item is not None else count <= 2 * raw
            held = f"{raw} bytes"
        else:
            typed = sum(
                1 if isinstance(value, int) else max(len(value) // least, 1)
                for name, least in _TYPED.items()
                for value in tensor.get(name, [])
            )
            fits = count <= typed or not count
            held = f"{typed} numbers"
        if not fits or min(dims, default=0) < 0:
            raise PolicyError(
                f"{self._where}: tensor {name!r} claims {' x '.join(map(str, dims))} numbers, the "
                f"file holds {held} for it",
                fix="the file is damaged or forged: export the policy again",
            )
        self._bytes += count * (item or 1)
        if self._bytes > self._limits.tensor_bytes:
            self._refuse(f"its tensors have over {self._limits.tensor_bytes // 2**20} MiB")

    def _declared(self, graph: ProtobufMessage) -> None:
        """Check what the main graph says of its inputs and outputs."""
        read = self._reader.read
        # Until 2019, weights were declared as inputs too.
        weights = {read(tensor, "Tensor").text("name") for tensor in graph.views("initializer")}
        for kind in ("input", "output"):
            total = 0
            for data in graph.views(kind):
                value = read(data, "ValueInfo")
                name = value.text("name")
                if kind == "output" or name not in weights:
                    total += self._numbers(value, kind)
            if total > _DECLARED:
                self._refuse(f"its {kind}s are declared to be over {_DECLARED} numbers")

    def _numbers(self, value: ProtobufMessage, kind: str) -> int:
        """Return how many numbers an input or output has, open axes counted as 1."""
        read = self._reader.read
        name = clean(value.text("name"), at_most=100)
        total = 1
        for declared in value.views("type"):
            type_ = read(declared, "Type")
            for tensor in type_.views("tensor_type"):
                facts = read(tensor, "TensorType")
                if facts.integer("elem_type") == _STRINGS:
                    self._refuse(f"its {kind} {name!r} is text")
                axes = [
                    read(axis, "Dim")
                    for shape in facts.views("shape")
                    for axis in read(shape, "Shape").views("dim")
                ]
                sizes = [axis.integer("dim_value") for axis in axes if "dim_value" in axis]
                if len(axes) > _AXES or min(sizes, default=1) < 1:
                    shape = " x ".join(map(str, sizes[:8]))
                    self._refuse(f"its {kind} {name!r} has the shape {shape}")
                total = math.prod(sizes)
            if "tensor_type" not in type_:
                self._refuse(f"its {kind} {name!r} is not a tensor")
        return total

    def _refuse(self, reason: str) -> NoReturn:
        raise PolicyError(f"{self._where}: {reason}", fix=_EXPORT)


def _operator(message: ProtobufMessage, name: str) -> Operator:
    domain = message.text("domain")
    return "" if domain == "ai.onnx" else domain, message.text(name), message.text("overload")


def _check_calls(
    functions: Mapping[Operator, Counter[Operator]],
    main: Counter[Operator],
    most: int,
    where: str,
) -> None:
    """Check that a graph stays small when every call is replaced by its function's nodes.

    Args:
        functions: how often each function of the file has each operator.
        main: as above, the main graph.
        most: nodes that the graph, or a function on its own, may become.
        where: the file, for errors.

    Raises:
        PolicyError: a function calls itself, through others perhaps; calls are nested deeper than
            exporters nest them; there are more nodes than `most`.
    """
    known: dict[Operator, tuple[int, int]] = {}  # Nodes, and how deep calls are nested.

    def written_out(calls: Counter[Operator], path: tuple[Operator, ...]) -> tuple[int, int]:
        nodes = depth = 0
        for key, times in calls.items():
            if key in functions and key not in known:
                if key in path:
                    raise PolicyError(
                        f"{where}: the function {_operator_said(key)} calls itself", fix=_FIX
                    )
                if len(path) < _NESTED_CALLS:
                    known[key] = written_out(functions[key], (*path, key))
            inner, below = known.get(key, (0, _NESTED_CALLS if key in functions else -1))
            nodes += times * (1 + inner)
            depth = max(depth, below + 1)
        if depth > _NESTED_CALLS:
            raise PolicyError(f"{where}: over {_NESTED_CALLS} functions call each other", fix=_FIX)
        if nodes > most:
            raise PolicyError(
                f"{where}: over {most} nodes when its functions are written out", fix=_FIX
            )
        return nodes, depth

    for key, calls in functions.items():
        if key not in known:
            known[key] = written_out(calls, (key,))
    written_out(main, ())


def _operator_said(key: Operator) -> str:
    """Return an operator as errors say it: `domain::name`."""
    domain, name, _ = key
    return repr(clean(f"{domain}::{name}" if domain else name, at_most=100))


_FIX = "export the policy again, its actor alone and without functions of its own"
