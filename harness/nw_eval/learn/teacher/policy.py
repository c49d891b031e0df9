"""Policies into a training and out of it.

In: what the networks begin as. Out: a policy as a card and its weights, as `nw-eval run --policy`
takes them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from nw_eval.cards.load import CARD_FILE
from nw_eval.errors import PolicyError, StoreError, UsageError
from nw_eval.files.cache import atomic_path
from nw_eval.learn.folder import TrainFolder, read_state
from nw_eval.learn.teacher.config import TeacherConfig
from nw_eval.learn.teacher.networks import Actor, Critic, new_networks, read_actor, write_actor
from nw_eval.policies import load_bundle

_NOTHING = "nothing"
_STREAM = 3
"""Of the seed, from which new networks are drawn."""

_CHECKPOINT = "policy.onnx"
_CARD = """\
nw-policy: 1
name: {name}
title: parkour teacher on terrain heights, trained by nw-eval
robot: go1
adapter: onnx
checkpoint:
  file: {file}
  sha256: {digest}

control:
  action: joint_position_offset
  scale: 0.25
  clip: 4.8
  delay_steps: 1
  kp: 20
  kd: 0.5

command: {{source: waypoint, speed: 0.8}}

observations:  # 332 numbers, in this order
  proprio: {{sensor: proprio, layout: parkour53}}
  scandots: {{sensor: scandots}}
  last_output: {{sensor: proprio, terms: [last_output]}}
  history:  # earlier frames without delta_yaw, speed and the mask
    sensor: proprio
    layout: parkour53
    select: ["0:5", "13:53"]
    history: {{steps: 3, order: newest_first, current: false}}
"""


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


def export_teacher(actor: Actor, folder: Path, *, name: str) -> None:
    """Write the policy's folder: weights first, then the card that says their digest.

    Raises:
        StoreError: it cannot be written.
    """
    weights = write_actor(actor)
    named = re.sub(r"[^A-Za-z0-9_.-]", "-", name).lstrip("_.-")[:64] or "teacher"
    card = _CARD.format(name=named, file=_CHECKPOINT, digest=sha256(weights).hexdigest())
    with atomic_path(folder / _CHECKPOINT) as temporary:
        temporary.write_bytes(weights)
    with atomic_path(folder / CARD_FILE) as temporary:
        temporary.write_text(card, encoding="utf-8")


def export_checkpoint(folder: Path, number: int | None, out: Path) -> Path:
    """Write the policy of a training's checkpoint; return the checkpoint's file.

    Args:
        folder: of the training.
        number: of the kept checkpoint; None = the newest state.
        out: the policy's folder.

    Raises:
        UsageError: there is no such checkpoint.
        StoreError: it cannot be read, or the policy not written.
    """
    path = TrainFolder.resume(folder).checkpoint(number)
    actor = Actor()
    load_network(actor, read_state(path), "actor", path)
    export_teacher(actor, out, name=out.name)
    return path
