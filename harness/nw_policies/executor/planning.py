"""Plans a graph: gives each value its floats in one arena, and each operator its rows.

Batch one and fixed shapes. What only moves numbers becomes a view where it can; what depends on no
input is computed while planning; a bias and a ReLU go into the product before them. The operators
are in `moves`, `arithmetic`, `products` and `recurrent`, one function each.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_policies.executor import program as rows
from nw_policies.executor.fusing import fused
from nw_policies.executor.graph import Graph, Node, UnsupportedError
from nw_policies.executor.program import PANEL, SLACK, WIDTH, Program, Slot
from nw_policies.executor.views import Kind, Shape, View, merged, strides_of

Array = NDArray[Any]
Rule = Callable[["Planner", Node], None]
_RULES: dict[tuple[str, str], Rule] = {}
_KINDS: dict[str, Kind] = {"f": "float", "b": "bool", "i": "whole", "u": "whole"}

_EXACT = 2**24
"""Whole numbers up to here are float32, too."""

RELU_FIELD, BIAS_FIELD, TARGET_FIELD, ROW_FIELD, TIMES_STEP_FIELD = 14, 9, 11, 12, 17
"""Fields of a product's row that are filled in later."""


def operator(*names: str, domain: str = "") -> Callable[[Rule], Rule]:
    """Register the rule of operators: a function of the planner and a node."""

    def register(rule: Rule) -> Rule:
        for name in names:
            _RULES[domain, name] = rule
        return rule

    return register


def operators() -> dict[str, list[str]]:
    """Return the names of all operators that can be planned, by the module that has their rules."""
    names: dict[str, list[str]] = {}
    for (domain, name), rule in sorted(_RULES.items()):
        module = rule.__module__.rpartition(".")[2]
        names.setdefault(module, []).append(f"{domain}::{name}" if domain else name)
    return names


