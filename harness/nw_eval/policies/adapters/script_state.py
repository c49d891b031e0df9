"""The recurrent state of a TorchScript module: its buffers, and attributes that its code sets."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from nw_eval.errors import PolicyError

_SETS = re.compile(r'prim::SetAttr\[name="(\w+)"\]')

Slots = dict[str, tuple[str, str]]
"""Paths of state to (path of the submodule, name of its attribute)."""


def state_slots(module: Any, where: str) -> Slots:
    """Return where a scripted module keeps what changes from step to step.

    Raises:
        PolicyError: its code changes a list or another object, which cannot be saved.
    """
    parts: list[tuple[str, Any]] = list(module.named_modules())
    changed = set[str]().union(*(_names_set_by(part) for _, part in parts))
    slots: Slots = {}
    for path, part in parts:
        buffers = {name for name, _ in part.named_buffers(recurse=False)}
        for name in sorted(buffers | {name for name in changed if part._c.hasattr(name)}):  # noqa: SLF001 - torch shows a script's attributes nowhere else.
            value = getattr(part, name)
            if not isinstance(value, torch.Tensor | int | float | bool):
                raise PolicyError(
                    f"{where}: its code changes `{name}`, a {type(value).__name__}, which cannot "
                    "be saved with a trial",
                    fix="keep recurrent state in buffers: register_buffer",
                )
            slots[f"{path}.{name}" if path else name] = (path, name)
    return slots


def read_state(module: Any, slots: Slots) -> dict[str, NDArray[Any]]:
    """Return the state by path, as arrays of their own memory."""
    state: dict[str, NDArray[Any]] = {}
    for key, (path, name) in slots.items():
        value = getattr(_part(module, path), name)
        if isinstance(value, torch.Tensor):
            value = value.detach().numpy()
        state[key] = np.array(value)
    return state


def write_state(module: Any, slots: Slots, state: Mapping[str, NDArray[Any]]) -> None:
    """Set the state that `read_state` returned, or one of the same types."""
    for key, (path, name) in slots.items():
        part = _part(module, path)
        is_tensor = isinstance(getattr(part, name), torch.Tensor)
        value = state[key]
        setattr(part, name, torch.from_numpy(value.copy()) if is_tensor else value.item())


def same(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether two arrays hold the same bits."""
    return a.shape == b.shape and a.tobytes() == b.tobytes()


def _part(module: Any, path: str) -> Any:
    for name in path.split(".") if path else ():
        module = getattr(module, name)
    return module


def _names_set_by(part: Any) -> set[str]:
    """Return the names of attributes that any method of a submodule assigns."""
    script = part._c  # noqa: SLF001 - as above.
    graphs = (script._get_method(name).graph for name in script._method_names())  # noqa: SLF001
    return {name for graph in graphs for name in _SETS.findall(str(graph))}
