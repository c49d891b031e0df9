"""The training of a teacher, from its config or from where it stopped.

It is proximal policy optimisation, in one thread: samples, and updates of both networks from them.
A sample is what a robot saw and did in a control step, and what it was worth.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nw_base.errors import StoreError
from nw_learn.config import device_of, load_config, one_thread
from nw_learn.curve import Curve
from nw_learn.folder import TrainFolder
from nw_learn.progress import Keeper, Trained, TrainingProgress
from nw_learn.teacher.config import PpoSettings, TeacherConfig
from nw_learn.teacher.curriculum import Curriculum
from nw_learn.teacher.episodes import Episodes, Outcomes, Sights
from nw_learn.teacher.lanes import Lanes
from nw_learn.teacher.policy import (
    Actor,
    Beginning,
    Critic,
    begin,
    export_teacher,
    load_network,
    normalise,
)
from nw_learn.teacher.simulation import training_robot
from nw_scenes.robots import get_robot

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
        critic: is improved in place.
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
        log_probabilities = log_probability(samples.actions, means, samples.std)
        likelier = (log_probabilities - samples.log_probabilities).exp().clamp(max=_HEAVIEST)
        advantages = samples.advantages
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        return replace(
            samples,
            means=means,
            log_probabilities=log_probabilities,
            advantages=likelier * advantages,
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


Say = Callable[[str], None]

POLICY = "policy"
"""The folder of the newest policy, within a training's folder."""
_WORLD, _NOISE, _ORDER = 2, 4, 5
"""Streams of the seed."""


def train_teacher(config: Path, out: Path, *, say: Say) -> Trained:
    """Train a teacher.

    Args:
        config: the file of a `TeacherConfig`.
        out: the folder to make.
        say: takes lines of progress.

    Raises:
        UsageError: the config has problems, or a training is in the folder already.
        PolicyError, StoreError: what it starts from cannot be read.
        StoreError: the folder cannot be written.
    """
    settings = load_config(config, TeacherConfig)
    beginning = begin(settings)
    return _Training(settings, TrainFolder.begin(out, config), say).run(beginning, None)


def resume_teacher(folder: Path, *, say: Say) -> Trained:
    """Go on with a training where its last state is; its curve is an uninterrupted one's.

    Raises:
        UsageError: no training is in the folder.
        StoreError: its state is damaged, or of another config, or cannot be written.
    """
    there = TrainFolder.resume(folder)
    settings = load_config(there.config, TeacherConfig)
    state = there.load_state()
    if state is not None and state.get("config") != settings.digest:
        raise StoreError(
            f"{there.state} was trained by another config than {there.config}",
            fix="restore the config, or start a new training from the state: `start: .../state.pt`",
        )
    return _Training(settings, there, say).run(begin(settings) if state is None else None, state)


