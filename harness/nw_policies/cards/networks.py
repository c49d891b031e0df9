"""Files of weights as a card names them, and which observations make which of their inputs.

There are the checkpoint and the networks that feed it: estimators, adaptation modules, encoders.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeGuard, get_args

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from nw_base.errors import PolicyError, nearest
from nw_base.files.inside import OutsideError, checked
from nw_base.plural import plural
from nw_policies.cards.model import CardModel, Line, Rate
from nw_policies.cards.observations import Select

if TYPE_CHECKING:
    from nw_policies.cards.card import Card


NetworkAdapter = Literal["onnx", "torchscript", "torch-export"]
"""What runs a file that may also be a network which feeds another."""
BuiltInAdapter = Literal[
    NetworkAdapter, "mlp", "lucidsim", "extreme-parkour", "act", "remote", "zero"
]
"""The table of adapters; what opens each of them stands in `nw_policies.opening`."""

ADAPTERS: tuple[str, ...] = get_args(BuiltInAdapter)


def is_built_in(adapter: str) -> TypeGuard[BuiltInAdapter]:
    """Whether an adapter of a card is one of ours rather than `python:package.module:Class`."""
    return adapter in ADAPTERS


def _known_adapter(name: str) -> str:
    if is_built_in(name) or re.fullmatch(r"python:[A-Za-z_][\w.]*:[A-Za-z_]\w*", name):
        return name
    if name.startswith("python:"):
        message = f"{name!r} names no class; write python:package.module:Class"
        raise ValueError(message)
    message = f"unknown adapter {name!r}; {nearest(name, ADAPTERS)}"
    raise ValueError(message)


Adapter = Annotated[str, AfterValidator(_known_adapter)]


def _plain_file(name: str) -> str:
    try:
        checked(name)
    except OutsideError as error:
        message = f"{name!r} leaves the card's folder: {error}"
        raise ValueError(
            f"{message}; name a file inside it; only --checkpoint may name one elsewhere"
        ) from None
    return name


def _sha256(digest: str) -> str:
    if not re.fullmatch(r"[0-9a-fA-F]{64}", digest):
        message = f"{digest[:20]!r} is not a SHA-256, which has 64 hex digits, not {len(digest)}"
        raise ValueError(f"{message}; `sha256sum FILE` prints it")
    return digest.lower()


Sha256 = Annotated[str, AfterValidator(_sha256)]


class Checkpoint(CardModel):
    """The file of weights, and the digest that it must have."""

    file: Annotated[str, AfterValidator(_plain_file)]
    """Path inside the card's folder."""
    sha256: Sha256 | None = None
    """Hex digest that the file must have; None = whatever lies there is taken, and recorded."""
    source: Line | None = None
    """Where people get the file if it does not lie beside the card."""


class TensorList(CardModel):
    """An input that is a list of arrays: `forward(obs_1d: Tensor, obs_2d: List[Tensor])`."""

    parts: list[str] = Field(alias="list", min_length=1)
    """The observations and networks that it holds, one array each, in this order."""


Inputs = dict[str, list[str] | TensorList] | list[str]
"""By input of a file, what is joined to make it; a list makes the one input of a file."""

OutputKey = Annotated[str, Field(min_length=1)] | Annotated[int, Field(ge=0)]
"""An output of a file: its name, or its position, from 0."""


class Feedback(CardModel):
    """What a TorchScript file gives back to one of its own inputs at the next step."""

    output: Annotated[int, Field(ge=0)]
    """Its position, from 0, among all that `forward` returns."""
    shape: Annotated[list[Annotated[int, Field(ge=1, le=100_000)]], Field(max_length=5)]
    """Shape of the zeros that a trial begins with: these files do not declare it."""


Recurrent = dict[str, str | Feedback]
"""By input of a file, the output of the last step that feeds it."""


def recurrent_fault(adapter: str, recurrent: Recurrent | None) -> tuple[str, str] | None:
    """Return what is wrong with `recurrent` of a file that an adapter runs, and the fix."""
    if not recurrent or (adapter == "onnx" and all(isinstance(o, str) for o in recurrent.values())):
        return None
    if adapter == "onnx":
        return "an ONNX graph has names for its outputs", "write `recurrent: {input: output}`"
    if adapter != "torchscript":
        words = f"`recurrent` is for adapters onnx and torchscript; `{adapter}` keeps its state"
        return f"{words} itself", "remove it"
    name = next((name for name, one in recurrent.items() if isinstance(one, str)), None)
    if name is None:
        return None
    words = "the outputs of a TorchScript file have no names, and its inputs no sizes"
    return words, f"write `recurrent: {{{name}: {{output: 1, shape: [1, 12]}}}}`"


