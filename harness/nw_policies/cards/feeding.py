"""What the networks of a card are fed with: their order, and the sizes of their inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from nw_base.errors import PolicyError, nearest
from nw_base.plural import plural
from nw_policies.cards.networks import input_parts, listed_inputs

if TYPE_CHECKING:
    from nw_policies.cards.card import Card


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
    """Return the way from a network over those that feed it to itself; None if it has none."""
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
