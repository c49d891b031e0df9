"""TorchScript checkpoints, run on the CPU on one thread.

The recurrent state of a module is its buffers, and attributes that its code sets; and inputs that
its own outputs feed, where the card says so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.confinement import fence_stands
from nw_base.errors import PolicyError, TrialError, nearest
from nw_base.memory import pack
from nw_base.plural import plural
from nw_policies.bundle import Bundle
from nw_policies.cards.feeding import InputSpec
from nw_policies.cards.networks import Feedback, Recurrent, listed_inputs
from nw_policies.executor import RecordedFile, UnsupportedError
from nw_policies.line import check_program
from nw_policies.networks.recording import numbered, record, recorded_file
from nw_policies.policy import (
    ActingNetwork,
    InputAssembler,
    Observation,
    Wanted,
    unfitting,
    unpacked,
)
from nw_policies.safety import file_kind, tensor_facts
from nw_policies.safety.archive import kind_said

_SETS = re.compile(r'prim::SetAttr\[name="(\w+)"\]')

_KEPT = "input "
"""Begins the names of what is fed back in a state; no path of a module has a space."""
_Slots = dict[str, tuple[str, str]]
"""Paths of state to (path of the submodule, name of its attribute)."""


class TorchScriptNetwork:
    """A scripted or traced module that takes tensors and returns one, or a tuple of them.

    Buffers, and whatever else its code writes to, are its recurrent state, as rsl_rl exports it:
    a trial begins with what the file holds of them. Inputs that the card's `recurrent` names begin
    as zeros.

    It is a program, which torch runs as it is: in a process that is fenced in, or where the caller
    trusts it. Inputs are passed in the order of the card's `inputs`.
    """

    inputs: tuple[InputSpec, ...] = ()
    """TorchScript files do not declare shapes."""

    def __init__(self, bundle: Bundle, wanted: Wanted, *, allow_code: bool) -> None:
        """Open the module of a card, or of one of its networks.

        Raises:
            PolicyError: it cannot be used, or an output is wanted by a name.
        """
        check_program(bundle, allow_code=allow_code)
        self.where = bundle.where
        self._name = bundle.name
        self._subject = bundle.subject
        self._places = [_place(one, bundle) for one in wanted]
        # More threads change the order of sums, and with it the last bits of an action.
        torch.set_num_threads(1)
        self._module: Any = _open(bundle.read_checkpoint(), str(bundle.checkpoint))
        self._arguments = _check_signature(self._module, bundle)
        self._assemble = InputAssembler(bundle.card, self.inputs)
        self._slots = _state_slots(self._module, str(bundle.checkpoint))
        self._fed = _fed(bundle.card.recurrent)
        feeding = [one.output for one in self._fed.values()]
        self._places = [_free(place, feeding) for place in self._places]
        self._zeros = {_KEPT + n: np.zeros(f.shape, np.float32) for n, f in self._fed.items()}
        self._memory: dict[str, NDArray[Any]] = dict(self._zeros)
        self._first = read_state(self._module, self._slots) | self._zeros

    def reset(self, seed: int) -> None:  # noqa: ARG002 - `DrawingPolicy` seeds the generator.
        """Begin a trial with the state that the file holds."""
        self._memory = dict(self._zeros)
        if self._module is not None:
            _write_state(self._module, self._slots, self._first)

    def run(self, observation: Observation) -> tuple[NDArray[Any], ...]:
        """Run the module once."""
        if self._module is None:
            raise TrialError(f"{self._subject} is closed", fix="open it again")
        tensors = _as_tensors(self._with_memory(self._assemble.in_order(observation)))
        try:
            with torch.inference_mode():
                raw = self._module.forward(*tensors)
        except (RuntimeError, IndexError, torch.jit.Error) as error:
            reason = clean(str(error).strip().splitlines()[-1])
            fix = "export it in float32: module.float()" if "dtype" in reason else None
            raise TrialError(f"{self._subject} failed: {reason}", fix=fix) from error
        outputs = raw if isinstance(raw, tuple | list) else [raw]
        for name, one in self._fed.items():
            value = self._picked(outputs, one.output)
            if value.shape != tuple(one.shape) or value.dtype != np.float32:
                raise TrialError(
                    f"{self._subject}: what feeds its input {name!r} is {value.dtype} of shape "
                    f"{list(value.shape)}",
                    fix=f"correct `recurrent`, which names {one.shape}",
                )
            self._memory[_KEPT + name] = value.copy()
        return tuple(self._picked(outputs, place) for place in self._places)

    def recorded(self, observation: Observation) -> RecordedFile:
        """Return what `run` computes as a graph.

        Args:
            observation: as for `run`; its sizes count.

        Raises:
            UnsupportedError: it has an operator that cannot be recorded, or counts in Python.
        """
        self.reset(0)
        seen = _as_tensors(self._assemble.in_order(observation))
        flat = [x for one in seen for x in (one if isinstance(one, list) else [one])]
        fed = {name: torch.from_numpy(self._zeros[_KEPT + name].copy()) for name in self._fed}
        rest = iter(seen)
        arguments = (
            [fed[name] if name in fed else next(rest, None) for name in self._arguments]
            if fed
            else seen
        )

        def attributes() -> dict[str, Any]:
            places = self._slots.items()
            return {key: getattr(_part(self._module, path), name) for key, (path, name) in places}

        before = attributes()

        def run() -> dict[str, Any]:
            raw = self._module.forward(*arguments)
            outputs = raw if isinstance(raw, tuple | list) else [raw]
            named = {f"output {k}": outputs[place] for k, place in enumerate(self._places)}
            named |= {_KEPT + name: outputs[one.output] for name, one in self._fed.items()}
            for key, value in attributes().items():
                if isinstance(value, torch.Tensor):
                    named[key] = value
                elif value != before[key]:
                    raise UnsupportedError(f"`{key}`, a {type(value).__name__} that changes")
            return named

        tensors = {key: x for key, x in before.items() if isinstance(x, torch.Tensor)}
        memory = tensors | {_KEPT + name: tensor for name, tensor in fed.items()}
        try:
            return recorded_file(record(run, numbered(flat), memory), self._first)
        finally:
            self.reset(0)

    def _with_memory(
        self, arrays: Sequence[NDArray[Any] | list[NDArray[Any]]]
    ) -> list[NDArray[Any] | list[NDArray[Any]] | None]:
        """Return what is observed and what is fed back, in the module's order; else None."""
        if not self._fed:
            return list(arrays)
        observed = iter(arrays)
        return [
            # The module may write into what it is given.
            self._memory[_KEPT + name].copy() if name in self._fed else next(observed, None)
            for name in self._arguments
        ]

    def _picked(self, outputs: Sequence[Any], index: int) -> NDArray[Any]:
        if index >= len(outputs):
            raise TrialError(
                f"{self._subject} returned {plural(len(outputs), 'tensor')}, none at index {index}",
                fix="indices count from 0: correct `output` on the card",
            )
        if not isinstance(outputs[index], torch.Tensor):
            kind = type(outputs[index]).__name__
            raise TrialError(f"{self._subject} returned a {kind}, no tensor")
        return outputs[index].numpy()

    def state(self) -> bytes:
        """Return the state where it differs from the file's, as bytes."""
        if self._module is None:
            return b""
        values = read_state(self._module, self._slots) | self._memory
        return pack(
            {path: array for path, array in values.items() if not same(array, self._first[path])}
        )

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._name) as arrays:
            for path, array in arrays.items():
                if path not in self._first or self._first[path].dtype != array.dtype:
                    raise unfitting(self._name, f"it has {path!r} of {array.dtype}")
                if path in self._zeros and self._zeros[path].shape != array.shape:
                    raise unfitting(self._name, f"it has {path!r} of shape {array.shape}")
            self._memory = {path: arrays.get(path, zeros) for path, zeros in self._zeros.items()}
            if self._module is not None:
                _write_state(self._module, self._slots, self._first | arrays)

    def close(self) -> None:
        """Free the module."""
        self._module = None


