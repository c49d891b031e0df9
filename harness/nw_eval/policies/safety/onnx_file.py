"""The tensors of an ONNX file, measured before onnxruntime allocates what their headers ask for.

An ONNX file is a protobuf message: fields of a number, a wire type and a value, some of which are
messages again. Only the few fields that hold or nest tensors are looked at.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from nw_eval.errors import PolicyError
from nw_eval.policies.safety.kind import file_kind, kind_said
from nw_eval.policies.safety.limits import Limits

# Fields by number: where tensors are, and which messages hold them (ONNX's onnx.proto).
_GRAPH_OF_MODEL, _FUNCTIONS_OF_MODEL = 7, 25
_NODES_OF_GRAPH, _INITIALIZERS_OF_GRAPH, _SPARSE_OF_GRAPH = 1, 5, 15
_NODES_OF_FUNCTION = 7
_ATTRIBUTES_OF_NODE = 5
_TENSOR, _GRAPH, _TENSORS, _GRAPHS, _SPARSE, _SPARSES = 5, 6, 10, 11, 22, 23
_DIMS, _TYPE, _NAME, _RAW, _EXTERNAL = 1, 2, 8, 9, 13
_TYPED = {4: 4, 5: 1, 6: 1, 7: 1, 10: 8, 11: 1}
"""Fields of typed numbers, with the least bytes that one number takes there."""
_ITEM_BYTES = {1: 4, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 8, 9: 1, 10: 2, 11: 8, 12: 4, 13: 8, 16: 2}
"""Bytes of a number by TensorProto.DataType; types that are not here take half a byte or more."""

_Field = tuple[int, memoryview | int]


def check_onnx(data: bytes, where: str, limits: Limits | None = None) -> None:
    """Check that every tensor of an ONNX file is as large as its numbers in the file.

    Args:
        data: the whole file.
        where: its path, for errors.
        limits: bounds on number and size of tensors.

    Raises:
        PolicyError: the file is of another kind or damaged, a tensor's header asks for other memory
            than the file holds numbers for, or its numbers lie in another file.
    """
    limits = limits or Limits()
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
    count = 0
    try:
        for tensor in _tensors_of_model(memoryview(data)):
            count += 1
            if count > limits.tensors:
                raise PolicyError(
                    f"{where}: more than {limits.tensors} tensors", fix="export the actor alone"
                )
            _check_tensor(tensor, where)
    except (ValueError, IndexError, TypeError) as error:
        raise PolicyError(
            f"{where}: not a usable ONNX file, cut short or damaged: {error}",
            fix="copy or download it again, or export it again as one file",
        ) from None


def _tensors_of_model(model: memoryview) -> Iterator[memoryview]:
    for number, value in _fields(model):
        if number == _GRAPH_OF_MODEL:
            yield from _tensors_of_graph(_message(value), 0)
        elif number == _FUNCTIONS_OF_MODEL:
            for inner, node in _fields(_message(value)):
                if inner == _NODES_OF_FUNCTION:
                    yield from _tensors_of_node(_message(node), 0)


def _tensors_of_graph(graph: memoryview, depth: int) -> Iterator[memoryview]:
    if depth > 16:
        raise ValueError("its graphs are nested too deeply")
    for number, value in _fields(graph):
        if number == _NODES_OF_GRAPH:
            yield from _tensors_of_node(_message(value), depth)
        elif number == _INITIALIZERS_OF_GRAPH:
            yield _message(value)
        elif number == _SPARSE_OF_GRAPH:
            raise ValueError("it has sparse tensors")


def _tensors_of_node(node: memoryview, depth: int) -> Iterator[memoryview]:
    for number, attribute in _fields(node):
        if number != _ATTRIBUTES_OF_NODE:
            continue
        for kind, value in _fields(_message(attribute)):
            if kind in {_TENSOR, _TENSORS}:
                yield _message(value)
            elif kind in {_GRAPH, _GRAPHS}:
                yield from _tensors_of_graph(_message(value), depth + 1)
            elif kind in {_SPARSE, _SPARSES}:
                raise ValueError("it has sparse tensors")


def _check_tensor(tensor: memoryview, where: str) -> None:
    name, kind, dims, raw = "", 0, list[int](), None
    typed = 0
    for number, value in _fields(tensor):
        if number == _EXTERNAL:
            raise PolicyError(
                f"{where}: the numbers of tensor {name!r} lie in another file",
                fix="export it again as one file: onnx.save(onnx.load('policy.onnx'), 'one.onnx')",
            )
        if number == _DIMS:
            dims += [value] if isinstance(value, int) else _varints(value)
        elif number == _TYPE and isinstance(value, int):
            kind = value
        elif number == _NAME:
            name = bytes(_message(value)[:100]).decode(errors="replace")
        elif number == _RAW:
            raw = len(_message(value))
        elif number in _TYPED:
            typed += 1 if isinstance(value, int) else max(len(value) // _TYPED[number], 1)
    count = math.prod(dims)
    if raw is not None:
        item = _ITEM_BYTES.get(kind)
        fits = raw == count * item if item is not None else count <= 2 * raw
    else:
        fits = count <= typed or not count
    if not fits or min(dims, default=0) < 0:
        held = f"{raw} bytes" if raw is not None else f"{typed} numbers"
        raise PolicyError(
            f"{where}: tensor {name!r} claims {' x '.join(map(str, dims))} numbers, the file holds "
            f"{held} for it",
            fix="the file is damaged or forged: export the policy again",
        )


def _fields(message: memoryview) -> Iterator[_Field]:
    """Give number and value of each field: an int of the wire type 0, bytes of all others."""
    place = 0
    while place < len(message):
        tag, place = _varint(message, place)
        number, wire = tag >> 3, tag & 7
        if wire == 0:
            value, place = _varint(message, place)
            yield number, value
            continue
        if wire == 2:
            size, place = _varint(message, place)
        else:
            size = {1: 8, 5: 4}.get(wire, -1)
        if size < 0 or place + size > len(message):
            raise ValueError(f"a field reaches beyond its message at byte {place}")
        yield number, message[place : place + size]
        place += size


def _varint(message: memoryview, place: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if place >= len(message):
            break
        byte = message[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, place
    raise ValueError(f"a number without an end at byte {place}")


def _varints(packed: memoryview) -> list[int]:
    values: list[int] = []
    place = 0
    while place < len(packed):
        value, place = _varint(packed, place)
        values.append(value)
    return values


def _message(value: memoryview | int) -> memoryview:
    if isinstance(value, int):
        raise TypeError("a number in place of a message")
    return value
