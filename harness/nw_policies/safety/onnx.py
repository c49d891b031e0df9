"""ONNX files: the messages and fields of onnx.proto, and the check before onnxruntime sees a file.

Protobuf messages are read by a table of the fields that they may have, and of no others, and
written. What is read here is what every other reader makes of the file: a field that is not in the
table, that is of another wire type, or that comes twice where it may come once (readers merge or
overwrite, each in its way) is refused. Texts are UTF-8 and bounded.

Left out, and so refused: fields for several devices, maps and opaque types, and those that no
version of the format has given a meaning yet.

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
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import NamedTuple, NoReturn

from nw_base.clean import clean
from nw_base.errors import PolicyError
from nw_policies.safety.archive import FileLimits, file_kind, kind_said

FIELDS = 500_000
"""Fields of one file, all messages together: what some seconds can read."""
NAME, TEXT = 2048, 2**20
"""Bytes of a name, and of a text that a person or an exporter wrote."""

_VARINT, _EIGHT, _SIZED, _FOUR = 0, 1, 2, 5  # Wire types; 3 and 4 are groups, which are obsolete.
_NUMBERS = {"int": _VARINT, "float": _FOUR, "double": _EIGHT}
_TEXTS = {"name": NAME, "text": TEXT}

Value = int | str | memoryview


class Field(NamedTuple):
    """A field: its name, its type, and whether it may be repeated."""

    name: str
    kind: str
    many: bool


Table = Mapping[str, Mapping[int, Field]]


def table(messages: Mapping[str, str]) -> Table:
    """Return the fields of each message by number, from texts such as `1 name name, 2 dims int*`.

    A kind is `int`, `float`, `double`, `bytes`, `name`, `text` or a message; `*` means many.
    """
    return {
        message: {
            int(number): Field(name, kind, bool(star))
            for number, name, kind, star in re.findall(r"(\d+) (\w+) (\w+)(\*?)", text)
        }
        for message, text in messages.items()
    }


class ProtobufMessage(dict[str, list[Value]]):
    """Values by the names of their fields; absent ones are absent.

    An `int` is signed. Packed numbers, bytes and inner messages are views of their bytes.
    """

    def text(self, name: str) -> str:
        """Return a name or text, empty if absent."""
        return "".join(value for value in self.get(name, []) if isinstance(value, str))

    def integer(self, name: str) -> int:
        """Return a number, 0 if absent."""
        return sum(value for value in self.get(name, []) if isinstance(value, int))

    def views(self, name: str) -> list[memoryview]:
        """Return bytes or inner messages."""
        return [value for value in self.get(name, []) if isinstance(value, memoryview)]


class Reader:
    """Reads the messages of one file."""

    def __init__(self, known: Table) -> None:
        self._known = known
        self._left = FIELDS

    def read(self, data: memoryview, kind: str) -> ProtobufMessage:
        """Return one message; those inside of it stay bytes.

        Raises:
            ValueError: it is damaged, has a field that it may not have, the file has too many
                fields, or a text is too long or not UTF-8.
        """
        message = ProtobufMessage()
        place = 0
        while place < len(data):
            self._left -= 1
            if self._left < 0:
                raise ValueError(f"it has more than {FIELDS} fields")
            tag, place = _varint(data, place)
            number, wire = tag >> 3, tag & 7
            raw, place = _raw(data, place, wire)
            field = self._known[kind].get(number)
            if field is None:
                raise ValueError(f"field {number} of {kind} is unknown to this version")
            # Numbers of a list may come packed together.
            if wire != _NUMBERS.get(field.kind, _SIZED) and not (wire == _SIZED and field.many):
                raise ValueError(f"`{field.name}` of {kind} is of another type")
            if isinstance(raw, memoryview) and field.kind in _TEXTS:
                raw = _text(raw, f"`{field.name}` of {kind}", _TEXTS[field.kind])
            values = message.setdefault(field.name, [])
            if values and not field.many:
                raise ValueError(f"`{field.name}` of {kind} comes twice")
            values.append(raw)
        return message

    def inside(self, message: ProtobufMessage, kind: str) -> Iterator[tuple[str, memoryview]]:
        """Give kind and bytes of all messages inside of one."""
        for field in self._known[kind].values():
            if field.kind in self._known:
                for view in message.views(field.name):
                    yield field.kind, view


def encoded(message: ProtobufMessage, fields: Mapping[int, Field]) -> bytes:
    """Return the bytes of a message, fields in the order of their numbers.

    Args:
        message: as a `Reader` gives it; lists of numbers may be written packed that were not.
        fields: those of its kind.
    """
    data = bytearray()
    for number, field in sorted(fields.items()):
        for value in message.get(field.name, []):
            raw = value.encode() if isinstance(value, str) else value
            if isinstance(raw, int):
                data += _written(number << 3 | _VARINT) + _written(raw % 2**64)
            elif field.kind in {"float", "double"} and not field.many:
                data += _written(number << 3 | _NUMBERS[field.kind]) + raw
            else:
                data += _written(number << 3 | _SIZED) + _written(len(raw)) + raw
    return bytes(data)


def integers(values: list[Value], at_most: int) -> list[int]:
    """Return signed numbers that came one by one or packed.

    Raises:
        ValueError: they are more than `at_most`.
    """
    numbers: list[int] = []
    for value in values:
        if isinstance(value, int):
            numbers.append(value)
        elif isinstance(value, memoryview):
            place = 0
            while place < len(value) and len(numbers) <= at_most:
                number, place = _varint(value, place)
                numbers.append(_signed(number))
    if len(numbers) > at_most:
        raise ValueError(f"a list has more than {at_most} numbers")
    return numbers


def _raw(data: memoryview, place: int, wire: int) -> tuple[int | memoryview, int]:
    if wire == _VARINT:
        number, place = _varint(data, place)
        return _signed(number), place
    size = {_EIGHT: 8, _FOUR: 4}.get(wire, -1)
    if wire == _SIZED:
        size, place = _varint(data, place)
    if size < 0 or place + size > len(data):
        raise ValueError(f"a field reaches beyond its message at byte {place}")
    return data[place : place + size], place + size


def _varint(data: memoryview, index: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if index >= len(data):
            break
        byte = data[index]
        index += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & (2**64 - 1), index
    raise ValueError(f"a number without an end at byte {index}")


def _written(number: int) -> bytes:
    data = bytearray()
    while number >= 0x80:
        data.append(number & 0x7F | 0x80)
        number >>= 7
    data.append(number)
    return bytes(data)


def _signed(number: int) -> int:
    return number - (number >> 63 << 64)


def _text(data: memoryview, what: str, limit: int) -> str:
    if len(data) > limit:
        raise ValueError(f"{what} has {len(data)} bytes, over {limit}")
    try:
        return bytes(data).decode()
    except UnicodeDecodeError:
        raise ValueError(f"{what} is not UTF-8") from None


ONNX = table({
    "Model": """1 ir_version int, 2 producer_name text, 3 producer_version text, 4 domain text,
        5 model_version int, 6 doc_string text, 7 graph Graph, 8 opset_import Opset*,
        14 metadata_props Entry*, 20 training_info bytes*, 25 functions Function*""",
    "Graph": """1 node Node*, 2 name name, 5 initializer Tensor*, 10 doc_string text,
        11 input ValueInfo*, 12 output ValueInfo*, 13 value_info ValueInfo*,
        14 quantization_annotation Annotation*, 15 sparse_initializer bytes*,
        16 metadata_props Entry*""",
    "Function": """1 name name, 4 input name*, 5 output name*, 6 attribute name*, 7 node Node*,
        8 doc_string text, 9 opset_import Opset*, 10 domain name, 11 attribute_proto Attribute*,
        12 value_info ValueInfo*, 13 overload name, 14 metadata_props Entry*""",
    "Node": """1 input name*, 2 output name*, 3 name name, 4 op_type name, 5 attribute Attribute*,
        6 doc_string text, 7 domain name, 8 overload name, 9 metadata_props Entry*""",
    "Attribute": """1 name name, 2 f float, 3 i int, 4 s bytes, 5 t Tensor, 6 g Graph,
        7 floats float*, 8 ints int*, 9 strings bytes*, 10 tensors Tensor*, 11 graphs Graph*,
        13 doc_string text, 14 tp Type, 15 type_protos Type*, 20 type int, 21 ref_attr_name name,
        22 sparse_tensor bytes, 23 sparse_tensors bytes*""",
    "Tensor": """1 dims int*, 2 data_type int, 3 segment bytes, 4 float_data float*,
        5 int32_data int*, 6 string_data bytes*, 7 int64_data int*, 8 name name, 9 raw_data bytes,
        10 double_data double*, 11 uint64_data int*, 12 doc_string text, 13 external_data bytes*,
        14 data_location int, 16 metadata_props Entry*""",
    "ValueInfo": "1 name name, 2 type Type, 3 doc_string text, 4 metadata_props Entry*",
    "Type": """1 tensor_type TensorType, 4 sequence_type Element, 6 denotation name,
        9 optional_type Element""",
    "TensorType": "1 elem_type int, 2 shape Shape",
    "Element": "1 elem_type Type",
    "Shape": "1 dim Dim*",
    "Dim": "1 dim_value int, 2 dim_param name, 3 denotation name",
    "Entry": "1 key name, 2 value text",
    "Opset": "1 domain name, 2 version int",
    "Annotation": "1 tensor_name name, 2 quant_parameter_tensor_names Entry*",
})  # fmt: skip
"""Fields by number, with ONNX's names. What is refused wherever it stands is left as bytes."""

