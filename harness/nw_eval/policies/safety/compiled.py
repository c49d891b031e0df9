"""What torch compiled of a script, looked at once more before any of it runs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.policies.safety.torchscript.body import GUARDS
from nw_eval.policies.safety.torchscript.operators import (
    COMPILED_OPERATORS,
    PRIM_OPERATORS,
    REFUSED_OVERLOADS,
    STRUCTURE,
    may_run,
)


def check_compiled(unit: Any, where: str) -> None:
    """Check every node of every function that torch compiled.

    The text of a script says what is called, and torch's types decide what that means: a method
    that a class of the file defines is an operator where the value turns out to be a tensor.

    Args:
        unit: the `torch._C.CompilationUnit` that the file was loaded into.
        where: path of the file, for errors.

    Raises:
        PolicyError: a node is none that a network needs.
    """
    from nw_eval.policies.safety.guards import GUARDED

    for function in unit.get_functions():
        guard = function.qualified_name.startswith(f"{GUARDS}.")
        for node in _nodes(function.graph):
            name, place = node.kind(), function.qualified_name
            space, _, operator = name.partition("::")
            if space == "prim" and operator in STRUCTURE | PRIM_OPERATORS:
                fault = _device_fault(node)
            elif space == "aten" and may_run(operator, COMPILED_OPERATORS):
                overload = _overload(node)
                refused = overload in REFUSED_OVERLOADS or (overload in GUARDED and not guard)
                fault = f"`{overload}`" if refused else _layout_fault(node, operator)
            else:
                fault = f"`{name}`"
            if fault is not None:
                raise PolicyError(
                    f"{where}: the script's `{clean(place, at_most=200)}` does {fault}, which is "
                    "not among what may run",
                    fix="export the plain network: layers and arithmetic, on the CPU",
                )


def _nodes(block: Any) -> Iterator[Any]:
    """Give the nodes of a graph or block and of all blocks inside."""
    for node in block.nodes():
        yield node
        for inner in node.blocks():
            yield from _nodes(inner)


def _overload(node: Any) -> str:
    """Return `lstm.input` for a node, `relu.default` where an operator has one form only."""
    name = node.schema().split("(", 1)[0].removeprefix("aten::")
    return name if "." in name else f"{name}.default"


def _device_fault(node: Any) -> str | None:
    """Say which device but the CPU a constant names."""
    if node.kind() != "prim::Constant" or str(node.output().type()) != "Device":
        return None
    device = node.output().toIValue()
    return None if device is None or device.type == "cpu" else f"name the device `{device}`"


def _layout_fault(node: Any, operator: str) -> str | None:
    """Say what asks for a tensor that is not dense, or for a device that is computed."""
    inputs = list(node.inputs())
    if operator == "device" and inputs[0].node().kind() != "prim::Constant":
        return "compute the name of a device"
    for value, argument in zip(inputs, _arguments(node.schema()), strict=False):
        source = value.node()
        if argument != "layout" or source.kind() == "prim::layout":
            continue
        if source.kind() != "prim::Constant" or value.toIValue() not in {None, 0}:
            return "ask for a tensor that is not dense"
    return None


def _arguments(schema: str) -> list[str]:
    """Return the names of an operator's arguments from `aten::full(int[] size, *, ...) -> ...`."""
    inside = schema.split("(", 1)[1].split(") -> ", 1)[0]
    parts = [part.split("=")[0].strip() for part in inside.split(", ")]
    return [part.rsplit(" ", 1)[-1] for part in parts if part != "*"]
