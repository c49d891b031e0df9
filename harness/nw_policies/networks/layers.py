"""Which layers a chain of linear and recurrent layers has, by the names and shapes of its tensors.

A training saves weights by name. torch calls those of a linear layer `weight` and `bias`, flax
`kernel` and `bias`; the layers of an `nn.Sequential` are numbered, and an activation between two
of them takes a number and has no tensor. So a gap in the numbers is an activation.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, TypeVar

from nw_base.errors import PolicyError, nearest

Shape = tuple[int, ...]
LayerKind = Literal["linear", "norm", "lstm", "gru", "rnn"]
_GATES: dict[int, LayerKind] = {4: "lstm", 3: "gru", 1: "rnn"}
"""Rows of a recurrent layer's weights for each of its units."""
_RECURRENT = re.compile(r"(weight|bias)_(ih|hh)_l(\d+)")
_LAYER = {("weight",), ("kernel",), ("weight", "bias"), ("kernel", "bias")}
_WRAPPERS = re.compile(
    r"(?<![^.])(?:_orig_mod|_fsdp_wrapped_module|_checkpoint_wrapped_module|_forward_module"
    r"|module(?=\.[A-Za-z_]))\."
)
"""What torch.compile, DistributedDataParallel and their like put into the names of tensors."""
_Item = TypeVar("_Item")


def unwrapped(items: Mapping[str, _Item]) -> dict[str, _Item]:
    """Return items by names without those of wrappers; as they are if two were called the same."""
    plain = {_WRAPPERS.sub("", name): item for name, item in items.items()}
    return plain if len(plain) == len(items) else dict(items)


@dataclass(frozen=True, kw_only=True)
class Layer:
    """One layer of a chain."""

    kind: LayerKind
    name: str
    """What the names of its tensors begin with."""
    inputs: int
    outputs: int
    depth: int = 1
    """Recurrent layers on top of each other."""
    transposed: bool = False
    """Whether its weights are (inputs, outputs), as flax saves them."""
    activated: bool = False
    """Whether an activation follows."""


def chain(shapes: Mapping[str, Shape], weights: Sequence[str], where: str) -> tuple[Layer, ...]:
    """Return the layers below names, in the order in which they run.

    Args:
        shapes: of all tensors of a file, by name.
        weights: what the names of the tensors of each part begin with: of one layer, of layers that
            are numbered, or of a recurrent layer. An activation follows each linear layer but the
            last of all; inside of numbered layers it follows where a number is left out.
        where: path of the file, for errors.

    Raises:
        PolicyError: there is no such part, or it has tensors of other layers; two layers do not fit
            together.
    """
    layers: list[Layer] = []
    for part in weights:
        prefix = f"{part}." if part else ""
        below = {
            name.removeprefix(prefix): shape
            for name, shape in shapes.items()
            if name.startswith(prefix)
        }
        if not below:
            known = sorted({name.rpartition(".")[0] for name in shapes})
            raise PolicyError(
                f"{where}: no tensor's name begins with {part!r}",
                fix=f"correct `weights`; {nearest(part, known)}",
            )
        layers += _part(part, below, where)
    last = max((n for n, layer in enumerate(layers) if layer.kind == "linear"), default=-1)
    if last != len(layers) - 1:
        raise PolicyError(
            f"{where}: the last layer, {layers[-1].name!r}, is not linear",
            fix="name the layer that gives the action as the last of `weights`",
        )
    layers[-1] = replace(layers[-1], activated=False)
    for one, other in pairwise(layers):
        if one.outputs != other.inputs:
            raise PolicyError(
                f"{where}: {one.name!r} gives {one.outputs} numbers, {other.name!r} takes "
                f"{other.inputs}",
                fix="name the parts in `weights` in the order in which they run",
            )
    return tuple(layers)


