"""Values of a graph that is recorded, by the tensors of torch that hold them; rules use it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nw_policies.executor import Graph, UnsupportedError


def as_array(tensor: Tensor) -> NDArray[Any]:
    """Return a copy of a tensor's numbers; of any floats as float32."""
    plain = tensor.detach()
    plain = plain.to(torch.float32) if plain.is_floating_point() else plain
    return np.array(plain.numpy())


class Values:
    """Names of tensors in a graph, and operators that are added to it.

    Attributes:
        graph: what is written.
        names: of tensors that depend on an input, by their `id`.
        constants: of the others.
        sharing: tensors by their memory, all kept alive: else another one could have the same `id`.
    """

    def __init__(self) -> None:
        self.graph = Graph()
        self.names: dict[int, str] = {}
        self.constants: dict[int, str] = {}
        self.sharing: dict[int, dict[int, Tensor]] = {}

    def is_constant(self, value: Any) -> bool:
        """Whether a value depends on no input."""
        return not isinstance(value, Tensor) or id(value) not in self.names

    def name(self, value: Any) -> str:
        """Return the name of a tensor or a number in the graph."""
        if not isinstance(value, Tensor):
            kind = np.bool_ if isinstance(value, bool) else np.float32
            return self.graph.constant(np.asarray(value, kind))
        known = self.names.get(id(value)) or self.constants.get(id(value))
        if known is None:
            self.know(value)
            known = self.constants[id(value)] = self.graph.constant(as_array(value))
        return known

    def array(self, value: Tensor) -> NDArray[Any]:
        """Return the numbers of a tensor that depends on no input.

        Raises:
            UnsupportedError: it depends on one.
        """
        if not self.is_constant(value):
            raise UnsupportedError("weights or indices that depend on the inputs")
        return as_array(value)

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Add an operator with one output and return the output's name."""
        return self.graph.add(operator, *inputs, **attributes)

    def whole(self, numbers: Sequence[int]) -> str:
        """Return the name of constant whole numbers."""
        return self.graph.constant(np.array(list(numbers), np.int64))

    def reshaped(self, name: str, shape: Sequence[int]) -> str:
        """Return the name of a value with another shape of as many elements."""
        return self.add("Reshape", name, self.whole(shape), allowzero=1)

    def batched(self, tensor: Tensor, axes: int) -> str:
        """Return the name of a tensor, with a leading axis of 1 if it has one axis less."""
        name = self.name(tensor)
        return name if tensor.ndim == axes else self.reshaped(name, [1, *tensor.shape])

    def slice(self, name: str, axis: int, start: int, end: int, step: int = 1) -> str:
        """Return the name of some of a value's elements along one axis, as ONNX's Slice says."""
        return self.add("Slice", name, *(self.whole([n]) for n in (start, end, axis, step)))

    def know(self, tensor: Tensor) -> None:
        """Keep a tensor alive, beside those that share its memory."""
        self.sharing.setdefault(memory_of(tensor), {})[id(tensor)] = tensor


def memory_of(tensor: Tensor) -> int:
    """Return a key that is equal for tensors that share their memory."""
    return tensor.untyped_storage().data_ptr()  # It stays theirs: all are kept.
