"""Networks that people export: what is loaded of a script acts as the script does, bit for bit."""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path

import pytest
import torch
from torch import nn

from nw_eval.policies.safety import check_torchscript

REPOSITORY = Path(__file__).resolve().parents[2]
ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", REPOSITORY.parent / "shared" / "assets"))
FILES = sorted((ASSETS / "policies").glob("*/*.pt"))

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def load(data):
    with torch.inference_mode():
        return torch.jit.load(io.BytesIO(data), map_location="cpu").eval()


def saved(module):
    buffer = io.BytesIO()
    torch.jit.save(module, buffer)
    return buffer.getvalue()


def flat(value):
    if isinstance(value, torch.Tensor):
        return [value]
    parts = value.values() if isinstance(value, dict) else value
    return [tensor for part in parts for tensor in flat(part)] if not isinstance(value, int) else []


def what_differs(data, *shapes, steps=5):
    """Return what of the loaded script is not, bit for bit, as `torch.jit.load` gives it."""
    plain, ours = load(data), load(check_torchscript(data, "policy.pt"))
    torch.manual_seed(0)
    pairs = {}
    for step in range(steps):
        given = [torch.randn(shape) for shape in shapes]
        with torch.inference_mode():
            expected, found = flat(plain(*given)), flat(ours(*given))
        pairs[f"the actions of step {step}"] = bits(expected), bits(found)
    pairs["buffers"] = (
        [(name, *bits([value])) for name, value in plain.named_buffers()],
        [(name, *bits([value])) for name, value in ours.named_buffers()],
    )
    pairs["names of parameters"] = (
        {name for name, _ in plain.named_parameters()},
        {name for name, _ in ours.named_parameters()},
    )
    missing = [] if pairs["the actions of step 0"][0] else ["actions: there are none"]
    return [*missing, *(what for what, (one, other) in pairs.items() if one != other)]


def bits(tensors):
    return [
        (str(each.dtype), tuple(each.shape), each.detach().numpy().tobytes()) for each in tensors
    ]


@pytest.mark.assets
@pytest.mark.skipif(not FILES, reason=f"no weights at {ASSETS}")
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.parent.name)
def test_a_published_policy_acts_as_before(path):
    data = path.read_bytes()
    networks = load(data)
    # The part that sees the observation first: himloco's estimator, the LSTM of a recurrent one.
    firsts = (getattr(networks, name, None) for name in ("estimator", "memory"))
    first = next((part for part in firsts if part is not None), networks)
    width = next(first.parameters()).shape[1]
    assert what_differs(data, (1, width), steps=50) == []


class Normalizer(nn.Module):
    """rsl_rl's EmpiricalNormalization."""

    def __init__(self, size):
        super().__init__()
        self.eps = 1e-2
        self.register_buffer("_mean", torch.randn(1, size))
        self.register_buffer("_std", torch.rand(1, size))

    def forward(self, x):
        return (x - self._mean) / (self._std + self.eps)


class Feedforward(nn.Module):
    """rsl_rl's exporter of feed-forward policies."""

    def __init__(self):
        super().__init__()
        self.actor = nn.Sequential(nn.Linear(45, 32), nn.ELU(), nn.Linear(32, 12))
        self.normalizer = Normalizer(45)

    def forward(self, x):
        return self.actor(self.normalizer(x))

    @torch.jit.export
    def reset(self):
        pass


class Recurrent(nn.Module):
    """rsl_rl's exporter of recurrent policies: state in buffers, written in place."""

    def __init__(self, kind, layers=1):
        super().__init__()
        self.actor = nn.Sequential(nn.Linear(16, 12), nn.Tanh())
        self.normalizer = nn.Identity()
        self.rnn = kind(45, 16, layers)
        self.register_buffer("hidden_state", torch.zeros(layers, 1, 16))


class WithLstm(Recurrent):
    def __init__(self):
        super().__init__(nn.LSTM)
        self.register_buffer("cell_state", torch.zeros(1, 1, 16))

    def forward(self, x):
        x = self.normalizer(x)
        x, (h, c) = self.rnn(x.unsqueeze(0), (self.hidden_state, self.cell_state))
        self.hidden_state[:] = h
        self.cell_state[:] = c
        return self.actor(x.squeeze(0))

    @torch.jit.export
    def reset(self):
        self.hidden_state[:] = 0.0
        self.cell_state[:] = 0.0


class WithGru(Recurrent):
    def __init__(self):
        super().__init__(nn.GRU, layers=2)

    def forward(self, x):
        x, h = self.rnn(self.normalizer(x).unsqueeze(0), self.hidden_state)
        self.hidden_state[:] = h
        return self.actor(x.squeeze(0))


class Cells(nn.Module):
    def __init__(self):
        super().__init__()
        self.gru, self.lstm = nn.GRUCell(45, 8), nn.LSTMCell(8, 12)
        self.plain = nn.RNN(12, 12, nonlinearity="relu")
        self.register_buffer("h", torch.zeros(1, 8))

    def forward(self, x):
        self.h = self.gru(x, self.h)
        h, c = self.lstm(self.h)
        return self.plain((h + c).unsqueeze(0))[0].squeeze(0)


