"""Policies of published training code, from their own state dicts: extreme-parkour, LucidSim, ACT.

Inputs on the card of extreme-parkour's expert, and of its depth student:
    proprio     53 numbers (layout parkour53)
    history     530 numbers: the ten frames before the present one, oldest first, each with the two
                heading numbers (6 and 7) zero
    scandots    132 numbers: makes it the expert
    depth       (45, 80) or (58, 87) in place of scandots: makes it the student

The student looks at a depth image every fifth control step and keeps what it saw between them.

Inputs on the card of LucidSim's transformer:
    proprio    53 numbers (layout parkour53), or 371: seven such frames, oldest first
    frames     (7, 3, 45, 80), the last seven images, oldest first, (byte - 127.5) / 255

With 53 numbers the network sees the present frame seven times. That is how the published
checkpoints are evaluated, and what they expect.

Inputs on the card of an ACT policy, whose chunks of actions are blended over time:
    proprio    a vector of the size that the network was trained with
    images     (channels, rows, columns), or a stack of such images: one for each camera or frame;
               none for a network without an image encoder

The layout of its state dict is that of `nw_eval.policies.networks.act`.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from nw_eval.cards.model import CardModel
from nw_eval.cards.networks import InputSpec
from nw_eval.errors import PolicyError, TrialError
from nw_eval.memory import Arrays, pack
from nw_eval.policies.bundle import Bundle, NoOptions, read_options
from nw_eval.policies.networks.act import Act
from nw_eval.policies.networks.parameters import build
from nw_eval.policies.networks.parkour import (
    FRAMES,
    HIDDEN,
    HISTORY,
    IMAGE,
    LATENT,
    PROPRIO,
    SCANDOTS,
    LucidSimTransformer,
    ParkourExpert,
    ParkourStudent,
)
from nw_eval.policies.policy import unpacked
from nw_eval.policies.torch_network import NetworkPolicy, checkpoint_tensors, input_spec

_BODY = (input_spec("proprio", PROPRIO), input_spec("history", HISTORY * PROPRIO))


class StudentOptions(CardModel):
    """How the depth student is run."""

    depth_every: int = Field(default=5, ge=1, le=50)
    """Control steps between two images that it looks at."""
    steer_by_depth: bool = True
    """Whether the heading that it sees in the images replaces the waypoint's."""


def open_extreme_parkour(bundle: Bundle, *, joints: int) -> NetworkPolicy:
    """Return the expert or the student, by the inputs that the card names.

    Raises:
        PolicyError: the checkpoint does not hold it, or the card names other inputs.
    """
    names = {name for name, _ in bundle.card.input_parts()}
    return (StudentPolicy if "depth" in names else ExpertPolicy)(bundle, joints=joints)


class ExpertPolicy(NetworkPolicy):
    """Scandots to actions."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        read_options(bundle, NoOptions)
        tensors = checkpoint_tensors(bundle)
        self._network = ParkourExpert.from_tensors(tensors, str(bundle.checkpoint))
        super().__init__(bundle, (*_BODY, input_spec("scandots", SCANDOTS)), joints=joints)

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Return the actor's output."""
        history = inputs["history"].view(1, HISTORY, PROPRIO)
        return self._network(inputs["proprio"], inputs["scandots"], history)


class StudentPolicy(NetworkPolicy):
    """Depth images to actions, with the hidden state of a GRU."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        self._options = read_options(bundle, StudentOptions)
        tensors = checkpoint_tensors(bundle)
        self._network = ParkourStudent.from_tensors(tensors, str(bundle.checkpoint))
        inputs = (*_BODY, input_spec("depth", *self._network.image))
        super().__init__(bundle, inputs, joints=joints)

    def forget(self) -> None:
        """Begin with a hidden state of zeros."""
        self._hidden = torch.zeros(1, 1, HIDDEN)
        self._seen = torch.zeros(1, LATENT + 2)
        self._step = 0

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Look if it is time to, then act on what was seen last."""
        if self._step % self._options.depth_every == 0:
            self._seen, self._hidden = self._network.see(
                inputs["depth"], inputs["proprio"], self._hidden
            )
        self._step += 1
        return self._network(
            inputs["proprio"],
            self._seen,
            inputs["history"].view(1, HISTORY, PROPRIO),
            steer_by_depth=self._options.steer_by_depth,
        )

    def state(self) -> bytes:
        """Return hidden state, what was seen last, and the count of steps."""
        return pack(
            {
                "hidden": self._hidden.numpy(),
                "seen": self._seen.numpy(),
                "step": np.array(self._step),
            }
        )

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._name) as arrays:
            self._hidden = torch.from_numpy(arrays["hidden"]).view(1, 1, HIDDEN)
            self._seen = torch.from_numpy(arrays["seen"]).view(1, LATENT + 2)
            self._step = int(arrays["step"])


class LucidSimPolicy(NetworkPolicy):
    """The transformer. Its heading head takes no part, so its weights may be missing."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        read_options(bundle, NoOptions)
        tensors = checkpoint_tensors(bundle)
        network = build(LucidSimTransformer, tensors, str(bundle.checkpoint), unused=("yaw",))
        self._session = network.open()
        inputs = (input_spec("proprio", None), input_spec("frames", FRAMES, *IMAGE))
        super().__init__(bundle, inputs, joints=joints)

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Return the action token's projection."""
        proprio = inputs["proprio"]
        numbers = proprio.shape[-1]
        if numbers not in {PROPRIO, FRAMES * PROPRIO}:
            raise TrialError(
                f"input `proprio` is {numbers} numbers; the transformer wants {PROPRIO}, or "
                f"{FRAMES} x {PROPRIO} = {FRAMES * PROPRIO}",
                fix="use `layout: parkour53` on the card",
            )
        vectors = proprio.view(-1, PROPRIO).expand(FRAMES, PROPRIO)
        feeds = {"proprio": vectors.numpy(), "frames": inputs["frames"][0].numpy()}
        return torch.from_numpy(self._session.run(None, feeds)[0])


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