class Planner:
    """A graph on its way to a program.

    Attributes:
        values: by name, constants as arrays and what is computed as views.
        version: of the standard operator set.
    """

    def __init__(self, graph: Graph) -> None:
        self.version = graph.version
        self.values: dict[str, Array | View] = dict(graph.constants)
        self._graph = graph
        self._rows: list[tuple[list[int], bool]] = []
        self._data: list[tuple[int, NDArray[np.float32]]] = []
        self._stored: dict[int, tuple[Array, int]] = {}
        self._top = PANEL  # The first floats stay zeros.
        self._products: dict[str, int] = {}  # Rows of products, by the name of their output.
        self._images: set[str] = set()
        self._uses = Counter(name for node in graph.nodes for name in node.inputs)
        for name in graph.outputs:
            self._uses[name] += 2

    # --- values ---------------------------------------------------------------------------------

    def view(self, name: str) -> View:
        """Return the floats of a value; constants are laid into the arena."""
        value = self.values[name]
        if isinstance(value, View):
            return value
        if value.dtype.kind not in _KINDS:
            raise UnsupportedError(f"numbers of type {value.dtype}")
        if value.dtype.kind in "iu" and value.size and np.abs(value).max() > _EXACT:
            raise UnsupportedError(f"whole numbers above {_EXACT} among floats")
        return View(
            self.put(value), value.shape, strides_of(value.shape), True, _KINDS[value.dtype.kind]
        )

    def constant(self, name: str) -> Array:
        """Return a value that depends on no input."""
        value = self.values[name]
        if isinstance(value, View):
            raise UnsupportedError(f"`{name}` depends on the inputs of the network")
        return value

    def constant_or(self, node: Node, index: int, default: Any) -> Any:
        """Return a constant input, or a default where it is left out."""
        return self.constant(node.inputs[index]) if self.has(node, index) else default

    @staticmethod
    def has(node: Node, index: int) -> bool:
        """Whether an optional input is there."""
        return len(node.inputs) > index and bool(node.inputs[index])

    def used_once(self, name: str) -> bool:
        """Whether one operator alone takes a value."""
        return self._uses[name] == 1

    # --- memory ---------------------------------------------------------------------------------

    def room(self, size: int) -> int:
        """Return the offset of floats that nothing else has."""
        place = self._top
        self._top += -(-(size + SLACK) // PANEL) * PANEL
        if self._top > rows.MOST_FLOATS:
            raise UnsupportedError(f"a network of more than {rows.MOST_FLOATS} numbers")
        return place

    def put(self, numbers: Any) -> int:
        """Lay numbers into the arena and return their offset; the same array goes there once."""
        array = np.asarray(numbers)
        kept = self._stored.get(id(array))
        if kept is not None:
            return kept[1]
        flat = np.ascontiguousarray(array, np.float32).ravel()
        place = self.room(flat.size)
        self._data.append((place, flat))
        self._stored[id(array)] = (array, place)
        return place

    def put_columns(self, numbers: Any, columns: int) -> int:
        """Lay one number for each column into the arena, filled up to whole panels."""
        flat = np.broadcast_to(np.asarray(numbers, np.float32).ravel(), columns)
        return self.put(np.pad(flat, (0, -columns % PANEL)))

    def new(self, shape: Sequence[int], *sources: View, kind: Kind = "float") -> View:
        """Return memory for the result of an operation on some views."""
        is_fixed = bool(sources) and all(source.is_fixed for source in sources)
        shape = tuple(shape)
        return View(self.room(math.prod(shape)), shape, strides_of(shape), is_fixed, kind)

    # --- rows -----------------------------------------------------------------------------------

    def row(self, *fields: int, is_fixed: bool = False) -> int:
        """Add a row and return its number."""
        self._rows.append(([*fields, *[0] * (WIDTH - len(fields))], is_fixed))
        return len(self._rows) - 1

    def dense(self, view: View) -> View:
        """Return the elements of a view one behind the other."""
        if view.is_dense:
            return replace(view, strides=strides_of(view.shape))
        target = self.new(view.shape, view, kind=view.kind)
        self.copy(view, target)
        return target

    def reshaped(self, view: View, shape: Sequence[int]) -> View:
        """Return a view with another shape, copied if need be."""
        shape = tuple(shape)
        if math.prod(shape) != view.size:
            raise UnsupportedError(f"{view.shape} as {shape}")
        same = view.reshaped(shape) or self.dense(view).reshaped(shape)
        assert same is not None
        return same

    def copy(self, source: View, target: View) -> None:
        """Copy elements; `target` may lie inside of a larger array."""
        sizes, (x, d) = merged(source.shape, source.strides, target.strides)
        self.row(
            rows.COPY, 0, *sizes, *x, *d, source.offset, target.offset, is_fixed=source.is_fixed
        )

    def combine(self, code: int, x: View, y: View, *, kind: Kind = "float") -> View:
        """Return f(x, y) by element, broadcast."""
        shape = np.broadcast_shapes(x.shape, y.shape)
        target = self.new(shape, x, y, kind=kind)
        x, y = x.broadcast(shape), y.broadcast(shape)
        sizes, strides = merged(shape, x.strides, y.strides, target.strides)
        flat = [step for each in strides for step in each]
        self.row(
            rows.ELEMENTS, code, *sizes, *flat, x.offset, y.offset, target.offset,
            is_fixed=target.is_fixed,
        )  # fmt: skip
        return target

    def apply(self, code: int, x: View, parameter: float = 0.0, *, kind: Kind = "float") -> View:
        """Return f(x) by element."""
        x = self.dense(x)
        target = self.new(x.shape, x, kind=kind)
        place = self.number(parameter)
        self.row(rows.UNARY, code, x.offset, target.offset, x.size, place, is_fixed=target.is_fixed)
        return target

    def number(self, value: float) -> int:
        """Return the offset of one constant."""
        return self.put(np.array([value], np.float32))

    def scalar(self, value: float) -> View:
        """Return a constant that broadcasts to anything."""
        return View(self.number(value), (), (), True)

    def product(self, name: str, x: View, weights: Array, bias: Array | None) -> View:
        """Return x @ weights + bias for constant weights.

        Args:
            name: of the value that it becomes, for what is fused into it; empty if none may be.
            x: (..., depth).
            weights: (depth, columns).
            bias: (columns,) or (1,).
        """
        depth, columns = weights.shape
        if x.shape[-1] != depth:
            raise UnsupportedError(f"{x.shape} times {weights.shape}")
        if x.strides[-1] != 1 and depth > 1:
            x = self.dense(x)
        matrix = self.reshaped(x, (x.size // depth if depth else 0, depth))
        target = self.new((*x.shape[:-1], columns), x)
        number = self.row(
            rows.PRODUCT, matrix.offset, matrix.strides[0], 1, 0, 1, 0, depth,
            self.put(panels(weights)), self.bias(bias, columns), columns, target.offset, columns,
            matrix.shape[0], 0, 1, is_fixed=target.is_fixed,
        )  # fmt: skip
        if name:
            self._products[name] = number
        return target

    def bias(self, bias: Array | None, columns: int) -> int:
        """Return the offset of a product's bias; of zeros if it has none."""
        if bias is not None:
            return self.put_columns(bias, columns)
        return self.put_columns(np.zeros(1), columns)

    def of_product(self, name: str, *, is_image: bool = False) -> list[int] | None:
        """Return the row of the product that alone makes a value which one operator takes.

        Args:
            name: of the value.
            is_image: whether it must be one that makes an image line by line.
        """
        number = self._products.get(name)
        if number is None or not self.used_once(name) or (is_image and name not in self._images):
            return None
        return self._rows[number][0]

    def renamed_product(self, before: str, after: str) -> None:
        """Say that a value into whose product something was fused has another name now."""
        self._products[after] = self._products.pop(before)
        if before in self._images:
            self._images.add(after)

    def note_image(self, name: str, number: int) -> None:
        """Remember which row makes an image, for what may be fused into it."""
        self._products[name] = number
        self._images.add(name)

    # --- the whole graph ------------------------------------------------------------------------

    def plan(self) -> Program:
        """Return the program of the graph.

        Raises:
            UnsupportedError: an operator, or a use of one, cannot be planned; named.
        """
        inputs: dict[str, Slot] = {}
        for given in self._graph.inputs:
            if given.dtype.str not in rows.DTYPES:
                raise UnsupportedError(f"an input of type {given.dtype}")
            if None in given.shape[1:]:
                raise UnsupportedError(f"the input {given.name!r} of unknown size")
            shape: Shape = tuple(size or 1 for size in given.shape)
            view = replace(self.new(shape), kind=_KINDS[given.dtype.kind])
            self.values[given.name] = view
            inputs[given.name] = Slot(view.offset, shape, given.dtype.str)
        for node in self._graph.nodes:
            self._plan_node(node)
        outputs: dict[str, Slot] = {}
        for name in self._graph.outputs:
            view = self.dense(self.view(name))
            outputs[name] = Slot(view.offset, view.shape)
        return self._program(inputs, outputs)

    def _plan_node(self, node: Node) -> None:
        said = f"{node.domain}::{node.operator}" if node.domain else node.operator
        rule = _RULES.get((node.domain, node.operator))
        if rule is None:
            raise UnsupportedError(f"operator {said}")
        try:
            rule(self, node)
        except UnsupportedError as error:
            raise UnsupportedError(f"operator {said} with {error}") from None
        except (ValueError, IndexError, KeyError, TypeError, ZeroDivisionError) as error:
            raise UnsupportedError(f"operator {said} with unsuitable inputs: {error}") from None
        if any(name and name not in self.values for name in node.outputs):
            raise UnsupportedError(f"operator {said} with {len(node.outputs)} outputs")

    def _program(self, inputs: dict[str, Slot], outputs: dict[str, Slot]) -> Program:
        scratch = self.room(2 * PANEL)
        arena = np.zeros(self._top + SLACK, np.float32)
        for place, numbers in self._data:
            arena[place : place + numbers.size] = numbers
        made = fused(self._rows, [slot.offset for slot in (*inputs.values(), *outputs.values())])
        every = np.array([fields for fields, _ in made], np.int64).reshape(-1, WIDTH)
        is_fixed = np.array([fixed for _, fixed in made], bool)
        program = Program(
            arena=arena.size,
            scratch=scratch,
            once=every[is_fixed],
            rows=every[~is_fixed],
            numbers=arena,
            inputs=inputs,
            outputs=outputs,
        )
        program.check()
        return program


def panels(weights: Array) -> NDArray[np.float32]:
    """Return weights, (depth, columns), as panels of sixteen columns, filled up with zeros."""
    depth, columns = weights.shape
    wide = np.zeros((depth, -(-columns // PANEL) * PANEL), np.float32)
    wide[:, :columns] = weights
    return np.ascontiguousarray(wide.reshape(depth, -1, PANEL).transpose(1, 0, 2))
