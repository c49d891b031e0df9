"""What a draft guesses of heights, batches, joints and scripted modules, and what it admits."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zipfile

import numpy as np
import onnx
import pytest
import torch
from torch import nn

from nw_base.errors import PolicyError
from nw_eval import api
from nw_policies import load_bundle, open_policy
from nw_policies.cards.load import load_card
from nw_policies.drafting.checkpoint import inspect_checkpoint
from nw_policies.drafting.draft import write_card_draft
from nw_scenes.robots import get_robot
from nw_sim.sensors import check_card

GO1 = get_robot("go1")


@pytest.mark.parametrize(
    ("inputs", "scan", "points"),
    [
        ({"obs": [1, 187]}, "obs", (17, 11)),
        ({"obs": [1, 231]}, "obs", (21, 11)),
        ({"obs": [1, 235]}, "obs_scan", (17, 11)),
        ({"obs": [1, 6 * 45 + 187]}, "obs_scan", (17, 11)),
        ({"obs": [1, 53 + 132]}, "obs_scan", (12, 11)),
        ({"obs": [1, 45], "height_scan": [1, 77]}, "height_scan", (11, 7)),
        ({"obs": [1, 45], "scan": [1, None]}, "scan", (17, 11)),
    ],
)
def test_a_scan_of_heights_is_drafted_as_one(inputs, scan, points, onnx_file, drafted):
    text, card, problems = drafted(onnx_file(inputs))
    assert problems == []
    heights = card.observations[scan]
    assert heights.sensor == "scandots"
    assert (heights.x[2], heights.y[2]) == points
    assert f"CHECK: {points[0] * points[1]} heights" in text
    assert "ZEROS" not in text


def test_the_grid_of_isaac_lab_is_1_6_by_1_m_and_half_a_metre_down(onnx_file, drafted):
    # Isaac Lab: GridPatternCfg(resolution=0.1, size=[1.6, 1.0]), ordering "xy" (x innermost), and
    # mdp.height_scan with offset=0.5 and clip=(-1.0, 1.0).
    _, card, _ = drafted(onnx_file({"obs": [1, 235]}))
    scan = card.observations["obs_scan"]
    assert (scan.x, scan.y) == ((-0.8, 0.8, 17), (-0.5, 0.5, 11))
    assert (scan.offset, scan.clip, scan.order) == (-0.5, (-1.0, 1.0), "x_fastest")
    terms = [term.term for term in card.observations["obs"].frame_terms]
    assert terms[3:5] == ["command", "joint_pos"]
    assert card.inputs == {"obs": ["obs", "obs_scan"]}


def test_a_scan_of_mjlab_is_scaled_as_the_file_says_and_not_lowered(onnx_file, drafted):
    # mjlab: height_scan(offset=0.0), scale=1 / max_distance of 5 m, which rays that miss read.
    metadata = {
        "observation_names": "base_ang_vel,height_scan,joint_pos",
        "observation_terms_scale": "1.000,0.200,1.000",
        "observation_terms_clip": "-inf;inf,-inf;inf,-inf;inf",
        "observation_terms_history_length": "0,2,0",
    }
    _, card, problems = drafted(onnx_file({"obs": [1, 3 + 2 * 187 + 12]}, metadata))
    assert problems == []
    assert card.inputs == {"obs": ["obs", "obs_scan", "obs_3"]}
    scan = card.observations["obs_scan"]
    assert (scan.offset, scan.clip, scan.order) == (0.0, (-5.0, 5.0), "x_fastest")
    assert [wrap.wrapper for wrap in scan.wrap] == ["scale", "stack", "flatten"]
    assert scan.wrap[0].scale == 0.2


def test_zeros_in_place_of_what_is_seen_are_said_loudly(onnx_file, drafted):
    text, _, _ = drafted(onnx_file({"obs": [1, 332]}))
    assert "# CHECK: THESE 332 ZEROS STAND FOR what the checkpoint really sees" in text
    metadata = {"observation_names": "base_ang_vel,phase,foot_height,joint_pos"}
    text, _, problems = drafted(onnx_file({"obs": [1, 20]}, metadata))
    assert problems == []
    assert "# CHECK: THESE 5 ZEROS STAND FOR phase, foot_height" in text


def test_motors_that_the_file_does_not_hold_are_shown_as_they_will_be(onnx_file, drafted):
    text, card, _ = drafted(onnx_file({"obs": [1, 48]}, {"joint_stiffness": "35.000"}))
    for key, own in (
        ("torque_limits", GO1.torque_limits[2]),
        ("armature", GO1.armature[0]),
        ("friction_loss", GO1.friction_loss[0]),
    ):
        line = re.search(rf"^  # {key}: (.*)  # CHECK: ", text, re.MULTILINE)
        assert line is not None, key
        assert f"{own:g}" in line[1]
        assert getattr(card.control, key) is None


def test_a_card_elsewhere_says_that_it_needs_its_checkpoint(onnx_file, tmp_path):
    path = onnx_file({"obs": [1, 45]}, name="run/exported/policy.onnx")
    facts = inspect_checkpoint(path)
    above = write_card_draft(facts, GO1, folder=tmp_path / "run")
    (tmp_path / "run" / "policy.yaml").write_text(above)
    assert load_bundle(tmp_path / "run").checkpoint.samefile(path)
    other = tmp_path / "other"
    other.mkdir()
    text = write_card_draft(facts, GO1, folder=other)
    (other / "policy.yaml").write_text(text)
    assert "# CHECK: it does not lie beside this card: copy it there, or give --checkpoint" in text
    assert load_bundle(other, checkpoint=path).checkpoint.samefile(path)
    shutil.copy(path, other)
    open_policy(load_bundle(other)).close()


def test_rows_of_a_batch_are_no_history(onnx_file, drafted):
    text, card, problems = drafted(onnx_file({"obs": [16, 45]}))
    assert "CHECK: the checkpoint wants a batch of 16: export it with batch 1 or a free" in text
    assert card.observations["obs"].history is None
    assert problems == ["input `obs` wants a batch of 16; export batch 1"]


@pytest.mark.parametrize(("shape", "axis"), [([1, 16, 45], "first"), ([None, 45, 16], "last")])
def test_frames_on_an_axis_of_their_own_are_stacked(shape, axis, onnx_file, drafted):
    _, card, problems = drafted(onnx_file({"obs": shape}))
    assert problems == []
    (stack,) = card.observations["obs"].wrap
    assert (stack.steps, stack.axis) == (16, axis)


def test_a_free_number_of_frames_is_to_be_said(onnx_file, drafted):
    text, card, problems = drafted(onnx_file({"obs": [1, None, 45]}))
    assert problems == []
    assert card.observations["obs"].wrap[0].wrapper == "stack"
    assert "CHECK: the file leaves the number of frames free" in text


def test_a_map_of_depth_is_a_camera(onnx_file, drafted):
    _, card, problems = drafted(onnx_file({"obs": [1, 53], "depth": [1, 58, 87]}))
    assert problems == []
    assert (card.observations["depth"].width, card.observations["depth"].height) == (87, 58)


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("Trot_v2/policy.onnx", "trot_v2"),
        ("trot/model_1500.onnx", "trot"),
        ("trot/policy-final.onnx", "trot"),
        ("trot/modelling.onnx", "modelling"),
        ("trot/gallop.onnx", "gallop"),
        ("007/policy.onnx", "007"),
        ("trot/1e3.onnx", "1e3"),
    ],
)
def test_a_policy_is_named_after_its_folder_where_its_file_has_no_name(
    file, name, onnx_file, drafted
):
    assert drafted(onnx_file({"obs": [1, 45]}, name=file))[1].name == name


def test_the_order_of_joints_of_those_who_may_have_trained_it_is_offered(onnx_file, drafted):
    text, card, _ = drafted(onnx_file({"obs": [1, 45]}))
    # Isaac Gym takes the legs by their names; Isaac Lab takes all first joints, then all second.
    assert card.control.joints[:4] == ["FL_hip", "FL_thigh", "FL_calf", "FR_hip"]
    assert "#     joints: [FL_hip, FR_hip, RL_hip, RR_hip, FL_thigh," in text
    text, card, _ = drafted(onnx_file({"obs": [1, 53]}))
    assert card.control.joints[:3] == ["FR_hip", "FR_thigh", "FR_calf"]
    assert "[FL_hip" not in text


class TwoInputs(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(270, 16), nn.ELU())
        self.actor = nn.Linear(61, 12)

    def forward(self, obs, hist):
        return self.actor(torch.cat([obs, self.encoder(hist)], dim=-1))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("traced", [True, False])
def test_a_scripted_module_gets_as_many_inputs_as_its_code_has(traced, tmp_path):
    module = TwoInputs().eval()
    example = torch.zeros(1, 45), torch.zeros(1, 270)
    script = torch.jit.trace(module, example) if traced else torch.jit.script(module)
    torch.jit.save(script, tmp_path / "p.pt")
    facts = inspect_checkpoint(tmp_path / "p.pt")
    assert [(i.name, i.kind, i.size) for i in facts.script] == [
        ("obs", "Tensor", None),
        ("hist", "Tensor", 270),
    ]
    (tmp_path / "policy.yaml").write_text(write_card_draft(facts, GO1))
    card = load_card(tmp_path / "policy.yaml")
    assert card.inputs == {"obs": ["obs"], "hist": ["hist"]}
    assert card.observations["hist"].history.steps == 6
    # Six frames are HIMLoco's, so the frame beside them is laid out as its are.
    firsts = {seen.frame_terms[0].term for seen in card.observations.values()}
    assert firsts == {"command"}
    assert card.control.clip == (-100, 100)
    assert "CHECK: its size is not in the file" in write_card_draft(facts, GO1)


class Odd(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.actor = nn.Linear(45, 12)

    def forward(
        self,
        obs: dict[str, torch.Tensor],
        height_scan: torch.Tensor,
        depth: torch.Tensor,
        seed: int = 3,
        mask: torch.Tensor | None = None,
    ):
        scale = torch.ones(1) if mask is None else mask
        return self.actor(obs["policy"]) * scale + seed + height_scan.mean() + depth.mean()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_arguments_with_defaults_are_no_inputs_and_dicts_cannot_be_fed(tmp_path):
    torch.jit.save(torch.jit.script(Odd()), tmp_path / "p.pt")
    facts = inspect_checkpoint(tmp_path / "p.pt")
    assert [i.name for i in facts.script] == ["obs", "height_scan", "depth"]
    text = write_card_draft(facts, GO1)
    assert "it is a Dict[str, Tensor], which no card can feed" in text
    (tmp_path / "policy.yaml").write_text(text)
    card = load_card(tmp_path / "policy.yaml")
    sensors = [card.observations[name].sensor for name in ("obs", "height_scan", "depth")]
    assert sensors == ["proprio", "scandots", "depth"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_code_that_does_not_say_its_inputs_is_admitted(tmp_path):
    torch.jit.save(torch.jit.script(nn.Linear(45, 12)), tmp_path / "whole.pt")
    with (
        zipfile.ZipFile(tmp_path / "whole.pt") as whole,
        zipfile.ZipFile(tmp_path / "p.pt", "w") as mute,
    ):
        for name in whole.namelist():
            # As torch would never write it, but may read it.
            mute.writestr(name, whole.read(name).replace(b"def forward(", b"def forward( "))
    facts = inspect_checkpoint(tmp_path / "p.pt")
    assert facts.script == ()
    assert "CHECK: the file does not say how many inputs it takes" in write_card_draft(facts, GO1)


class Convolution(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.actor = nn.Conv1d(1, 12, 48)

    def forward(self, obs: torch.Tensor):
        return self.actor(obs[:, None])[:, :, 0]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_network_without_linear_layers_is_said_to_tell_no_size(tmp_path):
    torch.jit.save(torch.jit.script(Convolution()), tmp_path / "p.pt")
    text = write_card_draft(inspect_checkpoint(tmp_path / "p.pt"), GO1)
    assert "it has no linear layer that would tell, so 48 is assumed" in text
    assert "[]" not in text


@pytest.mark.parametrize("shape", [[1, 3, 45, 80], [1, 58, 87]])
def test_how_often_a_camera_looks_is_for_the_author_to_check(shape, onnx_file, drafted):
    text, card, _ = drafted(onnx_file({"obs": [1, 53], "camera": shape}))
    assert card.observations["camera"].rate == 10
    assert "    rate: 10  # CHECK: images a second of the training" in text


def test_a_pickled_module_is_to_be_exported(tmp_path):
    torch.save(nn.Linear(45, 12), tmp_path / "module.pt")
    old = {"_use_new_zipfile_serialization": False}  # As torch saved before 1.6.
    torch.save(nn.Linear(45, 12).state_dict(), tmp_path / "bare.pt", **old)
    for name in ("module.pt", "bare.pt"):
        with pytest.raises(PolicyError) as raised:
            inspect_checkpoint(tmp_path / name)
        assert "export the policy as ONNX or with torch.export" in str(raised.value)
        assert "save the plain state dict" not in str(raised.value)


def test_files_beside_a_checkpoint_are_named_as_what_may_feed_it(onnx_file):
    path = onnx_file({"obs": [1, 45]}, name="run/body.onnx")
    encoder = path.with_name("Encoder v2.jit")
    encoder.write_bytes(b"any")
    path.with_name("notes.txt").write_text("no network")
    path.with_name("away.pt").symlink_to(path)
    card = path.with_name("policy.yaml")
    api.init_policy(path, robot="go1")
    load_bundle(card)
    assert "notes" not in card.read_text()
    assert "away" not in card.read_text()
    (block,) = re.findall(r"^# networks:\n(?:#  .*\n)+", card.read_text(), flags=re.MULTILINE)
    alive = re.sub(r"^# ", "", block, flags=re.MULTILINE)
    lines = card.read_text().replace(block, alive)
    (observed,) = load_bundle(card).card.observations
    card.write_text(lines.replace("inputs: []", f"inputs: [{observed}]") + "inputs: [encoder_v2]\n")
    bundle = load_bundle(card)
    assert bundle.networks["encoder_v2"].path.samefile(encoder)
    assert bundle.card.networks["encoder_v2"].adapter == "torchscript"


def test_a_draft_elsewhere_says_nothing_of_what_lies_beside_the_checkpoint(onnx_file, tmp_path):
    path = onnx_file({"obs": [1, 45]}, name="run/body.onnx")
    path.with_name("encoder.pt").write_bytes(b"any")
    api.init_policy(path, robot="go1", out=tmp_path / "other.yaml")
    assert "networks" not in (tmp_path / "other.yaml").read_text()


def test_drafting_can_be_imported_before_all_else_as_the_verb_does():
    line = "import nw_policies.drafting.draft"
    ended = subprocess.run([sys.executable, "-c", line], check=False, capture_output=True)
    assert ended.returncode == 0, ended.stderr


class Wide(nn.Module):
    """45 numbers through a function first, then layers of which one is wider."""

    def __init__(self) -> None:
        super().__init__()
        self.value = nn.Sequential(nn.Linear(512, 480), nn.ELU(), nn.Linear(480, 1))
        self.actor = nn.Sequential(nn.Linear(45, 512), nn.ELU(), nn.Linear(512, 12))

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        return self.actor(torch.clamp(obs, -100.0, 100.0) * 1.0)


class Hidden(Wide):
    """Likewise, but code that is not followed sees the numbers first."""

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        return self.actor(torch.cat([obs[:, 3:], obs[:, :3]], dim=1))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("module", [Wide, Hidden])
def test_the_size_of_an_input_is_the_width_of_its_first_layer_not_of_the_widest(tmp_path, module):
    torch.jit.save(torch.jit.script(module()), tmp_path / "p.pt")
    (tmp_path / "policy.yaml").write_text(
        write_card_draft(inspect_checkpoint(tmp_path / "p.pt"), GO1)
    )
    (observation,) = check_card(load_card(tmp_path / "policy.yaml"))
    assert observation.shape == (45,)


class KeepsHistory(nn.Module):
    """Takes a frame of 45, and keeps the last five of them."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("history", torch.zeros(1, 5, 45))
        self.encoder = nn.Linear(225, 32)
        self.actor = nn.Linear(77, 12)

    def forward(self, x):
        self.history = torch.cat([self.history[:, 1:], x.unsqueeze(1)], dim=1)
        return self.actor(torch.cat([self.encoder(self.history.flatten(1)), x], dim=1))