class Images(nn.Module):
    """An encoder of depth images with the usual layers, and an action from both inputs."""

    def __init__(self):
        super().__init__()
        self.seen = nn.Sequential(
            nn.Conv2d(1, 8, 5, stride=2),
            nn.BatchNorm2d(8),
            nn.LeakyReLU(),
            nn.MaxPool2d(2),
            nn.Conv2d(8, 8, 3, padding=1, groups=2),
            nn.GroupNorm(2, 8),
            nn.SiLU(),
            nn.AdaptiveAvgPool2d((2, 2)),
            nn.Flatten(),
            nn.GELU(),
            nn.Dropout(0.5),
            nn.LayerNorm(32),
        )
        self.act = nn.Sequential(nn.Linear(32 + 45, 12), nn.Softplus())

    def forward(self, x, image):
        small = nn.functional.interpolate(image, size=(24, 32), mode="bilinear")
        return self.act(torch.cat([x, self.seen(small)], dim=-1)).clamp(-1.0, 1.0)


class Attention(nn.Module):
    def __init__(self):
        super().__init__()
        layer = nn.TransformerEncoderLayer(16, 2, 32, batch_first=True)
        self.layer = nn.TransformerEncoder(layer, 2)
        self.heads = nn.MultiheadAttention(16, 4, batch_first=True)
        self.out = nn.Linear(16, 12)
        self.register_buffer("places", torch.randn(1, 3, 16))

    def forward(self, x):
        tokens = self.layer(x[:, :48].reshape(-1, 3, 16) + self.places)
        mixed, _ = self.heads(tokens, tokens, tokens, need_weights=False)
        again = nn.functional.scaled_dot_product_attention(mixed, tokens, tokens)
        return self.out(again.mean(dim=1))


class Branches(nn.Module):
    """Loops, conditions, lists, dicts, strings, and several outputs."""

    def __init__(self):
        super().__init__()
        self.layers = nn.ModuleList([nn.Linear(45, 45) for _ in range(3)])
        self.scales = {"hip": 0.5, "knee": 2.0}
        self.order: list[int] = [2, 0, 1]
        self.steps = 0
        self.phase: tuple[float, float] = (0.0, float("inf"))

    def forward(self, x):
        with torch.no_grad():
            for layer in self.layers:
                x = torch.tanh(layer(x))
        self.steps += 1
        parts = []
        for k in range(0, 12, 4):
            parts.append(x[:, k : k + 4])  # noqa: PERF401 - so that lists grow in the script.
        ordered = torch.cat([parts[k] for k in self.order], dim=-1)
        if self.steps % 2 == 0 and x.shape[0] == 1:
            ordered = ordered * self.scales["hip"]
        elif float(x.sum()) > 0.0:
            ordered[:, ::3] += 1.0
        else:
            assert ordered.ndim == 2, f"{ordered.shape} is no row"
        while bool((ordered.abs() > 1.0).any()):
            ordered = ordered * 0.5
        first, rest = ordered.split([4, 8], dim=1)
        rest[:, -1] = torch.where(rest[:, 0] > 0, rest[:, 1], -rest[:, 2]).clamp(max=self.phase[1])
        return torch.cat((first, rest), 1), {"steps": torch.full((1,), self.steps)}


NETWORKS = {
    "scripted MLP": lambda: torch.jit.script(Feedforward()),
    "traced MLP": lambda: torch.jit.trace(Feedforward(), torch.zeros(1, 45)),
    "scripted LSTM": lambda: torch.jit.script(WithLstm()),
    "scripted GRU": lambda: torch.jit.script(WithGru()),
    "traced LSTM": lambda: torch.jit.trace(WithLstm(), torch.zeros(1, 45)),
    "scripted cells": lambda: torch.jit.script(Cells()),
    "traced cells": lambda: torch.jit.trace(Cells(), torch.zeros(1, 45)),
    "scripted branches": lambda: torch.jit.script(Branches()),
    "frozen MLP": lambda: torch.jit.freeze(torch.jit.script(Feedforward().eval())),
}


@pytest.mark.parametrize("name", NETWORKS)
def test_a_network_acts_as_before(name):
    torch.manual_seed(1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = saved(NETWORKS[name]())
    assert what_differs(data, (1, 45)) == []


@pytest.mark.parametrize("export", ["script", "trace"])
def test_an_encoder_of_images_acts_as_before(export):
    torch.manual_seed(1)
    given = (torch.zeros(1, 45), torch.zeros(1, 1, 48, 64))
    module = Images().eval()
    data = saved(torch.jit.script(module) if export == "script" else torch.jit.trace(module, given))
    assert what_differs(data, *(tensor.shape for tensor in given)) == []


@pytest.mark.parametrize("export", ["script", "trace"])
def test_attention_acts_as_before(export):
    torch.manual_seed(1)
    module = Attention().eval()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = saved(
            torch.jit.script(module)
            if export == "script"
            else torch.jit.trace(module, torch.zeros(1, 48), check_trace=False)
        )
    assert what_differs(data, (1, 48)) == []


def test_a_script_is_written_anew_once_and_for_all():
    data = saved(torch.jit.script(Branches()))
    once = check_torchscript(data, "policy.pt")
    assert check_torchscript(once, "policy.pt") == once
