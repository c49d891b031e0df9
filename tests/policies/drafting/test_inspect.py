"""What a file says of itself, and whether the card drafted from it opens the file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from nw_base.errors import PolicyError
from nw_policies import load_bundle, open_policy
from nw_policies.cards.load import load_card
from nw_policies.cards.terms import term_size
from nw_policies.drafting.checkpoint import inspect_checkpoint
from nw_policies.drafting.draft import write_card_draft
from nw_policies.networks.act import Act, read_sizes
from nw_policies.networks.parkour import (
    DepthEncoder,
    Estimator,
    LucidSimTransformer,
    ParkourActor,
)
from nw_scenes.robots import get_robot

GO1 = get_robot("go1")
# As mjlab's exporter writes them: lists joined by commas, numbers with three decimals.
ISAAC_ORDER = [
    f"{leg}_{kind}_joint" for kind in ("hip", "thigh", "calf") for leg in ("FL", "FR", "RL", "RR")
]
METADATA = {
    "run_path": "team/project/abc",
    "joint_names": ",".join(ISAAC_ORDER),
    "joint_stiffness": ",".join(["35.000"] * 12),
    "joint_damping": ",".join(["0.500"] * 8 + ["0.700"] * 4),
    "default_joint_pos": ",".join(["0.100", "-0.100"] * 2 + ["0.900"] * 4 + ["-1.800"] * 4),
    "action_scale": "0.373",
    "observation_names": "base_lin_vel,base_ang_vel,projected_gravity,joint_pos,joint_vel,actions,"
    "command",
    "command_names": "twist",
}


def save_onnx(path: Path, *, size: int, metadata: dict[str, str], recurrent: bool = False) -> Path:
    weight = np.random.default_rng(0).normal(0, 0.1, (size, 12)).astype(np.float32)
    nodes = [helper.make_node("MatMul", ["obs", "w"], ["actions"])]
    inputs = [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, size])]
    outputs = [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 12])]
    if recurrent:
        for name in ("h", "c"):
            nodes.append(helper.make_node("Tanh", [f"{name}_in"], [f"{name}_out"]))
            shape = [1, 1, 256]
            inputs.append(helper.make_tensor_value_info(f"{name}_in", TensorProto.FLOAT, shape))
            outputs.append(helper.make_tensor_value_info(f"{name}_out", TensorProto.FLOAT, shape))
    graph = helper.make_graph(nodes, "g", inputs, outputs, [numpy_helper.from_array(weight, "w")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata)
    onnx.save(model, str(path))
    return path


def draft(path: Path):
    """Write the draft beside the checkpoint, and read it back as a card."""
    text = write_card_draft(inspect_checkpoint(path), GO1)
    (path.parent / "policy.yaml").write_text(text)
    return text, load_card(path.parent / "policy.yaml")


def frame_size(card, name: str) -> int:
    observation = card.observations[name]
    size = sum(term_size(term, range(12)) for term in observation.frame_terms)
    return size * (observation.history.steps if observation.history else 1)


def test_an_exporters_metadata_becomes_the_card(tmp_path):
    path = save_onnx(tmp_path / "walk v2.onnx", size=48, metadata=METADATA)
    facts = inspect_checkpoint(path)
    assert facts.exporter.joint_names == tuple(ISAAC_ORDER)
    assert facts.exporter.joint_damping == (0.5,) * 8 + (0.7,) * 4
    assert facts.metadata["run_path"] == "team/project/abc"
    text, card = draft(path)
    assert card.name == "walk-v2"
    assert card.control.joints == [name.removesuffix("_joint") for name in ISAAC_ORDER]
    assert card.control.kp == 35
    assert card.control.kd == [0.5] * 8 + [0.7] * 4
    assert card.control.scale == 0.373
    assert card.control.default_pose[:5] == [0.1, -0.1, 0.1, -0.1, 0.9]
    terms = [term.term for term in card.observations["obs"].frame_terms]
    assert terms == [
        "lin_vel",
        "ang_vel",
        "gravity",
        "joint_pos",
        "joint_vel",
        "last_output",
        "command",
    ]
    assert card.command.source == "trail_follower"
    assert "CHECK: scales and clips are not in the file" in text
    policy = open_policy(load_bundle(tmp_path))
    assert policy.act({"obs": np.ones(48)}).shape == (12,)


def test_unknown_terms_of_an_exporter_keep_their_place_and_size(tmp_path):
    names = {"observation_names": "base_ang_vel,gait_phase,joint_pos_rel"}
    text, card = draft(save_onnx(tmp_path / "p.onnx", size=202, metadata=names))
    assert [term.term for term in card.observations["obs"].frame_terms] == [
        "ang_vel", "constant", "joint_pos",
    ]  # fmt: skip
    assert frame_size(card, "obs") == 202
    assert "THESE 187 ZEROS STAND FOR gait_phase" in text


def test_a_history_of_named_terms_is_seen_in_the_size(tmp_path):
    names = {"observation_names": "base_ang_vel, projected_gravity, 'joint_pos'"}
    text, card = draft(save_onnx(tmp_path / "p.onnx", size=90, metadata=names))
    assert card.observations["obs"].history.steps == 5
    assert card.observations["obs"].history.by == "term"
    assert "90 = 5 x 18" in text


@pytest.mark.parametrize("broken", ["nan,1.0", "a,b", "", "1.0,inf"])
def test_metadata_that_cannot_be_read_is_left_out(broken, tmp_path):
    path = save_onnx(tmp_path / "p.onnx", size=45, metadata={**METADATA, "joint_stiffness": broken})
    assert inspect_checkpoint(path).exporter.joint_stiffness == ()


@pytest.mark.parametrize(
    ("size", "layout", "steps", "said"),
    [
        (48, None, None, "MuJoCo Playground, mjlab (1 x 48); or legged_gym (1 x 48), Isaac Lab"),
        (53, "parkour53", None, "extreme-parkour, LucidSim (1 x 53)"),
        (270, None, 6, "HIMLoco, rl_sar (6 x 45)"),
        (371, "parkour53", 7, "(7 x 53)"),
        (332, None, None, "no known layout has it, so these are zeros"),
        (2003, None, None, "no known layout has it"),
    ],
)
def test_without_metadata_terms_are_guessed_from_the_size(size, layout, steps, said, tmp_path):
    text, card = draft(save_onnx(tmp_path / "p.onnx", size=size, metadata={}))
    assert said in text
    assert card.observations["obs"].layout == layout
    assert frame_size(card, "obs") == size
    if steps is not None:
        assert card.observations["obs"].history.steps == steps
    open_policy(load_bundle(tmp_path)).close()


def test_recurrent_inputs_of_an_onnx_file_are_state_and_not_observations(tmp_path):
    facts = inspect_checkpoint(save_onnx(tmp_path / "p.onnx", size=48, metadata={}, recurrent=True))
    assert [array.name for array in facts.inputs] == ["obs"]
    assert [array.name for array in facts.outputs] == ["actions"]
    assert facts.recurrent == ("h_in -> h_out", "c_in -> c_out")
    assert "# recurrent state: h_in -> h_out, c_in -> c_out" in write_card_draft(facts, GO1)


class Recurrent(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.rnn = nn.GRU(53, 16)
        self.head = nn.Linear(16, 12)
        self.register_buffer("hidden", torch.zeros(1, 1, 16))

    def forward(self, obs, camera):
        output, hidden = self.rnn(obs[None], self.hidden)
        self.hidden.copy_(hidden)
        return self.head(output[0]) + camera.mean()


def test_a_torch_export_file_shows_inputs_and_state(tmp_path):
    example = torch.zeros(1, 53), torch.zeros(1, 2, 3, 45, 80)
    torch.export.save(torch.export.export(Recurrent().eval(), example), tmp_path / "p.pt2")
    facts = inspect_checkpoint(tmp_path / "p.pt2")
    assert [(array.name, array.shape) for array in facts.inputs] == [
        ("obs", (1, 53)),
        ("camera", (1, 2, 3, 45, 80)),
    ]
    assert facts.recurrent == ("b_hidden",)
    _, card = draft(tmp_path / "p.pt2")
    image = card.observations["camera"]
    assert (image.width, image.height, image.axes, image.stack) == (80, 45, "chw", 2)
    assert card.inputs == {"obs": ["obs"], "camera": ["camera"]}
    policy = open_policy(load_bundle(tmp_path))
    camera = np.zeros((2, 3, 45, 80), np.float32)
    assert policy.act({"obs": np.zeros(53), "camera": camera}).shape == (12,)


def test_a_scripted_module_is_described_by_its_weights_and_not_run(tmp_path):
    class Trap(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.memory = nn.LSTM(45, 8)
            self.actor = nn.Sequential(nn.Linear(270, 32), nn.ELU(), nn.Linear(32, 12))

        def forward(self, x):
            assert x.shape[0] > 1, "this was run"
            return self.actor(x)

    torch.jit.save(torch.jit.script(Trap()), tmp_path / "p.pt")
    facts = inspect_checkpoint(tmp_path / "p.pt")
    assert facts.adapter == "torchscript"
    assert facts.recurrent == ("memory",)
    text, card = draft(tmp_path / "p.pt")
    assert frame_size(card, "obs") == 270
    assert "its layers take [8, 32, 45, 270]" in text


def test_published_networks_are_recognised_and_their_drafts_open(tmp_path):
    def save(folder: str, value: object) -> Path:
        path = tmp_path / folder / "w.pt"
        path.parent.mkdir()
        torch.save(value, path)
        return path

    lucidsim = LucidSimTransformer().state_dict()
    lucidsim["img_enc.0.running_var"].fill_(1)
    path = save("lucidsim", lucidsim)
    facts = inspect_checkpoint(path)
    assert (facts.adapter, facts.format) == ("lucidsim", "state-dict")
    # 1,823,972 parameters and, in five norms, five embeddings and one batch norm, 967 buffers.
    assert facts.parameters == 1_823_972 + 5 * (128 + 32 + 32) + 3 + 3 + 1
    draft(path)
    open_policy(load_bundle(path.parent)).close()
    actor = {f"actor.{name}": tensor for name, tensor in ParkourActor().state_dict().items()}
    expert = {"model_state_dict": actor, "estimator_state_dict": Estimator().state_dict()}
    student = expert | {"depth_encoder_state_dict": DepthEncoder(41472).state_dict()}
    for folder, saved, sees in (("expert", expert, "scandots"), ("student", student, "depth")):
        path = save(folder, saved)
        assert inspect_checkpoint(path).adapter == "extreme-parkour"
        _, card = draft(path)
        assert set(card.observations) == {"proprio", "history", sees}
        open_policy(load_bundle(path.parent)).close()


def test_a_draft_for_act_has_its_sizes(tmp_path):
    shapes = {
        "encoder_robot_state_input_proj.weight": (32, 53),
        "encoder_latent_input_proj.weight": (32, 8),
        "decoder_pos_embed.weight": (25, 32),
        "action_head.weight": (12, 32),
        "encoder.layers.0.linear1.weight": (64, 32),
        "decoder.layers.0.linear1.weight": (64, 32),
        "backbone.0.weight": (8, 3, 3, 3),
    }
    tensors = {name: torch.zeros(shape) for name, shape in shapes.items()}
    network = Act(read_sizes(tensors, "w", heads=8))
    weights = {name: torch.full(t.shape, 0.01) for name, t in network.state_dict().items()}
    torch.save(weights, tmp_path / "act.pt")
    text, card = draft(tmp_path / "act.pt")
    assert card.adapter == "act"
    assert card.options == {"heads": 8, "ensemble": 0.01, "query_every": 1}
    assert "a chunk has 25 actions" in text
    policy = open_policy(load_bundle(tmp_path))
    rgb = np.zeros((3, 180, 320), np.float32)
    assert policy.act({"proprio": np.zeros(53), "rgb": rgb}).shape == (12,)


def test_weights_of_an_unknown_network_get_no_card(tmp_path):
    torch.save({"net.0.weight": torch.zeros(10, 332)}, tmp_path / "teacher.pt")
    facts = inspect_checkpoint(tmp_path / "teacher.pt")
    assert facts.adapter is None
    with pytest.raises(PolicyError, match=r"unknown network: net\.0\.weight \(10, 332\).*ONNX"):
        write_card_draft(facts, GO1)


def test_what_is_no_checkpoint_is_said(tmp_path):
    for content, reason in (
        (b"<html>", "a web page"),
        (b"import torch\n", "format of the file is unknown"),
        (b"\x08\x07 and then noise", "not a usable ONNX file"),
    ):
        (tmp_path / "p").write_bytes(content)
        with pytest.raises(PolicyError, match=reason):
            inspect_checkpoint(tmp_path / "p")
    with pytest.raises(PolicyError, match="cannot be read: No such file"):
        inspect_checkpoint(tmp_path / "absent")


SHARED = Path(__file__).resolve().parents[4] / "shared" / "assets"
ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", SHARED)) / "policies"


@pytest.mark.assets
@pytest.mark.skipif(not ASSETS.is_dir(), reason="third-party policies are not here")
def test_third_party_files_give_cards_that_open(tmp_path):
    for file, size in (("playground-go1/go1_policy.onnx", 48), ("himloco-go2/himloco.pt", 270)):
        folder = tmp_path / file.split("/")[0]
        folder.mkdir()
        (folder / Path(file).name).write_bytes((ASSETS / file).read_bytes())
        _, card = draft(folder / Path(file).name)
        assert frame_size(card, "obs") == size
        policy = open_policy(load_bundle(folder))
        assert np.isfinite(policy.act({"obs": np.zeros(size, np.float32)})).all()