class TakesHistory(KeepsHistory):
    """Takes the five frames."""

    def forward(self, x):
        return self.actor(torch.cat([self.encoder(torch.flip(x, [0])), x[:, -45:]], dim=1))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    ("module", "size", "words"),
    [
        (KeepsHistory, 45, "on zeros it runs with 45; its layers take [77, 225]"),
        (TakesHistory, 225, "its layers take [77, 225]"),
    ],
)
def test_a_guessed_size_is_one_that_the_module_takes(module, size, words, tmp_path):
    torch.jit.save(torch.jit.script(module()), tmp_path / "p.pt")
    told = api.init_policy(tmp_path / "p.pt", robot="go2")
    card = load_card(tmp_path / "policy.yaml")
    assert [seen.shape for seen in check_card(card)] == [(size,)]
    assert words in told.text


@pytest.mark.parametrize(
    ("name", "shape", "sensor"),
    [
        ("depth", [1, 1, 18, 32], "depth"),
        ("camera", [1, 1, 18, 32], "depth"),
        ("depth_image", [1, 4, 18, 32], "depth"),
        ("depth", [1, 18, 32, 1], "depth"),
        ("gray_image", [1, 1, 18, 32], "splat_rgb"),
        ("rgb", [1, 3, 18, 32], "splat_rgb"),
    ],
)
def test_a_picture_is_drafted_in_the_shape_that_the_checkpoint_takes(
    onnx_file, tmp_path, name, shape, sensor
):
    text = write_card_draft(inspect_checkpoint(onnx_file({name: shape})), GO1)
    (tmp_path / "policy.yaml").write_text(text)
    card = load_card(tmp_path / "policy.yaml")
    assert card.observations[name].sensor == sensor
    (spec,) = check_card(card)
    assert spec.shape == tuple(shape[1:])


def test_the_drafted_output_is_the_action_not_the_first_one(tmp_path):
    sizes = {"value": 1, "latent": 12, "actions": 12}
    values = [onnx.helper.make_tensor_value_info(n, 1, [1, s]) for n, s in sizes.items()]
    nodes = [
        onnx.helper.make_node("MatMul", ["obs", f"w{i}"], [name]) for i, name in enumerate(sizes)
    ]
    weights = [
        onnx.numpy_helper.from_array(np.zeros((45, size), np.float32), f"w{i}")
        for i, size in enumerate(sizes.values())
    ]
    obs = onnx.helper.make_tensor_value_info("obs", 1, [1, 45])
    graph = onnx.helper.make_graph(nodes, "g", [obs], values, weights)
    opset = [onnx.helper.make_opsetid("", 17)]
    file = tmp_path / "p.onnx"
    onnx.save(onnx.helper.make_model(graph, opset_imports=opset, ir_version=8), file)
    text = write_card_draft(inspect_checkpoint(file), GO1)
    assert "output: actions  # CHECK: or latent, value" in text.replace('"', "")
