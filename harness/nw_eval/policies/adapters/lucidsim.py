"""LucidSim's transformer from its published state dict.

Inputs on the card:
    proprio    53 numbers (layout parkour53), or 371: seven such frames, oldest first
    frames     (7, 3, 45, 80), the last seven images, oldest first, (byte - 127.5) / 255

With 53 numbers the network sees the present frame seven times. That is how the published
checkpoints are evaluated, and what they expect.
"""

from __future__ import annotations

import torch
from torch import Tensor

from nw_eval.errors import TrialError
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.networks.lucidsim import FRAMES, IMAGE, PROPRIO, LucidSimTransformer
from nw_eval.policies.networks.parameters import build
from nw_eval.policies.networks.policy import NetworkPolicy, checkpoint_tensors, input_spec
from nw_eval.policies.options import NoOptions, read_options


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
