"""Digest of a checkpoint's computation, which a re-export of the same network does not change.

The digest of a file changes with everything in it: producer, doc strings, names of nodes and
values, debug files, the order of the initializers. This one is of operators, attributes, weights
and the way that they are connected. Equal digests mean equal computations. Different digests may
mean equal computations: no algebra is done, and an operator set of another version counts as
another one.

Files are read as data by the readers that vet them. Nothing of a file is run or unpickled. A file
that cannot be read in this way has no such digest, and its own SHA-256 stands in for it.
"""

from __future__ import annotations

import json
import math
import pickletools
import re
import struct
from collections import ChainMap, Counter
from collections.abc import Mapping, MutableMapping, Sequence
from hashlib import sha256
from typing import Any, cast

from nw_base.errors import PolicyError
from nw_policies.safety.archive import Archive, file_kind, open_archive
from nw_policies.safety.onnx import ONNX, ProtobufMessage, Reader, integers

_FAULTS = (PolicyError, ValueError, LookupError, TypeError, RecursionError, OverflowError)
_NESTED = 16
"""Graphs in graphs, as `check_onnx` takes them."""
_TYPED = 2**20
"""Numbers of a file that are written one by one in place of as bytes: a second of reading."""
_PICKLE = 2**22
"""Bytes of a pickle, whose steps are read one by one. The numbers of tensors lie beside it."""
_JSON = 2**26
"""Bytes of a graph or a header."""
_SHORT = 64
"""Letters of a text of a pickle that is kept as it is: it may be used a million times."""
_DRAWS = re.compile(r"Random|Bernoulli|Multinomial")
"""Operators of which two equal ones give different values."""
_SIZES = {
    1: 4, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 8, 9: 1, 10: 2, 11: 8, 12: 4, 13: 8, 14: 8, 15: 16,
    16: 2, 17: 1, 18: 1, 19: 1, 20: 1,
}  # fmt: skip
"""Bytes of one number by TensorProto.DataType."""
_STRINGS = 8
_TRACES = re.compile(r"traced_inputs(\.pkl$|/)|data/sample_inputs/|.*\.debug_pkl$|\.")
"""Members of an archive that no forward pass reads: where code came from, with what it was traced,
which file it is."""
_CODE = re.compile(r"code/(__torch__.*)\.py$")
_NAMES = re.compile(r"(__torch__(?:\.\w+)*)\.(\w+)")
_MANGLED = re.compile(r"\.___torch_mangle_\d+")

Scope = MutableMapping[str, str]
Operator = tuple[str, str, str]


def computed_digest(data: bytes) -> str:
    """Return the hex SHA-256 of a checkpoint's computation; empty if it cannot be read.

    Args:
        data: the whole file.
    """
    try:
        match file_kind(data, "the checkpoint"):
            case "onnx":
                return _id("onnx", _OnnxDigest(data).digest())
            case "torchscript" | "torch-export" | "state-dict" as kind:
                return _id(kind, _members(open_archive(data, "the checkpoint")))
            case "stable-baselines3":
                return computed_digest(open_archive(data, "the checkpoint").read("policy.pth"))
            case "safetensors":
                return _id("safetensors", _tensors(data))
            case _:
                return ""
    except _FAULTS:
        return ""


def _id(*parts: object) -> str:
    return sha256(json.dumps(parts).encode()).hexdigest()


