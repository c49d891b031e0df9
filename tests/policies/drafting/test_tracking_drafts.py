"""Cards of policies that track a motion, drafted from what trainings write beside them."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
import yaml
from onnx import TensorProto, helper, numpy_helper

from nw_policies import load_bundle
from nw_policies.drafting.beside import read_beside
from nw_policies.drafting.checkpoint import inspect_checkpoint
from nw_policies.drafting.draft import write_card_draft
from nw_policies.drafting.tracking import motions_beside
from nw_scenes.robots import get_robot

JOINTS = get_robot("go1").joints
TERMS = "command,motion_anchor_pos_b,motion_anchor_ori_b,base_ang_vel,joint_pos,joint_vel,actions"
WIDTHS = (24, 3, 6, 3, 12, 12, 12)
METADATA = {
    "joint_names": ",".join(JOINTS),
    "command_names": "motion",
    "observation_names": TERMS,
    "anchor_body_name": "trunk",
    "body_names": "trunk,FR_calf,FL_calf",
}
"""As `attach_onnx_metadata` of whole_body_tracking and mjlab writes it."""


def seen(card):
    return {
        name: [getattr(term, "term", term) for term in observation.terms]
        for name, observation in card.observations.items()
    }


def motion(folder):
    row = ",".join(["0"] * 6 + ["1"] + ["0"] * 12)
    (folder / "dance_60hz.csv").write_text(f"{row}\n{row}\n{row}\n")


def test_metadata_of_a_tracking_policy_make_its_motion(onnx_file, tmp_path):
    path = onnx_file({"obs": [1, sum(WIDTHS)]}, METADATA)
    motion(tmp_path)
    found = motions_beside(path, tmp_path)
    text = write_card_draft(inspect_checkpoint(path), get_robot("go1"), motions=found)
    (tmp_path / "policy.yaml").write_text(text)
    card = load_bundle(tmp_path).card
    assert seen(card) == {
        "obs_motion": [
            "joint_positions",
            "joint_velocities",
            "anchor_position",
            "anchor_orientation_6d",
        ],
        "obs": ["ang_vel", "joint_pos", "joint_vel", "last_output"],
    }
    assert card.observations["obs_motion"].ahead == (1,)
    assert card.inputs == {"obs": ["obs_motion", "obs"]}
    reference = card.reference
    assert (reference.file, reference.rate) == ("dance_60hz.csv", 60)
    assert (reference.anchor, reference.bodies) == ("trunk", ("trunk", "FR_calf", "FL_calf"))


def test_a_command_that_is_no_motion_stays_a_velocity(onnx_file, drafted):
    metadata = {
        "joint_names": METADATA["joint_names"],
        "command_names": "twist",
        "observation_names": "command,base_ang_vel,joint_pos,joint_vel,actions",
    }
    _, card, problems = drafted(onnx_file({"obs": [1, 42]}, metadata))
    assert card.reference is None
    assert card.observations["obs"].terms[0].term == "command"
    assert problems == []


def test_a_checkpoint_with_its_motion_is_its_own_reference(tmp_path):
    """Outputs and inputs are those of `_OnnxMotionPolicyExporter`."""
    tables = {"joint_pos": (5, 12), "joint_vel": (5, 12), "body_pos_w": (5, 1, 3)}
    tables["body_quat_w"] = (5, 1, 4)
    constants = {name: np.zeros(shape, np.float32) for name, shape in tables.items()}
    constants["body_quat_w"][..., 0] = 1.0
    nodes = [
        helper.make_node("Cast", ["time_step"], ["long"], to=TensorProto.INT64),
        helper.make_node("Reshape", ["long", "flat"], ["row"]),
        helper.make_node("MatMul", ["obs", "weight"], ["actions"]),
        *(helper.make_node("Gather", [f"{name}_", "row"], [name], axis=0) for name in tables),
    ]
    initial = {f"{name}_": array for name, array in constants.items()}
    initial |= {"flat": np.array([1]), "weight": np.zeros((sum(WIDTHS), 12), np.float32)}
    graph = helper.make_graph(
        nodes,
        "g",
        [
            helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, sum(WIDTHS)]),
            helper.make_tensor_value_info("time_step", TensorProto.FLOAT, [1, 1]),
        ],
        [
            helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 12]),
            *(
                helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, *shape[1:]])
                for name, shape in tables.items()
            ),
        ],
        [numpy_helper.from_array(array, name) for name, array in initial.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, METADATA)
    path = tmp_path / "policy.onnx"
    onnx.save(model, str(path))
    text = write_card_draft(inspect_checkpoint(path), get_robot("go1"))
    (tmp_path / "policy.yaml").write_text(text)
    bundle = load_bundle(tmp_path)
    assert bundle.card.reference.file == "policy.onnx"
    assert bundle.motion.sha256 == bundle.checkpoint_sha256
    assert bundle.card.output == "actions"
    assert seen(bundle.card)["time_step"] == ["frame"]
    assert bundle.card.inputs["time_step"] == ["time_step"]
    assert "CHECK: or" not in text


ENVIRONMENT = {
    "sim": {"dt": 0.005},
    "decimation": 4,
    "scene": {"robot": {"init_state": {"joint_pos": {".*": 0.1}}}},
    "commands": {
        "motion": {
            "motion_file": "/data/artifacts/dance.npz",
            "anchor_body_name": "trunk",
            "body_names": ["trunk", "FR_calf"],
        }
    },
    "actions": {"joint_pos": {"class_type": "isaaclab.JointPositionAction", "scale": 0.25}},
    "observations": {
        "policy": {
            "command": {
                "func": "isaaclab.envs.mdp:generated_commands",
                "params": {"command_name": "motion"},
            },
            "ori": {"func": "whole_body_tracking.mdp.observations:motion_anchor_ori_b"},
        }
    },
}
"""The part of an env.yaml of whole_body_tracking that says what is tracked."""


def test_env_yaml_says_what_is_tracked():
    known = read_beside({"env.yaml": yaml.safe_dump(ENVIRONMENT)}, get_robot("go1"))
    assert [term.word for term in known.observation_terms] == [
        "motion_command",
        "motion_anchor_ori_b",
    ]
    assert (known.anchor, known.bodies) == ("trunk", ("trunk", "FR_calf"))
    assert known.motion_file == "/data/artifacts/dance.npz"


@pytest.mark.parametrize("where", ["", "motions", "../params"])
def test_motions_are_found_near_a_checkpoint(tmp_path, where):
    folder = tmp_path / "exported"
    (folder / where).mkdir(parents=True)
    (folder / "policy.onnx").write_bytes(b"")
    motion(folder / where)
    (folder / where / "dance.npz").write_bytes(b"")
    found = motions_beside(folder / "policy.onnx", tmp_path)
    assert [path.rpartition("/")[2] for path in found] == ["dance.npz", "dance_60hz.csv"]
    assert motions_beside(folder / "policy.onnx", tmp_path / "elsewhere") == ()