class NetworkOutput(CardModel):
    """Numbers that a network gives, under a name of their own."""

    output: OutputKey | None = None
    """Which output of the file, by its name, or by its position (from 0) among those that feed no
    recurrent state; None = its first one."""
    select: Select | None = None
    """Which of its numbers are kept: indices and ranges such as "0:3" (end excluded)."""
    scale: float | list[float] = 1.0
    """Factor, one for all numbers that are kept or one each."""


def _named(value: Any) -> Any:
    """Read `velocity: null`, and `{velocity: }`, as an output with all by default."""
    return {} if value is None else value


class Network(CardModel):
    """A file of its own that turns observations, or what other networks give, into numbers."""

    adapter: NetworkAdapter
    """How the file is run."""
    checkpoint: Checkpoint
    """The file."""
    inputs: Inputs = Field(min_length=1)
    """For each input of the file, the observations and networks that are joined to make it; or
    just their list, for a file with one input."""
    outputs: Annotated[dict[str, NetworkOutput], Field(min_length=1)] | None = None
    """Names for parts of what it gives, used as `network.name`; None = all numbers of its first
    output, under the network's own name."""
    rate: Rate | None = None
    """How often a second it is asked, Hz, beginning with the first action; in between, what it
    gave is held. None = at every action."""
    recurrent: Recurrent | None = None
    """As the card's own `recurrent`."""

    @field_validator("outputs", mode="before")
    @classmethod
    def _bare(cls, outputs: Any) -> Any:
        if isinstance(outputs, dict):
            return {name: _named(value) for name, value in outputs.items()}
        return outputs

    def given_as(self, name: str) -> dict[str, NetworkOutput]:
        """Return what the network `name` gives, by the names under which others take it."""
        if self.outputs is None:
            return {name: NetworkOutput()}
        return {f"{name}.{part}": output for part, output in self.outputs.items()}


def input_parts(inputs: Inputs) -> tuple[tuple[str | None, tuple[str, ...]], ...]:
    """Return input names with what they are made of; no name where the file has one input."""
    if isinstance(inputs, list):
        return ((None, tuple(inputs)),)
    return tuple(
        (name, tuple(parts.parts if isinstance(parts, TensorList) else parts))
        for name, parts in inputs.items()
    )


def listed_inputs(inputs: Inputs | None) -> frozenset[str]:
    """Return the names of the inputs that are lists of arrays."""
    if not isinstance(inputs, dict):
        return frozenset()
    return frozenset(name for name, parts in inputs.items() if isinstance(parts, TensorList))


def feeding_order(card: Card) -> list[str]:
    """Return the networks of a card, each behind those that feed it.

    Those of a circle are left out, and those that one feeds.
    """
    order: list[str] = []
    waiting = dict(card.networks)
    while ready := [name for name in waiting if _fed_by(card, name) <= set(order)]:
        order += ready
        for name in ready:
            del waiting[name]
    return order


def way_back(card: Card, name: str) -> list[str] | None:
    """Return the way from a network over those that feed it to itself; None = there is none."""
    ways = [[name]]
    seen: set[str] = set()
    for way in ways:
        for other in sorted(_fed_by(card, way[-1])):
            if other == name:
                return [*way, name]
            if other not in seen:
                seen.add(other)
                ways.append([*way, other])
    return None


def _fed_by(card: Card, name: str) -> set[str]:
    """Return the networks that feed a network."""
    taken = {part for _, parts in input_parts(card.networks[name].inputs) for part in parts}
    return {
        other for other, network in card.networks.items() if taken & set(network.given_as(other))
    }


@dataclass(frozen=True, kw_only=True)
class InputSpec:
    """One input of a checkpoint as its file declares it; None in `shape` is a free axis."""

    name: str
    shape: tuple[int | None, ...]
    dtype: np.dtype[Any]
    is_list: bool = False
    """Whether it is a list of arrays, one of each observation; not one array of all."""


