"""The extreme-parkour student: depth images in place of scandots, with a recurrent state."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from nw_eval.errors import PolicyError
from nw_eval.policies.networks.parameters import build, mlp
from nw_eval.policies.networks.parkour_expert import LATENT, PROPRIO, Estimator, ParkourActor
from nw_eval.policies.safety import tensors_below

HIDDEN = 512
YAW_GAIN = 1.5  # rad for each unit of the predicted heading
# Numbers left after both convolutions, by the size of the image: rows, columns.
_IMAGES = {64 * 18 * 36: (45, 80), 64 * 25 * 39: (58, 87)}


class DepthImageEncoder(nn.Module):
    """One depth image to 32 numbers."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.image_compression = nn.Sequential(
            nn.Conv2d(1, 32, kernel_size=5), nn.MaxPool2d(2), nn.ELU(),
            nn.Conv2d(32, 64, kernel_size=3), nn.ELU(), nn.Flatten(),
            nn.Linear(features, 128), nn.ELU(), nn.Linear(128, LATENT), nn.ELU(),
        )  # fmt: skip

    def forward(self, depth: Tensor) -> Tensor:
        """Encode (1, rows, columns)."""
        return self.image_compression(depth[:, None])


class DepthEncoder(nn.Module):
    """Depth images, one after another, to the latent of the scandots and a heading."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.base_backbone = DepthImageEncoder(features)
        self.combination_mlp = mlp((LATENT + PROPRIO, 128, LATENT))
        self.rnn = nn.GRU(LATENT, HIDDEN, batch_first=True)
        self.output_mlp = nn.Sequential(nn.Linear(HIDDEN, LATENT + 2), nn.Tanh())

    def forward(self, depth: Tensor, proprio: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Return latent and heading (1, 34), and the next hidden state (1, 1, 512)."""
        seen = self.combination_mlp(torch.cat([self.base_backbone(depth), proprio], dim=1))
        output, hidden = self.rnn(seen[:, None], hidden)
        return self.output_mlp(output[:, 0]), hidden


class ParkourStudent(nn.Module):
    """Depth encoder, actor and estimator. It holds no state: `see` takes and returns it."""

    def __init__(
        self,
        encoder: DepthEncoder,
        actor: ParkourActor,
        estimator: Estimator,
        image: tuple[int, int],
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.actor = actor
        self.estimator = estimator
        self.image = image
        """Rows and columns of the depth image."""

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor], where: str) -> ParkourStudent:
        """Take the weights of a published file.

        Its own actor, `depth_actor_state_dict`, is used where there is one, else the expert's.

        Raises:
            PolicyError: a part is missing or has other shapes, or the depth image has a size that
                was never published.
        """
        encoder = tensors_below(tensors, "depth_encoder_state_dict.")
        if not encoder:
            raise PolicyError(
                f"{where}: no `depth_encoder_state_dict`: this is an expert, not a depth student",
                fix="feed it `scandots` on the card, or give the student's checkpoint",
            )
        flat = encoder.get("base_backbone.image_compression.6.weight")
        features = flat.shape[-1] if flat is not None and flat.ndim else 0
        if features not in _IMAGES:
            known = " or ".join(f"{rows} x {columns}" for rows, columns in _IMAGES.values())
            raise PolicyError(
                f"{where}: the depth encoder takes {features} image features; images of {known} "
                "are known",
                fix="export the student with torch.export and use that adapter",
            )
        actor = (
            tensors_below(tensors, "depth_actor_state_dict.actor.")
            or tensors_below(tensors, "depth_actor_state_dict.")
            or tensors_below(tensors, "model_state_dict.actor.")
        )
        return cls(
            build(lambda: DepthEncoder(features), encoder, where),
            build(ParkourActor, actor, where),
            build(Estimator, tensors_below(tensors, "estimator_state_dict."), where),
            _IMAGES[features],
        )

    def see(self, depth: Tensor, proprio: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Return latent and heading (1, 34), and the next hidden state (1, 1, 512).

        The waypoint's heading is hidden from the encoder, which learns to see it.
        """
        blind = proprio.clone()
        blind[:, 6:8] = 0.0
        return self.encoder(depth, blind, hidden)

    def forward(
        self, proprio: Tensor, seen: Tensor, history: Tensor, *, steer_by_depth: bool
    ) -> Tensor:
        """Return raw actions (1, 12).

        Args:
            proprio: (1, 53).
            seen: latent and heading from `see`, (1, 34).
            history: as the expert's, (1, 10, 53).
            steer_by_depth: whether the heading seen replaces the waypoint's in `proprio`.
        """
        if steer_by_depth:
            proprio = proprio.clone()
            proprio[:, 6:8] = YAW_GAIN * seen[:, LATENT:]
        return self.actor(proprio, seen[:, :LATENT], self.estimator(proprio), history)
