"""ACT: a transformer that turns images and proprioception into a chunk of future actions.

From arXiv 2304.13705, inference only: the latent variable of the training is zero. The state dict
has the names of LeRobot's ACT, whose leading `model.` may be left out:

    backbone.*                          image encoder, see `_backbone_for`; none without images
    encoder_img_feat_input_proj.*       1 x 1 convolution, feature maps to width
    encoder_robot_state_input_proj.*    linear, proprioception to width
    encoder_latent_input_proj.*         linear, latent to width; the latent is zeros
    encoder_1d_feature_pos_embed.weight (2, width) places of latent and proprioception
    encoder.layers.N.*                  self_attn, linear1, linear2, norm1, norm2
    encoder.norm.*                      only where layers normalise first
    decoder_pos_embed.weight            (chunk, width), one place for each future action
    decoder.layers.N.*                  self_attn, multihead_attn, linear1, linear2, norm1..norm3
    decoder.norm.*                      after the last layer
    action_head.*                       linear, width to actions
    normalize.{proprio,action}.{mean,std}   optional: (x - mean) / std going in, the inverse out
    vae_encoder*                        used in training only, left out

Sizes are those of the tensors. How many heads share the width is not in them: the card says it.

Image encoders of ACT: ResNet-18 or 34 without its head, or a plain stack of convolutions.

Which of them a state dict holds is read from its names: `conv1`, `bn1`, `layer1.0.conv1`, ... are
torchvision's ResNet; `0`, `2`, `4`, ... are convolutions of stride 2, each followed by a ReLU.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from nw_base.errors import PolicyError
from nw_policies.networks.parameters import build

_UNUSED = ("vae_encoder", "num_batches_tracked")
Shapes = Mapping[str, tuple[int, ...]]


@dataclass(frozen=True, kw_only=True)
class ActSizes:
    """Sizes of an ACT network."""

    width: int
    heads: int
    feedforward: int
    encoder_layers: int
    decoder_layers: int
    pre_norm: bool
    """Whether layers normalise their input instead of their output."""
    proprio: int
    latent: int
    actions: int
    chunk: int
    """Actions of one forward pass."""
    backbone: Shapes
    """Shapes of the image encoder's tensors; empty without images."""
    normalized: bool
    """Whether mean and standard deviation of proprioception and actions are in the file."""


class Act(nn.Module):
    """Encoder over latent, proprioception and image tokens; decoder over future steps."""

    def __init__(self, sizes: ActSizes) -> None:
        super().__init__()
        width = sizes.width
        self.sizes = sizes
        if sizes.backbone:
            self.backbone = _backbone_for(sizes.backbone)
            maps = _output_channels(sizes.backbone)
            self.encoder_img_feat_input_proj = nn.Conv2d(maps, width, kernel_size=1)
        self.encoder_robot_state_input_proj = nn.Linear(sizes.proprio, width)
        self.encoder_latent_input_proj = nn.Linear(sizes.latent, width)
        self.encoder_1d_feature_pos_embed = nn.Embedding(2, width)
        self.encoder = Encoder(sizes)
        self.decoder_pos_embed = nn.Embedding(sizes.chunk, width)
        self.decoder = Decoder(sizes)
        self.action_head = nn.Linear(width, sizes.actions)
        if sizes.normalized:
            self.normalize = Statistics(sizes)

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor], where: str, *, heads: int) -> Act:
        """Take the weights of a file.

        Raises:
            PolicyError: a part is missing or has other shapes, or the heads do not divide the
                width.
        """
        names = {name.removeprefix("model."): tensor for name, tensor in tensors.items()}
        sizes = read_sizes(names, where, heads=heads)
        return build(lambda: cls(sizes), names, where, unused=_UNUSED)

    def forward(self, proprio: Tensor, images: Tensor | None) -> Tensor:
        """Return a chunk of raw actions, (chunk, actions), the present step's first.

        Args:
            proprio: (1, proprio).
            images: (n, channels, rows, columns), one for each camera or frame; None without.
        """
        if self.sizes.normalized:
            moments = self.normalize.proprio
            proprio = (proprio - moments.mean) / moments.std
        tokens = [
            self.encoder_latent_input_proj(proprio.new_zeros(1, self.sizes.latent)),
            self.encoder_robot_state_input_proj(proprio),
        ]
        places = [self.encoder_1d_feature_pos_embed.weight]
        if images is not None:
            features = self.encoder_img_feat_input_proj(self.backbone(images))
            place = image_places(features.shape[2], features.shape[3], self.sizes.width)
            for feature in features:
                tokens.append(feature.flatten(1).T)
                places.append(place)
        place = torch.cat(places)[None]
        memory = self.encoder(torch.cat(tokens)[None], place)
        decoded = self.decoder(memory, place, self.decoder_pos_embed.weight[None])
        actions = self.action_head(decoded)[0]
        if self.sizes.normalized:
            moments = self.normalize.action
            actions = actions * moments.std + moments.mean
        return actions