def resolve_inputs(
    card: Card, specs: Sequence[InputSpec]
) -> tuple[tuple[InputSpec, tuple[str, ...]], ...]:
    """Return the inputs of a checkpoint with the observations they are made of, in its order.

    Raises:
        PolicyError: as `InputAssembler`.
    """
    parts = card.input_parts()
    if not specs:
        # The order of the card is the order of the arguments, with a batch axis of unknown length.
        listed = listed_inputs(card.inputs)
        return tuple(
            (_undeclared(name or f"input {i}", is_list=name in listed), names)
            for i, (name, names) in enumerate(parts)
        )
    known = {spec.name: spec for spec in specs}
    if len(parts) == 1 and parts[0][0] is None:
        if len(specs) > 1:
            raise PolicyError(
                f"the checkpoint has {plural(len(specs), 'input')}: {', '.join(known)}",
                fix="say on the card which observations make each: `inputs: {name: [...]}`",
            )
        return ((specs[0], parts[0][1]),)
    named = {name: names for name, names in parts if name is not None}
    for name in named:
        if name not in known:
            raise PolicyError(f"the checkpoint has no input {name!r}", fix=nearest(name, known))
    absent = [name for name in known if name not in named]
    if absent:
        raise PolicyError(
            f"the card feeds no observation to the input {', '.join(absent)}",
            fix="add it to `inputs` on the card",
        )
    return tuple((spec, named[spec.name]) for spec in specs)


def _undeclared(name: str, *, is_list: bool) -> InputSpec:
    return InputSpec(name=name, shape=(), dtype=np.dtype(np.float32), is_list=is_list)


def shape_problems(
    card: Card, specs: Sequence[InputSpec], shapes: Mapping[str, tuple[int, ...]]
) -> list[str]:
    """Compare observations with the inputs that a checkpoint declares.

    Args:
        card: the policy's card.
        specs: inputs of the checkpoint; empty compares nothing.
        shapes: shape of each observation on the card.

    Returns:
        One sentence for each input that does not fit, in the card's own terms.
    """
    problems: list[str] = []
    for spec, names in resolve_inputs(card, specs):
        if spec.is_list:
            continue
        joined = _joined_shape([shapes[name] for name in names])
        if joined is None:
            image = next(name for name in names if len(shapes[name]) != 1)
            problems.append(f"`{image}` is an image and cannot be joined with other numbers")
            continue
        if not spec.shape:
            continue
        wanted = spec.shape
        if len(wanted) == len(joined) + 1:
            if wanted[0] not in {None, 1}:
                problems.append(f"input `{spec.name}` wants a batch of {wanted[0]}; export batch 1")
                continue
            wanted = wanted[1:]
        if len(wanted) != len(joined) or any(
            size not in {None, have} for size, have in zip(wanted, joined, strict=True)
        ):
            problems.append(_mismatch(spec, names, shapes, joined, wanted))
    return problems


def _joined_shape(shapes: Sequence[tuple[int, ...]]) -> tuple[int, ...] | None:
    """Return the shape of observations that make one input, or None if they cannot be joined."""
    if len(shapes) == 1:
        return shapes[0]
    sizes = [shape[0] for shape in shapes if len(shape) == 1]
    return (sum(sizes),) if len(sizes) == len(shapes) else None


def _mismatch(
    spec: InputSpec,
    names: Sequence[str],
    shapes: Mapping[str, tuple[int, ...]],
    joined: tuple[int, ...],
    wanted: tuple[int | None, ...],
) -> str:
    if len(joined) != 1 or len(wanted) != 1:
        return (
            f"`{names[0]}` has shape {joined}; the checkpoint's input `{spec.name}` wants {wanted}"
        )
    total = joined[0]
    if len(names) == 1:
        sums = f"`{names[0]}` is {plural(total, 'number')}"
    else:
        sums = " + ".join(f"`{name}` {sum(shapes[name])}" for name in names) + f" = {total} numbers"
    return f"{sums}; the checkpoint's input `{spec.name}` wants {wanted[0]}"


def sized(name: str, shape: tuple[int, ...]) -> str:
    """Return the name and the sides of an observation, in words."""
    return f"`{name}` {' x '.join(str(side) for side in shape)}"
