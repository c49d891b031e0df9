"""The student's network, and the network as a policy folder: one ONNX file and its card.

It is ACT (arXiv 2304.13705) as the adapter `act` runs it, for many at a time. The latent variable,
which the paper needs because people demonstrate in many ways, is left at zero for good: one teacher
answers one way.

Temporal ensembling is inside the ONNX graph, as recurrent state. Its weights exp(-m i), i = 0 for
the oldest prediction, are to each other as exp(m age): so sums over all predictions so far are
enough, which grow by exp(m) with each step that they age.
"""

from __future__ import annotations

import io
import math
import warnings
from copy import deepcopy
from hashlib import sha256
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor, nn

from nw_base.errors import PrerequisiteError
from nw_base.files.cache import atomic_path
from nw_learn.student.card import (
    ENCODER_FILE,
    NETWORK_FILE,
    SEEN,
    card_text,
    student_card,
)
from nw_policies.cards.load import CARD_FILE
from nw_policies.networks.act import Act, ActSizes, DecoderLayer, image_places

if TYPE_CHECKING:
    from pathlib import Path

    from nw_learn.student.config import NetworkSizes, Sees, StudentConfig
    from nw_policies.cards import Card

JOINTS = 12
COLOURS = 3

_KERNELS = (5, 3)
"""Of the first convolution, and of the others."""
_FARTHEST = 8.0
"""Standard deviations from the mean beyond which a number of the body says no more."""

_OPSET = 17
_BYTE = 255.0


class StudentNetwork(nn.Module):
    """Images and numbers of the body to a chunk of actions.

    Attributes:
        act: all weights.
        mean_image: (channels, rows, columns), what an image is compared with.
    """

    mean_image: Tensor

    def __init__(self, sizes: NetworkSizes, sees: Sees, *, proprio: int) -> None:
        """Make a network whose weights are drawn from torch's present generator.

        Args:
            sizes: from the config.
            sees: what it observes, from the config.
            proprio: numbers of the body.
        """
        super().__init__()
        channels = _image_channels(sees)
        self.act = Act(_sizes(sizes, channels=channels, proprio=proprio))
        self.register_buffer("mean_image", torch.zeros(channels, sees.height, sees.width))
        for moments in (self.act.normalize.proprio, self.act.normalize.action):
            moments.mean.zero_()
            moments.std.fill_(1.0)
        for parameter in self.act.parameters():
            if parameter.dim() > 1:  # As the paper's code does it.
                nn.init.xavier_uniform_(parameter)
        for name, parameter in self.act.named_parameters():
            if name.endswith("in_proj_bias"):
                nn.init.zeros_(parameter)
        with torch.no_grad():
            self._grid: tuple[int, int] = self.act.backbone(self.mean_image[None]).shape[2:]

    def forward(self, proprio: Tensor, images: Tensor, image_of: Tensor) -> Tensor:
        """Return chunks of normalised actions, (N, chunk, 12), the present step's first.

        Args:
            proprio: (N, proprio).
            images: (M, channels, rows, columns), 0 to 1.
            image_of: (N,) which of the M images is the newest of each row of numbers.
        """
        return self.decided(proprio, self.seen(images)[image_of])

    def seen(self, images: Tensor) -> Tensor:
        """Return what is made of images alone, (M, places, width).

        Args:
            images: (M, channels, rows, columns), 0 to 1.
        """
        maps = self.act.backbone(images - self.mean_image)
        return self.act.encoder_img_feat_input_proj(maps).flatten(2).transpose(1, 2)

    def decided(self, proprio: Tensor, seen: Tensor) -> Tensor:
        """Return chunks as `forward`.

        Args:
            proprio: (N, proprio).
            seen: (N, places, width), of the newest image of each row of numbers.
        """
        act, width = self.act, self.act.sizes.width
        moments = act.normalize.proprio
        body = ((proprio - moments.mean) / moments.std).clamp(-_FARTHEST, _FARTHEST)
        latent = act.encoder_latent_input_proj(body.new_zeros(len(body), act.sizes.latent))
        state = act.encoder_robot_state_input_proj(body)
        tokens = torch.cat([latent[:, None], state[:, None], seen], dim=1)
        own = act.encoder_1d_feature_pos_embed.weight
        place = torch.cat([own, image_places(*self._grid, width).to(own)])[None]
        return act.action_head(self._decoded(act.encoder(tokens, place), place))

    def _decoded(self, memory: Tensor, place: Tensor) -> Tensor:
        """Return what the decoder makes of a memory, (N, chunk, width).

        Nothing of the memory has come to the first layer when it attends to itself: that is the
        same for all, and worked out once.
        """
        decoder, ahead = self.act.decoder, self.act.decoder_pos_embed.weight[None]
        first, *others = cast("list[DecoderLayer]", list(decoder.layers))
        same = first.norm1(first.self_attn(ahead, ahead, torch.zeros_like(ahead)))
        ahead = ahead.expand(len(memory), -1, -1)
        x = same.expand(len(memory), -1, -1)
        x = first.norm2(x + first.multihead_attn(x + ahead, memory + place, memory))
        x = first.norm3(x + first.linear2(torch.relu(first.linear1(x))))
        for layer in others:
            x = layer(x, ahead, memory, place)
        return decoder.norm(x)

    def actions(self, chunks: Tensor) -> Tensor:
        """Return raw actions of normalised ones."""
        moments = self.act.normalize.action
        return chunks * moments.std + moments.mean


