"""Graphs of networks: those of the onnx package's own node tests, and small ones."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from nw_policies.networks.onnx_reading import read_graph


@pytest.fixture
def graph_of():
    """Return the graph of an ONNX model, read as a policy's is."""
    return lambda model: read_graph(model.SerializeToString())


@pytest.fixture
def perceptron():
    """Return a model of two dense layers with ELU, 48 to 12."""
    rng = np.random.default_rng(0)
    weights = {
        name: numpy_helper.from_array(rng.normal(0, 0.2, shape).astype(np.float32), name)
        for name, shape in {"w": (48, 64), "b": (64,), "v": (64, 12), "c": (12,)}.items()
    }
    nodes = [
        onnx.helper.make_node("Gemm", ["obs", "w", "b"], ["h"]),
        onnx.helper.make_node("Elu", ["h"], ["a"]),
        onnx.helper.make_node("Gemm", ["a", "v", "c"], ["action"]),
    ]
    of = onnx.helper.make_tensor_value_info
    graph = onnx.helper.make_graph(
        nodes,
        "perceptron",
        [of("obs", onnx.TensorProto.FLOAT, [1, 48])],
        [of("action", onnx.TensorProto.FLOAT, [1, 12])],
        list(weights.values()),
    )
    opset = onnx.helper.make_opsetid("", 17)
    return onnx.helper.make_model(graph, opset_imports=[opset], ir_version=9)


@pytest.fixture
def eye():
    """Return a function: a model of a convolution over (bytes / 255 - mean), with other outputs."""

    def eye(*also, mean=None):
        rng = np.random.default_rng(1)
        weights = {
            "full": np.float32(255.0),
            "mean": rng.random((1, 3, 20, 30), np.float32) if mean is None else mean,
            "w": rng.normal(0, 0.2, (8, 3, 5, 5)).astype(np.float32),
            "b": rng.normal(0, 0.2, 8).astype(np.float32),
        }
        node, of = onnx.helper.make_node, onnx.helper.make_tensor_value_info
        nodes = [
            node("Cast", ["rgb"], ["cast"], to=onnx.TensorProto.FLOAT),
            node("Div", ["cast", "full"], ["share"]),
            node("Sub", ["share", "mean"], ["centred"]),
            node("Conv", ["centred", "w", "b"], ["seen"], pads=[2, 2, 2, 2], strides=[2, 2]),
            node("Mul", ["share", "share"], ["squared"]),
        ]
        shape = [1, 3, 20, 30]
        outputs = [of("seen", onnx.TensorProto.FLOAT, [1, 8, 10, 15])]
        outputs += [of(name, onnx.TensorProto.FLOAT, shape) for name in also]
        graph = onnx.helper.make_graph(
            nodes if "squared" in also else nodes[:-1],
            "eye",
            [of("rgb", onnx.TensorProto.UINT8, shape)],
            outputs,
            [numpy_helper.from_array(array, name) for name, array in weights.items()],
        )
        opset = onnx.helper.make_opsetid("", 17)
        return onnx.helper.make_model(graph, opset_imports=[opset], ir_version=9)

    return eye
