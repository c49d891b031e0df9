"""Records what torch computes as a graph of `nw_policies.executor`, which runs without torch.

A network runs once on zeros, and each operator of ATen that torch's dispatcher is asked for becomes
operators of the graph (`aten`, `aten_layers`). So modules in Python, TorchScript files and graphs
of torch.export are recorded alike. What depends on no input is a constant. A way that depends on
the numbers of an input cannot be recorded, and is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from nw_policies.executor import NEXT, Graph, Node, RecordedFile, UnsupportedError
from nw_policies.networks.aten import EXACT, MADE, RULES
from nw_policies.networks.aten_layers import COMPOSED
from nw_policies.networks.exported import without_compiler
from nw_policies.networks.values import Values, as_array, memory_of

_PIECES = 256
"""Runs of numbers that stay together where a part of an array is overwritten."""


def record(
    run: Callable[[], Mapping[str, Tensor]],
    inputs: Mapping[str, Tensor],
    memory: Mapping[str, Tensor] | None = None,
) -> Graph:
    """Return the graph of a function of tensors; its outputs are named `NEXT` and their name.

    Args:
        run: computes from `inputs` and `memory`, and returns by name what it gives, the next
            `memory` among it under the same names.
        inputs: by name.
        memory: by name, what is given back to it at its next run. What it does not change becomes
            a constant.

    Raises:
        UnsupportedError: it has an operator, or a use of one, that cannot be recorded; named.
    """
    recorder = Recorder()
    kept = {name: tensor.clone() for name, tensor in (memory or {}).items()}
    for name, tensor in (*inputs.items(), *(memory or {}).items()):
        recorder.input(name, tensor)
    try:
        with without_compiler(), torch.inference_mode(), recorder:
            results = run()
        names = {name: recorder.name(tensor) for name, tensor in results.items()}
    except Exception:
        if recorder.fault is not None:  # TorchScript says it in words of its own.
            raise recorder.fault from None
        raise
    graph = recorder.graph
    for name in [name for name in kept if names[name] == name]:
        graph.constants[name] = as_array(kept[name])
        graph.inputs = [each for each in graph.inputs if each.name != name]
        del names[name]
    named(graph, names)
    used = {name for node in graph.nodes for name in node.inputs}
    graph.inputs = [each for each in graph.inputs if each.name in used]
    return graph


def numbered(tensors: Iterable[Tensor]) -> dict[str, Tensor]:
    """Return the inputs of a file by the names that they have in its graph."""
    return {f"input {place}": tensor for place, tensor in enumerate(tensors)}


def recorded_file(graph: Graph, memory: Mapping[str, NDArray[Any]]) -> RecordedFile:
    """Return the recorded file of a single graph.

    Args:
        graph: from `record`.
        memory: as a trial begins; what the graph does not change of it is left out.
    """
    changed = {name for name in memory if NEXT + name in graph.outputs}
    return RecordedFile(
        parts=((1, graph),), first={name: x for name, x in memory.items() if name in changed}
    )


def named(graph: Graph, names: Mapping[str, str]) -> None:
    """Let values be outputs of a graph, by the names that they have there."""
    for name, value in names.items():
        graph.nodes.append(Node(operator="Identity", inputs=(value,), outputs=(NEXT + name,)))
        graph.outputs.append(NEXT + name)


class _Arguments:
    """Arguments of an operator by the names of its schema, and the operator's own name."""

    def __init__(self, operator: str, func: Any, args: Sequence[Any], kwargs: Any) -> None:
        schema = func._schema.arguments  # noqa: SLF001 - torch shows it nowhere else.
        given = {one.name: one.default_value for one in schema if one.has_default_value()}
        given |= {one.name: value for one, value in zip(schema, args, strict=False)}
        self.__dict__ |= given | dict(kwargs)
        self.operator = operator

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)

    def get(self, name: str, default: Any = None) -> Any:
        """Return an argument, or a default where the operator has none of that name."""
        return self.__dict__.get(name, default)