class _Training:
    """One process's work on one training.

    While the networks learn from the last samples, the next ones are collected by copies of them:
    samples are one update old, whether two threads do that at once or one does both.
    """

    def __init__(self, config: TeacherConfig, folder: TrainFolder, say: Say) -> None:
        one_thread()
        self._config, self._folder, self._say = config, folder, say
        self._device = device_of(config.device)
        self._rng = np.random.default_rng(self._seeds(_WORLD))
        self._noise, self._order = (self._generator(stream) for stream in (_NOISE, _ORDER))
        self._actor, self._critic = Actor(), Critic()
        self._learner: PpoLearner
        self._lanes: Lanes
        self._curriculum: Curriculum
        self._episodes: Episodes
        self._collector: SampleCollector
        self._step = 0  # learnt from
        self._collected = 0
        self._pending: Collected

    def run(self, beginning: Beginning | None, state: dict[str, Any] | None) -> Trained:
        """Train until the budget or a signal ends it."""
        if state is None:
            assert beginning is not None, "what has no state begins"
            self._begin(beginning)
        else:
            try:
                self._restore(state)
            except (KeyError, TypeError, AttributeError, ValueError, RuntimeError) as error:
                raise StoreError(
                    f"{self._folder.state} is not a state of this training: {error!r}",
                    fix="start a new training from a checkpoint: `start: .../0001.pt`",
                ) from None
        config, steps = self._config, self._config.budget.steps
        upto = None if state is None else self._step
        curve = Curve(self._folder.path, upto=upto, say=self._say)
        progress = TrainingProgress(
            self._say,
            steps=steps,
            first=self._step,
            minutes=config.budget.minutes,
            what="control steps",
        )
        keeper = Keeper(self._folder, curve, keep_every=config.keep_every, first=self._step)
        with keeper, self._hands() as submit:
            while self._step < steps:
                figures = self._update(submit, is_last=self._step + config.ppo.samples >= steps)
                curve.append(self._step, figures)
                is_over = self._step >= steps or progress.is_time_up
                if keeper.after(self._step, self.state, is_last=is_over):
                    export_teacher(self._actor, self._policy, name=self._folder.path.name)
                phase = config.phase_at(self._step - 1)
                progress.update(self._step, f"phase {phase + 1}", _headlines(figures))
                if is_over or keeper.is_interrupted:
                    break
        return Trained(
            program="teacher",
            folder=self._folder.path,
            policy=self._policy,
            step=self._step,
            is_done=self._step >= steps,
            is_interrupted=keeper.is_interrupted,
        )

    @property
    def _policy(self) -> Path:
        return self._folder.path / POLICY

    def _update(
        self, submit: Callable[..., Future[Collected]], *, is_last: bool
    ) -> dict[str, float]:
        """Learn from the samples that wait, and collect the next ones meanwhile."""
        following = None if is_last else submit(self._collect, *self._copies())
        phase = self._config.phases[index := self._config.phase_at(self._step)]
        is_first = self._step == 0 or self._config.phase_at(self._step - 1) != index
        if is_first and phase.learning_rate is not None:
            self._learner.set_rate(phase.learning_rate)
        figures = self._learner.learn(self._pending.samples) | self._pending.figures
        self._step += self._config.ppo.samples
        if following is not None:
            self._pending = following.result()
        return figures

    def _collect(self, actor: Actor, critic: Critic) -> Collected:
        one_thread()
        config = self._config
        phase = config.phases[index := config.phase_at(self._collected)]
        if self._collected and config.phase_at(self._collected - 1) != index:
            self._episodes.enter(phase)
        count = self._collected // config.ppo.samples
        if config.courses.redraw and count % config.courses.redraw == 0:
            self._episodes.redraw()
        collected = self._collector.collect(actor, critic, phase.std)
        self._collected += config.ppo.samples
        return Collected(
            samples=collected.samples, figures=collected.figures | self._curriculum.figures()
        )

    def _copies(self) -> tuple[Actor, Critic]:
        return deepcopy(self._actor).cpu(), deepcopy(self._critic).cpu()

    @contextmanager
    def _hands(self) -> Generator[Callable[..., Future[Collected]]]:
        """Give what a function is called with: a second thread, or this one at once."""
        if not self._config.overlap:
            yield _at_once
            return
        with ThreadPoolExecutor(1) as pool:

            def submit(collect: Callable[..., Collected], *arguments: Any) -> Future[Collected]:
                return pool.submit(collect, *arguments)

            yield submit

    # Beginning and going on.

    def _begin(self, beginning: Beginning) -> None:
        config = self._config
        phase = config.phases[0]
        self._actor, self._critic = beginning.actor, beginning.critic
        self._build(generations=None)
        levels = beginning.levels
        if levels is not None and levels.shape == self._curriculum.levels.shape:
            self._curriculum.levels = np.minimum(levels, config.courses.levels - 1)
        self._collector.seen = self._episodes.begin(phase)
        if not beginning.sees:
            first = self._collector.collect(*self._copies(), phase.std)
            normalise(self._actor, first.samples.observations)
            self._critic.see_as(self._actor)
        if beginning.judges:
            self._learner.updates = config.ppo.critic_first
        self._pending = self._collect(*self._copies())

    def _build(self, *, generations: np.ndarray | None) -> None:
        config = self._config
        robot = training_robot(get_robot("go1"))
        self._learner = PpoLearner(self._actor, self._critic, config.ppo, self._order, self._device)
        self._lanes = Lanes(
            config.courses, robot, config.seed, generations=generations, say=self._say
        )
        self._curriculum = Curriculum(config.ppo.robots, config.courses, self._lanes, self._rng)
        self._episodes = Episodes(
            robot, self._lanes, self._curriculum, config.rewards, self._rng, threads=config.threads
        )
        nothing = np.zeros((0, 0), dtype=np.float32)
        self._collector = SampleCollector(
            self._episodes, config.ppo, self._noise, Sights(nothing, nothing)
        )

    def state(self) -> dict[str, Any]:
        """Return everything to go on with."""
        return _as_tensors({
            "config": self._config.digest,
            "step": self._step,
            "collected": self._collected,
            "actor": self._actor.state_dict(),
            "critic": self._critic.state_dict(),
            "learner": self._learner.state(),
            "generations": self._lanes.generations,
            "curriculum": self._curriculum.arrays(),
            "episodes": self._episodes.state(),
            "seen": self._collector.seen._asdict(),
            "pending": self._pending.samples.tensors(),
            "figures": self._pending.figures,
            "rng": self._rng.bit_generator.state,
            "noise": self._noise.get_state(),
            "order": self._order.get_state(),
        })  # fmt: skip

    def _restore(self, state: dict[str, Any]) -> None:
        for network, name in ((self._actor, "actor"), (self._critic, "critic")):
            load_network(network, state, name, self._folder.state)
        self._build(generations=_as_arrays(state["generations"]))
        self._step, self._collected = int(state["step"]), int(state["collected"])
        self._learner.restore(state["learner"])
        for name, array in _as_arrays(state["curriculum"]).items():
            setattr(self._curriculum, name, array)
        config = self._config
        phase = config.phases[config.phase_at(max(self._collected - 1, 0))]
        levels, tasks = self._curriculum.levels, self._curriculum.tasks
        self._curriculum.begin(phase)
        self._curriculum.levels, self._curriculum.tasks = levels, tasks
        self._episodes.restore(_as_arrays(state["episodes"]), phase)
        self._collector.seen = Sights(**_as_arrays(state["seen"]))
        self._pending = Collected(samples=Samples(**state["pending"]), figures=state["figures"])
        self._rng.bit_generator.state = state["rng"]
        self._noise.set_state(state["noise"])
        self._order.set_state(state["order"])

    def _seeds(self, stream: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self._config.seed, spawn_key=(stream,))

    def _generator(self, stream: int) -> torch.Generator:
        return torch.Generator().manual_seed(int(self._seeds(stream).generate_state(1)[0]))


def _at_once(collect: Callable[..., Collected], *arguments: Any) -> Future[Collected]:
    done: Future[Collected] = Future()
    done.set_result(collect(*arguments))
    return done


def _headlines(figures: dict[str, float]) -> dict[str, float]:
    """Return the few figures that matter."""
    levels = {
        f"level {name.partition('/')[2]}": v for name, v in figures.items() if name[:6] == "level/"
    }
    return {"scenes": figures["scenes/mean"], **levels} if "scenes/mean" in figures else levels


def _as_tensors(tree: Any) -> Any:
    """Return nested mappings with every array as a tensor of its own memory."""
    if isinstance(tree, Mapping):
        mapping = cast("Mapping[str, Any]", tree)
        return {key: _as_tensors(value) for key, value in mapping.items()}
    return torch.from_numpy(tree.copy()) if isinstance(tree, np.ndarray) else tree


def _as_arrays(tree: Any) -> Any:
    """Return nested mappings with every tensor as an array of its own memory."""
    if isinstance(tree, Mapping):
        mapping = cast("Mapping[str, Any]", tree)
        return {key: _as_arrays(value) for key, value in mapping.items()}
    return tree.numpy().copy() if isinstance(tree, torch.Tensor) else tree
