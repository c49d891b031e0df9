"""torch.export files: the same numbers as torch, recurrent state, and nothing that runs code."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from adapters import by_its_own_runtime
from torch import nn

from nw_base.errors import PolicyError
from nw_policies import load_bundle, open_policy
from nw_policies.networks.exported import ExportedGraph

CARD = """\
nw-policy: 1
name: walker
robot: go1
adapter: torch-export
checkpoint: {file: policy.pt2, sha256: SHA256}
control: {action: joint_position_offset, scale: 0.25}
observations:
  obs: {sensor: proprio, layout: parkour53}
"""


class Feedforward(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(53, 32), nn.ELU(), nn.LayerNorm(32), nn.Linear(32, 12))
        self.register_buffer("mean", torch.linspace(-1, 1, 53))

    def forward(self, obs):
        return self.net((obs - self.mean).clamp(-6, 6))


class Recurrent(nn.Module):
    """A GRU that keeps its hidden state in a buffer, as Isaac Lab's exporter writes them."""

    def __init__(self) -> None:
        super().__init__()
        self.rnn = nn.GRU(53, 16)
        self.head = nn.Linear(16, 12)
        self.register_buffer("hidden", torch.zeros(1, 1, 16))

    def forward(self, obs):
        output, hidden = self.rnn(obs[None], self.hidden)
        self.hidden.copy_(hidden)
        return self.head(output[0])


class Camera(nn.Module):
    """Convolutions, pooling, attention, splitting, a non-persistent buffer and a constant."""

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Sequential(nn.Conv2d(3, 8, 5, stride=2), nn.BatchNorm2d(8), nn.ReLU())
        self.attention = nn.MultiheadAttention(8, 2, batch_first=True)
        self.head = nn.Linear(8 + 53, 24)
        self.register_buffer("scale", torch.full((12,), 0.5), persistent=False)
        self.gain = torch.full((12,), 2.0)

    def forward(self, obs, image):
        x = nn.functional.max_pool2d(self.conv(image), 2).flatten(2).transpose(1, 2)
        x, _ = self.attention(x, x, x, need_weights=False)
        both = torch.cat([x.mean(dim=1), obs], dim=1)
        value, gate = self.head(both).chunk(2, dim=1)
        best = torch.where(gate > 0, value, torch.zeros_like(value)).max(dim=1, keepdim=True).values
        return (value * torch.sigmoid(gate) + best) * self.scale * self.gain


def exported(module: nn.Module, *example: torch.Tensor) -> bytes:
    buffer = io.BytesIO()
    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(0)
        for parameter in module.parameters():
            parameter.copy_(torch.randn(parameter.shape) * 0.3)
    torch.export.save(torch.export.export(module.eval(), example), buffer)
    return buffer.getvalue()


OBS = torch.zeros(1, 53)


def rewritten(data: bytes, edit) -> bytes:
    """The file with its graph changed by `edit(program)`."""
    source, buffer = zipfile.ZipFile(io.BytesIO(data)), io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name.endswith("models/model.json"):
                program = json.loads(content)
                edit(program)
                content = json.dumps(program).encode()
            target.writestr(name, content)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("module", "example"),
    [(Feedforward, (OBS,)), (Camera, (OBS, torch.zeros(1, 3, 45, 80)))],
)
def test_the_graph_gives_the_numbers_of_torch_bit_for_bit(module, example):
    network = module()
    data = exported(network, *example)
    graph = ExportedGraph(data, "policy.pt2")
    loaded = torch.export.load(io.BytesIO(data)).module()  # Our own file, so it may be loaded.
    loaded.requires_grad_(requires_grad=False)  # With gradients torch multiplies in another order.
    rng = np.random.default_rng(0)
    for _ in range(3):
        inputs = [torch.tensor(rng.normal(size=x.shape), dtype=torch.float32) for x in example]
        with torch.no_grad():
            expected, eager = loaded(*inputs), network(*inputs)
        assert torch.equal(graph.run(inputs)[0], expected)
        torch.testing.assert_close(expected, eager, atol=1e-5, rtol=1e-5)
    assert graph.state() == {}


def save_bundle(folder: Path, data: bytes, card: str = CARD) -> Path:
    (folder / "policy.pt2").write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    (folder / "policy.yaml").write_text(card.replace("SHA256", digest))
    return folder


