"""What torch computes, recorded as a graph and run by nw-eval: against torch itself."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812 - as torch's own documentation has it.

from nw_policies.executor import NEXT, UnsupportedError
from nw_policies.executor.network import Network
from nw_policies.executor.plan import plan
from nw_policies.networks import aten
from nw_policies.networks.recording import numbered, record

A = torch.ops.aten
_random = np.random.default_rng(3)


def some(*shape):
    """Random numbers that a network may have as weights."""
    return torch.from_numpy(_random.normal(0.0, 0.5, shape).astype(np.float32))


W, V, B = some(6, 8), some(8, 6), some(6)
K1, K2 = some(4, 8, 3), some(4, 3, 3, 3)
LSTM, GRU = nn.LSTM(8, 5, 2, bidirectional=True, batch_first=True), nn.GRU(8, 5)
TANH, RELU = nn.RNN(8, 5), nn.RNN(8, 5, nonlinearity="relu", bias=False)
CELLS = [c(8, 5) for c in (nn.LSTMCell, nn.GRUCell, nn.RNNCell)]
RELU_CELL = nn.RNNCell(8, 5, nonlinearity="relu")
RELU_CELL_WEIGHTS = [p.detach() for p in RELU_CELL.parameters()]
ATTENTION = nn.MultiheadAttention(8, 2, batch_first=True).eval()
ENCODERS = [
    nn.TransformerEncoderLayer(8, 2, 16, batch_first=True, **options).eval()
    for options in ({}, {"norm_first": True, "activation": "gelu"})
]
X, Y, Z, IMAGE, LINE = (2, 8), (2, 8), (2, 3, 8), (2, 3, 9, 12), (2, 8, 10)
ONE = {
    "elements": lambda x: [
        f(x) for f in (
            torch.abs, torch.ceil, torch.cos, torch.erf, torch.exp, torch.floor, F.hardswish,
            F.mish, torch.neg, torch.relu, torch.round, torch.sigmoid, torch.sign, F.silu,
            torch.sin, torch.tanh, torch.square, F.softsign, F.hardsigmoid, F.gelu, F.softplus,
            F.elu, F.celu, F.selu, F.leaky_relu, F.relu6, F.hardtanh, torch.positive,
        )
    ],
    "positive": lambda x: [
        torch.log(x.abs() + 0.1), torch.sqrt(x.abs()), torch.rsqrt(x.abs() + 0.1),
        torch.reciprocal(x.abs() + 0.1), x.abs().pow(0.5), x**2, 2.0**x, x ** torch.tensor(3.0),
    ],
    "elu": lambda x: [
        F.celu(x, alpha=0.7), A.elu(x, 0.5, 2.0, 1.5), F.gelu(x, approximate="tanh"),
        F.softplus(x, beta=2.0), F.prelu(x, torch.tensor([0.1])), F.prelu(x, some(8)),
        A._prelu_kernel(x, some(8)),
    ],
    "limits": lambda x: [
        x.clamp(-0.5, 0.5), x.clip(min=0.1), x.clamp_min(0.2), x.clamp_max(0.3),
        x.clamp(torch.tensor(-0.1), torch.tensor(0.2)),
    ],
    "scalars": lambda x: [
        x + 1, x - 2.5, 3 - x, torch.rsub(x, 2.0, alpha=0.5), x * 0.3, x / 7, 1 / (x.abs() + 1),
        torch.add(x, x, alpha=3), torch.div(x, 0.3, rounding_mode="floor"), x // 0.7,
        torch.true_divide(x, 3),
    ],
    "logic": lambda x: [
        ((x > 0) & (x < 1)).float(), ((x >= 0) | (x <= -1)).float(), (~(x > 0)).float(),
        (x == x * 1).float(), (x != x * 1).float(), torch.logical_xor(x > 0, x > 0.5).float(),
        torch.logical_and(x > 0, x < 1).float(), torch.logical_or(x > 0, x < -1).float(),
        ((x > 0) ^ (x < 1)).float(), torch.logical_not(x > 0).float(), (x > 0) * x,
        torch.where(x > 0, x, 0.1), x.masked_fill(x > 0, 2.0), (x > 0).to(torch.int64).float(),
        (x > 0).type_as(x),
    ],
    "products": lambda x: [
        F.linear(x, W, B), F.linear(x, W), x @ V, torch.mm(x, V), torch.addmm(B, x, V),
        torch.addmm(B, x, V, beta=0.5, alpha=2.0), x.mv(V[:, 0]), x[0].dot(V[:, 0]),
        torch.addmv(B, V.T, x[0]), F.linear(x, W * (x.sum() * 0 + 1)),
    ],
    "softmax": lambda x: [
        x.softmax(-1), x.log_softmax(0), A._softmax(x, 1, False), A._log_softmax(x, 1, False),
    ],
    "moves": lambda x: [
        x.view(16), x.reshape(4, 4), x.flatten(), x.unflatten(1, (2, 4)), x.unsqueeze(1),
        x[:, None].squeeze(1), x.T, x.t(), x.transpose(0, 1), x.permute(1, 0), x.swapaxes(0, 1),
        x.expand(3, 2, 8), x[:1].expand_as(x), torch.broadcast_to(x[:1], (4, 8)), x.repeat(2, 3),
        x[:, 2:5], x[1], x[:, -1], x[:, ::3], x.narrow(1, 2, 3), x.flip(1), x.roll(3), x.roll(1, 1),
        x.contiguous(), x.clone(), x.detach(), A.alias(x), A.contiguous(x),
        A.copy(x, x * 2), A.fill(x, 0.5),
        x.view_as(x), A._unsafe_view(x, [16]),
        A._reshape_alias(x, [16], [1]), x.ravel(), x.numpy_T if hasattr(x, "numpy_T") else x.T,
        A.numpy_T(x), A.lift_fresh(x), A.lift_fresh_copy(x), A.detach_(x.clone()),
    ],
    "parts": lambda x: [
        *x.split(3, 1), *x.split([3, 5], 1), *x.chunk(2, 1), *x.unbind(0), *A.unsafe_split(x, 4, 1),
        *A.unsafe_chunk(x, 2, 1), torch.cat([x, x], 1), torch.stack([x, x], 1), A.concat([x, x], 0),
        F.pad(x, (1, 2)), F.pad(x, (1, 0, 2, 0), value=0.5), x.to(torch.float64).float(),
        x.index_select(1, torch.tensor([3, 1, 1])), x[:, [5, 2]], x[:, torch.arange(8) > 4],
        F.embedding(torch.tensor([2, 0]), V) + x[:, :6], A._to_copy(x),
    ],
    "reductions": lambda x: [
        x.mean(), x.mean(1), x.sum(0, keepdim=True), x.sum(), x.amax(1), x.amin(0), x.max(),
        x.min(),
        x.max(1).values, x.min(0).values, x.prod(1), torch.max(x, x * 2), torch.minimum(x, -x),
        torch.maximum(x, -x), x.norm(), x.norm(dim=1), torch.linalg.vector_norm(x, 1, 1),
        torch.linalg.vector_norm(x, float("inf"), 1), F.normalize(x, dim=1), x.var(1), x.std(1),
        x.var(), x.var(1, unbiased=False), torch.std(x, dim=1, correction=0),
        A.frobenius_norm(x, [1]),
        A.norm(x, 2.0, [1], True),
    ],
    "normalisation": lambda x: [
        F.layer_norm(x, (8,), some(8), some(8)), F.layer_norm(x, (8,)),
        A.native_layer_norm(x, [8], some(8), some(8), 1e-5)[0], F.rms_norm(x, (8,), some(8)),
        F.batch_norm(x, some(8), some(8).abs() + 0.1, some(8), some(8)),
        A._native_batch_norm_legit_no_training(x, None, None, some(8), some(8).abs(), 0.1, 1e-3)[0],
        A.native_batch_norm(x, some(8), some(8), some(8), some(8).abs(), False, 0.1, 1e-3)[0],
        A._fused_rms_norm(x, [8], some(8), 1e-5)[0], F.dropout(x, 0.5, training=False),
        A.alpha_dropout(x, 0.5, False), A.feature_dropout(x, 0.5, False),
        torch.addcmul(x, x, x, value=0.5), torch.addcdiv(x, x, x.abs() + 1, value=0.5),
    ],
    "in place": lambda x: [
        written(x, lambda y: y[:, 2:4].zero_()), written(x, lambda y: y.relu_()),
        written(x, lambda y: y[1].fill_(0.5)), written(x, lambda y: y.T[3].copy_(x[:, 0])),
        written(x, lambda y: y.view(16)[3:9].clamp_(-0.1, 0.1)),
        written(x, lambda y: y.add_(x).mul_(2.0)[:, :3].tanh_()),
        written(torch.zeros(2, 8), lambda y: y[:, 1:7:2].copy_(x[:, :3])),
        written(torch.ones(2, 8), lambda y: y[0].zero_()) + x.sum(),
    ],
    "cells": lambda x: [
        *CELLS[0](x), CELLS[1](x), CELLS[2](x), RELU_CELL(x),
    ],
}  # fmt: skip
OTHERS = {
    "three axes": (Z, lambda x: [
        torch.bmm(x, x.transpose(1, 2)), torch.baddbmm(x[:, :, :3], x, x.transpose(1, 2)),
        F.linear(x, W, B), *LSTM(x)[:1], *LSTM(x)[1], *GRU(x), *TANH(x), *RELU(x),
        F.layer_norm(x, (3, 8), some(3, 8), some(3, 8)), x.mean((0, 2)),
        F.scaled_dot_product_attention(x, x, x),
        F.scaled_dot_product_attention(x, x, x, is_causal=True),
        F.scaled_dot_product_attention(x, x, x, attn_mask=torch.eye(3) > 0),
        F.scaled_dot_product_attention(x, x, x, attn_mask=some(3, 3), scale=0.2),
    ]),
    "images": (IMAGE, lambda x: [
        F.conv2d(x, K2), F.conv2d(x, K2, some(4), stride=2, padding=1), F.conv2d(x[0], K2),
        F.conv2d(x, K2, padding="same"), F.conv2d(x, K2, padding="valid", dilation=2),
        A.convolution(x, K2, None, [1, 1], [1, 1], [1, 1], False, [0, 0], 1),
        A._convolution(x, K2, None, [1, 1], [1, 1], [1, 1], False, [0, 0], 1, False, False, True, True),  # noqa: E501
        F.max_pool2d(x, 2), F.max_pool2d(x, 3, 2, 1), F.max_pool2d(x[0], 2),
        A.max_pool2d_with_indices(x, [2, 2])[0],
        F.avg_pool2d(x, 3, 2, 1), F.adaptive_avg_pool2d(x, 1), F.adaptive_avg_pool2d(x, (3, 4)),
        A._adaptive_avg_pool2d(x, [3, 3]), F.group_norm(x, 3, some(3), some(3)),
        A.native_group_norm(x, None, None, 2, 3, 108, 1, 1e-5)[0], F.instance_norm(x),
        F.batch_norm(x, some(3), some(3).abs() + 0.1), x.flatten(1), x.mean((2, 3)),
    ]),
    "lines": (LINE, lambda x: [
        F.conv1d(x, K1, some(4), stride=2, padding=1), F.avg_pool1d(x, 2), F.max_pool1d(x, 2),
        F.adaptive_avg_pool1d(x, 5),
    ]),
    "layers of attention": (Z, lambda x: [
        ENCODERS[0](x), ENCODERS[1](x), ATTENTION(x, x, x, need_weights=False)[0],
    ]),
    "attention": ((1, 2, 3, 8), lambda x: [
        F.scaled_dot_product_attention(x, x, x),
        A._scaled_dot_product_flash_attention_for_cpu(x, x, x)[0],
    ]),
}  # fmt: skip
CASES = {name: (X, function) for name, function in ONE.items()} | OTHERS


def written(x, change):
    """What a tensor, and what views of it say together, after something was written into it."""
    y = x.clone()
    views = y[:, ::2], y.view(4, 4)
    change(y)
    return torch.cat([y.flatten(), *(view.flatten() for view in views)])


def ran(function, *shapes):
    """The outputs of a function by torch, and by nw-eval from its graph."""
    inputs = [some(*shape) for shape in shapes]
    zeros = [torch.zeros(shape) for shape in shapes]
    with torch.inference_mode():
        state = _random.bit_generator.state
        expected = [y.float().numpy().copy() for y in function(*[x.clone() for x in inputs])]
        _random.bit_generator.state = state  # Equal weights, twice.

    def run():
        return {f"output {k}": y for k, y in enumerate(function(*zeros))}

    network = Network(plan(record(run, numbered(zeros))))
    found = network({f"input {k}": x.numpy() for k, x in enumerate(inputs)})
    return expected, [found[f"{NEXT}output {k}"].copy() for k in range(len(expected))]


@pytest.mark.parametrize("name", CASES)
def test_operators_of_torch_give_what_torch_gives(name):
    shape, function = CASES[name]
    expected, found = ran(function, shape)
    for number, (a, b) in enumerate(zip(expected, found, strict=True)):
        assert a.shape == b.shape, number
        np.testing.assert_allclose(b, a, rtol=3e-5, atol=3e-6, err_msg=str(number))


def test_every_rule_has_a_case(monkeypatch):
    used = set()

    class Noted(dict):
        def __getitem__(self, name):
            used.add(name)
            return super().__getitem__(name)

    monkeypatch.setattr("nw_policies.networks.recording.RULES", Noted(aten.RULES))
    for shape, function in CASES.values():
        zeros = torch.zeros(shape)
        with torch.inference_mode():
            record(lambda f=function, x=zeros: dict(enumerated(f(x))), {"input 0": zeros})
    assert sorted(set(aten.RULES) - used) == []


def enumerated(outputs):
    return ((f"output {k}", y) for k, y in enumerate(outputs))


class Counting(nn.Module):
    """An LSTM cell with its state in buffers, and a history that is shifted."""

    def __init__(self):
        super().__init__()
        self.cell = nn.LSTMCell(8, 4)
        self.register_buffer("h", torch.full((1, 4), 0.2))
        self.register_buffer("c", torch.zeros(1, 4))
        self.register_buffer("past", torch.zeros(1, 3, 8))
        self.register_buffer("scale", torch.full((1,), 0.5))

    def forward(self, x):
        self.past[:, :-1] = self.past[:, 1:].clone()
        self.past[:, -1] = x
        h, self.c = self.cell(self.past.mean(1) * self.scale, (self.h, self.c))
        self.h.copy_(h)
        return h + self.past[:, 0, :4]


@pytest.mark.parametrize("is_scripted", [False, True])
def test_memory_is_an_input_and_an_output_and_what_nothing_writes_is_a_constant(is_scripted):
    torch.manual_seed(1)
    module, reference = Counting().eval(), Counting().eval()
    reference.load_state_dict(module.state_dict())
    first = {name: buffer.numpy().copy() for name, buffer in module.named_buffers()}
    module = torch.jit.script(module) if is_scripted else module
    zeros = torch.zeros(1, 8)

    def run():
        return {"output 0": module(zeros), **dict(module.named_buffers())}

    graph = record(run, numbered([zeros]), dict(module.named_buffers()))
    assert {one.name for one in graph.inputs} == {"input 0", "h", "c", "past"}
    network = Network(plan(graph))
    memory = {name: first[name] for name in ("h", "c", "past")}
    for step in range(6):
        x = some(1, 8)
        with torch.inference_mode():
            expected = reference(x).numpy()
        found = network({"input 0": x.numpy(), **memory})
        np.testing.assert_allclose(found[f"{NEXT}output 0"], expected, rtol=1e-5, atol=1e-6)
        memory = {name: found[NEXT + name].copy() for name in memory}
        assert step or not np.array_equal(memory["past"], first["past"])


class Choosing(nn.Module):
    def forward(self, x):
        return x + 1 if bool(x.sum() > 0) else x - 1


class Drawing(nn.Module):
    def forward(self, x):
        return x + torch.rand(8)


@pytest.mark.parametrize(
    ("module", "operator"),
    [
        (Choosing(), "operator _local_scalar_dense"),
        (Drawing(), "operator rand"),
        (nn.Dropout().train(), "operator dropout with `train`, which draws numbers"),
        (nn.Conv2d(2, 2, 3, padding_mode="reflect", padding=1), "operator reflection_pad2d"),
    ],
)
@pytest.mark.parametrize("is_scripted", [False, True])
def test_what_cannot_be_recorded_is_refused_by_the_operator_s_name(module, operator, is_scripted):
    shape = (1, 2, 8, 8) if isinstance(module, nn.Conv2d) else (1, 8)
    zeros = torch.zeros(shape)
    module = module.train(isinstance(module, nn.Dropout))
    run = torch.jit.script(module) if is_scripted else module
    with pytest.raises(UnsupportedError, match=operator), torch.inference_mode():
        record(lambda: {"output 0": run(zeros)}, numbered([zeros]))
