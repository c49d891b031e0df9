"""Files of weights as a card names them, and which observations make which of their inputs.

There are the checkpoint and the networks that feed it: estimators, adaptation modules, encoders.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, TypeGuard, get_args

from pydantic import AfterValidator, Field, field_validator

from nw_base.errors import nearest
from nw_base.files.inside import OutsideError, checked
from nw_policies.cards.model import CardModel, Line, Rate
from nw_policies.cards.observations import Select

NetworkAdapter = Literal["onnx", "torchscript", "torch-export"]
"""What runs a file that may also be a network which feeds another."""
BuiltInAdapter = Literal[
    NetworkAdapter, "mlp", "lucidsim", "extreme-parkour", "act", "remote", "zero"
]
"""The table of adapters; `nw_policies.opening` has the function that opens each."""

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


PlainFile = Annotated[str, AfterValidator(_plain_file)]


def _sha256(digest: str) -> str:
    if not re.fullmatch(r"[0-9a-fA-F]{64}", digest):
        message = f"{digest[:20]!r} is not a SHA-256, which has 64 hex digits, not {len(digest)}"
        raise ValueError(f"{message}; `sha256sum FILE` prints it")
    return digest.lower()


Sha256 = Annotated[str, AfterValidator(_sha256)]


class Checkpoint(CardModel):
    """The file of weights, and the digest that it must have."""

    file: PlainFile
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
    """An output of a TorchScript file that becomes one of its inputs at the next step."""

    output: Annotated[int, Field(ge=0)]
    """Its position, from 0, among all that `forward` returns."""
    shape: Annotated[list[Annotated[int, Field(ge=1, le=100_000)]], Field(max_length=5)]
    """Shape of the zeros that a trial begins with: these files do not declare it."""


Recurrent = dict[str, str | Feedback]
"""By input of a file, the output of the last step that feeds it."""


def recurrent_fault(adapter: str, recurrent: Recurrent | None) -> tuple[str, str] | None:
    """Return the error in `recurrent` of a file that an adapter runs, and the fix."""
    if not recurrent or (adapter == "onnx" and all(isinstance(o, str) for o in recurrent.values())):
        return None
    if adapter == "onnx":
        return "an ONNX graph has names for its outputs", "write `recurrent: {input: output}`"
    if adapter != "torchscript":
        text = f"`recurrent` is for adapters onnx and torchscript; `{adapter}` keeps its state"
        return f"{text} itself", "remove it"
    name = next((name for name, one in recurrent.items() if isinstance(one, str)), None)
    if name is None:
        return None
    text = "the outputs of a TorchScript file have no names, and its inputs no sizes"
    return text, f"write `recurrent: {{{name}: {{output: 1, shape: [1, 12]}}}}`"


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
    """Return input names with their observations; no name where the file has one input."""
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
