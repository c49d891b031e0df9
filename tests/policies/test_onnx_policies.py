import hashlib

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from nw_base.errors import PolicyError, TrialError
from nw_policies import load_bundle, open_policy

CARD = """\
nw-policy: 1
name: mine
robot: go1
adapter: onnx
checkpoint: {file: policy.onnx, sha256: %s}
control: {action: joint_position_offset, scale: 0.25}
observations:
  body: {sensor: proprio, terms: [joint_pos]}
  feet: {sensor: proprio, terms: [foot_contacts]}
"""


def linear(weight, inputs=16, outputs=12):
    """A graph action = obs @ weight.T, as bytes."""
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["obs", "weight"], ["action"], transB=1)],
        "linear",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, outputs])],
        [numpy_helper.from_array(weight.astype(np.float32), "weight")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    return model.SerializeToString()


def bundle_of(folder, data, extra=""):
    (folder / "policy.onnx").write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    (folder / "policy.yaml").write_text(CARD % digest + extra)
    return load_bundle(folder)


def test_observations_are_joined_in_the_order_of_the_card(tmp_path):
    weight = np.zeros((12, 16))
    weight[0, 0], weight[1, 12] = 1.0, 1.0
    policy = open_policy(bundle_of(tmp_path, linear(weight)))
    body, feet = np.arange(12, dtype=np.float32) + 5, np.full(4, 7, dtype=np.float32)
    action = policy.act({"feet": feet, "body": body})
    assert action[:3].tolist() == [5.0, 7.0, 0.0]
    assert action.dtype == np.float64


def test_an_action_is_not_changed_by_the_next_one(tmp_path):
    policy = open_policy(bundle_of(tmp_path, linear(np.eye(12, 16))))
    feet = np.zeros(4, dtype=np.float32)
    first = policy.act({"body": np.ones(12, dtype=np.float32), "feet": feet})
    policy.act({"body": np.zeros(12, dtype=np.float32), "feet": feet})
    assert first.tolist() == [1.0] * 12


def test_an_action_that_is_not_a_number_is_a_trial_error(tmp_path):
    policy = open_policy(bundle_of(tmp_path, linear(np.full((12, 16), np.nan))))
    zeros = {"body": np.zeros(12, np.float32), "feet": np.zeros(4, np.float32)}
    with pytest.raises(TrialError, match="policy 'mine' returned nan for joint 0"):
        policy.act(zeros)


def test_an_output_of_another_size_is_found_before_any_trial(tmp_path):
    with pytest.raises(PolicyError, match="has 8 numbers, the robot 'go1' has 12 joints"):
        open_policy(bundle_of(tmp_path, linear(np.zeros((8, 16)), outputs=8)))


def test_a_corrupt_file_is_a_policy_error_of_one_line(tmp_path):
    with pytest.raises(PolicyError, match="not a usable ONNX file") as caught:
        open_policy(bundle_of(tmp_path, b"\x08\x08garbage"))
    assert "\n" not in str(caught.value)


def test_an_unknown_output_is_answered_with_the_nearest_one(tmp_path):
    with pytest.raises(PolicyError, match="did you mean 'action'"):
        open_policy(bundle_of(tmp_path, linear(np.zeros((12, 16))), "output: actoin\n"))


def test_an_unknown_input_is_answered_with_the_nearest_one(tmp_path):
    extra = "inputs: {ops: [body, feet]}\n"
    with pytest.raises(PolicyError, match="no input 'ops'; did you mean 'obs'"):
        open_policy(bundle_of(tmp_path, linear(np.zeros((12, 16))), extra))


def test_weights_in_files_beside_the_graph_are_not_read(tmp_path):
    model = onnx.load_from_string(linear(np.ones((12, 16))))
    onnx.save(
        model,
        tmp_path / "outside.onnx",
        save_as_external_data=True,
        location="data.bin",
        size_threshold=0,
    )
    data = (tmp_path / "outside.onnx").read_bytes()
    with pytest.raises(PolicyError, match="export it again as one file"):
        open_policy(bundle_of(tmp_path, data))


def test_a_closed_policy_says_so(tmp_path):
    policy = open_policy(bundle_of(tmp_path, linear(np.zeros((12, 16)))))
    policy.close()
    policy.close()
    with pytest.raises(TrialError, match="is closed"):
        policy.act({})


def counting(source="h_in", target="h_out", shape=(1, 1, 12)):
    """A graph h_out = h_in + obs[:12], action = 2 * h_out, as bytes."""
    flat = numpy_helper.from_array(np.array([1, 12], np.int64), "flat")
    deep = numpy_helper.from_array(np.array(shape, np.int64), "deep")
    starts = numpy_helper.from_array(np.array([0], np.int64), "starts")
    ends = numpy_helper.from_array(np.array([12], np.int64), "ends")
    axes = numpy_helper.from_array(np.array([1], np.int64), "axes")
    graph = helper.make_graph(
        [
            helper.make_node("Slice", ["obs", "starts", "ends", "axes"], ["body"]),
            helper.make_node("Reshape", [source, "flat"], ["before"]),
            helper.make_node("Add", ["before", "body"], ["sum"]),
            helper.make_node("Add", ["sum", "sum"], ["actions"]),
            helper.make_node("Reshape", ["sum", "deep"], [target]),
        ],
        "counting",
        [
            helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 16]),
            helper.make_tensor_value_info(source, TensorProto.FLOAT, shape),
        ],
        [
            helper.make_tensor_value_info(target, TensorProto.FLOAT, shape),
            helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 12]),
        ],
        [flat, deep, starts, ends, axes],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    return model.SerializeToString()


