"""Bundles of LEAPP become cards that act as LEAPP's own runtime does.

The folders of `leapp/` were written by leapp 0.7.2: `isaac-lab` and `isaac-lab-jit` annotated as
Isaac Lab's exporter annotates (`isaaclab/utils/leapp/export_annotator.py`): a small random network
that takes the state of a Go2, its orientation as x y z w, and gives targets and gains; `two-nodes`
has the senses in a graph of their own. `expected.json` has four steps in a row of its
`InferenceManager`. Debug members of the scripts, which name paths, are left out.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from nw_base.errors import PolicyError
from nw_eval.api.policies import init_policy
from nw_policies import load_bundle, open_policy
from nw_policies.cards.card import Card
from nw_policies.cards.load import load_card
from nw_policies.drafting.beside import files_beside_checkpoint, find_checkpoint
from nw_policies.drafting.draft import draft_of

BUNDLES = Path(__file__).parent / "leapp"
BY_TYPE = [f"{leg}_{kind}" for kind in ("hip", "thigh", "calf") for leg in ("FL", "FR", "RL", "RR")]


@pytest.fixture
def bundle(tmp_path):
    """Copy a bundle, with replacements in its YAML, and return its folder."""

    def copy(name: str, *changes: tuple[str, str]) -> Path:
        folder = Path(shutil.copytree(BUNDLES / name, tmp_path / "run" / name))
        (file,) = folder.glob("*.yaml")
        text = file.read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        file.write_text(text)
        return folder

    return copy


def drafted(folder: Path) -> str:
    """Draft the card of a bundle here, as the confined process does, beside it."""
    checkpoint, _ = find_checkpoint(folder)
    text = draft_of(
        checkpoint=str(checkpoint),
        robot="go2",
        folder=str(folder),
        beside=files_beside_checkpoint(checkpoint),
    )["text"]
    (folder / "policy.yaml").write_text(text)
    return text


def card_of(folder: Path) -> Card:
    drafted(folder)
    return load_card(folder / "policy.yaml")


@pytest.mark.parametrize("name", ["isaac-lab", "isaac-lab-jit", "two-nodes"])
def test_the_drafted_card_acts_as_leapps_own_runtime(name, bundle):
    folder = bundle(name)
    drafted(folder)
    loaded = load_bundle(folder)
    policy = open_policy(loaded, allow_code=True)
    steps = json.loads((folder / "expected.json").read_text())["steps"]
    for _ in range(2):  # The second trial begins anew.
        policy.reset(0)
        for step in steps:
            seen = {key: np.array(value, np.float32) for key, value in step["inputs"].items()}
            action = policy.act({name: seen[name] for name in loaded.card.observations})
            np.testing.assert_allclose(action, step["action"], rtol=0, atol=1e-6)
    saved = policy.state()
    once = policy.act({name: seen[name] for name in loaded.card.observations})
    policy.restore(saved)
    again = policy.act({name: seen[name] for name in loaded.card.observations})
    assert np.array_equal(once, again)
    assert not np.allclose(once, steps[-1]["action"]), "the last action is fed back"
    policy.close()


@pytest.mark.parametrize("name", ["isaac-lab", "isaac-lab-jit"])
def test_kinds_and_names_are_the_whole_card(name, bundle):
    folder = bundle(name)
    card = card_of(folder)
    assert card.control.action == "joint_position"
    assert card.control.scale == 1
    assert card.control.rate == 50
    assert card.control.joints == BY_TYPE
    assert card.control.kp == [20.0 + place for place in range(12)]
    assert card.control.kd == 0.5
    terms = {name: seen.terms[0] for name, seen in card.observations.items()}
    assert list(terms) == [
        "base_velocity", "robot_root_ang_vel_b", "robot_root_quat_w", "robot_joint_pos",
        "robot_joint_vel",
    ]  # fmt: skip
    assert terms["robot_root_quat_w"].order == "xyzw"
    assert not terms["robot_joint_pos"].relative
    assert "Velocity-Go2.yaml" in drafted(folder).partition("kp:")[2].partition("\n")[0]


def test_nodes_that_feed_the_policy_are_networks(bundle):
    card = card_of(bundle("two-nodes"))
    assert card.checkpoint.file == "policy.onnx"
    assert card.networks["senses"].checkpoint.file == "senses.onnx"
    assert card.inputs["body"] == ["senses.body"]
    assert card.observations["joint_vel"].select == list(reversed(range(12)))
    assert card.recurrent == {"last_action_in": "last_action_out"}


def test_a_bundle_in_a_folder_of_a_training_takes_from_it_what_it_does_not_say(bundle):
    folder = bundle("isaac-lab")
    (folder.parent / "params").mkdir()
    (folder.parent / "params" / "deploy.yaml").write_text(
        "joint_ids_map: [3, 0, 9, 6, 4, 1, 10, 7, 5, 2, 11, 8]\nstep_dt: 0.02\n"
        "default_joint_pos: [.2, -.2, .2, -.2, .8, .8, 1, 1, -1.5, -1.5, -1.5, -1.5]\n"
        "actions: {JointPositionAction: {scale: [.25], clip: [-3, 3]}}\n"
        "observations: {base_ang_vel: {scale: [.2, .2, .2], history_length: 3}}\n"
    )
    card = card_of(folder)
    assert card.control.default_pose[:4] == [0.2, -0.2, 0.2, -0.2]
    assert (card.control.scale, card.control.clip) == (1, None), "these are in the graph"


@pytest.mark.parametrize("place", ["folder", "file", "above"])
def test_the_bundle_is_found_by_its_folder_its_file_and_the_folder_above(place, bundle):
    folder = bundle("isaac-lab")
    where = {"folder": folder, "file": folder / "Velocity-Go2.onnx", "above": folder.parent}[place]
    found = find_checkpoint(where)[0] if where.is_dir() else where
    assert found == folder / "Velocity-Go2.onnx"
    if place == "above":  # This one in a process of its own, as `policies init` drafts.
        draft = init_policy(where, robot="go2")
        assert load_bundle(draft.file).checkpoint == found
        assert draft.text.count("CHECK") < 10


@pytest.mark.parametrize(
    ("name", "changes", "said"),
    [
        ("isaac-lab", [("model_path: Vel", "model_path: ../Vel")], r"has its file at .*has `\.\.`"),
        ("isaac-lab", [("backend: onnx", "backend: tensorrt")], "'tensorrt', which no card runs"),
        ("isaac-lab", [("sha256sum: ", "sha256sum: 0")], "has no `sha256sum`"),
        (
            "isaac-lab",
            [("kind: state/body/rotation", "kind: state/body/pose")],
            r"'robot_root_quat_w' \(state/body/pose, 1 x 4\) .* is nothing that a card's",
        ),
        ("isaac-lab", [("kind: kp", "kind: target/joint/velocity")], "one action, .* has 2: 'joi"),
        ("isaac-lab", [("FL_hip_joint", "LF_HAA")], "another robot than go2.*ANYmal"),
        ("isaac-lab", [("shape: [1, 3]", "shape: [1, x]")], "no inputs that can be read"),
        (
            "two-nodes",
            [("[policy/last_action_in]", "[policy/last_action_in, senses/gyro]")],
            "of the last step: another node",
        ),
        ("two-nodes", [("senses/body:", "senses_body:")], "the flow .* cannot be read"),
        ("two-nodes", [("senses/body:", "nobody/body:")], "fed by 'nobody', which is not a node"),
        ("two-nodes", [("kind: target/joint/position", "kind: x")], "has 0: 'targets'"),
    ],
)
def test_what_no_card_can_be_is_refused_by_name(name, changes, said, bundle):
    folder = bundle(name, *changes)
    with pytest.raises(PolicyError, match=said):
        drafted(folder)


def test_an_action_without_names_has_the_joints_of_its_input_to_be_checked(bundle):
    folder = bundle("two-nodes")
    (file,) = folder.glob("*.yaml")
    head, targets, rest = file.read_text().partition("kind: target/joint/position\n")
    file.write_text(head + targets + rest.replace("element_names", "names", 1))
    assert "RR_calf]  # CHECK: the order of the checkpoint" in drafted(folder)


def test_another_file_than_the_exported_one_is_refused(bundle):
    folder = bundle("isaac-lab")
    shutil.copy(BUNDLES / "two-nodes" / "policy.onnx", folder / "Velocity-Go2.onnx")
    with pytest.raises(PolicyError, match="another file than the one that was exported"):
        drafted(folder)


def test_first_values_that_are_not_zeros_are_said(bundle):
    folder = bundle("isaac-lab")
    (file,) = folder.glob("*.safetensors")
    data = bytearray(file.read_bytes())
    data[-4:] = np.float32(1).tobytes()
    file.write_bytes(data)
    text = drafted(folder)
    assert "has other numbers than zeros for Velocity-Go2/last_action_in" in text
