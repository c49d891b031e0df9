"""ONNX files are measured before onnxruntime allocates what they claim."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from nw_base.errors import PolicyError
from nw_policies.safety import FileLimits, check_onnx


def model(*, weight: TensorProto | None = None, nodes=()) -> bytes:
    weight = weight or numpy_helper.from_array(np.ones((53, 12), np.float32), "w")
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "w"], ["action"]), *nodes],
        "g",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 53])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 12])],
        [weight],
    )
    return helper.make_model(graph).SerializeToString()


def test_other_formats_are_named(tmp_path):
    torch.save({"w": torch.zeros(3)}, tmp_path / "policy.onnx")
    with pytest.raises(PolicyError, match="not an ONNX file: it holds a state dict"):
        check_onnx((tmp_path / "policy.onnx").read_bytes(), "policy.onnx")
    with pytest.raises(PolicyError, match="a web page"):
        check_onnx(b"<!doctype html><html>", "policy.onnx")


def huge(**fields) -> TensorProto:
    return TensorProto(name="w", dims=[25_000_000_000], data_type=TensorProto.FLOAT, **fields)


@pytest.mark.parametrize(
    "dtype", [np.float32, np.float64, np.float16, np.int64, np.int32, np.int8, np.uint8, np.bool_]
)
def test_honest_tensors_of_every_type_pass(dtype):
    check_onnx(model(weight=numpy_helper.from_array(np.ones((3, 4), dtype), "w")), "p.onnx")
    values = [1.0, 0.0, 1.0] if np.issubdtype(dtype, np.floating) else [1, 0, 1]
    kind = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
    check_onnx(model(weight=helper.make_tensor("w", kind, [3], values)), "p.onnx")


def test_scalars_empty_tensors_and_constants_in_subgraphs_pass():
    then = helper.make_graph(
        [
            helper.make_node(
                "Constant", [], ["c"], value=numpy_helper.from_array(np.array(2.0), "c")
            )
        ],
        "then",
        [],
        [helper.make_tensor_value_info("c", TensorProto.DOUBLE, [])],
    )
    node = helper.make_node("If", ["flag"], ["out"], then_branch=then, else_branch=then)
    empty = numpy_helper.from_array(np.zeros((0, 4), np.float32), "w")
    check_onnx(model(weight=empty, nodes=[node]), "p.onnx")


@pytest.mark.parametrize(
    ("tensor", "reason"),
    [
        (huge(), "claims 25000000000 numbers, the file holds 0 numbers"),
        (huge(raw_data=b"\0" * 16), "claims 25000000000 numbers, the file holds 16 bytes"),
        (huge(float_data=[1.0] * 5), "the file holds 5 numbers"),
        (TensorProto(name="w", dims=[-1], data_type=1, float_data=[1.0]), "claims"),
        (
            huge(
                data_location=1,
                external_data=[onnx.StringStringEntryProto(key="location", value="/etc/passwd")],
            ),
            "lie in another file",
        ),
    ],
)
def test_a_tensor_that_claims_more_than_the_file_holds_is_refused(tensor, reason):
    with pytest.raises(PolicyError, match=reason):
        check_onnx(model(weight=tensor), "p.onnx")
    inner = helper.make_node("Constant", [], ["c"], value=tensor)
    with pytest.raises(PolicyError, match=reason):
        check_onnx(model(nodes=[inner]), "p.onnx")


def test_limits_and_noise_are_refused():
    with pytest.raises(PolicyError, match="over the limit"):
        check_onnx(model(), "p.onnx", FileLimits(file_bytes=100))
    with pytest.raises(PolicyError, match="more than 0 tensors"):
        check_onnx(model(), "p.onnx", FileLimits(tensors=0))
    data = model()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(300):
        damaged = bytearray(data)
        for _ in range(3):
            damaged[int(rng.integers(100))] = int(rng.integers(256))
        try:
            check_onnx(bytes(damaged), "p.onnx")
        except PolicyError:
            refused += 1
    assert refused > 100