ONES = {"body": np.ones(12, np.float32), "feet": np.zeros(4, np.float32)}


@pytest.mark.parametrize(
    ("names", "extra"),
    [(("h_in", "h_out"), ""), (("left", "right"), "recurrent: {left: right}\n")],
    ids=["by its names", "by the card"],
)
def test_recurrent_state_is_fed_back_saved_and_restored(tmp_path, names, extra):
    policy = open_policy(bundle_of(tmp_path, counting(*names), extra))
    assert [spec.name for spec in policy.inputs] == ["obs"]
    policy.reset(0)
    assert policy.act(ONES)[0] == 2.0
    assert policy.act(ONES)[0] == 4.0
    saved = policy.state()
    assert policy.act(ONES)[0] == 6.0
    policy.restore(saved)
    assert policy.act(ONES)[0] == 6.0
    policy.reset(1)
    assert policy.act(ONES)[0] == 2.0


def test_an_unfed_recurrent_input_is_an_error_that_names_it(tmp_path):
    bundle = bundle_of(tmp_path, counting("left", "right"))
    with pytest.raises(PolicyError, match="the checkpoint has 2 inputs: obs, left"):
        open_policy(bundle)


def test_a_recurrent_output_that_is_not_there_is_named(tmp_path):
    bundle = bundle_of(tmp_path, counting("left", "right"), "recurrent: {left: rihgt}\n")
    with pytest.raises(PolicyError, match=r"no output 'rihgt'; did you mean 'right'\?"):
        open_policy(bundle)


def test_recurrent_state_of_another_size_does_not_fit(tmp_path):
    policy = open_policy(bundle_of(tmp_path, counting()))
    saved = policy.state()
    (tmp_path / "other").mkdir()
    other = open_policy(bundle_of(tmp_path / "other", counting(shape=(2, 1, 6))))
    with pytest.raises(TrialError, match="does not fit policy 'mine'"):
        other.restore(saved)


def test_a_graph_that_draws_numbers_draws_the_same_in_every_trial(tmp_path):
    nodes = [
        helper.make_node("RandomNormal", [], ["noise"], shape=[1, 12], seed=1.0),
        helper.make_node("Gemm", ["obs", "weight", "noise"], ["action"], transB=1),
    ]
    graph = helper.make_graph(
        nodes,
        "drawing",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 16])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 12])],
        [numpy_helper.from_array(np.zeros((12, 16), np.float32), "weight")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    bundle = bundle_of(tmp_path, model.SerializeToString())
    zeros = {"body": np.zeros(12, np.float32), "feet": np.zeros(4, np.float32)}
    first, second = (open_policy(bundle) for _ in range(2))
    drawn = first.act(zeros)
    assert drawn.any()
    assert second.act(zeros).tolist() == drawn.tolist()
    assert first.act(zeros).tolist() != drawn.tolist()