class Statistics(nn.Module):
    """Statistics of what goes in and comes out."""

    def __init__(self, sizes: ActSizes) -> None:
        super().__init__()
        self.proprio = Moments(sizes.proprio)
        self.action = Moments(sizes.actions)


class Moments(nn.Module):
    """Mean and standard deviation of a vector."""

    mean: Tensor
    std: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.empty(size))
        self.register_buffer("std", torch.empty(size))


class Encoder(nn.Module):
    """Layers of self-attention."""

    def __init__(self, sizes: ActSizes) -> None:
        super().__init__()
        self.layers = nn.ModuleList([EncoderLayer(sizes) for _ in range(sizes.encoder_layers)])
        self.norm = nn.LayerNorm(sizes.width) if sizes.pre_norm else nn.Identity()

    def forward(self, x: Tensor, place: Tensor) -> Tensor:
        """Return (1, tokens, width)."""
        for layer in self.layers:
            x = layer(x, place)
        return self.norm(x)


class EncoderLayer(nn.Module):
    """Self-attention with places added to queries and keys, then feed-forward."""

    def __init__(self, sizes: ActSizes) -> None:
        super().__init__()
        width = sizes.width
        self.pre_norm = sizes.pre_norm
        self.self_attn = Attention(width, sizes.heads)
        self.linear1 = nn.Linear(width, sizes.feedforward)
        self.linear2 = nn.Linear(sizes.feedforward, width)
        self.norm1 = nn.LayerNorm(width)
        self.norm2 = nn.LayerNorm(width)

    def forward(self, x: Tensor, place: Tensor) -> Tensor:
        """Return (1, tokens, width)."""
        before, after = _order(self.pre_norm)
        h = before(self.norm1, x)
        x = after(self.norm1, x + self.self_attn(h + place, h + place, h))
        h = before(self.norm2, x)
        return after(self.norm2, x + self.linear2(functional.relu(self.linear1(h))))


class Decoder(nn.Module):
    """Layers that ask the encoder's memory what to do at each future step."""

    def __init__(self, sizes: ActSizes) -> None:
        super().__init__()
        self.layers = nn.ModuleList([DecoderLayer(sizes) for _ in range(sizes.decoder_layers)])
        self.norm = nn.LayerNorm(sizes.width)

    def forward(self, memory: Tensor, memory_place: Tensor, place: Tensor) -> Tensor:
        """Return (1, chunk, width)."""
        x = torch.zeros_like(place)
        for layer in self.layers:
            x = layer(x, place, memory, memory_place)
        return self.norm(x)


class DecoderLayer(nn.Module):
    """Self-attention, attention to the memory, feed-forward."""

    def __init__(self, sizes: ActSizes) -> None:
        super().__init__()
        width = sizes.width
        self.pre_norm = sizes.pre_norm
        self.self_attn = Attention(width, sizes.heads)
        self.multihead_attn = Attention(width, sizes.heads)
        self.linear1 = nn.Linear(width, sizes.feedforward)
        self.linear2 = nn.Linear(sizes.feedforward, width)
        self.norm1 = nn.LayerNorm(width)
        self.norm2 = nn.LayerNorm(width)
        self.norm3 = nn.LayerNorm(width)

    def forward(self, x: Tensor, place: Tensor, memory: Tensor, memory_place: Tensor) -> Tensor:
        """Return (1, chunk, width)."""
        before, after = _order(self.pre_norm)
        h = before(self.norm1, x)
        x = after(self.norm1, x + self.self_attn(h + place, h + place, h))
        h = before(self.norm2, x)
        x = after(self.norm2, x + self.multihead_attn(h + place, memory + memory_place, memory))
        h = before(self.norm3, x)
        return after(self.norm3, x + self.linear2(functional.relu(self.linear1(h))))


