import dataclasses
import hashlib

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from nw_base.errors import PolicyError
from nw_policies import load_bundle
from nw_scenes.robots import get_robot
from nw_sim.rollout.confined.vetting import check_bundle
from nw_sim.sensors import check_card

CARD = """\
nw-policy: 1
name: mine
robot: go1
adapter: onnx
checkpoint: {file: policy.onnx, sha256: %s}
control: {action: joint_position_offset, scale: 0.25}
command: {source: trail_follower}
observations:
  proprio:
    sensor: proprio
    terms: [lin_vel, ang_vel, gravity, command, joint_pos, joint_vel, last_output]
"""


def bundle_that_wants(folder, inputs):
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["obs", "weight"], ["action"], transB=1)],
        "linear",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 12])],
        [numpy_helper.from_array(np.zeros((12, inputs), np.float32), "weight")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    onnx.save(model, folder / "policy.onnx")
    digest = hashlib.sha256((folder / "policy.onnx").read_bytes()).hexdigest()
    (folder / "policy.yaml").write_text(CARD % digest)
    return load_bundle(folder)


def test_a_checkpoint_that_wants_other_numbers_is_said_in_the_cards_terms(tmp_path):
    with pytest.raises(PolicyError) as caught:
        check_bundle(bundle_that_wants(tmp_path, 45))
    text = str(caught.value)
    assert "`proprio` is 48 numbers; the checkpoint's input `obs` wants 45" in text
    assert "48 = 3 + 3 + 3 + 3 + 12 + 12 + 12" in text


def test_a_checkpoint_that_fits_is_accepted(tmp_path):
    (spec,) = check_bundle(bundle_that_wants(tmp_path, 48))
    assert spec.shape == (48,)


@pytest.mark.parametrize("name", ["go1-parkour", "stand"])
def test_shipped_bundles_fit_their_robot_and_checkpoint(name):
    check_bundle(load_bundle(name), get_robot("go1"))


def test_go1_parkour_sees_332_numbers():
    specs = check_card(load_bundle("go1-parkour").card)
    assert [spec.shape[0] for spec in specs] == [53, 132, 12, 135]


def test_a_policy_of_another_robot_is_refused():
    other = dataclasses.replace(get_robot("go1"), name="go2")
    with pytest.raises(PolicyError, match="drives the robot 'go1', the suite runs 'go2'"):
        check_card(load_bundle("go1-parkour").card, other)


def test_an_unknown_robot_is_answered_with_the_nearest_one(card_of):
    with pytest.raises(PolicyError, match="unknown robot 'go11'; did you mean 'go1'"):
        check_card(card_of({}, robot="go11"))


def test_all_problems_with_the_robot_are_said_at_once(card_of):
    card = card_of(
        {
            "eye": {"sensor": "splat_rgb", "camera": "eggo"},
            "body": {"sensor": "proprio", "terms": ["joint_pos"], "select": ["0:13"]},
        }
    )
    with pytest.raises(PolicyError) as caught:
        check_card(card)
    eye, body = str(caught.value).splitlines()
    assert "`eye`: go1 has no camera 'eggo'; did you mean 'ego'?" in eye
    assert "`body`: select: '0:13' is outside the 12 numbers" in body


def test_a_wrong_joint_is_said_once(card_of):
    card = card_of({"body": {"sensor": "proprio", "terms": ["joint_pos"]}}, control={"scale": [1]})
    with pytest.raises(PolicyError) as caught:
        check_card(card)
    assert str(caught.value).count("control.scale") == 1


def test_image_shapes_follow_stack_and_axes(card_of):
    image = {"sensor": "splat_rgb", "width": 80, "height": 45}
    card = card_of(
        {
            "plain": image,
            "stacked": image | {"stack": 7, "axes": "chw"},
            "channels": image | {"stack": 2, "stack_axis": "channel"},
        }
    )
    shapes = {spec.name: spec.shape for spec in check_card(card)}
    assert shapes == {"plain": (45, 80, 3), "stacked": (7, 3, 45, 80), "channels": (45, 80, 6)}
