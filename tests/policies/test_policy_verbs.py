"""`nw-eval policies`: list, show, check, init, and what `check` finds in wrong cards."""

import hashlib
import os
import re
from pathlib import Path

import pytest
import torch

from nw_base.errors import PolicyError, UsageError
from nw_eval import api
from nw_eval.cli.verbs.policies import card_page, policy_table, probe_page
from nw_policies import load_bundle
from nw_policies.cards import load_card
from nw_scenes import robots
from nw_sim.probe.recording import record
from nw_sim.probe.report import probe_here

REPOSITORY = Path(__file__).resolve().parents[2]
ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", REPOSITORY.parent / "shared" / "assets"))
HIMLOCO = ASSETS / "policies" / "himloco-go2" / "himloco.pt"
PLAYGROUND = ASSETS / "policies" / "playground-go1" / "go1_policy.onnx"
needs_assets = pytest.mark.skipif(not HIMLOCO.is_file(), reason=f"no weights at {ASSETS}")
CARD = (REPOSITORY / "policies" / "examples" / "himloco-go2" / "policy.yaml").read_text()


def test_the_list_has_shipped_bundles_example_cards_and_the_projects_own(tmp_path, monkeypatch):
    folder = tmp_path / "policies" / "mine"
    folder.mkdir(parents=True)
    (folder / "policy.yaml").write_text("nw-policy: 1\nname: mine\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(robots, "_folders", {})  # Other tests of this process know a B2.
    lines = policy_table(api.list_policies()).splitlines()
    assert [line.split()[0] for line in lines] == [
        "examples/act-go1",
        "examples/b2-robot-lab",
        "examples/g1-unitree-rl-gym",
        "examples/go2w-robot-lab",
        "examples/himloco-go2",
        "examples/lucidsim-go1",
        "examples/parkour-expert-go1",
        "examples/parkour-student-go1",
        "examples/playground-go1",
        "examples/walk-these-ways-go1",
        "go1-act-depth",
        "go1-act-rgb",
        "go1-act-rgb-ray",
        "go1-parkour",
        "mine",
        "stand",
    ]
    (own,) = (line for line in lines if line.startswith("mine"))
    assert "is missing" in own
    (far,) = (line for line in lines if line.startswith("examples/b2-robot-lab"))
    assert "robot_lab's walking policy for the B2, blind (robot: not here)" in far


def test_a_card_is_shown_without_its_weights():
    shown = card_page(api.show_policy("examples/himloco-go2"))
    assert "the checkpoint is missing" in shown
    assert re.search(r"command +18 \(6 frames\) +x \[2, 2, 0\.25\] +50 Hz", shown)
    assert "`obs` 270 = 6 x (3 + 3 + 3 + 12 + 12 + 12)" in shown
    assert re.search(r"RL_thigh +1 +0\.25 +35 +1 +33\.5", shown)


def test_the_terms_of_a_frame_with_parts_left_out_are_counted_right():
    shown = card_page(api.show_policy("go1-parkour"))
    assert re.search(r"history +joint_pos +36 \(3 frames\)", shown)
    assert not re.search(r"history +delta_yaw", shown)
    assert re.search(r"scandots +scandots +132", shown)


EVERYTHING = """
nw-policy: 1
name: all
robot: go1
adapter: torchscript
checkpoint: {file: all.pt}
control:
  {action: joint_position_offset, scale: 0.25, clip: 3, rate: 25, physics_rate: 500, delay_steps: 2,
   torque_limits: 20, armature: 0.004, friction_loss: {hip: 0.3, thigh: 0.4, calf: 0.5}}
command: {source: constant, velocity: [0.5, 0.0, 0.25]}
observations:
  body:
    sensor: proprio
    latency: 0.02
    noise: {gaussian: 0.01, dropout: 0.1}
    terms:
      - {term: lin_vel, frame: yaw, at: [0.1, 0.0, 0.02]}
      - {term: joint_pos, relative: false, clip: 2}
      - {term: constant, values: [0, 0, 0, 1]}
    clip: 100
    select: ["0:3", 5]
    history: {steps: 4, order: newest_first, current: false, start: zeros, zero: ["1:3"]}
  rgb: {sensor: splat_rgb, camera: ego, width: 64, height: 48, axes: chw, dtype: float32,
        mean: 127.5, std: 127.5, stack: 2, rate: 5}
  depth: {sensor: depth, far: 20, wrap: [{wrapper: resize, width: 40, height: 24}, flatten]}
  dots: {sensor: scandots, x: [-0.3, 0.9, 7], offset: -0.25}
inputs: {proprio: [body, depth, dots], image: [rgb]}
output: action
options: {}
"""


def test_everything_that_is_not_by_default_is_shown(tmp_path):
    (tmp_path / "policy.yaml").write_text(EVERYTHING)
    shown = card_page(api.show_policy(str(tmp_path)))
    assert "\ncommand     constant (velocity [0.5, 0, 0.25])\n" in shown
    assert "\noutput      action\n" in shown
    assert re.search(r"body +lin_vel +12 \(4 frames\) +frame yaw at \[0.1, 0, 0.02\] +25 Hz", shown)
    assert re.search(r"body +joint_pos +4 \(4 frames\) +clip -2..2 relative false", shown)
    assert re.search(r"rgb +splat_rgb +2 x 3 x 48 x 64 +5 Hz", shown)
    settings = dict(re.findall(r"  `(\w+)` .*?; (.*)\n", shown))
    assert settings == {
        "body": "latency 0.02, noise {gaussian: 0.01, dropout: 0.1}, clip [-100, 100], "
        'select ["0:3", 5], history {steps: 4, order: newest_first, current: false, '
        'start: zeros, zero: ["1:3"]}',
        "rgb": "width 64, height 48, stack 2, axes chw, dtype float32, mean 127.5, std 127.5",
        "depth": "wrap [{wrapper: resize, width: 40, height: 24}, {wrapper: flatten}], far 20",
        "dots": "x [-0.3, 0.9, 7], offset -0.25",
    }
    assert "\nactions: joint_position_offset, limited to -3..3, 25 Hz, delayed by 2, " in shown
    assert "physics at 500 Hz\n" in shown
    assert re.search(r"FR_calf +-1\.5 +0\.25 +20 +0\.5 +20 +0\.004 +0\.5\n", shown)


def test_clocks_earlier_outputs_and_filters_are_shown(tmp_path):
    card = EVERYTHING.replace("rate: 25,", "rate: 25, filter: {kind: butterworth, cutoff: 5},")
    clock = "{term: clock, frequency: 3, offsets: [0.5, 0], values: [sine], standing: {below: 0.1}}"
    terms = f"[{{term: yaw, values: sine_cosine}}, {{term: last_output, ago: 2}}, {clock}]"
    frame = re.sub(r"    terms:\n(      .*\n)+", f"    terms: {terms}\n", card)
    (tmp_path / "policy.yaml").write_text(re.sub(r"    (select|history): .*\n", "", frame))
    shown = card_page(api.show_policy(str(tmp_path)))
    assert re.search(r"body +yaw +2 +values sine_cosine +25 Hz", shown)
    assert re.search(r"body +last_output +12 +ago 2 +25 Hz", shown)
    words = r"frequency 3 offsets \[0.5, 0\] values \[sine\] standing {below: 0.1}"
    assert re.search(rf"body +clock +2 +{words} +25 Hz", shown)
    assert ", delayed by 2, filter {kind: butterworth, cutoff: 5}, physics at 500 Hz\n" in shown
    assert "`body` 16 = 2 + 12 + 2;" in shown


def test_a_card_is_shown_with_weights_that_lie_elsewhere(tmp_path):
    weights = tmp_path / "other.onnx"
    weights.write_bytes(b"not the policy's")
    shown = card_page(api.show_policy("go1-parkour", checkpoint=weights))
    digest = hashlib.sha256(b"not the policy's").hexdigest()[:16]
    words = f"{weights}, 0.00 MB, SHA-256 {digest}, not the card's 1d9068e0fef8dd59\n"
    assert f"\ncheckpoint  {words}" in shown
    with pytest.raises(PolicyError, match="the checkpoint is missing"):
        api.show_policy("go1-parkour", checkpoint=tmp_path / "nothing.onnx")
    with pytest.raises(PolicyError, match="drop --checkpoint"):
        api.show_policy("stand", checkpoint=weights)


def test_the_shipped_policy_passes_its_check():
    told = api.check_policy("go1-parkour")
    assert told.passed
    assert probe_page(told).endswith("\nno fault found")
    assert re.search(r"proprio +speed +1 +0\.800 +0\.800 +0\.800 +1 of 1", probe_page(told))


def test_a_policy_that_stands_still_passes_without_observations():
    assert api.check_policy("stand").passed


class Deaf(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.zeros(1, 12) * x.sum()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_checkpoint_that_does_not_hear_its_inputs_is_found_out(tmp_path):
    torch.jit.save(torch.jit.script(Deaf()), str(tmp_path / "deaf.pt"))
    (tmp_path / "policy.yaml").write_text(
        "nw-policy: 1\nname: deaf\nrobot: go1\nadapter: torchscript\n"
        "checkpoint: {file: deaf.pt}\n"
        "control: {action: joint_position_offset, scale: 0.25}\n"
        "observations: {body: {sensor: proprio, clip: 0.01, terms: [joint_vel, gravity]}}\n"
    )
    told = api.check_policy(str(tmp_path), checkpoint=tmp_path / "deaf.pt")
    assert not told.passed
    assert "the action is the same at every step" in probe_page(told)
    assert "`body`, joint_vel: its limits -0.01..0.01 clip it in most steps" in probe_page(told)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_zeros_that_init_wrote_in_place_of_terms_are_noted(tmp_path):
    torch.jit.save(torch.jit.script(Deaf()), str(tmp_path / "deaf.pt"))
    (tmp_path / "policy.yaml").write_text(
        "nw-policy: 1\nname: deaf\nrobot: go1\nadapter: torchscript\n"
        "checkpoint: {file: deaf.pt}\n"
        "control: {action: joint_position_offset, scale: 0.25}\n"
        "observations:\n"
        f"  body: {{sensor: proprio, terms: [gravity, {{term: constant, values: {[0] * 130}}},\n"
        "    {term: constant, values: [0, 0]}, {term: constant, values: [1, 0]}]}\n"
        "  known: {sensor: proprio, layout: parkour53}\n"
    )
    told = probe_page(probe_here(load_bundle(tmp_path, checkpoint=tmp_path / "deaf.pt")))
    words = "note: `body` holds 132 zeros instead of what the checkpoint was trained on\n"
    assert told.count("instead of what") == told.count(words) == 1
    assert "moves against its targets" not in told


def himloco(folder, *changes):
    text = CARD
    for pattern, replacement in changes:
        text, count = re.subn(pattern, replacement, text, flags=re.DOTALL)
        assert count == 1
    (folder / "policy.yaml").write_text(text)
    return probe_here(load_bundle(folder, checkpoint=HIMLOCO))


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize("name", ["himloco-go2", "playground-go1"])
def test_other_peoples_policies_pass_with_their_cards(name):
    weights = HIMLOCO if name == "himloco-go2" else PLAYGROUND
    told = api.check_policy(f"examples/{name}", checkpoint=weights)
    assert told.passed, probe_page(told)


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((r"  joints: \[.*?\]\n", ""), "it walks with the joints in the order FL FR RL RR, leg by"),
        (("order: newest_first", "order: oldest_first"), "it walks with `obs` with order: newest"),
        (("- gravity", "- {term: gravity, scale: -1.0}"), "with the sign of `gravity` reversed"),
    ],
    ids=["joint order", "history order", "sign"],
)
@pytest.mark.nightly
def test_a_wrong_card_is_told_what_would_be_right(tmp_path, change, words):
    told = himloco(tmp_path, change)
    assert not told.passed
    assert words in probe_page(told)


