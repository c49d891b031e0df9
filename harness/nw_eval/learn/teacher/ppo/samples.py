"""Samples of one stretch of time: what robots saw and did, and what it was worth."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nw_eval.learn.teacher.config import PpoSettings
from nw_eval.learn.teacher.ppo.networks import Actor, Critic
from nw_eval.learn.teacher.world.episodes import Episodes, Outcomes, Sights

Single = NDArray[np.float32]


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
        """Run `horizon` control steps of all robots with a policy that nobody changes meanwhile."""
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
