"""Every example card runs in a real scene, on random weights of the published shapes."""

import re
import shutil
import warnings
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from nw_policies import load_bundle
from nw_policies.cards import load_card
from nw_policies.networks.act import Act, ActSizes
from nw_policies.networks.parkour import (
    DepthEncoder,
    Estimator,
    LucidSimTransformer,
    ParkourActor,
)
from nw_scenes.robots import get_robot
from nw_sim.probe.findings import measure, observation_findings
from nw_sim.probe.recording import record
from nw_sim.probe.summary import parts_of
from nw_sim.rollout.confined.vetting import check_bundle

EXAMPLES = Path(__file__).resolve().parents[3] / "policies" / "examples"
# Those of robots whose models nw-eval has.
CARDS = [
    path
    for path in sorted(EXAMPLES.glob("*/policy.yaml"))
    if re.search(r"^robot: go[12]$", path.read_text("utf-8"), re.MULTILINE)
]
SCENE = "flat/carpet_room"
STEPS = 10


def randomized(module, prefix="", seed=0):
    """Random numbers in the shapes of a module's state dict, of a size that dies out nowhere."""
    rng = np.random.default_rng(seed)
    weights = {}
    for name, tensor in module.state_dict().items():
        shape = tuple(tensor.shape)
        array = rng.normal(0, max(int(np.prod(shape[1:])), 1) ** -0.5, shape)
        if name.endswith("running_var"):
            array = rng.uniform(0.5, 1.5, shape)
        if name.endswith("inv_freq"):
            array = 10000.0 ** (-2 * np.arange(32) / 64)
        weights[prefix + name] = torch.tensor(array, dtype=tensor.dtype)
    return weights


def parkour(*, student):
    saved = {
        "model_state_dict": randomized(ParkourActor(), "actor.", seed=1),
        "estimator_state_dict": randomized(Estimator(), seed=2),
    }
    if student:  # 64 maps of 18 x 36 are left of an image of 45 x 80.
        saved["depth_encoder_state_dict"] = randomized(DepthEncoder(64 * 18 * 36), seed=3)
        saved["depth_actor_state_dict"] = randomized(ParkourActor(), seed=4)
    return saved


def resnet18():
    """Names and shapes of torchvision's ResNet-18 without its head."""

    def norm(name, n):
        return {f"{name}.{k}": (n,) for k in ("weight", "bias", "running_mean", "running_var")}

    shapes = {"conv1.weight": (64, 3, 7, 7)} | norm("bn1", 64)
    for stage, (before, n) in enumerate(((64, 64), (64, 128), (128, 256), (256, 512)), start=1):
        for block, inputs in enumerate((before, n)):
            name = f"layer{stage}.{block}"
            shapes |= {f"{name}.conv1.weight": (n, inputs, 3, 3)} | norm(f"{name}.bn1", n)
            shapes |= {f"{name}.conv2.weight": (n, n, 3, 3)} | norm(f"{name}.bn2", n)
            if inputs != n:
                shapes |= {f"{name}.downsample.0.weight": (n, inputs, 1, 1)}
                shapes |= norm(f"{name}.downsample.1", n)
    return shapes


def act():
    # LeRobot's sizes: width 512, feed-forward 3200, 4 and 1 layers, chunks of 100.
    sizes = ActSizes(
        width=512,
        heads=8,
        feedforward=3200,
        encoder_layers=4,
        decoder_layers=1,
        pre_norm=False,
        proprio=53,
        latent=32,
        actions=12,
        chunk=100,
        backbone=resnet18(),
        normalized=False,
    )
    return randomized(Act(sizes))


def save_onnx(path, inputs):
    weight = np.random.default_rng(0).normal(0, 0.1, (inputs, 12)).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weight"], ["action"])],
        "random",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 12])],
        [numpy_helper.from_array(weight, "weight")],
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), str(path))


def save_torchscript(path, inputs):
    network = torch.nn.Linear(inputs, 12)
    network.load_state_dict(randomized(network))
    torch.jit.save(torch.jit.trace(network, torch.zeros(1, inputs)), str(path))


def save_layers(path, sizes):
    parts = []
    for n, m in pairwise(sizes):
        parts += [torch.nn.Linear(n, m), torch.nn.ELU()]
    network = torch.nn.Sequential(*parts[:-1])
    network.load_state_dict(randomized(network))
    torch.jit.save(torch.jit.script(network), str(path))


