"""Encoders of images beside a checkpoint, which a deploy configuration speaks of."""

import math

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from tests.policies.drafting.test_beside import DEPLOY

from nw_eval.api.policies import init_policy
from nw_policies import load_bundle

SEEN = DEPLOY + (
    "  depth_image: {params: {history_skip_frames: 5, num_output_frames: 4}, history_length: 1}\n"
)


def save(path, name, shape, seed):
    """Write a graph that makes twelve numbers of all of its input."""
    weights = np.random.default_rng(seed).standard_normal((math.prod(shape), 12))
    graph = helper.make_graph(
        [
            helper.make_node("Flatten", [name], ["row"]),
            helper.make_node("MatMul", ["row", "weights"], ["actions"]),
        ],
        "g",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 12])],
        [numpy_helper.from_array(weights.astype(np.float32), "weights")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, str(path))


@pytest.fixture
def drafted(tmp_path):
    """Draft the card of a graph of 117 numbers beside another that gives twelve."""

    def draft(shape, size=117):
        path = tmp_path / "run" / "exported" / "policy.onnx"
        save(path, "obs", [1, size], 1)
        save(path.parent / "0-depth_encoder.onnx", "input", shape, 2)
        params = path.parent.parent / "params"
        params.mkdir()
        (params / "deploy.yaml").write_text(SEEN)
        text = init_policy(path, robot="go2").text
        return text, load_bundle(path.parent).card

    return draft


def test_an_encoder_that_gives_the_missing_numbers_sees_the_image(drafted):
    text, card = drafted([1, 4, 18, 32])
    depth = card.observations["depth_encoder_image"]
    assert (depth.sensor, depth.width, depth.height, depth.rate) == ("depth", 32, 18, 10)
    assert [(wrap.wrapper, wrap.steps) for wrap in depth.wrap] == [("stack", 4)]
    network = card.networks["depth_encoder"]
    assert network.checkpoint.file == "0-depth_encoder.onnx"
    assert "inputs: {obs: [obs, depth_encoder]}" in text
    assert "ZEROS" not in text
    assert "its near and far" in text, "which the file does not say"


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        pytest.param([1, 45], 117, id="no image"),
        pytest.param([1, 4, 18, 32], 118, id="another number of numbers is left"),
    ],
)
def test_another_network_is_offered_in_comments_alone(shape, size, drafted):
    text, card = drafted(shape, size=size)
    assert not card.networks
    assert "ZEROS STAND FOR depth_image" in text
    assert "#   depth_encoder:" in text, "by a name that a card may have"