def _image_channels(sees: Sees) -> int:
    """Return the channels of all images that a student is given at a time."""
    return sees.frames * (COLOURS * sees.rgb + sees.depth)


def _sizes(sizes: NetworkSizes, *, channels: int, proprio: int) -> ActSizes:
    backbone: dict[str, tuple[int, ...]] = {}
    inputs = channels
    for number, outputs in enumerate(sizes.convolutions):
        kernel = _KERNELS[min(number, 1)]
        backbone[f"{2 * number}.weight"] = (outputs, inputs, kernel, kernel)
        backbone[f"{2 * number}.bias"] = (outputs,)
        inputs = outputs
    return ActSizes(
        width=sizes.width,
        heads=sizes.heads,
        feedforward=sizes.feedforward,
        encoder_layers=sizes.encoder_layers,
        decoder_layers=sizes.decoder_layers,
        pre_norm=False,
        proprio=proprio,
        latent=1,
        actions=JOINTS,
        chunk=sizes.chunk,
        backbone=backbone,
        normalized=True,
    )


def write_policy(
    folder: Path,
    network: StudentNetwork,
    config: StudentConfig,
    teacher: Card,
    *,
    is_blind: bool = False,
) -> None:
    """Write a student as a policy folder; its files appear whole, the card last.

    One that sees is two graphs: that of images alone runs once an image.

    Args:
        folder: of the policy.
        network: trained.
        config: of the training.
        teacher: the teacher's card.
        is_blind: whether it is the network that has the mean image for good, to be compared with
            the one that sees.

    Raises:
        PrerequisiteError: as `graph_of`.
        StoreError: it cannot be written.
    """
    graphs = {NETWORK_FILE: graph_of(network, config, is_blind=is_blind)}
    if not is_blind:
        graphs[ENCODER_FILE] = encoder_of(network, config)
    name = f"{config.name}-frozen" if is_blind else config.name
    card = student_card(
        name,
        config.sees,
        teacher,
        sha256={file: sha256(graph).hexdigest() for file, graph in graphs.items()},
        is_blind=is_blind,
        scenes=config.scenes,
    )
    for file, graph in graphs.items():
        with atomic_path(folder / file) as temporary:
            temporary.write_bytes(graph)
    with atomic_path(folder / CARD_FILE) as temporary:
        temporary.write_text(card_text(card), encoding="utf-8")


def graph_of(network: StudentNetwork, config: StudentConfig, *, is_blind: bool = False) -> bytes:
    """Return a network as an ONNX file, but for what it makes of images alone: see `encoder_of`.

    Raises:
        PrerequisiteError: the package `onnx`, which torch exports with, is not installed.
    """
    acting = _Acting(_for_export(network), config, is_blind=is_blind)
    return _exported(acting, acting.example(), ["action", "sums_out"])


