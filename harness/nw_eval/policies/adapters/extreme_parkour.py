"""Policies of extreme-parkour from their published checkpoints: the expert, and its depth student.

Inputs on the card:
    proprio     53 numbers (layout parkour53)
    history     530 numbers: the ten frames before the present one, oldest first, each with the two
                heading numbers (6 and 7) zero
    scandots    132 numbers: makes it the expert
    depth       (45, 80) or (58, 87) in place of scandots: makes it the student

The student looks at a depth image every fifth control step and keeps what it saw between them.
"""

from __future__ import annotations

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from nw_eval.arrays import pack
from nw_eval.cards.model import CardModel
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.memory import unpacked
from nw_eval.policies.networks.parkour_expert import (
    HISTORY,
    LATENT,
    PROPRIO,
    SCANDOTS,
    ParkourExpert,
)
from nw_eval.policies.networks.parkour_student import HIDDEN, ParkourStudent
from nw_eval.policies.networks.policy import NetworkPolicy, checkpoint_tensors, input_spec
from nw_eval.policies.options import NoOptions, read_options

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

    def infer(self, given: dict[str, Tensor]) -> Tensor:
        """Return the actor's output."""
        history = given["history"].view(1, HISTORY, PROPRIO)
        return self._network(given["proprio"], given["scandots"], history)


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

    def infer(self, given: dict[str, Tensor]) -> Tensor:
        """Look if it is time to, then act on what was seen last."""
        if self._step % self._options.depth_every == 0:
            self._seen, self._hidden = self._network.see(
                given["depth"], given["proprio"], self._hidden
            )
        self._step += 1
        return self._network(
            given["proprio"],
            self._seen,
            given["history"].view(1, HISTORY, PROPRIO),
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
