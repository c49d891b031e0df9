"""The two networks: the policy that is shipped, and the critic that judges states for it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from nw_eval.learn.teacher.world.privileged import PRIVILEGED
from nw_eval.learn.teacher.world.senses import FRAME, JOINTS, OBSERVED, SCANDOTS

_ACTOR, _CRITIC = (256, 256, 128), (256, 128)
LIMIT = 6.0
"""Of normalised observations."""
_SCANDOT_STD, _LEAST_STD = 0.2, 0.05


class Normalised(nn.Module):
    """layers(clip((x - mean) * inverse_std, -6, 6)), ELU between layers.

    Args:
        inputs: numbers that it sees.
        hidden: widths.
        outputs: numbers that it gives.
    """

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int) -> None:
        super().__init__()
        widths = (inputs, *hidden, outputs)
        layers: list[nn.Module] = []
        for before, after in pairwise(widths):
            layers += [nn.Linear(before, after), nn.ELU()]
        self.layers = nn.Sequential(*layers[:-1])
        self.mean: Tensor
        self.inverse_std: Tensor
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("inverse_std", torch.ones(inputs))

    def forward(self, x: Tensor) -> Tensor:
        """Return outputs, (n, outputs), of rows (n, inputs)."""
        return self.layers(((x - self.mean) * self.inverse_std).clamp(-LIMIT, LIMIT))

    @property
    def linear(self) -> list[nn.Linear]:
        """The linear layers, first to last."""
        return [layer for layer in self.layers if isinstance(layer, nn.Linear)]


class Actor(Normalised):
    """From the 332 numbers of an observation to the mean of 12 raw actions."""

    def __init__(self) -> None:
        super().__init__(OBSERVED, _ACTOR, JOINTS)


class Critic(Normalised):
    """From an observation, and what only training knows, to the value of a state."""

    def __init__(self) -> None:
        super().__init__(OBSERVED + PRIVILEGED, _CRITIC, 1)

    def value(self, observation: Tensor, privileged: Tensor) -> Tensor:
        """Return values, (n,)."""
        return self(torch.cat([observation, privileged], dim=1)).squeeze(1)

    def see_as(self, actor: Actor) -> None:
        """Take the actor's normalisation for what both see."""
        self.mean[:OBSERVED], self.inverse_std[:OBSERVED] = actor.mean, actor.inverse_std


def new_networks(seed: int) -> tuple[Actor, Critic]:
    """Return networks that know nothing; the policy begins near zero."""
    # Only the state of this fork is seeded: torch initialises layers from its global generator.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        actor, critic = Actor(), Critic()
        last = actor.linear[-1]
        nn.init.orthogonal_(last.weight, 0.01)
        nn.init.zeros_(last.bias)
    return actor, critic


def normalise(actor: Actor, observations: Tensor) -> None:
    """Set the actor's normalisation from observations (n, 332) of its first episodes."""
    mean, std = observations.mean(dim=0), observations.std(dim=0).clamp_min(_LEAST_STD)
    dots = slice(FRAME, FRAME + SCANDOTS)
    mean[dots], std[dots] = 0.0, _SCANDOT_STD
    mean[6:8], std[6:8] = 0.0, 0.3  # The angle to the waypoint, rad.
    mean[10:13], std[10:13] = torch.tensor([0.8, 1.0, 0.0]), 1.0  # Speed and mask never change.
    actor.mean[:], actor.inverse_std[:] = mean, 1.0 / std
