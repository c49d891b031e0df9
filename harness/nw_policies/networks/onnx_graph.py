"""Writes ONNX graphs of weights at hand, for onnxruntime to run.

An ONNX file is a protobuf message: fields of a number, a wire type and a value, some of which are
messages again. A graph needs few of them, so they are written here without the onnx package.

How every ONNX graph is opened here: on one thread, on the CPU, without a word to anybody.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_policies.safety.onnx import MICROSOFT

if TYPE_CHECKING:
    import onnxruntime as ort

_OPSETS = {"": 17, MICROSOFT: 1}
_IR_VERSION = 8
_TYPES = {"float32": 1, "int64": 7}
_INT, _INTS = 2, 7
Shape = tuple[int | None, ...]


class Graph:
    """Inputs, constants and operators; each gives the name by which later operators refer to it.

    The numbers of fields are those of ONNX's onnx.proto.
    """

    def __init__(self) -> None:
        self._fields: list[bytes] = []

    def input(self, name: str, *shape: int) -> str:
        """Add a float32 input."""
        self._fields.append(_field(11, _value(name, shape)))
        return name

    def constant(self, numbers: NDArray[Any] | list[int]) -> str:
        """Add numbers, float32 or int64."""
        array = np.asarray(numbers)
        sizes = b"".join(_field(1, size) for size in array.shape)
        name = self._new_name()
        kind = _field(2, _TYPES[array.dtype.name])
        self._fields.append(_field(5, sizes + kind + _field(8, name) + _field(9, array.tobytes())))
        return name

    def node(
        self, operator: str, *inputs: str, domain: str = "", **attributes: int | list[int]
    ) -> str:
        """Add an operator with one output."""
        name = self._new_name()
        parts = [_field(1, source) for source in inputs]
        parts += [_field(2, name), _field(4, operator), _field(7, domain)]
        parts += [_field(5, _attribute(key, value)) for key, value in attributes.items()]
        self._fields.append(_field(1, b"".join(parts)))
        return name

    def model(self, output: str, *shape: int) -> bytes:
        """Return the file of the graph that computes this one float32 output."""
        graph = [*self._fields, _field(2, "graph"), _field(12, _value(output, shape))]
        versions = [_field(1, domain) + _field(2, number) for domain, number in _OPSETS.items()]
        model = [_field(1, _IR_VERSION), _field(7, b"".join(graph))]
        return b"".join([*model, *(_field(8, version) for version in versions)])

    def open(self, output: str, *shape: int) -> ort.InferenceSession:
        """Return a session that runs the graph."""
        return open_session(self.model(output, *shape))

    def _new_name(self) -> str:
        return f"v{len(self._fields)}"


def _value(name: str, shape: tuple[int, ...]) -> bytes:
    sizes = _field(2, b"".join(_field(1, _field(1, size)) for size in shape))
    return _field(1, name) + _field(2, _field(1, _field(1, _TYPES["float32"]) + sizes))


def _attribute(name: str, value: int | list[int]) -> bytes:
    if isinstance(value, int):
        return _field(1, name) + _field(3, value) + _field(20, _INT)
    return _field(1, name) + b"".join(_field(8, item) for item in value) + _field(20, _INTS)


def _field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _varint(value: int) -> bytes:
    value &= 2**64 - 1
    groups = bytearray()
    while value > 0x7F:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*groups, value])


@cache
def _runtime() -> ModuleType:
    """Return onnxruntime with its telemetry off.

    Importing it is enough for a device id and a database of events to be written into the user's
    cache folder, so the variable is set before; the call is for versions that do not read it.
    """
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime

    onnxruntime.disable_telemetry_events()
    return onnxruntime


def open_session(model: bytes, *, optimise: bool = True) -> ort.InferenceSession:
    """Return a session that runs a graph; more threads would change the last bits of an action.

    Args:
        model: the bytes of an ONNX file; untrusted ones have passed `check_onnx`.
        optimise: whether constant parts are computed and nodes fused, which actions to the last
            bit depend on; without, a graph can be described but nothing of it is computed.

    Raises:
        Exception: whatever onnxruntime has to say; its exceptions share no public base.
    """
    runtime = _runtime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = runtime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # What is wrong is raised; a warning would only be noise.
    if not optimise:
        options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    return runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def state_pairs(inputs: Mapping[str, Shape], outputs: Mapping[str, Shape]) -> dict[str, str]:
    """Return the inputs whose next value is an output, by their names: `h_in` and `h_out`.

    Exporters write `h_in` and `h_out` (rsl_rl, Isaac Lab), `in_h` and `out_h`, `h` and `h_next`,
    `prev_state` and `next_state`. The shapes must be the same.
    """
    pairs: dict[str, str] = {}
    for source, shape in inputs.items():
        stem = re.sub(r"(^|_)(in|input|prev)$|^(prev|in)_", "", source)
        for target, other_shape in outputs.items():
            other = re.sub(r"(^|_)(out|output|next)$|^(next|out)_", "", target)
            if other != target and other == stem and other_shape == shape:
                pairs[source] = target
    return pairs
