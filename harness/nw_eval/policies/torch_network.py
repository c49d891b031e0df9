"""What networks that torch runs here have in common, and the policies around our own of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.errors import PolicyError, TrialError
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.network import InputAssembler
from nw_eval.policies.policy import Observation, checked_action, unfitting
from nw_eval.policies.safety import read_tensors


class TorchNetwork:
    """A network that runs here, on one thread. Subclasses say how.

    `outputs` computes what it gives from the inputs; `forget`, `state` and `restore` are for those
    whose next outputs depend on more than the next inputs.
    """

    def __init__(self, bundle: Bundle, inputs: tuple[InputSpec, ...]) -> None:
        """Resolve the card's inputs against those of the network.

        Raises:
            PolicyError: the card names other inputs.
        """
        # More threads change the order of sums, and with it the last bits of an action.
        torch.set_num_threads(1)
        self.inputs = inputs
        self._name = bundle.name
        self._subject = bundle.subject
        self._open = True
        try:
            self._assemble = InputAssembler(bundle.card, inputs)
        except PolicyError as error:
            raise PolicyError(f"{bundle.where}: {error}") from None
        self.forget()

    def outputs(self, inputs: dict[str, Tensor]) -> Sequence[Tensor]:
        """Return what it gives for inputs by name, each with a leading axis of 1."""
        raise NotImplementedError

    def forget(self) -> None:
        """Begin without memory."""

    def state(self) -> bytes:
        """Return what the next outputs depend on beside the inputs."""
        return b""

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        if state:
            raise unfitting(self._name, f"{len(state)} bytes, and it remembers nothing")

    def reset(self, seed: int) -> None:  # noqa: ARG002 - nothing here is random.
        """Begin a trial."""
        self.forget()

    def run(self, observation: Observation) -> tuple[NDArray[Any], ...]:
        """Run the network once.

        Raises:
            TrialError: it failed.
        """
        if not self._open:
            raise TrialError(f"{self._subject} is closed", fix="open it again")
        inputs = {name: torch.from_numpy(x) for name, x in self._assemble(observation).items()}
        try:
            with torch.inference_mode():
                outputs = self.outputs(inputs)
        except RuntimeError as error:
            reason = " ".join(str(error).split())[:200]
            raise TrialError(f"{self._subject} failed: {reason}") from error
        return tuple(output.numpy() for output in outputs)

    def close(self) -> None:
        """End; a later `run` is an error."""
        self._open = False


class NetworkPolicy(TorchNetwork):
    """A policy around such a network. Subclasses compute an action from the inputs: `infer`."""

    def __init__(self, bundle: Bundle, inputs: tuple[InputSpec, ...], *, joints: int) -> None:
        super().__init__(bundle, inputs)
        self._joints = joints

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Return the raw action for inputs by name, each with a leading axis of 1."""
        raise NotImplementedError

    def outputs(self, inputs: dict[str, Tensor]) -> Sequence[Tensor]:
        """Return the raw action alone."""
        return (self.infer(inputs),)

    def act(self, observation: Observation) -> Action:
        """Run the network once.

        Raises:
            TrialError: it failed, or the action is not finite.
        """
        (raw,) = self.run(observation)
        return checked_action(raw, joints=self._joints, policy=self._name)


def input_spec(name: str, *shape: int | None) -> InputSpec:
    """Return the spec of a float32 input; a leading batch axis of 1 is added."""
    return InputSpec(name=name, shape=(1, *shape), dtype=np.dtype(np.float32))


def checkpoint_tensors(bundle: Bundle) -> dict[str, Tensor]:
    """Read the state dict that a card names.

    Raises:
        PolicyError: it cannot be read, or could run code.
    """
    return read_tensors(bundle.read_checkpoint(), str(bundle.checkpoint))