def test_buffers_that_the_graph_writes_to_are_the_recurrent_state(tmp_path):
    network = Recurrent()
    bundle = load_bundle(save_bundle(tmp_path, exported(network, OBS)))
    policy = open_policy(by_its_own_runtime(bundle))
    rng = np.random.default_rng(0)
    observations = rng.normal(size=(8, 53)).astype(np.float32)
    network.hidden.zero_()
    with torch.no_grad():
        expected = [network(torch.from_numpy(o[None])).numpy()[0].copy() for o in observations]
    for trial in range(2):
        policy.reset(trial)
        actions = []
        for step, o in enumerate(observations):
            if step == 3:
                state = policy.state()
            actions.append(policy.act({"obs": o}))
        np.testing.assert_array_equal(actions, expected)
    policy.restore(state)
    np.testing.assert_array_equal([policy.act({"obs": o}) for o in observations[3:]], expected[3:])
    assert not np.allclose(expected[0], network(torch.from_numpy(observations[:1])).detach())


@pytest.mark.parametrize(
    "target",
    [
        "torch.os.system",
        "torch.load",
        "_operator.methodcaller",
        "torch.ops.aten.linear.__class__.default",
        "torch.ops.prim.PythonOp.default",
        "math.acos",
    ],
)
def test_a_graph_that_calls_anything_but_operators_of_torch_is_refused(target, tmp_path):
    def edit(program):
        node = program["graph_module"]["graph"]["nodes"][0]
        node["target"] = target
        node["inputs"] = [{"name": "x", "arg": {"as_string": f"touch {tmp_path}/ran"}, "kind": 1}]

    data = rewritten(exported(Feedforward(), OBS), edit)
    with pytest.raises(PolicyError, match="which is not an operator of torch"):
        ExportedGraph(data, "policy.pt2")
    assert not (tmp_path / "ran").exists()


def test_a_symbolic_size_is_refused_and_not_evaluated(tmp_path):
    # torch.export.load passes this text to sympy, which evaluates it as Python.
    text = f"__import__('pathlib').Path('{tmp_path}/ran').touch()"

    def edit(program):
        value = program["graph_module"]["graph"]["tensor_values"]["obs"]
        value["sizes"][1] = {"as_expr": {"expr_str": text, "hint": {"as_int": 53}}}

    with pytest.raises(PolicyError, match=r"sizes that are not fixed.*without `dynamic_shapes`"):
        ExportedGraph(rewritten(exported(Feedforward(), OBS), edit), "policy.pt2")
    assert not (tmp_path / "ran").exists()


def test_a_pickled_weight_is_refused():
    source = zipfile.ZipFile(io.BytesIO(exported(Feedforward(), OBS)))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name.endswith("weights_config.json"):
                content = content.replace(b'"use_pickle": false', b'"use_pickle": true')
            target.writestr(name, content)
    with pytest.raises(PolicyError, match="is a pickled object, which could run code"):
        ExportedGraph(buffer.getvalue(), "policy.pt2")


def test_a_graph_that_asks_for_100_gb_is_refused_by_its_shapes_alone():
    def edit(program):
        graph = program["graph_module"]["graph"]
        first = graph["nodes"][0]
        name = first["outputs"][0]["as_tensor"]["name"]
        size = {"name": "size", "arg": {"as_ints": [25_000_000_000]}, "kind": 1}
        graph["nodes"].insert(
            1,
            {
                "target": "torch.ops.aten.zeros.default",
                "inputs": [size],
                "outputs": [{"as_tensor": {"name": "huge"}}],
                "metadata": {},
            },
        )
        assert name

    with pytest.raises(PolicyError, match="operator zeros of the graph makes 25000000"):
        ExportedGraph(rewritten(exported(Feedforward(), OBS), edit), "policy.pt2")


def test_a_card_that_does_not_fit_is_said_in_its_own_terms(tmp_path):
    data = exported(Camera(), OBS, torch.zeros(1, 3, 45, 80))
    with pytest.raises(PolicyError, match=r"the checkpoint has 2 inputs: obs, image"):
        open_policy(load_bundle(save_bundle(tmp_path, data)))
    data = exported(nn.Sequential(nn.Linear(53, 8)), OBS)
    with pytest.raises(PolicyError, match=r"shape \(1, 8\), the robot 'go1' has 12 joints"):
        open_policy(load_bundle(save_bundle(tmp_path, data)))
    with pytest.raises(PolicyError, match=r"not a torch.export file"):
        open_policy(load_bundle(save_bundle(tmp_path, b"\x08\x07")))
