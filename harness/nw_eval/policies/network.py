"""What a file of weights is when it runs: numbers in, numbers out, and a memory between.

Its inputs are put together from observations by an `InputAssembler`; a policy that is one network
has the action as one of its outputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.card import Card
from nw_eval.cards.inputs import InputSpec, resolve_inputs
from nw_eval.cards.joint_control import Action
from nw_eval.errors import PolicyError, nearest
from nw_eval.memory import Memory
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.policy import Observation, checked_action

Wanted = Sequence[str | int | None]
"""Outputs of a file, by name or by index among those that feed no state; None = the first one."""


class OpenNetwork(Memory[bytes], Protocol):
    """A file of weights in one trial, on one thread, with batch 1 and without randomness."""

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the file declares to take; empty where its format does not say."""
        ...

    def reset(self, seed: int) -> None:
        """Begin a trial with the memory that the file holds."""
        ...

    def run(self, observation: Observation) -> tuple[NDArray[Any], ...]:
        """Return the outputs that it was opened for; they may change with the next call.

        Args:
            observation: by the names that the card's `inputs` have, without a batch axis.

        Raises:
            TrialError: it failed.
        """
        ...

    def close(self) -> None:
        """Free what it holds. Closing twice is allowed."""
        ...


def place_of(wanted: str | int | None, names: Sequence[str], bundle: Bundle) -> int:
    """Return which of the outputs of a file is meant.

    Raises:
        PolicyError: there is no such output.
    """
    if isinstance(wanted, str) and wanted in names:
        return names.index(wanted)
    place = 0 if wanted is None else wanted
    if isinstance(place, int) and place < len(names):
        return place
    raise PolicyError(
        f"{bundle.where}: the checkpoint has no output {wanted!r}", fix=nearest(str(wanted), names)
    )


class ActingNetwork:
    """A network that was opened for one output, whose numbers are checked as an action."""

    def __init__(self, network: OpenNetwork, *, joints: int, policy: str) -> None:
        self._network = network
        self._joints = joints
        self._policy = policy

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take; empty where its format does not say."""
        return self._network.inputs

    @property
    def remembers(self) -> bool:
        """Whether the network has a memory, or may have one."""
        return getattr(self._network, "remembers", True)

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._network.reset(seed)

    def act(self, observation: Observation) -> Action:
        """Run the network once.

        Raises:
            ActionError: the output is no action.
            TrialError: the network failed.
        """
        (raw,) = self._network.run(observation)
        return checked_action(raw, joints=self._joints, policy=self._policy)

    def state(self) -> bytes:
        """Return the network's memory."""
        return self._network.state()

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        self._network.restore(state)

    def close(self) -> None:
        """Free the network."""
        self._network.close()


class InputAssembler:
    """Joins, casts and batches observations. Made once for a policy, called at every step."""

    def __init__(self, card: Card, specs: Sequence[InputSpec]) -> None:
        """Resolve the card's inputs against those of a checkpoint.

        Args:
            card: names inputs and the observations that they are made of.
            specs: inputs of the checkpoint in its order; empty if its format does not say.

        Raises:
            PolicyError: the card and the checkpoint name other inputs.
        """
        self._parts = resolve_inputs(card, specs)

    def __call__(self, observation: Observation) -> dict[str, NDArray[Any]]:
        """Return the inputs of a checkpoint that declares them, by name, with a batch axis of 1.

        Each has memory of its own, which no other input, step or log shares: networks normalise
        their inputs in place (`obs.clamp_(...)`), and a sensor shows one sample at several steps.
        """
        return {spec.name: _joined(spec, names, observation) for spec, names in self._parts}

    def in_order(self, observation: Observation) -> list[NDArray[Any] | list[NDArray[Any]]]:
        """Return the same for one that declares none, in the card's order, and lists as lists."""
        return [
            [_joined(spec, (name,), observation) for name in names]
            if spec.is_list
            else _joined(spec, names, observation)
            for spec, names in self._parts
        ]


def _joined(spec: InputSpec, names: Sequence[str], observation: Observation) -> NDArray[Any]:
    if len(names) == 1:
        joined = np.array(observation[names[0]], dtype=spec.dtype, order="C")
    else:
        joined = np.concatenate([observation[name] for name in names], dtype=spec.dtype)
    if len(spec.shape) != joined.ndim:
        joined = joined[np.newaxis]
    return np.ascontiguousarray(joined)
