"""A graph and the weights beside it become one file, without the package `onnx`."""

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from nw_base.errors import PolicyError, UsageError
from nw_eval import api
from nw_policies.folding import fold

VALUE = helper.make_tensor_value_info
THEN, OTHER = (np.full((1, 12), number, np.float32) for number in (1.5, -2.5))
WEIGHT = np.random.default_rng(0).normal(0, 0.1, (45, 12)).astype(np.float32)


def branch(name, values):
    """A graph whose one node is a constant: its numbers are an attribute, not an initializer."""
    node = helper.make_node("Constant", [], [name], value=numpy_helper.from_array(values, name))
    return helper.make_graph([node], name, [], [VALUE(name, TensorProto.FLOAT, [1, 12])])


def save(folder):
    """A graph with weights, a branch and metadata, whose numbers lie in policy.onnx.data."""
    folder.mkdir(exist_ok=True)
    nodes = [
        helper.make_node("MatMul", ["obs", "weight"], ["raw"]),
        helper.make_node(
            "If",
            ["ahead"],
            ["shift"],
            then_branch=branch("then", THEN),
            else_branch=branch("other", OTHER),
        ),
        helper.make_node("Add", ["raw", "shift"], ["actions"]),
        helper.make_node("LeakyRelu", ["actions"], ["aside"], alpha=0.125),
    ]
    graph = helper.make_graph(
        nodes,
        "walk",
        [VALUE("obs", TensorProto.FLOAT, [1, 45]), VALUE("ahead", TensorProto.BOOL, [1])],
        [VALUE("actions", TensorProto.FLOAT, [1, 12]), VALUE("aside", TensorProto.FLOAT, [1, 12])],
        [numpy_helper.from_array(WEIGHT, "weight")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"run_path": "a,b"})
    onnx.save(
        model,
        folder / "policy.onnx",
        save_as_external_data=True,
        location="policy.onnx.data",
        size_threshold=0,
        convert_attribute=True,
    )
    return folder / "policy.onnx"


def told(file, *, ahead):
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    return session.run(None, {"obs": np.ones((1, 45), np.float32), "ahead": np.array([ahead])})


def test_a_folded_graph_says_what_the_two_files_said(tmp_path):
    path, one = save(tmp_path / "two"), tmp_path / "one.onnx"
    assert "policy.onnx.data" in str(onnx.load(path, load_external_data=False))
    assert api.fold_policy(path, out=one).bytes == one.stat().st_size
    assert "policy.onnx.data" not in str(onnx.load(one))
    onnx.checker.check_model(onnx.load(one), full_check=True)
    for ahead in (True, False):
        np.testing.assert_array_equal(told(one, ahead=ahead), told(path, ahead=ahead))
    expected = WEIGHT.sum(axis=0) + OTHER[0]
    np.testing.assert_allclose(told(one, ahead=False)[0][0], expected, atol=1e-6)
    assert onnx.load(one).metadata_props[0].value == "a,b"
    assert "\nname: one\n" in api.init_policy(one, robot="go1").text


def test_a_graph_that_is_one_file_already_stays_what_it_is(tmp_path):
    whole = onnx.load(save(tmp_path / "two"))
    onnx.save(whole, tmp_path / "whole.onnx")
    fold(checkpoint=str(tmp_path / "whole.onnx"), out=str(tmp_path / "one.onnx"))
    assert onnx.load(tmp_path / "one.onnx") == whole


def edited(path, key, value):
    """The same graph with another entry in what its weight says of its file."""
    model = onnx.load(path, load_external_data=False)
    for entry in model.graph.initializer[0].external_data:
        if entry.key == key:
            entry.value = value
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("location", "../policy.onnx.data", "tensor 'weight' lies in '../policy.onnx.data', which"),
        ("location", "/etc/passwd", "cannot be used: it is an absolute path"),
        ("location", "absent.data", "absent.data: cannot be read: No such file"),
        ("offset", "4000", "lies at bytes 4000 to 6160 of 'policy.onnx.data', which has"),
        ("offset", "-8", "lies at bytes -8 to"),
        ("length", "12", "claims 45 x 12 numbers, the file holds 12 bytes"),
        ("length", "much", "cannot be used: invalid literal"),
    ],
)
def test_a_graph_that_names_other_bytes_than_its_own_is_refused(tmp_path, key, value, said):
    path = edited(save(tmp_path / "two"), key, value)
    (tmp_path / "policy.onnx.data").write_bytes(bytes(10_000))
    with pytest.raises(PolicyError) as raised:
        fold(checkpoint=str(path), out=str(tmp_path / "one.onnx"))
    assert said in str(raised.value)
    assert not (tmp_path / "one.onnx").exists()


def test_what_is_no_graph_is_not_folded_and_no_file_is_overwritten(tmp_path):
    (tmp_path / "noise.onnx").write_bytes(b"\x08\x07 and then noise")
    with pytest.raises(PolicyError, match="not a usable ONNX file"):
        fold(checkpoint=str(tmp_path / "noise.onnx"), out=str(tmp_path / "one.onnx"))
    path = save(tmp_path)
    with pytest.raises(UsageError, match="exists already"):
        api.fold_policy(path, out=path)
