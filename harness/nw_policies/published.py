"""Policies of published training code, from their own state dicts: extreme-parkour, LucidSim, ACT.

Inputs on the card of extreme-parkour's expert, and of its depth student:
    proprio     53 numbers (layout parkour53)
    history     530 numbers: the ten frames before the present one, oldest first, each with the two
                heading numbers (6 and 7) zero
    scandots    132 numbers: makes it the expert
    depth       (45, 80) or (58, 87) in place of scandots: makes it the student

The student looks at a depth image every fifth control step and keeps what it saw between them.

Inputs on the card of LucidSim's transformer:
    proprio    53 numbers (layout parkour53), or 371: seven such frames, oldest first
    frames     (7, 3, 45, 80), the last seven images, oldest first, (byte - 127.5) / 255

With 53 numbers the network sees the present frame seven times. That is how the published
checkpoints are evaluated, and what they expect.

Inputs on the card of an ACT policy, whose chunks of actions are blended over time:
    proprio    a vector of the size that the network was trained with
    images     (channels, rows, columns), or a stack of such images: one for each camera or frame;
               none for a network without an image encoder

The layout of its state dict is that of `nw_policies.networks.act`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from nw_base.errors import PolicyError, TrialError
from nw_base.memory import pack
from nw_policies.bundle import Bundle, NoOptions, read_options
from nw_policies.cards.feeding import InputSpec
from nw_policies.cards.model import CardModel
from nw_policies.chunks import ActOptions, ChunkPolicy
from nw_policies.executor import Node, RecordedFile
from nw_policies.networks.act import Act
from nw_policies.networks.parameters import build
from nw_policies.networks.parkour import (
    FRAMES,
    HIDDEN,
    HISTORY,
    IMAGE,
    LATENT,
    PROPRIO,
    SCANDOTS,
    LucidSimTransformer,
    ParkourExpert,
    ParkourStudent,
)
from nw_policies.networks.recording import named, numbered, record
from nw_policies.policy import Observation, unpacked
from nw_policies.torch_network import (
    NetworkPolicy,
    TorchNetwork,
    checkpoint_tensors,
    input_spec,
)

if TYPE_CHECKING:
    import onnxruntime as ort

_BODY = (input_spec("proprio", PROPRIO), input_spec("history", HISTORY * PROPRIO))


class StudentOptions(CardModel):
    """How the depth student is run."""

    depth_every: int = Field(default=5, ge=1, le=50)
    """Control steps between two images that it looks at."""
    steer_by_depth: bool = True
    """Whether the heading that it sees in the images replaces the waypoint's."""


def open_extreme_parkour(bundle: Bundle, *, joints: int) -> NetworkPolicy:
    """Return the expert or the student, by the inputs that the card names.

    Raises:
        PolicyError: the checkpoint does not hold it, or the card names other inputs.
    """
    names = {name for name, _ in bundle.card.input_parts()}
    return (StudentPolicy if "depth" in names else ExpertPolicy)(bundle, joints=joints)


class ExpertPolicy(NetworkPolicy):
    """Scandots to actions."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        read_options(bundle, NoOptions)
        tensors = checkpoint_tensors(bundle)
        self._network = ParkourExpert.from_tensors(tensors, str(bundle.checkpoint))
        super().__init__(bundle, (*_BODY, input_spec("scandots", SCANDOTS)), joints=joints)

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Return the actor's output."""
        history = inputs["history"].view(1, HISTORY, PROPRIO)
        return self._network(inputs["proprio"], inputs["scandots"], history)


class StudentPolicy(NetworkPolicy):
    """Depth images to actions, with the hidden state of a GRU."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        self._options = read_options(bundle, StudentOptions)
        tensors = checkpoint_tensors(bundle)
        self._network = ParkourStudent.from_tensors(tensors, str(bundle.checkpoint))
        inputs = (*_BODY, input_spec("depth", *self._network.image))
        super().__init__(bundle, inputs, joints=joints)

    def forget(self) -> None:
        """Begin with a hidden state of zeros."""
        self._hidden = torch.zeros(1, 1, HIDDEN)
        self._seen = torch.zeros(1, LATENT + 2)
        self._step = 0

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Take a new image if one is due, then act on the last one."""
        if self._step % self._options.depth_every == 0:
            self._seen, self._hidden = self._network.see(
                inputs["depth"], inputs["proprio"], self._hidden
            )
        self._step += 1
        return self._network(
            inputs["proprio"],
            self._seen,
            inputs["history"].view(1, HISTORY, PROPRIO),
            steer_by_depth=self._options.steer_by_depth,
        )

    def state(self) -> bytes:
        """Return hidden state, the features of the last image, and the count of steps."""
        return pack(
            {
                "hidden": self._hidden.numpy(),
                "seen": self._seen.numpy(),
                "step": np.array(self._step),
            }
        )

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._name) as arrays:
            self._hidden = torch.from_numpy(arrays["hidden"]).view(1, 1, HIDDEN)
            self._seen = torch.from_numpy(arrays["seen"]).view(1, LATENT + 2)
            self._step = int(arrays["step"])

    def recorded(self, observation: Observation) -> RecordedFile:
        """Return the encoder of images and the actor as two graphs."""
        first = {"hidden": torch.zeros(1, 1, HIDDEN), "seen": torch.zeros(1, LATENT + 2)}
        given = self.tensors(observation)
        body, history, depth = given.values()
        inputs = numbered(given.values()) | first

        def see() -> dict[str, Tensor]:
            seen, hidden = self._network.see(depth, body, first["hidden"])
            return {"hidden": hidden, "seen": seen}

        def act() -> dict[str, Tensor]:
            action = self._network(
                body,
                first["seen"],
                history.view(1, HISTORY, PROPRIO),
                steer_by_depth=self._options.steer_by_depth,
            )
            return {"output 0": action}

        parts = (self._options.depth_every, record(see, inputs)), (1, record(act, inputs))
        return RecordedFile(parts=parts, first={name: x.numpy() for name, x in first.items()})


