"""Policies that predict chunks of future actions, and blend those that overlap (ACT)."""

from __future__ import annotations

from decimal import Decimal
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nw_base.errors import TrialError
from nw_base.memory import Arrays, pack
from nw_policies.cards.feeding import InputSpec
from nw_policies.cards.joint_control import Action
from nw_policies.cards.model import CardModel
from nw_policies.policy import Observation, OpenNetwork, checked_action, unpacked

Array = NDArray[np.float64]


class ActOptions(CardModel):
    """Settings of an ACT network that its weights do not contain."""

    heads: int = Field(default=8, ge=1, le=64)
    """Attention heads."""
    ensemble: float | None = Field(default=0.01, ge=-10.0, le=10.0)
    """m of temporal ensembling, weights exp(-m i) with the oldest prediction first, so that below 0
    the newest counts most; null = the newest chunk alone."""
    query_every: int = Field(default=1, ge=1)
    """Control steps between two forward passes."""


class ChunkPolicy:
    """Asks a network for a chunk every `query_every` steps, and blends those that overlap.

    Args:
        network: one output, (chunk, actions), whose first row is for the present step.
        options: of the card.
        joints: how many numbers an action has.
        policy: name of the policy, for errors.
        is_exact: as for `ChunkQueue`.
    """

    def __init__(
        self, network: OpenNetwork, options: ActOptions, *, joints: int, policy: str, is_exact: bool
    ) -> None:
        self.network = network
        self._every = options.query_every
        self._queue = ChunkQueue(ensemble=options.ensemble, is_exact=is_exact)
        self._joints, self._policy = joints, policy
        self._step = 0

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the network takes."""
        return self.network.inputs

    def reset(self, seed: int) -> None:
        """Begin a trial without predictions."""
        self.network.reset(seed)
        self._queue.clear()
        self._step = 0

    def act(self, observation: Observation) -> Action:
        """Predict if it is time to, and return the blend for this step.

        Raises:
            ActionError: it is no action.
            TrialError: the network failed.
        """
        if self._step % self._every == 0:
            (chunk,) = self.network.run(observation)
            if chunk.ndim != 2 or not chunk.size:
                raise TrialError(f"policy {self._policy!r} gave a chunk of shape {chunk.shape}")
            self._queue.add(chunk.astype(np.float64))
        self._step += 1
        return checked_action(self._queue.take(), joints=self._joints, policy=self._policy)

    def state(self) -> bytes:
        """Return the predictions that reach beyond this step."""
        arrays: Arrays = {"step": np.array(self._step)}
        return pack(arrays | {f"chunk{i}": chunk for i, chunk in enumerate(self._queue.chunks)})

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._policy) as arrays:
            self._step = int(arrays["step"])
            self._queue.chunks = [arrays[f"chunk{i}"] for i in range(len(arrays) - 1)]

    def close(self) -> None:
        """Free the network."""
        self.network.close()


class ChunkQueue:
    """Predictions of past forward passes that reach the present step.

    With temporal ensembling (arXiv 2304.13705, section IV-B) the action is the mean of all
    predictions for this step, the oldest with the weight 1 and each younger one with exp(-m) of
    the weight of the one before it. Without, the newest prediction counts alone.
    """

    def __init__(self, *, ensemble: float | None, is_exact: bool = False) -> None:
        """Make an empty queue.

        Args:
            ensemble: m of the weights, 0 for equal ones; None for no ensembling.
            is_exact: whether the mean has the same bits on every processor: weights by decimal
                arithmetic, and one sum after another, in place of NumPy's exp and product.
        """
        self._ensemble = ensemble
        self._is_exact = is_exact
        # Rows that are left of each chunk, oldest chunk first, the present step's row first.
        self.chunks: list[Array] = []

    def clear(self) -> None:
        """Forget all predictions."""
        self.chunks = []

    def add(self, chunk: Array) -> None:
        """Add a forward pass, (chunk, actions); its first row is for the present step."""
        if self._ensemble is None:
            self.chunks = []
        self.chunks.append(chunk)

    def take(self) -> Array:
        """Return the action of the present step, (actions,), and go on to the next."""
        predictions = [chunk[0] for chunk in self.chunks]
        self.chunks = [chunk[1:] for chunk in self.chunks if len(chunk) > 1]
        m = self._ensemble or 0.0
        if not self._is_exact:
            weights = np.exp(-m * np.arange(len(predictions)))
            return weights @ np.stack(predictions) / weights.sum()
        total, whole = np.zeros_like(predictions[0]), 0.0
        for i, prediction in enumerate(predictions):
            weight = _exact_exp(-m * i)
            total, whole = total + weight * prediction, whole + weight
        return total / whole


@lru_cache(maxsize=4096)
def _exact_exp(x: float) -> float:
    """Return exp(x) to the last digit: libraries choose their own by the processor."""
    return float(Decimal(x).exp())