def encoder_of(network: StudentNetwork, config: StudentConfig) -> bytes:
    """Return what a network makes of images alone as an ONNX file.

    Raises:
        PrerequisiteError: as `graph_of`.
    """
    encoder = _Encoder(_for_export(network))
    return _exported(encoder, encoder.example(config.sees), [SEEN])


def _for_export(network: StudentNetwork) -> StudentNetwork:
    return deepcopy(network).cpu().eval()


def _exported(module: nn.Module, inputs: dict[str, Tensor], outputs: list[str]) -> bytes:
    file: Any = io.BytesIO()  # Its type is said too narrowly there: a file's path.
    with warnings.catch_warnings(), torch.inference_mode():
        # Sizes are constant here on purpose, and the exporter that takes no other package is old.
        warnings.simplefilter("ignore")
        try:
            torch.onnx.export(
                module,
                tuple(inputs.values()),
                file,
                dynamo=False,
                opset_version=_OPSET,
                input_names=list(inputs),
                output_names=outputs,
            )
        except torch.onnx.OnnxExporterError as error:
            raise PrerequisiteError(
                f"a student cannot be exported: {error}", fix="pip install 'nw-eval[learn]'"
            ) from None
    return file.getvalue()


class _Encoder(nn.Module):
    """What the network makes of the images of the card alone.

    Args:
        network: trained.
    """

    def __init__(self, network: StudentNetwork) -> None:
        super().__init__()
        self._network = network

    def forward(self, *images: Tensor) -> Tensor:
        """Return it, (1, places, width).

        Args:
            images: of the card, (1, channels, rows, columns) each, rgb as bytes.
        """
        return self._network.seen(torch.cat([as_numbers(image) for image in images], dim=1))

    def example(self, sees: Sees) -> dict[str, Tensor]:
        """Return inputs of the right shapes, by name."""
        inputs: dict[str, Tensor] = {}
        for eye in sees.cameras:
            is_colour = eye == "rgb"
            channels = sees.frames * (COLOURS if is_colour else 1)
            kind = torch.uint8 if is_colour else torch.float32
            inputs[eye] = torch.zeros(1, channels, sees.height, sees.width, dtype=kind)
        return inputs


class _Acting(nn.Module):
    """The rest of the network in one trial: to an action, step by step.

    Args:
        network: trained.
        config: of the training.
        is_blind: whether the mean image stands for all that would be seen.
    """

    def __init__(self, network: StudentNetwork, config: StudentConfig, *, is_blind: bool) -> None:
        super().__init__()
        self._network = network
        self._is_blind = is_blind
        self._growth = math.exp(config.network.ensemble)

    def forward(self, proprio: Tensor, *rest: Tensor) -> tuple[Tensor, Tensor]:
        """Return the action, (1, 12), and the sums of predictions, (1, chunk, 13).

        Args:
            proprio: (1, proprio).
            rest: what the encoder gave, unless it is blind; then the sums of the step before, zeros
                at first: predictions for this step and the next ones, times their weights, and the
                weights.
        """
        *given, sums = rest
        network = self._network
        seen = given[0] if given else network.seen(network.mean_image[None])
        chunk = network.actions(network.decided(proprio, seen))
        new = torch.cat([chunk, torch.ones_like(chunk[..., :1])], dim=2)
        older = torch.cat([sums[:, 1:], torch.zeros_like(sums[:, :1])], dim=1)
        total = new + self._growth * older
        return total[:, 0, :JOINTS] / total[:, 0, JOINTS:], total

    def example(self) -> dict[str, Tensor]:
        """Return inputs of the right shapes, by name."""
        network, sizes = self._network, self._network.act.sizes
        inputs = {"proprio": torch.zeros(1, sizes.proprio)}
        if not self._is_blind:
            inputs[SEEN] = torch.zeros_like(network.seen(network.mean_image[None]))
        return inputs | {"sums_in": torch.zeros(1, sizes.chunk, JOINTS + 1)}


def as_numbers(image: Tensor) -> Tensor:
    """Return an image from 0 to 1: bytes are shares of 255, other numbers are so already."""
    return image.to(torch.float32) / _BYTE if image.dtype == torch.uint8 else image