class _OnnxDigest:
    """One ONNX file. Each value has the digest of how it is computed, whatever its name is."""

    def __init__(self, data: bytes) -> None:
        self._reader = Reader(ONNX)
        self._model = self._reader.read(memoryview(data), "Model")
        if "training_info" in self._model:
            raise ValueError("it has graphs for training")
        self._typed = _TYPED
        self._functions: dict[Operator, ProtobufMessage] = {}
        self._bodies: dict[Operator, str | None] = {}
        for function in self._inside(self._model, "functions", "Function"):
            self._functions[_operator(function, "name")] = function

    def digest(self) -> str:
        """Return the digest of the main graph, with inputs, outputs and the names it needs."""
        (graph,) = self._inside(self._model, "graph", "Graph")
        weights = {tensor.text("name") for tensor in self._inside(graph, "initializer", "Tensor")}
        inputs = [
            value
            for value in self._inside(graph, "input", "ValueInfo")
            if value.text("name") not in weights
        ]
        names = [
            [value.text("name") for value in inputs],
            [value.text("name") for value in self._inside(graph, "output", "ValueInfo")],
        ]
        if [len(each) for each in names] == [1, 1]:
            names = []  # Nothing tells one from another, so no card needs them.
        types = [self._type(value) for value in inputs]
        return _id(names, types, self._graph(graph, {}, self._versions(self._model), 0))

    def _inside(self, message: ProtobufMessage, field: str, kind: str) -> list[ProtobufMessage]:
        return [self._reader.read(view, kind) for view in message.views(field)]

    def _versions(self, message: ProtobufMessage) -> dict[str, int]:
        imports = self._inside(message, "opset_import", "Opset")
        return {_domain(each): each.integer("version") for each in imports}

    def _type(self, value: ProtobufMessage) -> object:
        """Return type and shape of an input; the names of open axes mean nothing."""
        (type_,) = self._inside(value, "type", "Type")
        (tensor,) = self._inside(type_, "tensor_type", "TensorType")
        shapes = [
            [axis.integer("dim_value") or None for axis in self._inside(shape, "dim", "Dim")]
            for shape in self._inside(tensor, "shape", "Shape")
        ]
        return tensor.integer("elem_type"), shapes

    def _graph(
        self, graph: ProtobufMessage, outer: Scope, versions: Mapping[str, int], depth: int
    ) -> str:
        """Return the digest of the outputs of a graph.

        Args:
            graph: the message.
            outer: digests of the values of the graphs around it, by name.
            versions: of the operator sets, by domain.
            depth: how many graphs are around it.
        """
        if depth > _NESTED or "sparse_initializer" in graph:
            raise ValueError("nested too deeply, or with sparse tensors")
        scope = ChainMap[str, str]({}, outer)
        for tensor in self._inside(graph, "initializer", "Tensor"):
            scope[tensor.text("name")] = self._tensor(tensor)
        number = 0
        for value in self._inside(graph, "input", "ValueInfo"):
            if value.text("name") not in scope.maps[0]:  # Older files declare weights as inputs.
                scope[value.text("name")] = _id("input", depth, number)
                number += 1
        self._nodes(graph, scope, versions, depth)
        outputs = self._inside(graph, "output", "ValueInfo")
        return _id("graph", [scope[value.text("name")] for value in outputs])

    def _nodes(
        self, body: ProtobufMessage, scope: Scope, versions: Mapping[str, int], depth: int
    ) -> None:
        """Add the outputs of the nodes of a graph or function, which stand in running order."""
        for node in self._inside(body, "node", "Node"):
            sources = [scope[name] if name else "" for name in _names(node, "input")]
            targets = _names(node, "output")
            outputs = self._node(
                node, sources, [bool(name) for name in targets], versions, scope, depth
            )
            for number, name in enumerate(targets):
                if name:
                    scope[name] = (
                        outputs if node.text("op_type") == "Constant" else _id(outputs, number)
                    )

    def _node(
        self,
        node: ProtobufMessage,
        sources: Sequence[str],
        targets: Sequence[bool],
        versions: Mapping[str, int],
        scope: Scope,
        depth: int,
    ) -> str:
        operator = _operator(node, "op_type")
        if _DRAWS.search(operator[1]):
            raise ValueError("what it computes is drawn")
        attributes = self._inside(node, "attribute", "Attribute")
        if operator[:2] == ("", "Constant") and "t" in attributes[0]:
            return self._tensor(self._inside(attributes[0], "t", "Tensor")[0])
        read = sorted(
            (each.text("name"), self._attribute(each, scope, versions, depth))
            for each in attributes
        )
        what = (
            ["function", self._function(operator)]
            if operator in self._functions
            else [*operator, versions.get(operator[0], 0)]
        )
        return _id("node", what, read, sources, targets)

    def _function(self, operator: Operator) -> str:
        """Return the digest of a function's body; its name means nothing."""
        if operator not in self._bodies:
            self._bodies[operator] = None
            function, scope = self._functions[operator], dict[str, str]()
            for number, name in enumerate(_names(function, "input")):
                scope[name] = _id("argument", number)
            versions = self._versions(function)
            self._nodes(function, scope, versions, 0)
            defaults = [
                (each.text("name"), self._attribute(each, scope, versions, 0))
                for each in self._inside(function, "attribute_proto", "Attribute")
            ]
            outputs = [scope[name] for name in _names(function, "output")]
            self._bodies[operator] = _id(outputs, sorted(defaults))
        body = self._bodies[operator]
        if body is None:
            raise ValueError("a function calls itself")
        return body

    def _attribute(
        self, attribute: ProtobufMessage, scope: Scope, versions: Mapping[str, int], depth: int
    ) -> str:
        if set(attribute) & {"sparse_tensor", "sparse_tensors", "tp", "type_protos"}:
            raise ValueError("an attribute of another kind than networks have")
        tensors = [
            self._tensor(each)
            for field in ("t", "tensors")
            for each in self._inside(attribute, field, "Tensor")
        ]
        graphs = [
            self._graph(each, scope, versions, depth + 1)
            for field in ("g", "graphs")
            for each in self._inside(attribute, field, "Graph")
        ]
        floats = [b"".join(attribute.views(field)).hex() for field in ("f", "floats")]
        texts = [bytes(each).hex() for field in ("s", "strings") for each in attribute.views(field)]
        whole = [*attribute.get("i", []), *self._integers(attribute, "ints")]
        kind, of_function = attribute.integer("type"), attribute.text("ref_attr_name")
        return _id(kind, of_function, tensors, graphs, floats, texts, whole)

    def _integers(self, message: ProtobufMessage, field: str) -> list[int]:
        values = integers(message.get(field, []), self._typed)
        self._typed -= len(values)
        return values

    def _tensor(self, tensor: ProtobufMessage) -> str:
        """Return the digest of type, shape and numbers, in whichever field they are written."""
        if set(tensor) & {"external_data", "segment"} or tensor.integer("data_location"):
            raise ValueError("its numbers lie elsewhere")
        dims, kind = self._integers(tensor, "dims"), tensor.integer("data_type")
        numbers = sha256()
        if kind == _STRINGS:
            for text in tensor.views("string_data"):
                numbers.update(struct.pack("<Q", len(text)) + text)
            return _id("tensor", kind, dims, numbers.hexdigest())
        size = 0
        for part in self._parts(tensor, _SIZES[kind]):
            numbers.update(part)
            size += len(part)
        if size != math.prod(dims) * _SIZES[kind]:
            raise ValueError("a tensor of another size than its numbers")
        return _id("tensor", kind, dims, numbers.hexdigest())

    def _parts(self, tensor: ProtobufMessage, size: int) -> list[memoryview | bytes]:
        """Return the numbers as raw_data has them: little-endian, one after another."""
        for field in ("raw_data", "float_data", "double_data"):
            if field in tensor:
                return list(tensor.views(field))
        return [
            (number % 2 ** (8 * size)).to_bytes(size, "little")
            for field in ("int32_data", "int64_data", "uint64_data")
            for number in self._integers(tensor, field)
        ]


