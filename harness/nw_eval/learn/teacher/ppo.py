"""Proximal policy optimisation, in one thread: samples, and updates of both networks from them.

A sample is what a robot saw and did in a control step, and what it was worth.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nw_eval.learn.teacher.config import PpoSettings
from nw_eval.learn.teacher.episodes import Episodes, Outcomes, Sights
from nw_eval.learn.teacher.networks import Actor, Critic

_LOWEST, _HIGHEST = 3e-6, 1e-3
"""Learning rates of the policy."""
_CRITIC_RATE = 5e-4
_SLOWER, _FASTER = 1.25, 1.15
_BAND = 1.5
"""Times the divergence that is aimed at, up and down, within which the rate stays."""
_LONGEST_GRADIENT = 1.0
_HEAVIEST = 2.0
"""Weight of a sample that the present policy would take more often than the one that took it."""
_FIRST_RATE = 3e-4
_TOO_FAR = 4.0
"""Times the divergence that is aimed at: beyond it a batch teaches the critic alone."""

Single = NDArray[np.float32]


class PpoLearner:
    """Improves a policy, and a critic, by proximal policy optimisation.

    The noise is the phase's: at these learning rates its own gradient hardly moves it.

    Args:
        actor: is improved in place.
        critic: as above.
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
        there = self._anchored(samples.to(self._device))
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

    @torch.no_grad()
    def _anchored(self, samples: Samples) -> Samples:
        """Return samples of an older policy as seen from the present one.

        Ratios are bounded around the present policy, and samples weigh by how much likelier their
        actions are now (decoupled PPO: Hilton et al. 2022, arXiv 2110.00641). Bounded around the
        older one, each update would undo the last, overshoot, and grow.
        """
        means = self._actor(samples.observations)
        now = log_probability(samples.actions, means, samples.std)
        likelier = (now - samples.log_probabilities).exp().clamp(max=_HEAVIEST)
        advantages = samples.advantages
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        return replace(
            samples, means=means, log_probabilities=now, advantages=likelier * advantages
        )

    def _policy_loss(self, some: Samples) -> tuple[Tensor, float]:
        clip, std = self._settings.clip, some.std
        means = self._actor(some.observations)
        ratio = (log_probability(some.actions, means, std) - some.log_probabilities).exp()
        advantage = some.advantages
        bounded = ratio.clamp(1.0 - clip, 1.0 + clip) * advantage
        loss = -torch.min(ratio * advantage, bounded).mean()
        # Between two normal densities of one width.
        apart = ((means.detach() - some.means) / std).square().sum(dim=1).mean() / 2.0
        return loss, apart.item()

    def _adapt(self, divergence: float) -> None:
        """Adapt the rate once an update; more often it would overshoot."""
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


class SampleCollector:
    """Runs the policy with noise.

    Args:
        episodes: that go on from one call to the next.
        settings: of the config.
        noise: generator of the actions' noise.
        seen: what the robots see now.
    """

    def __init__(
        self, episodes: Episodes, settings: PpoSettings, noise: torch.Generator, seen: Sights
    ) -> None:
        self._episodes, self._settings, self._noise = episodes, settings, noise
        self.seen = seen

    @torch.no_grad()
    def collect(self, actor: Actor, critic: Critic, std: float) -> Collected:
        """Run `horizon` control steps of all robots with a policy that stays as it is."""
        horizon = self._settings.horizon
        spread = torch.tensor(std)
        kept: dict[str, list[Tensor]] = {
            name: [] for name in ("observations", "privileged", "actions", "means")
        }
        log_probabilities: list[Tensor] = []
        values: list[Single] = []
        earned: list[Single] = []
        over: list[NDArray[np.bool_]] = []
        ends: list[Outcomes] = []
        for _ in range(horizon):
            observation, privileged = (torch.from_numpy(array) for array in self.seen)
            means = actor(observation)
            noise = torch.empty_like(means).normal_(generator=self._noise)
            actions = means + spread * noise
            log_probabilities.append(log_probability(actions, means, spread))
            values.append(critic.value(observation, privileged).numpy())
            for name, tensor in zip(kept, (observation, privileged, actions, means), strict=True):
                kept[name].append(tensor)
            step = self._episodes.step(actions.numpy())
            # Time that is up and trails that are done are no states of no value.
            cut = np.flatnonzero(step.outcomes.over & ~step.outcomes.failed)
            reward = step.rewards
            if len(cut):
                last = (torch.from_numpy(array[cut]) for array in step.last)
                reward[cut] += self._settings.discount * critic.value(*last).numpy()
            earned.append(reward)
            over.append(step.outcomes.over)
            ends.append(step.outcomes)
            self.seen = step.seen
        values.append(critic.value(*(torch.from_numpy(array) for array in self.seen)).numpy())
        advantages = self._advantages(np.stack(values), np.stack(earned), np.stack(over))
        returns = advantages + np.stack(values[:-1])
        samples = Samples(
            **{name: torch.cat(tensors) for name, tensors in kept.items()},
            log_probabilities=torch.cat(log_probabilities),
            advantages=torch.from_numpy(advantages.reshape(-1)),
            returns=torch.from_numpy(returns.reshape(-1)),
            std=spread,
        )
        return Collected(samples=samples, figures=_figures(ends, np.stack(earned)))

    def _advantages(self, values: Single, earned: Single, over: NDArray[np.bool_]) -> Single:
        """Return generalised advantages, (T, N), of values (T + 1, N) and rewards (T, N)."""
        discount, trace = self._settings.discount, self._settings.trace
        advantages = np.zeros_like(earned)
        following = np.zeros_like(earned[0])
        for step in range(len(earned) - 1, -1, -1):
            goes_on = (~over[step]).astype(np.float32)
            surprise = earned[step] + discount * values[step + 1] * goes_on - values[step]
            following = surprise + discount * trace * goes_on * following
            advantages[step] = following
        return advantages.astype(np.float32)


def _figures(ends: list[Outcomes], earned: Single) -> dict[str, float]:
    """Return how episodes ended, as shares of those that did."""
    count = int(sum(end.over.sum() for end in ends))
    figures = {"reward/second": float(earned.mean()) * 50.0}
    if count:
        for name in ("complete", "fell", "collided", "stuck"):
            ended = sum(int((getattr(end, name) & end.over).sum()) for end in ends)
            figures[f"ends/{name}"] = ended / count
    return figures


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """S control steps; all tensors float32.

    Attributes:
        observations: (S, 332).
        privileged: (S, P) what the critic alone sees.
        actions: (S, 12) raw.
        means: (S, 12) of the policy that took them.
        log_probabilities: (S,) of the actions then.
        advantages: (S,).
        returns: (S,).
        std: () of the noise.
    """

    observations: Tensor
    privileged: Tensor
    actions: Tensor
    means: Tensor
    log_probabilities: Tensor
    advantages: Tensor
    returns: Tensor
    std: Tensor

    def to(self, device: torch.device) -> Self:
        """Return the same on a device."""
        return type(self)(**{name: tensor.to(device) for name, tensor in self.tensors().items()})

    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True, kw_only=True)
class Collected:
    """Samples, and figures of how they came about."""

    samples: Samples
    figures: dict[str, float]


def log_probability(actions: Tensor, means: Tensor, std: Tensor) -> Tensor:
    """Return the log density of actions (n, 12) under normal noise, up to a constant, (n,)."""
    return (-0.5 * ((actions - means) / std) ** 2 - std.log()).sum(dim=1)
