"""Operators give what the onnx package's own node tests expect."""

from __future__ import annotations

import copy
from collections import Counter

import numpy as np
import onnx
import pytest
from onnx import numpy_helper
from onnx.backend.test.case.node import collect_testcases

from nw_policies.executor import UnsupportedError
from nw_policies.executor.network import Network
from nw_policies.executor.plan import plan

BY_WEIGHTS = {"Add", "Conv", "Gemm", "GRU", "LSTM", "RNN", "MatMul", "Gather", "Split", "Where"}
BY_INPUTS = {"Softmax", "MaxPool", "AveragePool", "Elu", "Tanh", "Transpose", "Concat", "Clip"}


def with_constants(case):
    """Return a node test whose inputs but the first are constants, as a network's weights are."""
    model = copy.deepcopy(case.model)
    given = case.data_sets[0][0]
    first = model.graph.input[0].name
    for value, array in zip(model.graph.input, given, strict=False):
        if value.name not in {"", first} and isinstance(array, np.ndarray):
            model.graph.initializer.append(numpy_helper.from_array(array, value.name))
    known = {tensor.name for tensor in model.graph.initializer}
    rest = [value for value in model.graph.input if value.name not in known]
    del model.graph.input[:]
    model.graph.input.extend(rest)
    return model, [given[0]], case.data_sets[0][1]


def planned(model, graph_of):
    """Return a network of a node test, or None where it is not for this executor."""
    try:
        return Network(plan(graph_of(model)))
    except UnsupportedError:
        return None


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("constants", [False, True], ids=["inputs", "weights"])
def test_node_tests_of_onnx_that_can_be_planned_give_what_they_expect(constants, graph_of):
    ran: Counter[str] = Counter()
    for case in collect_testcases(None):
        arrays = [*case.data_sets[0][0], *case.data_sets[0][1]]
        if not case.model.graph.input or not all(
            isinstance(array, np.ndarray) and array.size for array in arrays
        ):
            continue
        model, given, wanted = case.model, *case.data_sets[0]
        if constants:
            model, given, wanted = with_constants(case)
        if (network := planned(model, graph_of)) is None:
            continue
        names = [value.name for value in model.graph.input]
        if len(names) != len(given):
            continue
        feeds = dict(zip(names, given, strict=True))
        network(feeds)
        results = network(feeds)  # What one call leaves behind changes nothing of the next.
        for value, expected in zip(model.graph.output, wanted, strict=True):
            found = results[value.name]
            assert found.shape == expected.shape, case.name
            np.testing.assert_allclose(
                found, expected.astype(np.float32), rtol=2e-5, atol=2e-6, err_msg=case.name
            )
        ran.update({node.op_type for node in model.graph.node})
    assert sum(ran.values()) > 300
    assert set(ran) >= (BY_WEIGHTS if constants else BY_INPUTS)


def one(graph_of, operator, shapes, *, attributes=None, constants=None, outputs=1):
    """Return a network of one operator whose first input is given and the rest are constants."""
    of = onnx.helper.make_tensor_value_info
    inputs = [f"x{i}" for i in range(len(shapes))] + list(constants or {})
    results = [f"y{i}" for i in range(outputs)]
    node = onnx.helper.make_node(operator, inputs, results, **(attributes or {}))
    graph = onnx.helper.make_graph(
        [node],
        "one",
        [of(f"x{i}", onnx.TensorProto.FLOAT, shape) for i, shape in enumerate(shapes)],
        [of(name, onnx.TensorProto.FLOAT, None) for name in results],
        [onnx.numpy_helper.from_array(array, name) for name, array in (constants or {}).items()],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)])
    return Network(plan(graph_of(model))), model


@pytest.mark.parametrize(
    ("shape", "kernel", "attributes"),
    [
        ((1, 9, 45, 80), (16, 9, 5, 5), {"strides": [2, 2], "pads": [2, 2, 2, 2]}),
        ((1, 1, 58, 87), (32, 1, 5, 5), {}),
        ((2, 6, 11, 9), (8, 3, 3, 3), {"group": 2, "pads": [1, 0, 1, 2]}),
        ((1, 4, 12, 12), (4, 1, 3, 3), {"group": 4, "strides": [2, 1]}),
        ((1, 5, 16, 17), (7, 5, 3, 3), {"dilations": [2, 3]}),
        ((1, 30, 10), (20, 30, 4), {"strides": [2]}),
        ((3, 3, 45, 80), (64, 3, 8, 8), {"strides": [8, 8]}),
    ],
)
def test_convolutions_agree_with_the_reference_implementation(shape, kernel, attributes, graph_of):
    rng = np.random.default_rng(1)
    weights = rng.normal(0, 0.3, kernel).astype(np.float32)
    bias = rng.normal(0, 1, kernel[0]).astype(np.float32)
    network, model = one(
        graph_of, "Conv", [shape], attributes=attributes, constants={"w": weights, "b": bias}
    )
    x = rng.normal(0, 1, shape).astype(np.float32)
    (wanted,) = onnx.reference.ReferenceEvaluator(model).run(None, {"x0": x})
    np.testing.assert_allclose(network({"x0": x})["y0"], wanted, rtol=1e-4, atol=1e-4)


def test_a_slice_of_a_product_that_is_rectified_leaves_the_rest_as_it_is(graph_of):
    of = onnx.helper.make_tensor_value_info
    eye = onnx.numpy_helper.from_array(np.eye(4, dtype=np.float32), "w")
    nodes = [
        onnx.helper.make_node("MatMul", ["x", "w"], ["h"]),
        onnx.helper.make_node("Split", ["h"], ["a", "b"], axis=1),
        onnx.helper.make_node("Relu", ["a"], ["r"]),
    ]
    graph = onnx.helper.make_graph(
        nodes,
        "split",
        [of("x", onnx.TensorProto.FLOAT, [1, 4])],
        [of(name, onnx.TensorProto.FLOAT, [1, 2]) for name in ("r", "b")],
        [eye],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)])
    results = Network(plan(graph_of(model)))({"x": -np.ones((1, 4), np.float32)})
    assert results["r"].tolist() == [[0.0, 0.0]]
    assert results["b"].tolist() == [[-1.0, -1.0]]


def test_what_cannot_be_planned_is_named(graph_of):
    with pytest.raises(UnsupportedError, match="operator NonMaxSuppression"):
        one(graph_of, "NonMaxSuppression", [(1, 4, 4), (1, 1, 4)])
    with pytest.raises(UnsupportedError, match="operator Conv with `x1` depends on the inputs"):
        one(graph_of, "Conv", [(1, 1, 4, 4), (1, 1, 3, 3)])