@pytest.mark.assets
@needs_assets
def test_missing_scales_are_suspected(tmp_path):
    told = himloco(tmp_path, (r"\{term: joint_vel, scale: 0\.05\}", "joint_vel"))
    assert "joint_vel: reaches" in probe_page(told)
    assert "a scale may be missing" in probe_page(told)


@pytest.mark.assets
@needs_assets
def test_a_missing_term_is_said_in_the_terms_of_the_card(tmp_path):
    with pytest.raises(PolicyError, match=r"`obs` 252 = 6 x \(3 \+ 3 \+ 12 \+ 12 \+ 12\)"):
        himloco(tmp_path, (r"      - gravity\n", ""))


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize(
    ("weights", "robot"), [(HIMLOCO, "go2"), (PLAYGROUND, "go1")], ids=["himloco", "playground"]
)
def test_init_writes_a_valid_card_of_the_right_sizes(tmp_path, weights, robot):
    copy = tmp_path / weights.name
    copy.write_bytes(weights.read_bytes())
    told = api.init_policy(copy, robot=robot)
    card = load_card(tmp_path / "policy.yaml")
    assert card.adapter == ("torchscript" if robot == "go2" else "onnx")
    assert told.to_check > 0
    numbers = "270 = 6 x" if robot == "go2" else "48 = 3 +"
    assert numbers in card_page(api.show_policy(str(tmp_path)))