class Attention(nn.Module):
    """Scaled dot-product attention with the parameter names of `nn.MultiheadAttention`."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.in_proj_weight = nn.Parameter(torch.empty(3 * width, width))
        self.in_proj_bias = nn.Parameter(torch.empty(3 * width))
        self.out_proj = nn.Linear(width, width)

    def forward(self, query: Tensor, key: Tensor, value: Tensor) -> Tensor:
        """Attend; all (1, n, width), `key` and `value` of one length."""
        parts = zip(
            (query, key, value),
            self.in_proj_weight.chunk(3),
            self.in_proj_bias.chunk(3),
            strict=True,
        )
        q, k, v = (self._split(functional.linear(x, w, b)) for x, w, b in parts)
        attended = functional.scaled_dot_product_attention(q, k, v)
        return self.out_proj(attended.transpose(1, 2).flatten(2))

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(2, (self.heads, -1)).transpose(1, 2)


def _order(pre_norm: bool):  # noqa: ANN202 - two small functions of (norm, x).
    """Return what to do before and after each part of a layer."""

    def apply(norm: nn.Module, x: Tensor) -> Tensor:
        return norm(x)

    def keep(norm: nn.Module, x: Tensor) -> Tensor:  # noqa: ARG001 - as `apply`.
        return x

    return (apply, keep) if pre_norm else (keep, apply)


def image_places(rows: int, columns: int, width: int) -> Tensor:
    """Return sinusoidal places of image tokens, (rows * columns, width): half for y, half for x."""
    half = width // 2
    frequency = 10000.0 ** (2 * (torch.arange(half, dtype=torch.float32) // 2) / half)

    def waves(count: int) -> Tensor:
        angle = torch.arange(1, count + 1, dtype=torch.float32) / (count + 1e-6) * 2 * math.pi
        angles = angle[:, None] / frequency
        return torch.stack([angles[:, 0::2].sin(), angles[:, 1::2].cos()], dim=2).flatten(1)

    y = waves(rows)[:, None].expand(rows, columns, half)
    x = waves(columns)[None].expand(rows, columns, half)
    return torch.cat([y, x], dim=2).flatten(0, 1)


def read_sizes(tensors: Mapping[str, Tensor], where: str, *, heads: int) -> ActSizes:
    """Read the sizes of a network from its tensors.

    Raises:
        PolicyError: an essential tensor is missing, or the heads do not divide the width.
    """
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    essential = {
        "encoder_robot_state_input_proj.weight": 2,
        "encoder_latent_input_proj.weight": 2,
        "decoder_pos_embed.weight": 2,
        "action_head.weight": 2,
        "encoder.layers.0.linear1.weight": 2,
    }
    for name, axes in essential.items():
        if len(shapes.get(name, ())) != axes:
            raise PolicyError(
                f"{where}: the weights are not those of Act: no matrix {name!r}",
                fix="rename the tensors to the layout in nw_policies/networks/act.py",
            )
    width, proprio = shapes["encoder_robot_state_input_proj.weight"]
    if heads < 1 or width % heads or width % 4:
        raise PolicyError(
            f"{where}: {heads} attention heads cannot share a width of {width}",
            fix="correct `options: {heads: ...}` on the card",
        )
    prefix = "backbone."
    encoder = {k.removeprefix(prefix): s for k, s in shapes.items() if k.startswith(prefix)}
    return ActSizes(
        width=width,
        heads=heads,
        feedforward=shapes["encoder.layers.0.linear1.weight"][0],
        encoder_layers=_layers(shapes, "encoder"),
        decoder_layers=_layers(shapes, "decoder"),
        pre_norm="encoder.norm.weight" in shapes,
        proprio=proprio,
        latent=shapes["encoder_latent_input_proj.weight"][1],
        actions=shapes["action_head.weight"][0],
        chunk=shapes["decoder_pos_embed.weight"][0],
        backbone=encoder,
        normalized=any(name.startswith("normalize.") for name in shapes),
    )


def _layers(shapes: Shapes, part: str) -> int:
    matches = (re.match(rf"{part}\.layers\.(\d{{1,3}})\.", name) for name in shapes)
    return 1 + max((int(match[1]) for match in matches if match), default=-1)


def _backbone_for(shapes: Shapes) -> nn.Module:
    """Return the encoder whose state dict has these shapes."""
    return ResNet(shapes) if "conv1.weight" in shapes else _ConvStack(shapes)


def _output_channels(shapes: Shapes) -> int:
    """Return the number of feature maps that an encoder ends with: its last convolution's."""
    kernels = [
        shape for name, shape in shapes.items() if len(shape) == 4 and "downsample" not in name
    ]
    return kernels[-1][0] if kernels else 0


