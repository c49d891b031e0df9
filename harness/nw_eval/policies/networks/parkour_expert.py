"""The extreme-parkour expert: scandots, history and an estimate of hidden quantities to an action.

Weights lie in two state dicts of one file: `model_state_dict`, whose keys begin with `actor.`, and
`estimator_state_dict`. 276,055 numbers together, of which the encoder of privileged quantities is
used in training only.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from nw_eval.policies.networks.parameters import build, mlp
from nw_eval.policies.safety import tensors_below

PROPRIO = 53
SCANDOTS = 132
HISTORY = 10  # earlier frames
LATENT = 32  # of the scandots


class ParkourActor(nn.Module):
    """Module names are those of the published `actor.`."""

    def __init__(self) -> None:
        super().__init__()
        self.scan_encoder = mlp((SCANDOTS, 128, 64, LATENT), last=nn.Tanh())
        self.priv_encoder = mlp((29, 64, 20), last=nn.ELU())
        self.history_encoder = HistoryEncoder()
        self.actor_backbone = mlp((PROPRIO + LATENT + 9 + 20, 512, 256, 128, 12))

    def forward(self, proprio: Tensor, latent: Tensor, estimate: Tensor, history: Tensor) -> Tensor:
        """Return raw actions (1, 12).

        Args:
            proprio: (1, 53).
            latent: of the scandots or of depth images, (1, 32).
            estimate: of the trunk's velocity and other hidden quantities, (1, 9).
            history: earlier proprio, oldest first, heading numbers 6 and 7 zero, (1, 10, 53).
        """
        past = self.history_encoder(history)
        return self.actor_backbone(torch.cat([proprio, latent, estimate, past], dim=1))


class HistoryEncoder(nn.Module):
    """Ten frames to 20 numbers."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(PROPRIO, 30), nn.ELU())
        self.conv_layers = nn.Sequential(
            nn.Conv1d(30, 20, kernel_size=4, stride=2), nn.ELU(),
            nn.Conv1d(20, 10, kernel_size=2), nn.ELU(), nn.Flatten(),
        )  # fmt: skip
        self.linear_output = nn.Sequential(nn.Linear(30, 20), nn.ELU())

    def forward(self, history: Tensor) -> Tensor:
        """Encode (1, 10, 53)."""
        return self.linear_output(self.conv_layers(self.encoder(history).transpose(1, 2)))


class Estimator(nn.Module):
    """Proprioception to nine hidden quantities."""

    def __init__(self) -> None:
        super().__init__()
        self.estimator = mlp((PROPRIO, 128, 64, 9))

    def forward(self, proprio: Tensor) -> Tensor:
        """Estimate from (1, 53)."""
        return self.estimator(proprio)


class ParkourExpert(nn.Module):
    """Actor and estimator together."""

    def __init__(self, actor: ParkourActor, estimator: Estimator) -> None:
        super().__init__()
        self.actor = actor
        self.estimator = estimator

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor], where: str) -> ParkourExpert:
        """Take the weights of a published file; critic and noise in it are left out.

        Raises:
            PolicyError: a part is missing or has other shapes.
        """
        actor = tensors_below(tensors, "model_state_dict.actor.")
        estimator = tensors_below(tensors, "estimator_state_dict.")
        return cls(build(ParkourActor, actor, where), build(Estimator, estimator, where))

    def forward(self, proprio: Tensor, scandots: Tensor, history: Tensor) -> Tensor:
        """Return raw actions (1, 12); arguments as `ParkourActor`, scandots (1, 132)."""
        latent = self.actor.scan_encoder(scandots)
        return self.actor(proprio, latent, self.estimator(proprio), history)