class LucidSimPolicy(NetworkPolicy):
    """The transformer. Its heading head takes no part, so its weights may be missing."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        read_options(bundle, NoOptions)
        tensors = checkpoint_tensors(bundle)
        where = str(bundle.checkpoint)
        self._transformer = build(LucidSimTransformer, tensors, where, unused=("yaw",))
        inputs = (input_spec("proprio", None), input_spec("frames", FRAMES, *IMAGE))
        super().__init__(bundle, inputs, joints=joints)

    @cached_property
    def _session(self) -> ort.InferenceSession:
        """What runs it here; where it is only recorded, nothing does."""
        return self._transformer.open()

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Return the action token's projection."""
        feeds = {
            "proprio": _frames_of(inputs["proprio"].numpy()),
            "frames": inputs["frames"][0].numpy(),
        }
        return torch.from_numpy(self._session.run(None, feeds)[0])

    def recorded(self, observation: Observation) -> RecordedFile:
        """Return the graph that it runs, of the inputs as the card makes them."""
        proprio, frames = (tuple(x.shape) for x in self.tensors(observation).values())
        graph = self._transformer.graph()
        _ = _frames_of(np.zeros(proprio, np.float32))  # Or it raises.
        whole = [
            graph.constant(np.array(n))
            for n in ([-1, PROPRIO], [FRAMES, PROPRIO], [FRAMES, *IMAGE])
        ]
        vectors = graph.add("Reshape", "input 0", whole[0])
        given, seen = (one.name for one in graph.inputs)
        graph.nodes[:0] = [
            graph.nodes.pop(),
            Node(operator="Expand", inputs=(vectors, whole[1]), outputs=(given,)),
            Node(operator="Reshape", inputs=("input 1", whole[2]), outputs=(seen,)),
        ]
        graph.inputs.clear()
        graph.input("input 0", proprio)
        graph.input("input 1", frames)
        named(graph, {"output 0": graph.outputs.pop()})
        return RecordedFile(parts=((1, graph),), first={})


def _frames_of(proprio: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return seven frames of the body, (7, 53), of one or of all of them.

    Raises:
        TrialError: they are neither.
    """
    if proprio.size not in {PROPRIO, FRAMES * PROPRIO}:
        raise TrialError(
            f"input `proprio` is {proprio.size} numbers; the transformer wants {PROPRIO}, or "
            f"{FRAMES} x {PROPRIO} = {FRAMES * PROPRIO}",
            fix="use `layout: parkour53` on the card",
        )
    return np.ascontiguousarray(np.broadcast_to(proprio.reshape(-1, PROPRIO), (FRAMES, PROPRIO)))


class ActNetwork(TorchNetwork):
    """Predicts a chunk of actions."""

    def __init__(self, bundle: Bundle, options: ActOptions, *, joints: int) -> None:
        where = str(bundle.checkpoint)
        self._network = Act.from_tensors(checkpoint_tensors(bundle), where, heads=options.heads)
        sizes = self._network.sizes
        if sizes.actions != joints:
            raise PolicyError(
                f"{where}: the network has {sizes.actions} actions, the robot "
                f"{bundle.card.robot!r} has {joints} joints",
                fix="name the right robot on the card",
            )
        if options.query_every > sizes.chunk:
            raise PolicyError(
                f"{bundle.where}: query_every is {options.query_every}, but a chunk has "
                f"only {sizes.chunk} actions",
                fix=f"use {sizes.chunk} or less",
            )
        inputs: tuple[InputSpec, ...] = (input_spec("proprio", sizes.proprio),)
        if sizes.backbone:
            channels = next(shape[1] for shape in sizes.backbone.values() if len(shape) == 4)
            shape = (None, channels, None, None)
            inputs += (InputSpec(name="images", shape=shape, dtype=np.dtype(np.float32)),)
        super().__init__(bundle, inputs)

    def outputs(self, inputs: dict[str, Tensor]) -> Sequence[Tensor]:
        """Return the chunk, (chunk, actions)."""
        return (self._network(inputs["proprio"], inputs.get("images")),)


def open_act(bundle: Bundle, *, joints: int) -> ChunkPolicy:
    """Return an ACT policy.

    Raises:
        PolicyError: the checkpoint is none, or of another robot, or the options do not fit it.
    """
    options = read_options(bundle, ActOptions)
    network = ActNetwork(bundle, options, joints=joints)
    return ChunkPolicy(network, options, joints=joints, policy=bundle.name, is_exact=False)