class _ConvStack(nn.Sequential):
    """Convolutions of stride 2 with ReLU; each halves the image, rounding up."""

    def __init__(self, shapes: Shapes) -> None:
        layers: list[nn.Module] = []
        for name, shape in shapes.items():
            if name.endswith(".weight") and len(shape) == 4:
                outputs, inputs, kernel, _ = shape
                layers += [
                    nn.Conv2d(inputs, outputs, kernel, stride=2, padding=kernel // 2),
                    nn.ReLU(),
                ]
        super().__init__(*layers)


class _FrozenNorm(nn.Module):
    """Batch norm with fixed statistics."""

    weight: Tensor
    bias: Tensor
    running_mean: Tensor
    running_var: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        for name in ("weight", "bias", "running_mean", "running_var"):
            self.register_buffer(name, torch.empty(channels))

    def forward(self, x: Tensor) -> Tensor:
        """Normalise (n, channels, rows, columns)."""
        return functional.batch_norm(x, self.running_mean, self.running_var, self.weight, self.bias)


class _BasicBlock(nn.Module):
    """Two 3 x 3 convolutions and a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False)
        self.bn1 = _FrozenNorm(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.bn2 = _FrozenNorm(outputs)
        self.downsample = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride=stride, bias=False), _FrozenNorm(outputs)
            )

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, outputs, rows / stride, columns / stride)."""
        short = x if self.downsample is None else self.downsample(x)
        return functional.relu(
            self.bn2(self.conv2(functional.relu(self.bn1(self.conv1(x))))) + short
        )


class ResNet(nn.Module):
    """ResNet of basic blocks up to its last feature map."""

    def __init__(self, shapes: Shapes) -> None:
        super().__init__()
        channels, inputs, _, _ = shapes["conv1.weight"]
        self.conv1 = nn.Conv2d(inputs, channels, 7, stride=2, padding=3, bias=False)
        self.bn1 = _FrozenNorm(channels)
        for stage in range(1, 5):
            blocks: list[nn.Module] = []
            outputs = 64 * 2 ** (stage - 1)
            for block in range(_count(shapes, f"layer{stage}.")):
                stride = 2 if stage > 1 and block == 0 else 1
                blocks.append(_BasicBlock(channels, outputs, stride))
                channels = outputs
            self.add_module(f"layer{stage}", nn.Sequential(*blocks))

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, 512, rows / 32, columns / 32)."""
        x = functional.max_pool2d(functional.relu(self.bn1(self.conv1(x))), 3, stride=2, padding=1)
        for stage in range(1, 5):
            x = getattr(self, f"layer{stage}")(x)
        return x


def _count(names: Iterable[str], prefix: str) -> int:
    """Return how many numbered parts follow a prefix: `layer1.0`, `layer1.1` are two."""
    return len({name[len(prefix) :].split(".")[0] for name in names if name.startswith(prefix)})
