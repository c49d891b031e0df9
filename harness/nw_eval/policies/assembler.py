"""From observations to the arrays that a checkpoint takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.card import Card
from nw_eval.cards.inputs import InputSpec, resolve_inputs
from nw_eval.policies.policy import Observation


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
