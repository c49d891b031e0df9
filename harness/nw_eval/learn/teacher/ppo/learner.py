"""Updates of the two networks from samples."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from nw_eval.learn.teacher.config import PpoSettings
from nw_eval.learn.teacher.ppo.networks import Actor, Critic
from nw_eval.learn.teacher.ppo.samples import Samples, log_probability

_LOWEST, _HIGHEST = 3e-6, 1e-3
"""Learning rates of the policy."""
_CRITIC_RATE = 5e-4
_SLOWER, _FASTER = 1.25, 1.15
_BAND = 1.5
"""Times the divergence that is aimed at, up and down, within which the rate stays."""
_LONGEST_GRADIENT = 1.0
_FIRST_RATE = 3e-4
_TOO_FAR = 4.0
"""Times the divergence that is aimed at: beyond it a batch teaches the critic alone."""


class PpoLearner:
    """Improves a policy, and a critic, by proximal policy optimisation.

    The noise is the phase's: at these learning rates its own gradient hardly moves it.

    Args:
        actor: is improved in place.
        critic: likewise.
        settings: of the config.
        generator: of the order of samples.
        device: where it computes.

    Attributes:
        updates: how many there have been.
        rate: the policy's learning rate.
    """

    def __init__(
        self,
        actor: Actor,
        critic: Critic,
        settings: PpoSettings,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        self._actor, self._critic = actor.to(device), critic.to(device)
        self._settings, self._generator, self._device = settings, generator, device
        groups = [
            {"params": list(actor.parameters()), "lr": _FIRST_RATE},
            {"params": list(critic.parameters()), "lr": _CRITIC_RATE},
        ]
        self._optimiser = torch.optim.Adam(groups, eps=1e-5)
        self.rate = _FIRST_RATE
        self.updates = 0

    def learn(self, samples: Samples) -> dict[str, float]:
        """Improve both networks; the critic alone at first. Return figures of the update."""
        settings = self._settings
        there = samples.to(self._device)
        count = len(there.returns)
        size = count // settings.minibatches
        critic_alone = self.updates < settings.critic_first
        losses: list[float] = []
        divergences: list[float] = []
        for _ in range(settings.epochs):
            order = torch.randperm(count, generator=self._generator).to(self._device)
            for chosen in order.split(size):
                some = _rows(there, chosen)
                value = self._critic.value(some.observations, some.privileged)
                loss = (value - some.returns).square().mean()
                losses.append(loss.item())
                if not critic_alone:
                    policy_loss, divergence = self._policy_loss(some)
                    divergences.append(divergence)
                    if divergence <= _TOO_FAR * settings.divergence:
                        loss = loss + policy_loss
                self._step(loss)
        self.updates += 1
        variance = there.returns.var().item()
        figures = {
            "critic/loss": sum(losses) / len(losses),
            "critic/explained": 1.0 - losses[0] / variance if variance > 0.0 else 0.0,
            "rate/policy": self.rate,
            "noise/std": float(samples.std),
        }
        if divergences:
            figures["divergence/mean"] = sum(divergences) / len(divergences)
            self._adapt(figures["divergence/mean"])
        return figures

    def _policy_loss(self, some: Samples) -> tuple[Tensor, float]:
        clip, std = self._settings.clip, some.std
        means = self._actor(some.observations)
        ratio = (log_probability(some.actions, means, std) - some.log_probabilities).exp()
        advantage = some.advantages
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        bounded = ratio.clamp(1.0 - clip, 1.0 + clip) * advantage
        loss = -torch.min(ratio * advantage, bounded).mean()
        # Between two normal densities of one width.
        apart = ((means.detach() - some.means) / std).square().sum(dim=1).mean() / 2.0
        return loss, apart.item()

    def _adapt(self, divergence: float) -> None:
        """Adapt the rate once an update: samples are one update old, and more would overshoot."""
        target = self._settings.divergence
        if divergence > _BAND * target:
            self.set_rate(self.rate / _SLOWER)
        elif divergence < target / _BAND:
            self.set_rate(self.rate * _FASTER)

    def set_rate(self, rate: float) -> None:
        """Go on with a learning rate."""
        self.rate = min(max(rate, _LOWEST), _HIGHEST)
        self._optimiser.param_groups[0]["lr"] = self.rate

    def _step(self, loss: Tensor) -> None:
        self._optimiser.zero_grad()
        loss.backward()
        for network in (self._actor, self._critic):
            torch.nn.utils.clip_grad_norm_(network.parameters(), _LONGEST_GRADIENT)
        self._optimiser.step()

    def state(self) -> dict[str, Any]:
        """Return what it goes on with, besides the networks."""
        return {
            "optimiser": self._optimiser.state_dict(),
            "rate": self.rate,
            "updates": self.updates,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a state."""
        self._optimiser.load_state_dict(state["optimiser"])
        self.updates = state["updates"]
        self.set_rate(state["rate"])


def _rows(samples: Samples, chosen: Tensor) -> Samples:
    rows = {
        name: tensor if tensor.ndim == 0 else tensor[chosen]
        for name, tensor in samples.tensors().items()
    }
    return Samples(**rows)
