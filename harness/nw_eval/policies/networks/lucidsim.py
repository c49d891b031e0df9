"""The LucidSim transformer: seven frames and seven proprioceptive vectors to one action.

57 entries in its state dict, 1,823,972 numbers, 260 tokens. Blocks follow each other without
residual connection and without a last norm; each computes attention and feed-forward side by side
from one projection, with eight query heads that share one key and one value head.
"""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

FRAMES = 7
PROPRIO = 53
IMAGE = (3, 45, 80)  # channels, rows, columns
TOKENS = 260  # 7 vectors, 7 x 4 x 9 image patches, 1 action
_WIDTH, _HEADS, _HEAD, _INNER, _LAYERS = 128, 8, 64, 512, 5
_ACTION_TOKENS = 300  # Learned; evaluation uses the first.


class LucidSimTransformer(nn.Module):
    """Module names are those of the published state dict. `yaw_proj` takes no part in inference."""

    def __init__(self) -> None:
        super().__init__()
        self.act_tokens = nn.Parameter(torch.empty(1, _ACTION_TOKENS, _WIDTH))
        self.transformer = nn.ModuleList([Block() for _ in range(_LAYERS)])
        self.obs_enc = nn.Conv1d(PROPRIO, _WIDTH, kernel_size=1)
        self.img_enc = nn.Sequential(
            nn.BatchNorm2d(3),
            nn.Conv2d(3, 64, kernel_size=8, stride=8),
            nn.ReLU(),
            nn.Conv2d(64, _WIDTH, kernel_size=2),
        )
        self.act_proj = nn.Sequential(nn.Linear(_WIDTH, 12))
        self.yaw_proj = nn.Sequential(
            nn.Linear(_WIDTH, 64), nn.Tanh(), nn.Linear(64, 32), nn.Tanh(),
            nn.Linear(32, 16), nn.Tanh(), nn.Linear(16, 2),
        )  # fmt: skip

    def forward(self, proprio: Tensor, frames: Tensor) -> Tensor:
        """Return raw actions.

        Args:
            proprio: (1, 7, 53).
            frames: (1, 7, 3, 45, 80), (byte - 127.5) / 255, oldest first.

        Returns:
            (1, 12).
        """
        vectors = self.obs_enc(proprio.transpose(1, 2)).transpose(1, 2)
        patches = self.img_enc(frames[0]).flatten(2).transpose(1, 2).reshape(1, -1, _WIDTH)
        x = torch.cat([vectors, patches, self.act_tokens[:, :1]], dim=1)[0]
        turns = rotations(cast("Block", self.transformer[0]).rotary_emb.inv_freq, TOKENS)
        for block in self.transformer[:-1]:
            x = block(x, turns)
        # Only the action token leaves the last block, so only its query is computed.
        return self.act_proj(self.transformer[-1](x, turns, queries=1))


class Block(nn.Module):
    """Attention and feed-forward in parallel, from one projection."""

    def __init__(self) -> None:
        super().__init__()
        self.norm = Norm()
        self.rotary_emb = Rotary()
        self.fused_attn_ff_proj = nn.Linear(_WIDTH, _INNER + 2 * _HEAD + 2 * _INNER, bias=False)
        self.attn_out = nn.Linear(_INNER, _WIDTH, bias=False)
        self.ff_out = nn.Sequential(
            nn.Identity(), nn.Identity(), nn.Linear(_INNER, _WIDTH, bias=False)
        )

    def forward(self, x: Tensor, turns: Tensor, queries: int = TOKENS) -> Tensor:
        """Return the last `queries` tokens of the block's output.

        Args:
            x: tokens, (260, 128).
            turns: from `rotations`, (260, 32) complex.
            queries: how many tokens, from the end.

        Returns:
            (queries, 128).
        """
        h = functional.layer_norm(x, (_WIDTH,), self.norm.gamma, self.norm.beta)
        weight = self.fused_attn_ff_proj.weight
        w_query, w_memory, w_forward = weight.split((_INNER, 2 * _HEAD, 2 * _INNER))
        recent = h[-queries:]
        memory = functional.linear(h, w_memory)
        key, value = turn(memory[:, :_HEAD], turns), memory[:, _HEAD:]
        # Heads share keys, so all queries of all heads make one matrix.
        query = turn(
            functional.linear(recent, w_query).view(-1, _HEADS, _HEAD), turns[-queries:, None]
        )
        scores = (query.reshape(-1, _HEAD) * _HEAD**-0.5) @ key.T
        attended = (scores.softmax(dim=-1) @ value).view(-1, _INNER)
        forward, gate = functional.linear(recent, w_forward).chunk(2, dim=-1)
        return self.attn_out(attended) + self.ff_out[2](functional.silu(gate) * forward)


class Norm(nn.Module):
    """Scale of a layer norm whose shift is a buffer of zeros."""

    beta: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.empty(_WIDTH))
        self.register_buffer("beta", torch.empty(_WIDTH))


class Rotary(nn.Module):
    """Frequencies of the rotary embedding. `scale` is for causal models, which this is not."""

    inv_freq: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("inv_freq", torch.empty(_HEAD // 2))
        self.register_buffer("scale", torch.empty(_HEAD // 2))


def rotations(frequencies: Tensor, tokens: int) -> Tensor:
    """Return exp(i * position * frequency), (tokens, 32) complex."""
    angles = torch.arange(tokens, dtype=torch.float32)[:, None] * frequencies
    return torch.polar(torch.ones_like(angles), angles)


def turn(x: Tensor, turns: Tensor) -> Tensor:
    """Rotate pairs of numbers: the first half of the last axis with the second half."""
    first, second = x.chunk(2, dim=-1)
    turned = torch.complex(first, second) * turns
    return torch.cat([turned.real, turned.imag], dim=-1)
