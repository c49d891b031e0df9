from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from nw_policies import load_bundle, open_policy

TEACHER = Path(__file__).parents[3] / "shared" / "teacher" / "teacher.pt"


@pytest.fixture(scope="module")
def bundle():
    return load_bundle("go1-parkour")


@pytest.fixture(scope="module")
def observations():
    """Sixteen observations of (proprio, scandots, last output, history), within their ranges."""
    generator = np.random.default_rng(3)
    flat = generator.normal(size=(16, 332)).astype(np.float32)
    flat[:, 53:185] = np.clip(flat[:, 53:185] * 0.3, -1, 1)
    return flat


def split(flat):
    names = ("proprio", "scandots", "last_output", "history")
    return dict(zip(names, np.split(flat, [53, 185, 197]), strict=True))


def forward(observation, mean, inverse_std, layers):
    """The network of the training, in plain NumPy, float64."""
    x = np.clip((observation.astype(np.float64) - mean) * inverse_std, -6.0, 6.0)
    for index, (weight, bias) in enumerate(layers):
        x = weight.astype(np.float64) @ x + bias
        if index < len(layers) - 1:
            x = np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0)))
    return x


def test_actions_equal_a_forward_pass_in_numpy(bundle, observations):
    graph = onnx.load(bundle.checkpoint).graph
    tensors = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    layers = [(tensors[f"layer{i}.weight"], tensors[f"layer{i}.bias"]) for i in range(4)]
    policy = open_policy(bundle)
    for flat in observations:
        expected = forward(flat, tensors["mean"], tensors["inverse_std"], layers)
        np.testing.assert_allclose(policy.act(split(flat)), expected, atol=2e-5)


@pytest.mark.assets
@pytest.mark.skipif(not TEACHER.is_file(), reason="the training's own file is not here")
def test_actions_equal_those_of_the_trained_file(bundle, observations):
    import torch

    trained = torch.load(TEACHER, map_location="cpu", weights_only=True)
    values = {key: value.numpy() for key, value in trained.items()}
    layers = [(values[f"net.{i}.weight"], values[f"net.{i}.bias"]) for i in (0, 2, 4, 6)]
    policy = open_policy(bundle)
    for flat in observations:
        expected = forward(flat, values["mean"], values["istd"], layers)
        np.testing.assert_allclose(policy.act(split(flat)), expected, atol=2e-5)


def test_the_same_observation_gives_the_same_bits(bundle, observations):
    first, second = open_policy(bundle), open_policy(bundle)
    for flat in observations:
        assert first.act(split(flat)).tobytes() == second.act(split(flat)).tobytes()


def test_the_graph_needs_no_custom_operators(bundle):
    model = onnx.load(bundle.checkpoint)
    assert {node.op_type for node in model.graph.node} == {"Sub", "Mul", "Clip", "Gemm", "Elu"}
    assert [entry.domain for entry in model.opset_import] == [""]
