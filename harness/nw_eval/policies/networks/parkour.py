"""Both networks of extreme-parkour.

The extreme-parkour expert: scandots, history and an estimate of hidden quantities to an action.

Weights lie in two state dicts of one file: `model_state_dict`, whose keys begin with `actor.`, and
`estimator_state_dict`. 276,055 numbers together, of which the encoder of privileged quantities is
used in training only.

The extreme-parkour student: depth images in place of scandots, with a recurrent state.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from nw_eval.errors import PolicyError
from nw_eval.policies.networks.parameters import build, mlp
from nw_eval.policies.safety import tensors_below

PROPRIO = 53
SCANDOTS = 132
HISTORY = 10  # earlier frames
LATENT = 32  # of the scandots
HIDDEN = 512
YAW_GAIN = 1.5  # rad for each unit of the predicted heading
# Numbers left after both convolutions, by the size of the image: rows, columns.
_IMAGES = {64 * 18 * 36: (45, 80), 64 * 25 * 39: (58, 87)}


class ParkourActor(nn.Module):
    """Module names are those of the published `actor.`."""

    def __init__(self) -> None:
        super().__init__()
        self.scan_encoder = mlp((SCANDOTS, 128, 64, LATENT), last=nn.Tanh())
        self.priv_encoder = mlp((29, 64, 20), last=nn.ELU())
        self.history_encoder = HistoryEncoder()
        self.actor_backbone = mlp((PROPRIO + LATENT + 9 + 20, 512, 256, 128, 12))

    def forward(self, proprio: Tensor, latent: Tensor, estimate: Tensor, history: Tensor) -> Tensor:
        """Return raw actions (1, 12).

        Args:
            proprio: (1, 53).
            latent: of the scandots or of depth images, (1, 32).
            estimate: of the trunk's velocity and other hidden quantities, (1, 9).
            history: earlier proprio, oldest first, heading numbers 6 and 7 zero, (1, 10, 53).
        """
        past = self.history_encoder(history)
        return self.actor_backbone(torch.cat([proprio, latent, estimate, past], dim=1))


class HistoryEncoder(nn.Module):
    """Ten frames to 20 numbers."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(PROPRIO, 30), nn.ELU())
        self.conv_layers = nn.Sequential(
            nn.Conv1d(30, 20, kernel_size=4, stride=2), nn.ELU(),
            nn.Conv1d(20, 10, kernel_size=2), nn.ELU(), nn.Flatten(),
        )  # fmt: skip
        self.linear_output = nn.Sequential(nn.Linear(30, 20), nn.ELU())

    def forward(self, history: Tensor) -> Tensor:
        """Encode (1, 10, 53)."""
        return self.linear_output(self.conv_layers(self.encoder(history).transpose(1, 2)))


class Estimator(nn.Module):
    """Proprioception to nine hidden quantities."""

    def __init__(self) -> None:
        super().__init__()
        self.estimator = mlp((PROPRIO, 128, 64, 9))

    def forward(self, proprio: Tensor) -> Tensor:
        """Estimate from (1, 53)."""
        return self.estimator(proprio)


class ParkourExpert(nn.Module):
    """Actor and estimator together."""

    def __init__(self, actor: ParkourActor, estimator: Estimator) -> None:
        super().__init__()
        self.actor = actor
        self.estimator = estimator

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor], where: str) -> ParkourExpert:
        """Take the weights of a published file; critic and noise in it are left out.

        Raises:
            PolicyError: a part is missing or has other shapes.
        """
        actor = tensors_below(tensors, "model_state_dict.actor.")
        estimator = tensors_below(tensors, "estimator_state_dict.")
        return cls(build(ParkourActor, actor, where), build(Estimator, estimator, where))

    def forward(self, proprio: Tensor, scandots: Tensor, history: Tensor) -> Tensor:
        """Return raw actions (1, 12); arguments as `ParkourActor`, scandots (1, 132)."""
        latent = self.actor.scan_encoder(scandots)
        return self.actor(proprio, latent, self.estimator(proprio), history)


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
