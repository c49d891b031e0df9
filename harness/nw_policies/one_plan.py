"""A policy and the networks that feed it as one plan: none of their numbers passes through Python.

All of them lie in one arena (`executor.joining`). Observations are written where they are taken.
What a network gives is copied to where others take it, and what a graph remembers to its inputs, by
rows of the plan. A step is one call of the interpreter for all networks that are due.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from nw_policies.executor import Program
from nw_policies.executor.joining import Link, joined
from nw_policies.executor.network import Network
from nw_policies.executor.program import Rows
from nw_policies.policy import Observation

if TYPE_CHECKING:
    from nw_policies.fed_policy import Feeder
    from nw_policies.onnx import OnnxNetwork

Array = NDArray[Any]


class _Place(NamedTuple):
    """Where an observation, or what a network gives, is an input or a part of one."""

    taker: int
    """Number of the network."""
    input: str
    first: int
    """Of the input's floats."""
    name: str
    """Of the observation, or that under which the network gives it."""


class _Part(NamedTuple):
    """An observation that a network takes."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    target: Array
    """Floats of the arena, of this shape."""


class OnePlan:
    """Networks in one arena.

    Args:
        feeders: each behind those that feed it.
        own: the policy itself.
        shown: observations of the shapes and types that there will be.

    Raises:
        ValueError: they cannot be one plan: they run one by one.
    """

    def __init__(self, feeders: Sequence[Feeder], own: OnnxNetwork, shown: Observation) -> None:
        self._feeders, self._own = feeders, len(feeders)
        networks = [*(cast("OnnxNetwork", feeder.network) for feeder in feeders), own]
        givers = {
            name: (number, output)
            for number, feeder in enumerate(feeders)
            for name, (output, _) in zip(feeder.outputs, networks[number].wanted, strict=True)
        }
        programs = tuple(_program(network) for network in networks)
        places = [
            each for n in range(len(networks)) for each in _places(networks, n, givers, shown)
        ]
        links = [Link(*givers[one.name], *one[:3]) for one in places if one.name in givers]
        self._takers = [{link.taker for link in links if link.giver == n} for n in range(self._own)]
        self._stale: set[int] = set()
        """Networks whose feeders ran since they did."""
        for number, network in enumerate(networks):
            links += [Link(number, out, number, into) for into, out in network.fed.items()]
        program, self._steps = joined(programs, tuple(links))
        self._network = Network(program)
        self._rows: dict[tuple[int, ...], Rows] = {}
        inputs, outputs = self._network.inputs, self._network.outputs
        self._parts: list[list[_Part]] = [[] for _ in networks]
        self._carried: list[tuple[str, Array]] = []
        for taker, into, first, name in places:
            flat = inputs[f"{taker} {into}"].reshape(-1)[first:]
            if name in givers:
                self._carried.append((name, flat))
                continue
            array = shown[name]
            target = flat[: array.size].reshape(array.shape)
            self._parts[taker].append(_Part(name, array.shape, array.dtype, target))
        self._taken: list[list[bytes] | None] = [None] * len(feeders)
        self._given = [
            {
                name: outputs[f"{n} {output}"]
                for name, (giver, output) in givers.items()
                if giver == n
            }
            for n in range(len(feeders))
        ]
        self._action = outputs[f"{self._own} {own.wanted[0][0]}"]
        for n, network in enumerate(networks):
            network.remember_in({name: inputs[f"{n} {name}"] for name in network.fed})

    def run(self, observation: Observation, actions: int) -> Array | None:
        """Run the networks that are due, and the policy.

        A network without memory whose inputs are the same bytes as before gave what it would give.

        Args:
            observation: by name.
            actions: how many there were in the trial.

        Returns:
            The action, which the next call overwrites; None, and nothing has run, where an
            observation has another shape or type than before.
        """
        due: dict[int, list[bytes] | None] = {}
        for number, parts in enumerate(self._parts):
            arrays = [observation[part.name] for part in parts]
            for part, array in zip(parts, arrays, strict=True):
                if array.shape != part.shape or array.dtype != part.dtype:
                    return None
            taken: list[bytes] | None = None
            if number != self._own:
                feeder = self._feeders[number]
                if actions % feeder.every:
                    continue
                if feeder.is_function:
                    # Not whether it is the same array: a sensor may write into it.
                    taken = [array.tobytes() for array in arrays]
                    if taken == self._taken[number] and number not in self._stale:
                        continue
                self._stale |= self._takers[number]
            for part, array in zip(parts, arrays, strict=True):
                part.target[...] = array
            due[number] = taken
        self._run(tuple(due))
        del due[self._own]
        for number, taken in due.items():
            self._feeders[number].check(self._given[number])
            self._taken[number] = taken
            self._stale.discard(number)
        return self._action

    def _run(self, which: tuple[int, ...]) -> None:
        rows = self._rows.get(which)
        if rows is None:
            rows = self._rows[which] = np.concatenate([self._steps[n] for n in which])
        self._network.run(rows)

    def given(self) -> dict[str, Array]:
        """Return what the networks gave last, by name, with their batch axes."""
        return {name: array for outputs in self._given for name, array in outputs.items()}

    def restore(self, held: Mapping[str, Array]) -> None:
        """Go back to what the networks gave last."""
        self._taken = [None] * len(self._feeders)
        for name, array in self.given().items():
            array.reshape(-1)[:] = held[name].reshape(-1)
        for name, target in self._carried:
            target[: held[name].size] = held[name].reshape(-1)


def _program(network: OnnxNetwork) -> Program:
    program = network.program
    assert program is not None, "onnxruntime runs none of them"
    for into, out in network.fed.items():
        before, after = program.inputs[into], program.outputs[out]
        if (before.shape, before.dtype) != (after.shape, after.dtype):
            raise ValueError(f"{out!r} is not a next value of {into!r}")
    return program


def _places(
    networks: Sequence[OnnxNetwork],
    number: int,
    givers: Mapping[str, tuple[int, str]],
    shown: Observation,
) -> list[_Place]:
    """Return where all inputs of a network come from.

    Raises:
        ValueError: an input has another size, or a type that Python must convert to.
    """
    places: list[_Place] = []
    for spec, names in networks[number].parts:
        first = 0
        for name in names:
            places.append(_Place(number, spec.name, first, name))
            if name in givers:
                giver, output = givers[name]
                size, dtype = _program(networks[giver]).outputs[output].size, np.dtype(np.float32)
            else:
                size, dtype = shown[name].size, shown[name].dtype
            if spec.dtype not in {np.dtype(np.float32), dtype}:
                raise ValueError(f"{name!r} becomes {spec.dtype}")
            first += size
        if first != _program(networks[number]).inputs[spec.name].size:
            raise ValueError(f"{first} numbers for {spec.name!r}")
    return places
