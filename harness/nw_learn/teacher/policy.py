"""The policy that is shipped and the critic of its states: into a training and out of it.

In: what the networks begin as. Out: a policy as a card and its weights, as `nw-eval run --policy`
takes them. The policy is an ONNX file too: read without running it, and written.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from nw_base.errors import PolicyError, StoreError, UsageError
from nw_base.files.cache import atomic_path
from nw_learn.folder import TrainFolder, read_state
from nw_learn.teacher.config import TeacherConfig
from nw_learn.teacher.senses import FRAME, JOINTS, OBSERVED, PRIVILEGED, SCANDOTS
from nw_policies import load_bundle
from nw_policies.cards.load import CARD_FILE
from nw_policies.networks.onnx_graph import Graph
from nw_policies.safety import check_onnx
from nw_policies.safety.onnx import ONNX, ProtobufMessage, Reader, integers

_ACTOR, _CRITIC = (256, 256, 128), (256, 128)
LIMIT = 6.0
"""Of normalised observations."""
_SCANDOT_STD, _LEAST_STD = 0.2, 0.05

_FLOAT32 = 1
_AXES = 8


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


def read_actor(data: bytes, where: str) -> Actor:
    """Return the network of an ONNX file of the form that `write_actor` writes.

    Only numbers are taken: the file's initialisers, in the order in which its nodes use them.

    Args:
        data: the whole file.
        where: its path, for errors.

    Raises:
        PolicyError: it is no such network, damaged, or of other sizes.
    """
    check_onnx(data, where)
    used = _numbers_in_order(memoryview(data))
    actor = Actor()
    wanted = {"mean": actor.mean, "inverse_std": actor.inverse_std}
    for index, layer in enumerate(actor.linear):
        wanted |= {
            f"layer {index} weight": layer.weight.data,
            f"layer {index} bias": layer.bias.data,
        }
    numbers = [array for array in used if array.ndim > 0]  # Without the two limits.
    shapes, expected = [a.shape for a in numbers], [tuple(t.shape) for t in wanted.values()]
    if shapes != expected:
        raise PolicyError(
            f"{where} is not a teacher's network: its arrays have the shapes {shapes}",
            fix=f"they should be {expected}, in the order of use",
        )
    for tensor, array in zip(wanted.values(), numbers, strict=True):
        tensor.copy_(torch.from_numpy(array))
    return actor


def write_actor(actor: Actor) -> bytes:
    """Return the policy as an ONNX file, (1, 332) to (1, 12), normalisation and all."""
    graph = Graph()

    def numbers(tensor: torch.Tensor) -> str:
        return graph.constant(tensor.detach().cpu().numpy().astype(np.float32))

    low, high = (graph.constant(np.array(limit, dtype=np.float32)) for limit in (-LIMIT, LIMIT))
    x = graph.node("Sub", graph.input("obs", 1, OBSERVED), numbers(actor.mean))
    x = graph.node("Clip", graph.node("Mul", x, numbers(actor.inverse_std)), low, high)
    for layer in actor.linear:
        x = graph.node("Gemm", x, numbers(layer.weight), numbers(layer.bias), transB=1)
        if layer is not actor.linear[-1]:
            x = graph.node("Elu", x)
    return graph.model(x, 1, actor.linear[-1].out_features)


def _numbers_in_order(data: memoryview) -> list[NDArray[np.float32]]:
    """Return float32 initialisers in the order in which nodes use them."""
    reader = Reader(ONNX)
    graph = reader.read(reader.read(data, "Model").views("graph")[0], "Graph")
    tensors = [reader.read(view, "Tensor") for view in graph.views("initializer")]
    by_name = {tensor.text("name"): tensor for tensor in tensors}
    nodes = [reader.read(view, "Node") for view in graph.views("node")]
    names = [name for node in nodes for name in node.get("input", [])]
    return [_array(by_name[str(name)]) for name in names if str(name) in by_name]


def _array(tensor: ProtobufMessage) -> NDArray[np.float32]:
    shape = tuple(integers(tensor.get("dims", []), _AXES))
    raw = b"".join(tensor.views("raw_data"))
    if tensor.integer("data_type") != _FLOAT32 or len(raw) != 4 * math.prod(shape):
        raise PolicyError(
            f"a tensor {tensor.text('name')!r} of a policy is not plain float32",
            fix="export it with float32 weights",
        )
    return np.frombuffer(raw, dtype="<f4").reshape(shape).copy()


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