SAVE = {
    "act-go1": lambda path: torch.save(act(), path),
    "himloco-go2": lambda path: save_torchscript(path, 270),
    "lucidsim-go1": lambda path: torch.save(randomized(LucidSimTransformer()), path),
    "parkour-expert-go1": lambda path: torch.save(parkour(student=False), path),
    "parkour-student-go1": lambda path: torch.save(parkour(student=True), path),
    "playground-go1": lambda path: save_onnx(path, 48),
    "walk-these-ways-go1": lambda path: save_layers(path, [2102, 512, 256, 128, 12]),
}
BESIDE = {
    "adaptation_module_latest.jit": lambda path: save_layers(path, [2100, 256, 128, 2]),
}
SHAPES = {
    "act-go1": {"proprio": (53,), "rgb": (3, 180, 320)},
    "himloco-go2": {"obs": (270,)},
    "lucidsim-go1": {"proprio": (53,), "rgb": (7, 3, 45, 80)},
    "parkour-expert-go1": {"proprio": (53,), "scandots": (132,), "history": (530,)},
    "parkour-student-go1": {"proprio": (53,), "depth": (45, 80), "history": (530,)},
    "playground-go1": {"obs": (48,)},
    "walk-these-ways-go1": {"history": (2100,)},
}


@pytest.fixture(scope="module", params=CARDS, ids=[path.parent.name for path in CARDS])
def ran(request, tmp_path_factory):
    """Return each example's bundle on random weights, and what it did for some steps."""
    card = load_card(request.param)
    folder = tmp_path_factory.mktemp("examples") / card.name
    folder.mkdir()
    weights = folder / card.checkpoint.file
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # torch's, of TorchScript.
        SAVE[card.name](weights)
        for network in card.networks.values():
            BESIDE[network.checkpoint.file](folder / network.checkpoint.file)
        shutil.copy(request.param, folder)
        bundle = load_bundle(folder, checkpoint=weights)
        return bundle, record(bundle, scene=SCENE, seconds=STEPS / 50)


def test_it_runs_on_random_weights_of_the_published_shapes(ran):
    bundle, made = ran
    assert bundle.card.name == bundle.card_path.parent.name
    seen = {key: values.shape[1:] for key, values in made.observations.items()}
    assert seen == SHAPES[bundle.card.name]
    assert made.actions.shape == (STEPS, 12)
    assert np.isfinite(made.actions).all()
    # In the first step the robot only falls, and no number of its proprioception tells.
    assert (made.actions[2:] != made.actions[1:-1]).any(axis=1).all()
    assert made.seconds == pytest.approx(STEPS / 50)


def test_no_part_of_what_it_sees_is_called_dead(ran):
    bundle, made = ran
    robot = get_robot(bundle.card.robot)
    parts = parts_of(bundle.card, robot, check_bundle(bundle, robot))
    found = observation_findings([measure(part, made) for part in parts], made)
    assert [one.text for one in found if one.kind == "fault" and "dead" in one.text] == []


def test_what_sees_images_is_known(ran):
    bundle, made = ran
    images = {"act-go1", "lucidsim-go1", "parkour-student-go1"}
    assert made.sees_images is (bundle.card.name in images)


def test_images_of_the_transformer_are_centred_and_the_students_depth_is_too(tmp_path):
    # Sections 5.2 and 5.5 of the published path: (byte - 127.5) / 255; 0.28 to 2 m on 1.
    for name, key in (("lucidsim-go1", "rgb"), ("parkour-student-go1", "depth")):
        weights = tmp_path / f"{name}.pt"
        SAVE[name](weights)
        bundle = load_bundle(EXAMPLES / name, checkpoint=weights)
        seen = record(bundle, scene=SCENE, seconds=0.2).observations[key]
        assert seen.dtype == np.float32
        assert seen.min() >= -0.5
        assert seen.max() <= 0.5
        assert seen.max() - seen.min() > 0.5
    levels = record(
        load_bundle(EXAMPLES / "lucidsim-go1", checkpoint=tmp_path / "lucidsim-go1.pt"),
        scene=SCENE,
        seconds=0.02,
    ).observations["rgb"]
    np.testing.assert_allclose((levels * 255 + 127.5) % 1, 0, atol=1e-4)


@pytest.mark.parametrize("path", CARDS, ids=[path.parent.name for path in CARDS])
def test_it_says_where_its_weights_come_from_and_how_to_pin_them(path):
    card = load_card(path)
    assert card.checkpoint.source
    if card.checkpoint.sha256 is None:
        assert "sha256sum" in path.read_text()
