"""`nw-eval policies check` names what is wrong with a card, in lines that mend it."""

import os
import re
from io import StringIO
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from onnx import helper, numpy_helper
from ruamel.yaml import YAML

from nw_base.errors import PolicyError
from nw_eval import api
from nw_eval.cli.verbs.policies import probe_page
from nw_policies import load_bundle
from nw_policies.cards import Card, load_card
from nw_policies.cards.joints import joint_values
from nw_policies.drafting.notation import changed_lines, flow, per_joint
from nw_scenes.robots import get_robot
from nw_sim.probe.hypotheses import turned_cards
from nw_sim.probe.report import BEYOND, probe_here

REPOSITORY = Path(__file__).resolve().parents[3]
EXAMPLES = REPOSITORY / "policies" / "examples"
ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", REPOSITORY.parent / "shared" / "assets"))
WEIGHTS = {
    "himloco-go2": ASSETS / "policies" / "himloco-go2" / "himloco.pt",
    "playground-go1": ASSETS / "policies" / "playground-go1" / "go1_policy.onnx",
}
OTHERS = ASSETS / "policies"
needs_others = pytest.mark.skipif(
    not (OTHERS / "legubiao-go2" / "policy.pt").is_file(), reason=f"no weights at {ASSETS}"
)
needs_assets = pytest.mark.skipif(
    not all(path.is_file() for path in WEIGHTS.values()), reason=f"no weights at {ASSETS}"
)
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
LEGS = {"the hips": r"_hip", "the right hips": r"^.R_hip", "thighs and calves": r"_thigh|_calf"}
ROBOT_ORDER = [
    f"{leg}_{kind}" for leg in ("FR", "FL", "RR", "RL") for kind in ("hip", "thigh", "calf")
]
SCALE = {"himloco-go2": 0.25, "playground-go1": 0.5}


def nightly(*values):
    """A case like another one of its test, which is enough for every day."""
    return pytest.param(*values, marks=pytest.mark.nightly)


def example(name):
    """The card of an example, as plain values."""
    return YAML(typ="safe", pure=True).load((EXAMPLES / name / "policy.yaml").read_text())


def write(folder, card):
    folder.mkdir(exist_ok=True)
    text, yaml = StringIO(), YAML(typ="safe", pure=True)
    yaml.sort_base_mapping_type_on_output = False  # The order of observations counts.
    yaml.dump(card, text)
    (folder / "policy.yaml").write_text(text.getvalue())


def check(folder, card, weights):
    """What the verb does in a process of its own, in this one."""
    write(folder, card)
    return probe_here(load_bundle(folder, checkpoint=weights))


def mend(card, told):
    """Write on a card what a finding says; return how many lines that were."""
    advice = re.search(r"if trained that way, write\n((?:    .*\n)+)", told)
    assert advice, told
    lines = advice[1].splitlines()
    for line in lines:
        place, value = re.fullmatch(r"    ([\w.]+): (.*)", line).groups()
        *parents, key = place.split(".")
        part = card
        for parent in parents:
            part = part[parent]
        if value.startswith("- "):
            new = YAML(typ="safe", pure=True).load(value[2:])
            names = [term if isinstance(term, str) else term["term"] for term in part[key]]
            part[key][names.index(new["term"])] = new
        else:
            part[key] = YAML(typ="safe", pure=True).load(value)
    return len(lines)


def shares_of(told):
    """What is reached of each command with the advised card, and was: texts by command."""
    figures = re.search(r"\n  then reached: (.*)", probe_page(told))
    assert figures, probe_page(told)
    found = re.findall(r"([a-z ]+) (-?[\d.]+) \(was (-?[\d.]+)(?: and \w+)?\)", figures[1])
    return {words.strip(): (now, was) for words, now, was in found}


def terms_of(card):
    return card["observations"]["obs"]["terms"]


def term_name(term):
    return term if isinstance(term, str) else term["term"]


def spelt(term):
    """A term with its scale, however it is written."""
    plain = {"term": term} if isinstance(term, str) else term
    return {"scale": 1.0} | plain