def test_init_of_a_shipped_bundle_finds_its_size_and_keeps_existing_cards(tmp_path):
    weights = tmp_path / "policy.onnx"
    weights.write_bytes((REPOSITORY / "policies" / "go1-parkour" / "policy.onnx").read_bytes())
    api.init_policy(weights, robot="go1")
    assert "332" in card_page(api.show_policy(str(tmp_path)))
    with pytest.raises(UsageError, match="exists already"):
        api.init_policy(weights, robot="go1")
    for given in (weights, tmp_path / "gone"):
        with pytest.raises(UsageError, match="unknown robot 'go3'"):
            api.init_policy(given, robot="go3")
    api.init_policy(weights, robot="go1", out=tmp_path / "other.yaml")
    assert load_card(tmp_path / "other.yaml").adapter == "onnx"


@pytest.mark.assets
@needs_assets
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_himlocos_own_estimator_of_its_speed_agrees_with_the_simulation():
    # The network estimates its velocity from the observations, times 2 as its training scaled it.
    # A card with other terms, scales, orders or gains makes it read something else.
    bundle = load_bundle("examples/himloco-go2", checkpoint=HIMLOCO)
    made = record(bundle, scene="flat/carpet_room", seconds=3.0)
    frames = torch.from_numpy(made.observations["obs"])
    with torch.inference_mode():
        forward = torch.jit.load(str(HIMLOCO)).estimator(frames)[:, 0]
    assert made.outcome is None
    assert float(forward.mean()) / 2.0 == pytest.approx(made.travelled / made.seconds, rel=0.1)