def _part(part: str, below: Mapping[str, Shape], where: str) -> list[Layer]:
    if any(_RECURRENT.fullmatch(name) for name in below):
        return [_recurrent(part, below, where)]
    if tuple(name for name in ("weight", "kernel", "bias") if name in below) in _LAYER:
        if set(below) <= {"weight", "kernel", "bias"}:
            layer = _layer(part, below, where)
            return [replace(layer, activated=layer.kind == "linear")]
        raise _unknown(where, part, sorted(set(below) - {"weight", "kernel", "bias"}))
    children: dict[str, dict[str, Shape]] = {}
    for name, shape in below.items():
        child, _, leaf = name.partition(".")
        children.setdefault(child, {})[leaf] = shape
    prefix = f"{part}." if part else ""
    names = sorted(children, key=_place)
    layers = [_layer(f"{prefix}{name}", children[name], where) for name in names]
    if all(name.isdecimal() for name in names):
        gaps = [int(after) - int(name) > 1 for name, after in pairwise(names)]
        if gaps and not any(gaps) and all(layer.kind == "linear" for layer in layers):
            gaps = [True] * len(gaps)  # An `nn.ModuleList` holds no activations.
        # What stands behind the last number has no tensor: an activation, if none stood before
        # the normalisation that ends the part.
        gaps.append(layers[-1].kind == "linear" or not any(gaps[-1:]))
    else:
        gaps = [layer.kind == "linear" for layer in layers]
    return [replace(layer, activated=gap) for layer, gap in zip(layers, gaps, strict=True)]


def _place(name: str) -> tuple[str, int]:
    """Return what layers are sorted by: hidden_10 comes behind hidden_9."""
    number = re.search(r"\d+$", name)
    return (name, 0) if number is None else (name[: number.start()], int(number[0]))


def _layer(name: str, tensors: Mapping[str, Shape], where: str) -> Layer:
    transposed = "kernel" in tensors
    shape = tensors.get("kernel" if transposed else "weight", ())
    kinds = tuple(key for key in ("weight", "kernel", "bias") if key in tensors)
    is_rms = len(shape) == 1 and "bias" not in tensors  # Or a layer normalisation without one.
    if kinds not in _LAYER or len(tensors) != len(kinds) or len(shape) not in {1, 2} or is_rms:
        raise _unknown(where, name, sorted(tensors))
    if len(shape) == 1:
        return Layer(kind="norm", name=name, inputs=shape[0], outputs=shape[0])
    inputs, outputs = shape if transposed else shape[::-1]
    if tensors.get("bias", (outputs,)) != (outputs,):
        raise _unknown(where, name, ["bias"])
    return Layer(kind="linear", name=name, inputs=inputs, outputs=outputs, transposed=transposed)


def _recurrent(name: str, tensors: Mapping[str, Shape], where: str) -> Layer:
    other = sorted(key for key in tensors if not _RECURRENT.fullmatch(key))
    first, hidden = tensors.get("weight_ih_l0", ()), tensors.get("weight_hh_l0", ())
    if other or len(first) != 2 or len(hidden) != 2 or not hidden[1]:
        raise _unknown(where, name, other or sorted(tensors))
    gates, rest = divmod(hidden[0], hidden[1])
    depth = sum(1 for key in tensors if key.startswith("weight_hh_l"))
    if gates not in _GATES or rest or len(tensors) not in {2 * depth, 4 * depth}:
        raise _unknown(where, name, sorted(tensors))
    return Layer(kind=_GATES[gates], name=name, inputs=first[1], outputs=hidden[1], depth=depth)


def _unknown(where: str, name: str, tensors: Sequence[str]) -> PolicyError:
    shown = ", ".join(tensors[:4]) + ", ..." * (len(tensors) > 4)
    return PolicyError(
        f"{where}: {name!r} is not a linear, layer-norm, LSTM or GRU layer: it has {shown}",
        fix="name the parts of the policy's chain in `weights`, or export it as ONNX",
    )