def seen_with(card):
    """What a card means by its terms, however they are written."""
    return Card.model_validate(card).observations["obs"].terms


def joints_of(card):
    return [joint.removesuffix("_joint") for joint in card["control"].get("joints", ROBOT_ORDER)]


class Rebuilt(torch.nn.Module):
    """A scripted policy in a stack with other factors of what it sees and of what it says."""

    def __init__(self, policy, seen, told):
        super().__init__()
        self.policy = policy
        self.register_buffer("seen", seen)
        self.register_buffer("told", told)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.policy(x * self.seen) * self.told


def rebuilt(name, folder, *, seen=None, told=1.0):
    """Save a real policy as a stack has it whose numbers are others, by term and by joint."""
    sizes = {"joint_pos": 12, "joint_vel": 12, "last_output": 12}
    terms = [t if isinstance(t, str) else t["term"] for t in terms_of(example(name))]
    parts = [np.broadcast_to((seen or {}).get(t, 1.0), sizes.get(t, 3)) for t in terms]
    seen = np.concatenate(parts).astype(np.float32)
    told = np.broadcast_to(told, 12).astype(np.float32)
    if name == "himloco-go2":
        path = folder / "rebuilt.pt"
        seen, told = torch.tensor(np.tile(seen, 6)), torch.tensor(told)
        parts = torch.jit.load(str(WEIGHTS[name])), seen, told
        torch.jit.save(torch.jit.script(Rebuilt(*parts)), str(path))
        return path
    path = folder / "rebuilt.onnx"
    model = onnx.load(str(WEIGHTS[name]))
    graph = model.graph
    given, answer = graph.input[0].name, graph.output[0].name
    for node in graph.node:
        node.input[:] = ["inside" if x == given else x for x in node.input]
        node.output[:] = ["answered" if x == answer else x for x in node.output]
        node.input[:] = ["answered" if x == answer else x for x in node.input]
    graph.initializer.extend(
        [numpy_helper.from_array(seen, "seen"), numpy_helper.from_array(told, "told")]
    )
    graph.node.insert(0, helper.make_node("Mul", [given, "seen"], ["inside"]))
    graph.node.append(helper.make_node("Mul", ["answered", "told"], [answer]))
    onnx.save(model, str(path))
    return path


def mirrored(name, joints, folder):
    """Save a real policy as a stack has it whose `joints` (a pattern) count the other way round."""
    told = [-1.0 if re.search(joints, joint) else 1.0 for joint in joints_of(example(name))]
    seen = dict.fromkeys(("joint_pos", "joint_vel", "last_output"), told)
    return rebuilt(name, folder, seen=seen, told=told)


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("himloco-go2", "the hips"),
        nightly("playground-go1", "the right hips"),
        ("playground-go1", "thighs and calves"),
        nightly("playground-go1", "the hips"),
        nightly("himloco-go2", "the right hips"),
        nightly("himloco-go2", "thighs and calves"),
    ],
)
def test_a_policy_of_a_stack_with_other_signs_is_told_where_to_write_them(tmp_path, name, words):
    joints = LEGS[words]
    weights, card = mirrored(name, joints, tmp_path), example(name)
    told = check(tmp_path / "card", card, weights)
    assert not told.passed
    assert f"with the signs of {words} reversed in targets and observations" in probe_page(told)
    assert mend(card, probe_page(told)) == 3
    names = joints_of(card)
    signs = np.array([-1.0 if re.search(joints, joint) else 1.0 for joint in names])
    scale = joint_values(card["control"]["scale"], names)
    np.testing.assert_allclose(scale, SCALE[name] * signs)
    seen = {
        t["term"]: t["scale"] for t in card["observations"]["obs"]["terms"] if "joint" in str(t)
    }
    velocity = 0.05 if name == "himloco-go2" else 1.0
    np.testing.assert_allclose(seen["joint_pos"], signs)
    np.testing.assert_allclose(seen["joint_vel"], velocity * signs)
    mended = check(tmp_path / "card", card, weights)
    assert mended.passed, probe_page(mended)