STANDARD = frozenset({"", "ai.onnx", "ai.onnx.ml"})
"""Domains whose operators are all arithmetic: they open no file and call no code."""
MICROSOFT = "com.microsoft"
"""The domain of the operators that onnxruntime adds to the standard."""
FUSED = frozenset({
    "Attention", "BiasGelu", "BiasSoftmax", "DequantizeLinear", "DynamicQuantizeLSTM",
    "DynamicQuantizeMatMul", "EmbedLayerNormalization", "FastGelu", "FusedConv", "FusedGemm",
    "FusedMatMul", "Gelu", "GroupQueryAttention", "Inverse", "MatMulIntegerToFloat",
    "MatMulNBits", "MultiHeadAttention", "NhwcMaxPool", "QAttention", "QGemm", "QLinearAdd",
    "QLinearAveragePool", "QLinearConcat", "QLinearConv", "QLinearGlobalAveragePool",
    "QLinearLeakyRelu", "QLinearMul", "QLinearReduceMean", "QLinearSigmoid", "QLinearSoftmax",
    "QLinearWhere", "QuantizeLinear", "QuickGelu", "RotaryEmbedding", "SkipLayerNormalization",
    "SkipSimplifiedLayerNormalization", "TransposeMatMul", "Trilu",
})  # fmt: skip
"""What onnxruntime's optimiser and quantiser write in place of standard operators."""


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
