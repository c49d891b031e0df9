"""The messages and fields of onnx.proto, the operators that a policy may use, and their reading.

Protobuf messages are read by a table of the fields that they may have, and of no others, and
written. What is read here is what every other reader makes of the file: a field that is not in the
table, that is of another wire type, or that comes twice where it may come once (readers merge or
overwrite, each in its way) is refused. Texts are UTF-8 and bounded.

Left out, and so refused: fields for several devices, maps and opaque types, and those that no
version of the format has given a meaning yet.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple

FIELDS = 500_000
"""Fields of one file, all messages together: what some seconds can read."""
NAME, TEXT = 2048, 2**20
"""Bytes of a name, and of a text that a person or an exporter wrote."""

_VARINT, _EIGHT, _SIZED, _FOUR = 0, 1, 2, 5  # Wire types; 3 and 4 are groups, which are obsolete.
_NUMBERS = {"int": _VARINT, "float": _FOUR, "double": _EIGHT}
_TEXTS = {"name": NAME, "text": TEXT}

Value = int | str | memoryview


class Field(NamedTuple):
    """A field: its name, what it holds, whether it may come more than once."""

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


def _varint(data: memoryview, place: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if place >= len(data):
            break
        byte = data[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & (2**64 - 1), place
    raise ValueError(f"a number without an end at byte {place}")


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
