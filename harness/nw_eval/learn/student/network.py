"""The student's network: ACT (arXiv 2304.13705) as the adapter `act` runs it, for many at a time.

The latent variable, which the paper needs because people demonstrate in many ways, is left at zero
for good: one teacher answers one way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor, nn

from nw_eval.policies.networks.act import Act, ActSizes, DecoderLayer, image_places

if TYPE_CHECKING:
    from nw_eval.learn.student.config import NetworkSizes, Sees

JOINTS = 12
COLOURS = 3

_KERNELS = (5, 3)
"""Of the first convolution, and of the others."""
_FARTHEST = 8.0
"""Standard deviations from the mean beyond which a number of the body says no more."""


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
            sees: likewise.
            proprio: numbers of the body.
        """
        super().__init__()
        channels = image_channels(sees)
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

    def forward(self, proprio: Tensor, images: Tensor, image_of: Tensor) -> Tensor:
        """Return chunks of normalised actions, (N, chunk, 12), the present step's first.

        Args:
            proprio: (N, proprio).
            images: (M, channels, rows, columns), 0 to 1.
            image_of: (N,) which of the M images is the newest of each row of numbers.
        """
        act, width = self.act, self.act.sizes.width
        moments = act.normalize.proprio
        body = ((proprio - moments.mean) / moments.std).clamp(-_FARTHEST, _FARTHEST)
        maps = act.encoder_img_feat_input_proj(act.backbone(images - self.mean_image))
        seen = maps.flatten(2).transpose(1, 2)[image_of]
        latent = act.encoder_latent_input_proj(body.new_zeros(len(body), act.sizes.latent))
        state = act.encoder_robot_state_input_proj(body)
        tokens = torch.cat([latent[:, None], state[:, None], seen], dim=1)
        own = act.encoder_1d_feature_pos_embed.weight
        place = torch.cat([own, image_places(maps.shape[2], maps.shape[3], width).to(own)])[None]
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


def image_channels(sees: Sees) -> int:
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