class Recorder(TorchDispatchMode, Values):
    """Writes down the operators that run in its `with` block.

    Attributes:
        graph: what was written down.
        fault: why it cannot be, if it cannot.
    """

    def __init__(self) -> None:
        super().__init__()
        Values.__init__(self)
        self.fault: UnsupportedError | None = None

    def input(self, name: str, tensor: Tensor) -> None:
        """Let a tensor be an input of the graph."""
        dtype = np.float32 if tensor.is_floating_point() else as_array(tensor).dtype
        self.graph.input(name, tuple(tensor.shape), dtype)
        self.know(tensor)
        self.names[id(tensor)] = name

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        """Run an operator and write it down."""
        try:
            return self._ran(func, args, kwargs or {})
        except UnsupportedError as error:
            self.fault = self.fault or error
            raise

    def _ran(self, func: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        full = func._schema.name.removeprefix("aten::")  # noqa: SLF001 - as above.
        written = _written(func, args, kwargs)
        operator = full if full in RULES or written is None else full.removesuffix("_")
        is_constant = all(map(self.is_constant, _tensors((args, kwargs))))
        if operator in MADE or (is_constant and operator in EXACT):
            return self._made(func, args, kwargs, written)
        if is_constant and written is None and torch.Tag.nondeterministic_seeded not in func.tags:
            result = func(*args, **kwargs)
            if not any(tensor.is_floating_point() for tensor in _tensors(result)):
                return result  # Whole numbers and truth values have no last digits.
        if operator in COMPOSED:
            return self._composed(_Arguments(operator, func, args, kwargs))
        if operator not in RULES:
            if func._can_decompose():  # noqa: SLF001 - as above.
                with self:
                    return func.decompose(*args, **kwargs)
            raise UnsupportedError(f"operator {full}")
        given = _Arguments(operator, func, args, kwargs)
        if written is not None:
            around = self._around(written)
            (name,) = self._named(given, [written])
            result = func(*args, **kwargs)
            self._write(written, name, around)
            return result
        result = func(*args, **kwargs)
        outputs = list(_tensors(result))
        for tensor, name in zip(outputs, self._named(given, outputs), strict=True):
            self.know(tensor)
            if name:
                self.names[id(tensor)] = name
        return result

    def _composed(self, given: _Arguments) -> Any:
        try:
            with self:
                return COMPOSED[given.operator](given)
        except UnsupportedError as error:
            raise UnsupportedError(f"operator {given.operator} with {error}") from None

    def _made(self, func: Any, args: Any, kwargs: Any, written: Tensor | None) -> Any:
        """Run an operator whose result depends on no input."""
        if written is not None:
            self.know(written)
            for each in self._beside(written):
                self.constants.pop(id(each), None)
                if id(each) in self.names:
                    raise UnsupportedError("memory that an input shares with a constant")
        result = func(*args, **kwargs)
        for tensor in _tensors(result):
            if func._schema.name.startswith("aten::empty"):  # noqa: SLF001 - as above.
                tensor.zero_()  # What lies there by chance would be a constant.
            self.know(tensor)
        return result

    def _named(self, given: _Arguments, outputs: Sequence[Tensor]) -> list[str]:
        try:
            names = RULES[given.operator](self, given, outputs)
        except UnsupportedError as error:
            raise UnsupportedError(f"operator {given.operator} with {error}") from None
        except (AttributeError, TypeError, ValueError, IndexError) as error:
            raise UnsupportedError(f"operator {given.operator}, used as nowhere: {error}") from None
        return [names] if isinstance(names, str) else list(names)

    # --- memory that tensors share --------------------------------------------------------------

    def _beside(self, tensor: Tensor) -> list[Tensor]:
        return list(self.sharing.get(memory_of(tensor), {}).values())

    def _around(self, written: Tensor) -> list[tuple[Tensor, str]]:
        """Return the tensors that an operator is about to change with one, and what they were."""
        self.know(written)
        places = set(_places(written).ravel().tolist())
        return [
            (each, self.name(each))
            for each in self._beside(written)
            if each is not written and not places.isdisjoint(_places(each).ravel().tolist())
        ]

    def _write(self, written: Tensor, name: str, around: list[tuple[Tensor, str]]) -> None:
        self.names[id(written)] = name
        new = {place: at for at, place in enumerate(_places(written).ravel().tolist())}
        for each, before in around:
            count = each.numel()
            taken = [
                new[place] + count if place in new else at
                for at, place in enumerate(_places(each).ravel().tolist())
            ]
            both = self.add(
                "Concat", self.reshaped(before, [count]), self.reshaped(name, [written.numel()]),
                axis=0,
            )  # fmt: skip
            cuts = [0, *(i + 1 for i, (a, b) in enumerate(pairwise(taken)) if b != a + 1), count]
            if len(cuts) > _PIECES:
                raise UnsupportedError("an array with many overwritten parts")
            parts = [
                self.slice(both, 0, taken[start], taken[start] + end - start)
                for start, end in pairwise(cuts)
            ]
            joined = parts[0] if len(parts) == 1 else self.add("Concat", *parts, axis=0)
            self.names[id(each)] = self.reshaped(joined, each.shape)


def _places(tensor: Tensor) -> NDArray[np.int64]:
    """Return where in their common memory the numbers of a tensor lie."""
    offsets = np.full(tuple(tensor.shape), tensor.storage_offset(), np.int64)
    for axis, (size, stride) in enumerate(zip(tensor.shape, tensor.stride(), strict=True)):
        offsets += (np.arange(size) * stride).reshape(-1, *[1] * (tensor.ndim - axis - 1))
    return offsets


def _written(func: Any, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Tensor | None:
    """Return the tensor that an operator writes into."""
    schema = func._schema  # noqa: SLF001 - torch shows it nowhere else.
    if not schema.is_mutable:
        return None
    names = [one.name for one in schema.arguments if one.alias_info and one.alias_info.is_write]
    if names != ["self"] or not schema.name.endswith("_"):
        raise UnsupportedError(f"operator {schema.name} that writes into {', '.join(names)}")
    return kwargs["self"] if "self" in kwargs else args[0]


def _tensors(value: Any) -> Iterator[Tensor]:
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, list | tuple):
        for each in value:
            yield from _tensors(each)
    elif isinstance(value, dict):
        yield from _tensors(list(value.values()))
