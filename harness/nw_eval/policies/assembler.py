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
        """Return an array for each input of the checkpoint, with a batch axis of 1.

        Each has memory of its own, which no other input, step or log shares: networks normalise
        their inputs in place (`obs.clamp_(...)`), and a sensor shows one sample at several steps.
        """
        feeds: dict[str, NDArray[Any]] = {}
        for spec, names in self._parts:
            if len(names) == 1:
                joined = np.array(observation[names[0]], dtype=spec.dtype, order="C")
            else:
                joined = np.concatenate([observation[name] for name in names], dtype=spec.dtype)
            if len(spec.shape) != joined.ndim:
                joined = joined[np.newaxis]
            feeds[spec.name] = np.ascontiguousarray(joined)
        return feeds
