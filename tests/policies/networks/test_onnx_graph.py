"""Graphs that we write, read by the onnx package and run by onnxruntime."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import numpy_helper

from nw_policies.networks.onnx_graph import Graph


def test_the_onnx_package_reads_what_was_written():
    graph = Graph()
    matrix = np.arange(600, dtype=np.float32).reshape(2, 300)
    x = graph.node("Gemm", graph.input("x", 4, 300), graph.constant(matrix), transB=1)
    x = graph.node("Softmax", x, axis=-1)
    x = graph.node(
        "Transpose", graph.node("Reshape", x, graph.constant([2, -1, 1])), perm=[2, 0, 1]
    )
    model = onnx.load_from_string(graph.model(x, 1, 2, 4))
    onnx.checker.check_model(model, full_check=True)
    assert [node.op_type for node in model.graph.node] == [
        "Gemm",
        "Softmax",
        "Reshape",
        "Transpose",
    ]
    attributes = [
        onnx.helper.get_attribute_value(attribute)
        for node in model.graph.node
        for attribute in node.attribute
    ]
    assert attributes == [1, -1, [2, 0, 1]]
    first, second = (numpy_helper.to_array(tensor) for tensor in model.graph.initializer)
    np.testing.assert_array_equal(first, matrix)
    assert (second.tolist(), second.dtype) == ([2, -1, 1], np.int64)
    sizes = [dim.dim_value for dim in model.graph.input[0].type.tensor_type.shape.dim]
    assert (model.graph.input[0].name, sizes) == ("x", [4, 300])


def test_a_session_computes_the_output():
    graph = Graph()
    matrix = np.random.default_rng(0).normal(size=(5, 300)).astype(np.float32)
    product = graph.node("Gemm", graph.input("x", 4, 300), graph.constant(matrix), transB=1)
    session = graph.open(graph.node("Relu", product), 4, 5)
    x = np.random.default_rng(1).normal(size=(4, 300)).astype(np.float32)
    expected = np.maximum(x.astype(np.float64) @ matrix.T, 0)
    np.testing.assert_allclose(session.run(None, {"x": x})[0], expected, atol=1e-4)