class TorchScriptPolicy(ActingNetwork):
    """A module, one of whose outputs is the action."""

    def __init__(self, bundle: Bundle, *, joints: int, allow_code: bool) -> None:
        network = TorchScriptNetwork(bundle, [bundle.card.output], allow_code=allow_code)
        super().__init__(network, joints=joints, policy=bundle.name)


def _as_tensors(arrays: Sequence[NDArray[Any] | list[NDArray[Any]] | None]) -> list[Any]:
    return [
        [torch.from_numpy(array) for array in one]
        if isinstance(one, list)
        else None
        if one is None
        else torch.from_numpy(one)
        for one in arrays
    ]


def _fed(recurrent: Recurrent | None) -> dict[str, Feedback]:
    """Return the inputs that outputs feed; the card has been checked."""
    return {n: one for n, one in (recurrent or {}).items() if isinstance(one, Feedback)}


def _free(index: int, feeding: Sequence[int]) -> int:
    """Return the position among all outputs from that among those that feed no state."""
    for taken in sorted(set(feeding)):
        index += taken <= index
    return index


def _check_signature(module: Any, bundle: Bundle) -> tuple[str, ...]:
    """Compare what `forward` takes with the inputs of the card; return what it takes, in order.

    Raises:
        PolicyError: it takes something that no card can feed, or the card feeds something else.
    """
    parts, listed = bundle.card.input_parts(), listed_inputs(bundle.card.inputs)
    if not module._c._has_method("forward"):  # noqa: SLF001 - torch shows it nowhere else.
        raise PolicyError(
            f"{bundle.where}: the checkpoint has no method `forward`",
            fix="script a complete module",
        )
    schema = module._c._get_method("forward").schema  # noqa: SLF001 - as above.
    arguments = [(a.name, str(a.type), a.has_default_value()) for a in schema.arguments[1:]]
    shown = ", ".join(f"{name}: {kind}" for name, kind, _ in arguments)
    where = f"{bundle.where}: the checkpoint's `forward({clean(shown, at_most=200)})`"
    every = tuple(name for name, _, _ in arguments)
    fed = _fed(bundle.card.recurrent)
    for name in fed:
        if name not in every:
            raise PolicyError(
                f"{where} takes no {name!r}, which `recurrent` names", fix=nearest(name, every)
            )
    arguments = [argument for argument in arguments if argument[0] not in fed]
    needed = [name for name, _, is_optional in arguments if not is_optional]
    for name, kind, is_optional in arguments:
        if kind not in {"Tensor", "Optional[Tensor]", "List[Tensor]"} and not is_optional:
            raise PolicyError(
                f"{where} takes `{name}`, a {clean(kind, at_most=80)}, which no card can feed",
                fix="export it with tensors, or lists of tensors, as its arguments",
            )
    if not len(needed) <= len(parts) <= len(arguments):
        names = ", ".join(f"{name}: [...]" for name in needed)
        raise PolicyError(
            f"{where} takes {plural(len(needed), 'input')}, the card feeds {len(parts)}",
            fix=f"name the observations of each, in this order: `inputs: {{{names}}}`",
        )
    for (own, names), (name, kind, _) in zip(parts, arguments, strict=False):
        is_list, joined = kind == "List[Tensor]", ", ".join(names)
        if is_list != (own in listed):
            one = f"{{list: [{joined}]}}" if is_list else f"[{joined}]"
            raise PolicyError(
                f"{where} takes `{name}`, a {kind}; the card feeds it "
                f"{'one array' if is_list else 'a list'}",
                fix=f"write `inputs: {{{own or name}: {one}}}`",
            )
    return every