@pytest.mark.assets
@needs_assets
def test_a_default_pose_that_was_copied_with_the_stacks_own_signs_is_refused(tmp_path):
    card = example("playground-go1")
    card["control"]["default_pose"] |= {"thigh": -0.9, "calf": 1.8}
    with pytest.raises(PolicyError, match=r"1\.8 is beyond the range of FR_calf; .* own signs"):
        check(tmp_path / "card", card, WEIGHTS["playground-go1"])


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize(
    ("name", "joints"), [nightly("himloco-go2", "^.R_hip"), ("playground-go1", "_hip")]
)
def test_signs_that_the_checkpoint_does_not_have_are_found_in_the_targets(tmp_path, name, joints):
    card = example(name)
    card["control"]["scale"] = {
        joint: SCALE[name] * (-1 if re.search(joints, joint) else 1) for joint in joints_of(card)
    }
    told = check(tmp_path, card, WEIGHTS[name])
    assert not told.passed
    assert f"\n    control.scale: {SCALE[name]:g}\n" in probe_page(told)


@pytest.mark.assets
@needs_assets
@pytest.mark.nightly
def test_hips_with_half_of_their_scale_are_no_fault_for_they_do_what_trials_command(tmp_path):
    """rl_sar has this scale in its own configuration of the checkpoint."""
    card = example("himloco-go2")
    card["control"]["scale"] = {"hip": 0.125, "thigh": 0.25, "calf": 0.25}
    write(tmp_path, card)
    told = api.check_policy(str(tmp_path), checkpoint=WEIGHTS["himloco-go2"])
    assert told.passed
    ahead, left = (
        re.search(
            rf"\n{words} +[\d.]+ m/s +(-?[\d.]+) m/s +(-?[\d.]+)\n", probe_page(told)
        ).groups()
        for words in ("ahead", "to the left")
    )
    assert float(ahead[1]) > 0.8
    assert float(left[1]) < 0.6
    assert f"note: `command`: 0.5 m/s to the left, {left[0]} m/s reached" in probe_page(told)
    assert "note: it follows better with the scale of the hips doubled" in probe_page(told)
    assert mend(card, probe_page(told)) == 1
    assert card["control"]["scale"] == 0.25
    assert check(tmp_path, card, WEIGHTS["himloco-go2"]).passed


@pytest.mark.assets
@needs_assets
def test_hips_with_twice_their_scale_are_found_out(tmp_path):
    card = example("playground-go1")
    card["control"]["scale"] = {"hip": 1.0, "thigh": 0.5, "calf": 0.5}
    told = check(tmp_path, card, WEIGHTS["playground-go1"])
    assert "with the scale of the hips halved" in probe_page(told)
    assert "\n    control.scale: 0.5\n" in probe_page(told)


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize(
    ("name", "scale", "right"),
    [("himloco-go2", 1.0, [2, 2, 0.25]), ("playground-go1", [1.0, -1.0, 1.0], 1)],
    ids=["missing", "y to the right"],
)
def test_a_wrong_scale_of_the_command_is_told(tmp_path, name, scale, right):
    card = example(name)
    terms = card["observations"]["obs"]["terms"]
    place = next(i for i, term in enumerate(terms) if "command" in str(term))
    terms[place] = {"term": "command", "scale": scale}
    told = check(tmp_path, card, WEIGHTS[name])
    assert not told.passed
    assert mend(card, probe_page(told)) == 1
    assert terms[place].get("scale", 1) == right


USUAL = {"ang_vel": 0.25, "joint_vel": 0.05, "lin_vel": 2.0}