def _names(message: ProtobufMessage, field: str) -> list[str]:
    return [name for name in message.get(field, []) if isinstance(name, str)]


def _domain(message: ProtobufMessage) -> str:
    domain = message.text("domain")
    return "" if domain == "ai.onnx" else domain


def _operator(message: ProtobufMessage, name: str) -> Operator:
    return _domain(message), message.text(name), message.text("overload")


def _members(archive: Archive) -> list[tuple[str, str]]:
    """Return names and digests of the members of a file of torch that say what it computes."""
    names = [name for name in archive.names() if not _TRACES.match(name)]
    known: dict[str, str] = {}
    pickled = (
        _pickled(archive.read("data.pkl", at_most=_PICKLE), known) if "data.pkl" in names else b""
    )
    members: list[tuple[str, str]] = []
    for name in names:
        data, place = archive.read(name), name
        if name == "data.pkl":
            data = pickled
        elif code := _CODE.match(name):
            place = f"code {_renamed(code[1].replace('/', '.'), known)}"
            data = _NAMES.sub(
                lambda hit: f"{_renamed(hit[1], known)}.{hit[2]}", data.decode()
            ).encode()
        elif name.endswith(".json"):
            data = _without_traces(data)
        members.append((place, sha256(data).hexdigest()))
    return sorted(members)


