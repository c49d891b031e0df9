"""Graphs: operators with named inputs and outputs, whatever file or code they come from.

Operators and attributes are ONNX's (https://onnx.ai/onnx/operators); values are named once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

MICROSOFT = "com.microsoft"
"""The domain of the operators that ONNX Runtime adds to the standard."""


NEXT = "next "
"""What the name of an output of a recorded file begins with, and that of a state's next value."""


class UnsupportedError(Exception):
    """A graph has an operator, or a use of one, that the executor does not run; names it."""


@dataclass(frozen=True, kw_only=True)
class Node:
    """One operator of a graph."""

    operator: str
    inputs: tuple[str, ...]
    """Names of values; empty where an optional one is left out."""
    outputs: tuple[str, ...]
    attributes: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Numbers, lists of numbers, texts as bytes, and arrays, by name."""
    domain: str = ""


@dataclass(frozen=True, kw_only=True)
class GraphInput:
    """An input of a graph."""

    name: str
    shape: tuple[int | None, ...]
    """None where a size is open, which counts as 1."""
    dtype: np.dtype[Any]


@dataclass(kw_only=True)
class Graph:
    """A network as operators in running order.

    Example:
        >>> graph = Graph()
        >>> x = graph.input("obs", (1, 48))
        >>> y = graph.add("Elu", graph.add("Gemm", x, graph.constant(w), graph.constant(b)))
        >>> graph.outputs = [y]
    """

    inputs: list[GraphInput] = field(default_factory=list[GraphInput])
    constants: dict[str, NDArray[Any]] = field(default_factory=dict[str, NDArray[Any]])
    nodes: list[Node] = field(default_factory=list[Node])
    outputs: list[str] = field(default_factory=list[str])
    version: int = 20
    """Of the standard operator set."""

    def input(self, name: str, shape: Sequence[int | None], dtype: Any = np.float32) -> str:
        """Add an input and return its name."""
        self.inputs.append(GraphInput(name=name, shape=tuple(shape), dtype=np.dtype(dtype)))
        return name

    def constant(self, numbers: Any) -> str:
        """Add numbers and return their name."""
        name = f"c{len(self.constants)}"
        self.constants[name] = np.asarray(numbers)
        return name

    def add(self, operator: str, *inputs: str, domain: str = "", **attributes: Any) -> str:
        """Add an operator with one output and return the output's name."""
        (name,) = self.add_many(operator, *inputs, outputs=1, domain=domain, **attributes)
        return name

    def add_many(
        self, operator: str, *inputs: str, outputs: int, domain: str = "", **attributes: Any
    ) -> tuple[str, ...]:
        """Add an operator with several outputs and return their names."""
        names = tuple(f"v{len(self.nodes)}.{number}" for number in range(outputs))
        node = Node(
            operator=operator, inputs=inputs, outputs=names, attributes=attributes, domain=domain
        )
        self.nodes.append(node)
        return names


@dataclass(frozen=True, kw_only=True)
class RecordedFile:
    """A file of weights as graphs that share a memory."""

    parts: tuple[tuple[int, Graph], ...]
    """In the order in which they run, each every so many actions. Inputs are `input 0`, ... and the
    names of `first`; outputs are `output 0`, ... and the names of `first`, behind `NEXT`."""
    first: dict[str, NDArray[Any]]
    """What it remembers, as a trial begins."""
