"""Bundles of every adapter that torch reads, with random weights, and digests of what they do.

As a program, it prints the digests of the bundles in a folder, run by nw-eval.
"""

from __future__ import annotations

import hashlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from nw_policies import load_bundle, open_policy
from nw_policies.line import trusting
from nw_policies.networks.act import Act, ActSizes
from nw_policies.networks.parkour import (
    DepthEncoder,
    Estimator,
    LucidSimTransformer,
    ParkourActor,
)
from nw_sim.sensors import check_card

HEAD = """\
nw-policy: 1
name: {name}
robot: go1
adapter: {adapter}
runtime: {runtime}
checkpoint: {{file: {file}}}
control: {{action: joint_position_offset, scale: 0.25}}
{rest}
"""
BODY = "  proprio: {sensor: proprio, layout: parkour53}\n"
PAST = (
    "  history: {sensor: proprio, layout: parkour53, "
    'history: {steps: 10, current: false, zero: ["6:8"]}}\n'
)
IMAGE = "{sensor: splat_rgb, camera: ego, width: 80, height: 45, axes: chw, dtype: float32"
DEPTH = "  depth: {sensor: depth, camera: ego, width: 80, height: 45, rate: 10}\n"
MLP = (
    "options: {weights: [norm, memory, actor], activation: elu, last: tanh, output_scale: [2.0],\n"
    "  normaliser: {mean: mean, std: std, eps: 0.01}}\n"
)
RESTS = {
    "expert": "extreme-parkour",
    "student": "extreme-parkour",
    "lucidsim": "lucidsim",
    "act": "act",
    "mlp": "mlp",
    "script": "torchscript",
    "fed": "torchscript",
    "export": "torch-export",
}
"""Adapters by the names of the bundles."""
CARDS = {
    "expert": f"observations:\n{BODY}  scandots: {{sensor: scandots}}\n{PAST}"
    "inputs: {proprio: [proprio], scandots: [scandots], history: [history]}",
    "student": f"options: {{depth_every: 3}}\nobservations:\n{BODY}{DEPTH}{PAST}"
    "inputs: {proprio: [proprio], depth: [depth], history: [history]}",
    "lucidsim": f"observations:\n{BODY}  rgb: {IMAGE}, stack: 7, mean: 127.5, std: 255}}\n"
    "inputs: {proprio: [proprio], frames: [rgb]}",
    "act": f"options: {{heads: 4, query_every: 2}}\nobservations:\n{BODY}  rgb: {IMAGE}}}\n"
    "inputs: {proprio: [proprio], images: [rgb]}",
    "mlp": f"{MLP}observations:\n{BODY}",
    "script": f"observations:\n{BODY}",
    "fed": f"networks: {{seen: {{adapter: onnx, checkpoint: {{file: seen.onnx}}, inputs: [proprio]"
    f"}}}}\nobservations:\n{BODY}inputs: [proprio, seen]",
    "export": f"observations:\n{BODY}",
}


class Remembering(nn.Module):
    """An LSTM with its state in buffers, as rsl_rl exports it."""

    def __init__(self, inputs: int = 53) -> None:
        super().__init__()
        self.memory = nn.LSTM(inputs, 16)
        self.head = nn.Linear(16, 12)
        self.register_buffer("h", torch.zeros(1, 1, 16))
        self.register_buffer("c", torch.zeros(1, 1, 16))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        out, (h, c) = self.memory(x[None], (self.h, self.c))
        self.h.copy_(h)
        self.c.copy_(c)
        return self.head(nn.functional.elu(out[0]))


