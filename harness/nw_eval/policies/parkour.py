"""Policies of extreme-parkour from their published checkpoints: the expert, and its depth student.

Inputs on the card:
    proprio     53 numbers (layout parkour53)
    history     530 numbers: the ten frames before the present one, oldest first, each with the two
                heading numbers (6 and 7) zero
    scandots    132 numbers: makes it the expert
    depth       (45, 80) or (58, 87) in place of scandots: makes it the student

The student looks at a depth image every fifth control step and keeps what it saw between them.

LucidSim's transformer from its published state dict.

Inputs on its card:
    proprio    53 numbers (layout parkour53), or 371: seven such frames, oldest first
    frames     (7, 3, 45, 80), the last seven images, oldest first, (byte - 127.5) / 255

With 53 numbers the network sees the present frame seven times. That is how the published
checkpoints are evaluated, and what they expect.
"""

from __future__ import annotations

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from nw_eval.cards.model import CardModel
from nw_eval.errors import TrialError
from nw_eval.memory import pack
from nw_eval.policies.bundle import Bundle, NoOptions, read_options
from nw_eval.policies.networks.lucidsim import FRAMES, IMAGE, LucidSimTransformer
from nw_eval.policies.networks.lucidsim import PROPRIO as FRAME_NUMBERS
from nw_eval.policies.networks.parameters import build
from nw_eval.policies.networks.parkour import (
    HIDDEN,
    HISTORY,
    LATENT,
    PROPRIO,
    SCANDOTS,
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
        if numbers not in {FRAME_NUMBERS, FRAMES * FRAME_NUMBERS}:
            raise TrialError(
                f"input `proprio` is {numbers} numbers; the transformer wants {FRAME_NUMBERS}, or "
                f"{FRAMES} x {FRAME_NUMBERS} = {FRAMES * FRAME_NUMBERS}",
                fix="use `layout: parkour53` on the card",
            )
        vectors = proprio.view(-1, FRAME_NUMBERS).expand(FRAMES, FRAME_NUMBERS)
        feeds = {"proprio": vectors.numpy(), "frames": inputs["frames"][0].numpy()}
        return torch.from_numpy(self._session.run(None, feeds)[0])
