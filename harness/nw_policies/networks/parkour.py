"""Both networks of extreme-parkour, and the LucidSim transformer.

The extreme-parkour expert: scandots, history and an estimate of hidden quantities to an action.
Weights lie in two state dicts of one file: `model_state_dict`, whose keys begin with `actor.`, and
`estimator_state_dict`. 276,055 numbers together, of which the encoder of privileged quantities is
used in training only.

The extreme-parkour student: depth images in place of scandots, with a recurrent state.

The LucidSim transformer: seven frames and seven proprioceptive vectors to one action. 57 entries in
its state dict, 1,823,972 numbers, 260 tokens. Blocks follow each other without residual connection
and without a last norm; each computes attention and feed-forward side by side from one projection,
with eight query heads that share one key and one value head. The weights live in a module with the
published names. onnxruntime runs them: its kernels take three quarters of the time of torch's, and
it keeps its memory from step to step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from nw_base.errors import PolicyError
from nw_policies.executor import Graph as RecordedGraph
from nw_policies.networks.onnx_graph import Graph, open_session
from nw_policies.networks.onnx_reading import read_graph
from nw_policies.networks.parameters import build, mlp
from nw_policies.safety import tensors_below
from nw_policies.safety.onnx import MICROSOFT

if TYPE_CHECKING:
    import onnxruntime as ort


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


FRAMES = 7
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
        return open_session(_Drawing(self.state_dict()).model())

    def graph(self) -> RecordedGraph:
        """Return the same graph for nw-eval, whose angles have one cosine on every processor."""
        return read_graph(_Drawing(self.state_dict(), cosine=math.cos, sine=math.sin).model())


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

    def __init__(
        self,
        state: dict[str, Tensor],
        *,
        cosine: Callable[[Any], Any] = np.cos,
        sine: Callable[[Any], Any] = np.sin,
    ) -> None:
        self._state = state
        self._turns = [_by_element(turn) for turn in (cosine, sine)]
        self._graph = Graph()

    def model(self) -> bytes:
        x = self._tokens()
        for layer in range(_LAYERS - 1):
            x = self._block(x, f"transformer.{layer}.", TOKENS)
        # Only the action token leaves the last block, so only its query is computed.
        x = self._block(x, f"transformer.{_LAYERS - 1}.", 1)
        weight, bias = self._numbers("act_proj.0.weight"), self._weight("act_proj.0.bias")
        return self._graph.model(self._linear(x, weight, bias), 1, _ACTIONS)

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
        rotations = [
            self._graph.constant(np.asarray(turn(angles), np.float32)) for turn in self._turns
        ]
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


def _by_element(function: Callable[[Any], Any]) -> Callable[[NDArray[np.float32]], Any]:
    """Return a function of arrays; `math` has more digits than float32 keeps."""
    if isinstance(function, np.ufunc):
        return function
    return lambda array: np.array([function(x) for x in array.flat]).reshape(array.shape)