def with_scales(name, scales):
    """An example's card with these scales of its terms."""
    card = example(name)
    for place, term in enumerate(terms_of(card)):
        plain = {"term": term} if isinstance(term, str) else term
        if plain["term"] in scales:
            terms_of(card)[place] = plain | {"scale": scales[plain["term"]]}
    return card


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize(
    ("name", "missing"),
    [
        nightly("himloco-go2", ["ang_vel"]),
        nightly("himloco-go2", ["joint_vel"]),
        ("himloco-go2", ["ang_vel", "joint_vel"]),
        nightly("playground-go1", ["ang_vel"]),
        nightly("playground-go1", ["joint_vel"]),
        nightly("playground-go1", ["lin_vel"]),
        ("playground-go1", ["lin_vel", "ang_vel", "joint_vel"]),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_scales_that_a_card_lacks_are_told(tmp_path, name, missing):
    weights, ones = WEIGHTS[name], dict.fromkeys(missing, 1.0)
    if name == "playground-go1":  # As a stack with legged_gym's scales would have trained it.
        weights = rebuilt(name, tmp_path, seen={term: 1 / USUAL[term] for term in missing})
    card = with_scales(name, ones)
    told = check(tmp_path / "card", card, weights)
    assert not told.passed
    assert mend(card, probe_page(told)) == len(missing)
    right = with_scales(name, {term: USUAL[term] for term in missing})
    assert seen_with(card) == seen_with(right)
    mended = check(tmp_path / "card", card, weights)
    assert mended.passed, probe_page(mended)


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize("term", ["ang_vel", "lin_vel"])
def test_scales_that_a_checkpoint_was_not_trained_with_are_told(tmp_path, term):
    card = with_scales("playground-go1", {term: USUAL[term]})
    told = check(tmp_path, card, WEIGHTS["playground-go1"])
    # With a wrong scale of the yaw rate alone the trial ends as soon as with the right one.
    assert told.passed == (term == "ang_vel")
    follows = "note: it follows better" if told.passed else "fault: it follows"
    assert f"{follows} with the scale of `{term}` 1; if trained that way" in probe_page(told)


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize(
    ("name", "terms"),
    [
        ("himloco-go2", ("command", "ang_vel")),
        nightly("himloco-go2", ("ang_vel", "gravity")),
        nightly("himloco-go2", ("joint_pos", "joint_vel")),
        nightly("playground-go1", ("lin_vel", "gravity")),
        nightly("playground-go1", ("gravity", "command")),
        ("playground-go1", ("joint_pos", "joint_vel")),
    ],
    ids=lambda value: value if isinstance(value, str) else " and ".join(value),
)
def test_terms_that_stand_in_each_others_place_are_told(tmp_path, name, terms):
    card = example(name)
    right = terms_of(card)
    names = [term if isinstance(term, str) else term["term"] for term in right]
    one, other = map(names.index, terms)
    wrong = list(right)
    wrong[one], wrong[other] = right[other], right[one]
    card["observations"]["obs"]["terms"] = wrong
    told = check(tmp_path, card, WEIGHTS[name])
    assert not told.passed
    assert mend(card, probe_page(told)) == 1
    assert seen_with(card) == seen_with(example(name))


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize("name", [nightly("himloco-go2"), "playground-go1"])
def test_joint_positions_that_the_training_counted_from_the_pose_are_told(tmp_path, name):
    card = example(name)
    terms = terms_of(card)
    terms[terms.index("joint_pos")] = {"term": "joint_pos", "relative": False}
    told = check(tmp_path, card, WEIGHTS[name])
    assert (
        "it walks with `joint_pos` counted from `default_pose`; if trained that way"
        in probe_page(told)
    )
    assert "observations.obs.terms: - {term: joint_pos}" in probe_page(told)


@pytest.mark.assets
@needs_assets
def test_a_missing_scale_of_the_action_is_told(tmp_path):
    card = example("himloco-go2")
    del card["control"]["scale"]
    told = check(tmp_path, card, WEIGHTS["himloco-go2"])
    assert "\n    control.scale: 0.25\n" in probe_page(told)


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize(("kp", "is_still"), [(5, True), nightly(10, False)])
def test_a_robot_too_weak_to_stand_is_told_stronger_gains(tmp_path, kp, is_still):
    card = example("playground-go1")
    card["control"]["kp"] = kp
    told = check(tmp_path, card, WEIGHTS["playground-go1"])
    assert not told.passed
    assert (probe_page(told).count("it stands still, whatever is commanded") == 1) == is_still
    assert mend(card, probe_page(told)) == 1
    assert card["control"]["kp"] >= 20
    assert check(tmp_path, card, WEIGHTS["playground-go1"]).passed


@pytest.mark.assets
@needs_assets
@pytest.mark.nightly
def test_a_stumbling_policy_is_told_a_delay_that_is_not_its_own(tmp_path):
    card = example("himloco-go2")
    card["control"]["delay_steps"] = 3
    told = check(tmp_path, card, WEIGHTS["himloco-go2"])
    assert "fault: it leans by 0.3" in probe_page(told)
    assert mend(card, probe_page(told)) == 1
    assert card["control"]["delay_steps"] == 0
    assert shares_of(told)["to the left"] == ("0.81", "0.43")


@pytest.mark.assets
@needs_assets
@pytest.mark.nightly
def test_a_stumbling_policy_is_not_told_a_card_under_which_it_ignores_its_commands(tmp_path):
    card = example("himloco-go2")
    card["command"]["speed"] = 3.0  # Faster than it can.
    told = check(tmp_path, card, WEIGHTS["himloco-go2"])
    assert "fault: it leans by 0.3" in probe_page(told)
    assert all(0.75 <= float(now) <= 1.3 for now, _ in shares_of(told).values())


@pytest.mark.assets
@needs_assets
@pytest.mark.parametrize(
    "command",
    [
        {"source": "trail_follower", "speed": 0.8, "yaw_limit": 0.001},
        nightly({"source": "constant", "velocity": [0.5, 0.0, 0.3]}),
        nightly({"source": "constant", "velocity": [-0.5, 0.0, 0.0]}),
        {"source": "constant", "velocity": [0.0, 0.3, 0.0]},
    ],
    ids=lambda command: f"{command['source']} {list(command.values())[1:]}",
)
def test_a_right_card_passes_with_commands_of_its_own(tmp_path, command):
    card = example("himloco-go2") | {"command": command}
    told = check(tmp_path, card, WEIGHTS["himloco-go2"])
    assert told.passed, probe_page(told)


def card_of(name):
    """The card of a policy that lies beside it, as plain values; and its checkpoint."""
    folder = OTHERS / name if (OTHERS / name).is_dir() else REPOSITORY / "policies" / name
    card = YAML(typ="safe", pure=True).load((folder / "policy.yaml").read_text())
    return card, folder / card["checkpoint"]["file"]


@pytest.mark.assets
@needs_others
@pytest.mark.parametrize("name", [nightly("chenci-go2"), "legubiao-go2", "go1-climb"])
def test_the_right_cards_of_policies_that_walk_have_no_fault(name):
    told = probe_here(load_bundle(OTHERS / name))
    assert told.passed, probe_page(told)
    assert "moves against" not in probe_page(told)
    assert ("it follows better with the scale of the hips doubled" in probe_page(told)) == (
        name == "go1-climb"
    )


@pytest.mark.assets
@needs_others
@pytest.mark.parametrize(
    ("name", "unscaled"),
    [("legubiao-go2", ()), nightly("go1-climb", ("ang_vel", "joint_vel", "command"))],
    ids=["order", "order and scales"],
)
def test_a_policy_that_never_turns_as_fast_as_it_is_told_is_told_its_cure(tmp_path, name, unscaled):
    card, weights = card_of(name)
    right = card["control"].pop("joints")
    scaled = list(terms_of(card))
    for place, term in enumerate(scaled):
        if term_name(term) in unscaled:
            terms_of(card)[place] = term_name(term)
    told = check(tmp_path, card, weights)
    assert not told.passed
    assert mend(card, probe_page(told)) == 1 + len(unscaled)
    assert card["control"]["joints"] == right
    assert {term_name(t): t for t in map(spelt, terms_of(card))} == {
        term_name(t): t for t in map(spelt, scaled)
    }
    turning, was = shares_of(told)["turning left"]
    assert float(was) < 0.5
    assert 0.6 < float(turning) < 0.75


@pytest.mark.assets
@needs_others
@pytest.mark.nightly
def test_a_default_pose_whose_hips_have_the_other_sign_is_told(tmp_path):
    card, weights = card_of("chenci-go2")
    card["control"]["default_pose"] = {"hip": -0.1, "FR_hip": 0.1, "RR_hip": 0.1}
    told = check(tmp_path, card, weights)
    assert not told.passed
    assert mend(card, probe_page(told)) == 1
    pose = joint_values(card["control"]["default_pose"], joints_of(card))
    np.testing.assert_allclose(pose, [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1, -1.5, -0.1, 1, -1.5])


@pytest.mark.parametrize(
    "change",
    [
        {"joints": [*ROBOT_ORDER[3:6], *ROBOT_ORDER[:3], *ROBOT_ORDER[9:], *ROBOT_ORDER[6:9]]},
        pytest.param({"action": "joint_position"}, marks=pytest.mark.nightly),
        nightly({"scale": 1.0}),
        pytest.param({"kp": 10}, marks=pytest.mark.nightly),
        {"default_pose": {"hip": 0.0, "thigh": 0.9, "calf": -1.8}},
    ],
    ids=lambda change: next(iter(change)),
)
def test_the_shipped_policy_with_a_wrong_card_is_told_what_was_trained(tmp_path, change):
    card, weights = card_of("go1-parkour")
    wrong = card | {"control": card["control"] | change}
    told = check(tmp_path, wrong, weights)
    assert not told.passed
    assert mend(wrong, probe_page(told)) == 1
    (key,) = change
    written = wrong["control"][key]
    if key == "default_pose":
        written = joint_values(written, ROBOT_ORDER).tolist()
    robots_own = {"joints": ROBOT_ORDER, "default_pose": list(get_robot("go1").default_pose)}
    assert written == card["control"].get(key, robots_own.get(key))
    now, was = shares_of(told)["on its way"]
    assert now == "1.13"
    assert float(was) < 0.8


def test_a_card_without_fault_is_told_what_no_second_on_the_flat_can_show():
    told = probe_here(load_bundle("go1-parkour"))
    assert probe_page(told).endswith(f"{BEYOND}\nno fault found")


def test_a_layout_with_turned_joints_is_written_out_as_terms():
    card = load_card(REPOSITORY / "policies" / "go1-parkour" / "policy.yaml")
    words, changed = next(iter(turned_cards(card, get_robot("go1"))))
    assert words == "the signs of the hips reversed in targets and observations"
    Card.model_validate(changed.model_dump(by_alias=True))
    lines = changed_lines(card, changed)
    assert lines[0].startswith("control.scale: {hip: -0.25, thigh: 0.25, calf: 0.25}")
    written = YAML(typ="safe", pure=True).load("\n".join(lines[1:2]).partition(": ")[2])
    assert [term["term"] for term in written][6:8] == ["joint_pos", "joint_vel"]
    assert written[7]["scale"] == [-0.05, 0.05, 0.05] * 4
    assert lines[1].endswith("# instead of `layout: parkour53`")


def test_values_for_joints_are_written_as_short_as_they_can_be():
    assert per_joint(ROBOT_ORDER, [0.25] * 12) == 0.25
    assert per_joint(ROBOT_ORDER, [-0.1, 0.8, -1.5] * 4) == {
        "hip": -0.1,
        "thigh": 0.8,
        "calf": -1.5,
    }
    right = per_joint(ROBOT_ORDER, [-0.2, 0.5, 0.5, 0.2, 0.5, 0.5] * 2)
    sides = {"FR_hip": -0.2, "FL_hip": 0.2, "RR_hip": -0.2, "RL_hip": 0.2}
    assert right == sides | {"thigh": 0.5, "calf": 0.5}
    assert flow(right).startswith("{FR_hip: -0.2, FL_hip: 0.2,")
    assert joint_values(right, ROBOT_ORDER).tolist() == [-0.2, 0.5, 0.5, 0.2, 0.5, 0.5] * 2


def test_values_are_written_as_yaml_reads_them():
    value = {"joints": ["FL_hip", "FR_hip"], "current": False, "clip": None, "scale": 0.25}
    assert flow(value) == "{joints: [FL_hip, FR_hip], current: false, clip: null, scale: 0.25}"
    assert YAML(typ="safe", pure=True).load(flow(value)) == value
