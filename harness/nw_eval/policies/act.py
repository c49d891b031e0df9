"""ACT policies from a state dict: chunks of actions from images, blended over time.

Inputs on the card:
    proprio    a vector of the size that the network was trained with
    images     (channels, rows, columns), or a stack of such images: one for each camera or frame;
               none for a network without an image encoder

The layout of the state dict is that of `nw_eval.policies.networks.act`.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.model import CardModel
from nw_eval.errors import PolicyError
from nw_eval.memory import Arrays, pack
from nw_eval.policies.bundle import Bundle, read_options
from nw_eval.policies.networks.act import Act
from nw_eval.policies.policy import unpacked
from nw_eval.policies.torch_network import NetworkPolicy, checkpoint_tensors, input_spec

Array = NDArray[np.float64]


class ActOptions(CardModel):
    """What is not in the weights of an ACT network."""

    heads: int = Field(default=8, ge=1, le=64)
    """Attention heads."""
    ensemble: float | None = Field(default=0.01, ge=-10.0, le=10.0)
    """m of temporal ensembling, weights exp(-m i) with the oldest prediction first, so that below 0
    the newest counts most; null = the newest chunk alone."""
    query_every: int = Field(default=1, ge=1)
    """Control steps between two forward passes."""


class ActPolicy(NetworkPolicy):
    """Predicts a chunk of actions every `query_every` steps, and blends those that overlap."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        self._options = read_options(bundle, ActOptions)
        where = str(bundle.checkpoint)
        self._network = Act.from_tensors(
            checkpoint_tensors(bundle), where, heads=self._options.heads
        )
        sizes = self._network.sizes
        if sizes.actions != joints:
            raise PolicyError(
                f"{where}: the network has {sizes.actions} actions, the robot "
                f"{bundle.card.robot!r} has {joints} joints",
                fix="name the right robot on the card",
            )
        if self._options.query_every > sizes.chunk:
            raise PolicyError(
                f"{bundle.where}: query_every is {self._options.query_every}, but a chunk has "
                f"only {sizes.chunk} actions",
                fix=f"use {sizes.chunk} or less",
            )
        self._queue = ChunkQueue(ensemble=self._options.ensemble)
        inputs: tuple[InputSpec, ...] = (input_spec("proprio", sizes.proprio),)
        if sizes.backbone:
            channels = next(shape[1] for shape in sizes.backbone.values() if len(shape) == 4)
            shape = (None, channels, None, None)
            inputs += (InputSpec(name="images", shape=shape, dtype=np.dtype(np.float32)),)
        super().__init__(bundle, inputs, joints=joints)

    def forget(self) -> None:
        """Begin without predictions."""
        self._queue.clear()
        self._step = 0

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Predict if it is time to, and return the blend for this step."""
        if self._step % self._options.query_every == 0:
            chunk = self._network(inputs["proprio"], inputs.get("images"))
            self._queue.add(chunk.numpy().astype(np.float64))
        self._step += 1
        return torch.from_numpy(self._queue.take())

    def state(self) -> bytes:
        """Return the predictions that reach beyond this step."""
        arrays: Arrays = {"step": np.array(self._step)}
        return pack(arrays | {f"chunk{i}": chunk for i, chunk in enumerate(self._queue.chunks)})

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._name) as arrays:
            self._step = int(arrays["step"])
            self._queue.chunks = [arrays[f"chunk{i}"] for i in range(len(arrays) - 1)]


class ChunkQueue:
    """Predictions of past forward passes that reach the present step.

    With temporal ensembling (arXiv 2304.13705, section IV-B) the action is the mean of all
    predictions for this step, the oldest with the weight 1 and each younger one with exp(-m) of
    the weight of the one before it. Without, the newest prediction counts alone.
    """

    def __init__(self, *, ensemble: float | None) -> None:
        """Make an empty queue.

        Args:
            ensemble: m of the weights, 0 for equal ones; None for no ensembling.
        """
        self._ensemble = ensemble
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
        predictions = np.stack([chunk[0] for chunk in self.chunks])
        self.chunks = [chunk[1:] for chunk in self.chunks if len(chunk) > 1]
        weights = np.exp(-(self._ensemble or 0.0) * np.arange(len(predictions)))
        return weights @ predictions / weights.sum()