class Smooth(nn.Module):
    """Exponential smoothing of what a perceptron gives."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(53, 32), nn.SiLU(), nn.LayerNorm(32), nn.Linear(32, 12))
        self.register_buffer("before", torch.zeros(1, 12))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.before.copy_(0.7 * self.before + 0.3 * self.net(x))
        return self.before.clone()


def randomized(module: nn.Module, seed: int, prefix: str = "") -> dict[str, torch.Tensor]:
    """Return a state dict of such shapes."""
    rng = np.random.default_rng(seed)
    found = {}
    for name, tensor in module.state_dict().items():
        array = rng.normal(0, max(int(np.prod(tensor.shape[1:])), 1) ** -0.5, tensor.shape)
        if name.endswith(("gamma", "running_var", "img_enc.0.weight")) or ".norm" in name:
            array = rng.uniform(0.5, 1.5, tensor.shape)
        if name.endswith(("beta", "scale")):
            array = np.zeros(tensor.shape)
        if name.endswith("inv_freq"):
            array = 10000.0 ** (-2 * np.arange(32) / 64)
        found[prefix + name] = torch.tensor(array, dtype=tensor.dtype)
    return found


def act_network() -> Act:
    """Return a small ACT network with images."""
    kernels = {"0.weight": (8, 3, 5, 5), "0.bias": (8,), "2.weight": (16, 8, 3, 3), "2.bias": (16,)}
    return Act(
        ActSizes(
            width=32, heads=4, feedforward=48, encoder_layers=2, decoder_layers=1, pre_norm=False,
            proprio=53, latent=8, actions=12, chunk=6, backbone=kernels, normalized=False,
        )
    )  # fmt: skip


def weights_of(name: str) -> object:
    """Return what `torch.save` writes for a bundle."""
    if name == "act":
        return randomized(act_network(), 5)
    if name == "lucidsim":
        return randomized(LucidSimTransformer(), 6)
    if name == "mlp":
        rng = np.random.default_rng(7)
        state = randomized(nn.GRU(53, 16, 2), 7, "memory.") | {
            "norm.weight": torch.ones(53), "norm.bias": torch.zeros(53),
            "mean": torch.tensor(rng.normal(size=53), dtype=torch.float32),
            "std": torch.tensor(rng.uniform(0.5, 2, 53), dtype=torch.float32),
        }  # fmt: skip
        return state | randomized(
            nn.Sequential(nn.Linear(16, 24), nn.ELU(), nn.Linear(24, 12)), 8, "actor."
        )
    saved = {
        "model_state_dict": randomized(ParkourActor(), 1, "actor."),
        "estimator_state_dict": randomized(Estimator(), 2),
    }
    if name == "student":
        saved["depth_encoder_state_dict"] = randomized(DepthEncoder(41472), 3)
        saved["depth_actor_state_dict"] = randomized(ParkourActor(), 4)
    return saved


def by_its_own_runtime(bundle):
    """Return a bundle that ONNX Runtime or torch runs."""
    return replace(bundle, card=bundle.card.model_copy(update={"runtime": "native"}))


def write(folder: Path, name: str, *, runtime: str = "nw-eval") -> Path:
    """Write a bundle of an adapter and return its folder."""
    bundle = folder / name
    bundle.mkdir(parents=True)
    torch.manual_seed(11)
    file = bundle / ("policy.pt2" if name == "export" else "policy.pt")
    if name == "script":
        torch.jit.script(Remembering().eval()).save(file)
    elif name == "fed":
        torch.jit.script(Remembering(56).eval()).save(file)
        (bundle / "seen.onnx").write_bytes(perceptron())
    elif name == "export":
        torch.export.save(torch.export.export(Smooth().eval(), (torch.zeros(1, 53),)), file)
    else:
        torch.save(weights_of(name), file)
    text = HEAD.format(
        name=name, adapter=RESTS[name], runtime=runtime, file=file.name, rest=CARDS[name]
    )
    (bundle / "policy.yaml").write_text(text)
    return bundle


def perceptron() -> bytes:
    """Return an ONNX file, 53 numbers to 3."""
    from nw_policies.networks.onnx_graph import Graph

    graph, rng = Graph(), np.random.default_rng(9)
    matrix = graph.constant(rng.normal(0, 0.2, (53, 3)).astype(np.float32))
    x = graph.node("Tanh", graph.node("MatMul", graph.input("obs", 1, 53), matrix))
    return graph.model(x, 1, 3)


def observations(folder: Path, steps: int = 7) -> list[dict[str, np.ndarray]]:
    """Return random observations of a bundle's card."""
    rng = np.random.default_rng(4)
    specs = check_card(load_bundle(folder).card)
    return [
        {spec.name: rng.normal(size=spec.shape).astype(spec.dtype) for spec in specs}
        for _ in range(steps)
    ]


def actions(folder: Path, seen: list[dict[str, np.ndarray]]) -> np.ndarray:
    """Return what a bundle does, in this process."""
    with trusting():
        policy = open_policy(load_bundle(folder))
        policy.reset(0)
        return np.array([policy.act(each) for each in seen])


if __name__ == "__main__":
    for path in sorted(Path(sys.argv[1]).iterdir()):
        done = actions(path, observations(path))
        sys.stdout.write(f"{path.name} {hashlib.sha256(done.tobytes()).hexdigest()}\n")
