"""The LucidSim transformer: seven frames and seven proprioceptive vectors to one action.

57 entries in its state dict, 1,823,972 numbers, 260 tokens. Blocks follow each other without
residual connection and without a last norm; each computes attention and feed-forward side by side
from one projection, with eight query heads that share one key and one value head.

The weights live in a module with the published names. onnxruntime runs them: its kernels
take three quarters of the time of torch's, and it keeps its memory from step to step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from nw_eval.policies.networks.onnx_graph import Graph
from nw_eval.policies.safety.onnx_format import MICROSOFT

if TYPE_CHECKING:
    import onnxruntime as ort

FRAMES = 7
PROPRIO = 53
IMAGE = (3, 45, 80)  # channels, rows, columns
TOKENS = 260  # 7 vectors, 7 x 4 x 9 image patches, 1 action
_WIDTH, _HEADS, _HEAD, _INNER, _LAYERS = 128, 8, 64, 512, 5
_PATCHES, _ACTIONS = 36, 12
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
        self.act_proj = nn.Sequential(nn.Linear(_WIDTH, _ACTIONS))
        self.yaw_proj = nn.Sequential(
            nn.Linear(_WIDTH, 64), nn.Tanh(), nn.Linear(64, 32), nn.Tanh(),
            nn.Linear(32, 16), nn.Tanh(), nn.Linear(16, 2),
        )  # fmt: skip

    def open(self) -> ort.InferenceSession:
        """Return a session on these weights.

        Its inputs are `proprio`, (7, 53), and `frames`, (7, 3, 45, 80), (byte - 127.5) / 255,
        oldest first; its output is the raw action, (1, 12).
        """
        return _Drawing(self.state_dict()).open()


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


class Norm(nn.Module):
    """Scale of a layer norm whose shift is a buffer of zeros."""

    def __init__(self) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.empty(_WIDTH))
        self.register_buffer("beta", torch.empty(_WIDTH))


class Rotary(nn.Module):
    """Frequencies of the rotary embedding. `scale` is for causal models, which this is not."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("inv_freq", torch.empty(_HEAD // 2))
        self.register_buffer("scale", torch.empty(_HEAD // 2))


class _Drawing:
    """Draws the network as a graph. Tokens are (tokens, numbers): there is no batch axis."""

    def __init__(self, state: dict[str, Tensor]) -> None:
        self._state = state
        self._graph = Graph()

    def open(self) -> ort.InferenceSession:
        x = self._tokens()
        for layer in range(_LAYERS - 1):
            x = self._block(x, f"transformer.{layer}.", TOKENS)
        # Only the action token leaves the last block, so only its query is computed.
        x = self._block(x, f"transformer.{_LAYERS - 1}.", 1)
        weight, bias = self._numbers("act_proj.0.weight"), self._weight("act_proj.0.bias")
        return self._graph.open(self._linear(x, weight, bias), 1, _ACTIONS)

    def _tokens(self) -> str:
        node, weight = self._graph.node, self._weight
        proprio = self._graph.input("proprio", FRAMES, PROPRIO)
        frames = self._graph.input("frames", FRAMES, *IMAGE)
        matrix = self._numbers("obs_enc.weight")[:, :, 0]
        vectors = self._linear(proprio, matrix, weight("obs_enc.bias"))
        statistics = ("weight", "bias", "running_mean", "running_var")
        x = node("BatchNormalization", frames, *[weight(f"img_enc.0.{s}") for s in statistics])
        x = node("Conv", x, weight("img_enc.1.weight"), weight("img_enc.1.bias"), strides=[8, 8])
        x = node("Conv", node("Relu", x), weight("img_enc.3.weight"), weight("img_enc.3.bias"))
        x = node("Transpose", self._reshape(x, FRAMES, _WIDTH, _PATCHES), perm=[0, 2, 1])
        action = self._graph.constant(self._numbers("act_tokens")[0, :1])
        return node("Concat", vectors, self._reshape(x, -1, _WIDTH), action, axis=0)

    def _block(self, x: str, name: str, queries: int) -> str:
        """Return the last `queries` tokens of a block's output."""
        node = self._graph.node
        scale, shift = self._weight(name + "norm.gamma"), self._weight(name + "norm.beta")
        h = node("LayerNormalization", x, scale, shift)
        last = self._graph.constant(np.arange(TOKENS - queries, TOKENS))
        recent = node("Gather", h, last) if queries < TOKENS else h
        matrix = self._numbers(name + "fused_attn_ff_proj.weight")
        w_query, w_key, w_value, w_forward, w_gate = np.split(matrix, [512, 576, 640, 1152])
        # An eighth is a power of two: that it scales the weights changes no bit.
        query = self._linear(recent, w_query * np.float32(_HEAD**-0.5))
        frequencies = self._numbers(name + "rotary_emb.inv_freq")
        query = self._turn(query, frequencies, _HEADS, queries)
        key = self._turn(self._linear(h, w_key), frequencies, 1, TOKENS)
        value = self._linear(h, w_value)
        # Heads share keys, so all queries of all heads make one matrix.
        scores = node("Gemm", query, key, transB=1)
        attended = node("MatMul", node("Softmax", scores, axis=-1), value)
        gate = self._linear(recent, w_gate)
        silu = node("Mul", gate, node("Sigmoid", gate))
        hidden = node("Mul", silu, self._linear(recent, w_forward))
        forward = self._linear(hidden, self._numbers(name + "ff_out.2.weight"))
        matrix = self._numbers(name + "attn_out.weight")
        return self._linear(self._reshape(attended, -1, _INNER), matrix, forward)

    def _turn(self, x: str, frequencies: NDArray[np.float32], heads: int, tokens: int) -> str:
        """Rotate each head of the last tokens by its position; return (tokens x heads, 64)."""
        angles = np.arange(TOKENS, dtype=np.float32)[:, None] * frequencies
        rotations = [self._graph.constant(turn(angles)) for turn in (np.cos, np.sin)]
        positions = self._graph.constant(np.arange(TOKENS - tokens, TOKENS)[None])
        x = self._graph.node(
            "RotaryEmbedding", self._reshape(x, 1, tokens, -1), positions, *rotations,
            domain=MICROSOFT, num_heads=heads,
        )  # fmt: skip
        return self._reshape(x, -1, _HEAD)

    def _linear(self, x: str, matrix: NDArray[np.float32], plus: str = "") -> str:
        """Return x times the transposed matrix, plus a bias or another matrix."""
        return self._graph.node("Gemm", x, self._graph.constant(matrix), plus, transB=1)

    def _reshape(self, x: str, *shape: int) -> str:
        return self._graph.node("Reshape", x, self._graph.constant(list(shape)))

    def _weight(self, name: str) -> str:
        return self._graph.constant(self._numbers(name))

    def _numbers(self, name: str) -> NDArray[np.float32]:
        return self._state[name].numpy()