def _pickled(data: bytes, known: dict[str, str]) -> bytes:
    """Return what a pickle builds, as text that no re-export changes; nothing is built here.

    A pickle keeps what it needs again in a memo, and exporters differ in what they keep. Here a
    text stands wherever it is used, and any other thing is referred to by where it was made.

    Args:
        data: the pickle.
        known: gets the modules of its classes, each with a name that no export changes. torch tells
            classes of one name apart by a number that counts all that its process has made
            (`___torch_mangle_7`); here they are numbered in the order in which the network has
            them.
    """
    steps: list[str] = []
    times: Counter[str] = Counter()
    memo: dict[int, str] = {}
    for opcode, operand, _ in pickletools.genops(data):
        argument: Any = operand
        if opcode.name in {"BINPUT", "LONG_BINPUT", "PUT", "MEMOIZE"}:
            place = len(memo) if opcode.name == "MEMOIZE" else int(argument)
            is_text = steps[-1].startswith("text ")
            memo[place] = steps[-1] if is_text else f"made {len(steps)}"
        elif opcode.name in {"BINGET", "LONG_BINGET", "GET"}:
            steps.append(memo[int(argument)])
        elif opcode.name == "GLOBAL":
            module, _, name = str(argument).rpartition(" ")
            if module.startswith("__torch__") and module not in known:
                plain = _MANGLED.sub("", module)
                known[module] = f"{plain}#{times[plain]}"
                times[plain] += 1
            steps.append(f"text {_short(_renamed(module, known))} {_short(name)}")
        elif "UNICODE" in opcode.name:
            steps.append(f"text {_short(repr(argument))}")
        elif opcode.name != "PROTO":
            steps.append(f"{opcode.name} {argument!r}")
    return "\n".join(steps).encode()


def _short(text: str) -> str:
    return text if len(text) <= _SHORT else sha256(text.encode(errors="replace")).hexdigest()


def _renamed(module: str, known: Mapping[str, str]) -> str:
    return known.get(module, module)


def _without_traces(data: bytes) -> bytes:
    """Return the JSON of torch.export without its stack traces and torch's own version."""
    if len(data) > _JSON:
        raise ValueError("a graph of another size than networks have")
    graph: Any = json.loads(data)
    if isinstance(graph, dict):
        for key in ("torch_version", "schema_version"):
            cast("dict[str, Any]", graph).pop(key, None)
    waiting: list[Any] = [graph]
    while waiting:
        each = waiting.pop()
        if isinstance(each, dict):
            fields = cast("dict[str, Any]", each)
            if "target" in fields:
                fields.pop("metadata", None)  # Of a node.
            waiting += fields.values()
        elif isinstance(each, list):
            waiting += cast("list[Any]", each)
    return json.dumps(graph).encode()


def _tensors(data: bytes) -> list[tuple[str, object]]:
    """Return names, types, shapes and digests of the tensors of a safetensors file."""
    end = 8 + int.from_bytes(data[:8], "little")
    if end > _JSON:
        raise ValueError("a header of another size than networks have")
    header: dict[str, dict[str, Any]] = json.loads(data[8:end])
    body = memoryview(data)[end:]
    tensors: list[tuple[str, object]] = []
    for name, facts in header.items():
        if name != "__metadata__":
            start, stop = facts["data_offsets"]
            numbers = sha256(body[start:stop]).hexdigest()
            tensors.append((name, [facts["dtype"], facts["shape"], numbers]))
    return sorted(tensors, key=lambda tensor: tensor[0])
