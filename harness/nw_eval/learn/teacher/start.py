"""What the networks begin as."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from nw_eval.errors import PolicyError, StoreError, UsageError
from nw_eval.learn.program.folder import read_state
from nw_eval.learn.teacher.config import TeacherConfig
from nw_eval.learn.teacher.ppo.networks import Actor, Critic, new_networks
from nw_eval.learn.teacher.weights import read_actor
from nw_eval.policies import load_bundle

_NOTHING = "nothing"
_STREAM = 3
"""Of the seed, from which new networks are drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Beginning:
    """Networks to begin with.

    Attributes:
        actor: the policy.
        critic: its critic.
        sees: whether the actor's normalisation is set.
        judges: whether the critic has learnt.
        levels: (N, 5) of an earlier training's robots; None = as the config says.
    """

    actor: Actor
    critic: Critic
    sees: bool = True
    judges: bool = False
    levels: NDArray[np.int64] | None = None


def begin(config: TeacherConfig) -> Beginning:
    """Return the networks that `start` names.

    Raises:
        UsageError: there is no such checkpoint.
        PolicyError: there is no such policy, or it is no such network.
        StoreError: a checkpoint is damaged, or of other networks.
    """
    seeds = np.random.SeedSequence(config.seed, spawn_key=(_STREAM,))
    actor, critic = new_networks(int(seeds.generate_state(1)[0]))
    if config.start == _NOTHING:
        return Beginning(actor=actor, critic=critic, sees=False)
    path = config.base / config.start
    if path.suffix == ".pt":
        if not path.is_file():
            raise UsageError(f"start: no checkpoint {path}", fix="name a .pt file of a training")
        state = read_state(path)
        load_network(actor, state, "actor", path)
        load_network(critic, state, "critic", path)
        levels = state.get("curriculum", {}).get("levels")
        return Beginning(
            actor=actor,
            critic=critic,
            judges=True,
            levels=levels.numpy() if isinstance(levels, torch.Tensor) else None,
        )
    bundle = load_bundle(path if path.exists() else config.start)
    if bundle.checkpoint is None:
        raise PolicyError(f"start: {config.start!r} has no weights", fix="name a teacher's policy")
    actor = read_actor(bundle.read_checkpoint(), str(bundle.checkpoint))
    critic.see_as(actor)
    return Beginning(actor=actor, critic=critic)


def load_network(network: nn.Module, state: dict[str, Any], name: str, path: Path) -> None:
    """Fill a network from a state.

    Raises:
        StoreError: the state has none of that name and those sizes.
    """
    try:
        network.load_state_dict(state[name])
    except (KeyError, TypeError, AttributeError, RuntimeError):
        raise StoreError(f"{path} holds no {name} of a teacher", fix="check the path") from None