def _place(wanted: str | int | None, bundle: Bundle) -> int:
    if isinstance(wanted, str):
        raise PolicyError(
            f"{bundle.where}: output {wanted!r}: the outputs of a TorchScript file have no names",
            fix="give its index among what `forward` returns, counted from 0",
        )
    return wanted or 0


@lru_cache(maxsize=1)  # All trials of a process open the same file.
def _check(data: bytes, where: str) -> None:
    """Refuse archives that unpack to too much, and pickles of anything but tensors and scripts."""
    tensor_facts(data, where)


def width_taken(checkpoint: Path, widths: Sequence[int]) -> int:
    """Return which row of zeros a module takes as its only input: the first of some widths.

    The module runs once for each width until then, from the state that its file holds.

    Args:
        checkpoint: a TorchScript file.
        widths: numbers of the row.

    Returns:
        0 if it takes none of them, or no fence stands round this process.

    Raises:
        PolicyError: the file cannot be opened.
    """
    if not fence_stands():
        return 0
    torch.set_num_threads(1)
    data = checkpoint.read_bytes()
    for width in widths:
        module = _open(data, str(checkpoint))  # Anew: what a run leaves in it shapes the next one.
        try:
            with torch.inference_mode():
                module.forward(torch.zeros(1, width))
        except (RuntimeError, IndexError, torch.jit.Error):
            continue
        return width
    return 0


def _open(data: bytes, where: str) -> Any:
    if (kind := file_kind(data, where)) != "torchscript":
        raise PolicyError(
            f"{where}: not a TorchScript file: {kind_said(kind)}",
            fix="save the module with torch.jit.save, or change `adapter`",
        )
    _check(data, where)
    try:
        module = torch.jit.load(BytesIO(data), map_location="cpu")
        module.eval()
    except (RuntimeError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise PolicyError(
            f"{where}: not a usable TorchScript file: {clean(error, at_most=300)}",
            fix="save it with torch.jit.save",
        ) from None
    return module


def _state_slots(module: Any, where: str) -> _Slots:
    """Return where a scripted module keeps what changes from step to step.

    Raises:
        PolicyError: its code changes a list or another object, which cannot be saved.
    """
    parts: list[tuple[str, Any]] = list(module.named_modules())
    changed = set[str]().union(*(_names_set_by(part) for _, part in parts))
    slots: _Slots = {}
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


def read_state(module: Any, slots: _Slots) -> dict[str, NDArray[Any]]:
    """Return the state by path, as arrays of their own memory."""
    state: dict[str, NDArray[Any]] = {}
    for key, (path, name) in slots.items():
        value = getattr(_part(module, path), name)
        if isinstance(value, torch.Tensor):
            value = value.detach().numpy()
        state[key] = np.array(value)
    return state


def _write_state(module: Any, slots: _Slots, state: Mapping[str, NDArray[Any]]) -> None:
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
