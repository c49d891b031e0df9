"""Published layouts: a draft has one of those that fit, and says the others in full."""

import os
import re
from pathlib import Path

import pytest
import torch
from ruamel.yaml import YAML
from torch import nn

from nw_base.errors import PolicyError
from nw_eval import api
from nw_policies.cards import load_card
from nw_policies.cards.terms import term_size
from nw_policies.drafting.checkpoint import inspect_checkpoint
from nw_policies.drafting.draft import write_card_draft
from nw_policies.drafting.layouts import FRAMES
from nw_scenes.robots import get_robot

GO2 = get_robot("go2")
OF_45 = [
    "legged-gym", "isaac-lab", "unitree-rl-lab", "robot-lab", "genesis", "mjlab", "himloco",
]  # fmt: skip


def blocks(text):
    """The layouts that stand as comments at the end of a draft, by name, as data."""
    found = re.split(r"^#\n# ([a-z0-9-]+) \(.*\): .*\n", text, flags=re.MULTILINE)[1:]
    bodies = (re.sub(r"^# ?", "", body, flags=re.MULTILINE) for body in found[1::2])
    return dict(zip(found[::2], map(YAML(typ="safe").load, bodies), strict=True))


def written(path, layout=None):
    """The draft of a checkpoint: its text, its card, and the same as plain data."""
    text = write_card_draft(inspect_checkpoint(path), GO2, layout=layout)
    card = path.with_name("policy.yaml")
    card.write_text(text)
    return text, load_card(card), YAML(typ="safe").load(text)


@pytest.mark.parametrize("name", OF_45)
def test_each_layout_of_45_numbers_is_written_on_demand_and_said_in_full_elsewhere(name, onnx_file):
    path = onnx_file({"obs": [1, 45]})
    _, card, data = written(path, name)
    assert sum(term_size(term, range(12)) for term in card.observations["obs"].frame_terms) == 45
    other = OF_45[OF_45.index(name) - 1]
    block = blocks(written(path, other)[0])[name]
    assert block["control"].items() <= data["control"].items()
    own = {key: value for key, value in data["observations"]["obs"].items() if key != "sensor"}
    assert block["observations"]["obs"] == own


def test_the_layouts_that_fit_are_those_of_the_size_and_differ_in_more_than_their_names(onnx_file):
    text, _, data = written(onnx_file({"obs": [1, 45]}))
    said = {"legged-gym": data} | blocks(text)
    assert list(said) == OF_45
    keys = ("joints", "scale", "delay_steps")
    ways = [
        (layout["observations"]["obs"]["terms"], *map(layout["control"].get, keys))
        for layout in said.values()
    ]
    assert len({str(way) for way in ways}) == len(OF_45)
    assert set(blocks(written(onnx_file({"obs": [1, 48]}))[0])) == {"legged-gym", "isaac-lab"}
    assert "Other published layouts" not in written(onnx_file({"obs": [1, 53]}))[0]


def test_frames_of_a_history_stand_as_those_have_them_who_train_so(onnx_file):
    text, card, _ = written(onnx_file({"obs": [1, 270]}))
    history = card.observations["obs"].history
    assert (history.steps, history.order, history.by) == (6, "newest_first", "step")
    theirs = blocks(text)["isaac-lab"]["observations"]["obs"]["history"]
    assert theirs == {"steps": 6, "order": "oldest_first", "by": "term"}


def test_heights_behind_a_frame_are_those_of_its_layout(onnx_file):
    path = onnx_file({"obs": [1, 235]})
    text, card, _ = written(path)
    assert (card.observations["obs_scan"].order, card.observations["obs_scan"].wrap) == (
        "x_fastest",
        [],
    )
    theirs = blocks(text)["legged-gym"]["observations"]["obs_scan"]
    _, card, _ = written(path, "legged-gym")
    scan = card.observations["obs_scan"]
    # legged_gym: clip(root height - 0.5 - heights, -1, 1) * 5, points of one x after another.
    assert (scan.order, scan.offset, scan.clip, scan.wrap[0].scale) == (
        "y_fastest",
        -0.5,
        (-1, 1),
        5,
    )
    assert (theirs["order"], theirs["wrap"][0]["scale"]) == ("y_fastest", 5)


@pytest.mark.parametrize("frame", FRAMES, ids=lambda frame: f"{frame.name}-{frame.size}")
def test_what_is_fed_back_clipped_is_clipped_at_the_same_limit(frame):
    fed_back = [term for term in frame.terms if "last_output" in term]
    assert any("clipped: true" in term for term in fed_back) == (frame.clip is not None)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    ("part", "layout", "sign"),
    [
        (None, "legged-gym", "it is an actor alone, as legged_gym saves it"),
        ("actor", "isaac-lab", "it is saved as in Isaac Lab"),
        ("estimator", "himloco", "it has an estimator, as HIMLoco's have"),
    ],
)
def test_how_a_checkpoint_is_saved_tells_who_trained_it(part, layout, sign, tmp_path):
    module = nn.Sequential(nn.Linear(45, 8), nn.ELU(), nn.Linear(8, 12))
    whole = module if part is None else nn.Sequential()
    if part is not None:
        whole.add_module(part, module)
    torch.jit.save(torch.jit.trace(whole, torch.zeros(1, 45)), tmp_path / "p.pt")
    text, _, _ = written(tmp_path / "p.pt")
    assert f"# This card is of {layout}. Other" in text
    assert sign in text


def test_a_layout_that_does_not_fit_is_answered_with_the_nearest_that_does(onnx_file):
    path = onnx_file({"obs": [1, 45]})
    with pytest.raises(
        PolicyError, match="do not fit the layout 'isaaclab'; did you mean 'isaac-lab'"
    ):
        written(path, "isaaclab")
    path = onnx_file({"obs": [1, 332]})
    with pytest.raises(PolicyError, match="none is guessed here: leave --layout out"):
        written(path, "isaac-lab")


def test_the_verb_writes_the_layout_that_is_asked_for(onnx_file, tmp_path):
    path = onnx_file({"obs": [1, 45]})
    told = api.init_policy(path, robot="go2", out=tmp_path / "lab.yaml", layout="isaac-lab")
    assert "# This card is of isaac-lab." in told.text
    assert load_card(tmp_path / "lab.yaml").control.joints[:2] == ["FL_hip", "FR_hip"]


SHARED = Path(__file__).resolve().parents[4] / "shared" / "assets"
ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", SHARED)) / "policies"


@pytest.mark.assets
@pytest.mark.skipif(not ASSETS.is_dir(), reason="third-party policies are not here")
@pytest.mark.parametrize(
    ("name", "layout"),
    [("chenci-go2", None), ("go1-climb", None), ("legubiao-go2", "himloco")],
)
def test_strangers_checkpoints_get_the_terms_and_joints_of_the_cards_that_make_them_walk(
    name, layout, tmp_path
):
    path = tmp_path / "policy.pt"
    path.write_bytes((ASSETS / name / "policy.pt").read_bytes())
    _, card, _ = written(path, layout)
    right = load_card(ASSETS / name / "policy.yaml")
    assert card.control.joints == right.control.joints

    def seen(card):
        terms = card.observations["obs"].frame_terms
        return [
            term.model_copy(update={"clipped": False}) if term.term == "last_output" else term
            for term in terms
        ]

    assert seen(card) == seen(right)


def test_a_row_of_an_unknown_size_may_be_frames_of_one(onnx_file, drafted):
    text, _, problems = drafted(onnx_file({"obs": [1, 570]}))
    assert problems == []
    assert "no known layout has it, so these are zeros; it may be 10 frames of 57 numbers" in text
    text, _, _ = drafted(onnx_file({"obs": [1, 43]}, name="other/p.onnx"))
    assert "frames of" not in text


def test_a_clock_of_two_numbers_is_that_of_unitree_rl_gym(onnx_file, drafted):
    for frames in (1, 10):
        _, card, problems = drafted(onnx_file({"obs": [1, 47 * frames]}, name=f"{frames}/p.onnx"))
        assert problems == []
        assert card.observations["obs"].frame_terms[-1].term == "clock"


def test_mjlab_without_linear_velocity_is_offered_for_45_numbers(onnx_file, drafted):
    text, _, _ = drafted(onnx_file({"obs": [1, 45]}))
    _, found, rest = text.partition("# mjlab (mjlab without linear velocity)")
    assert found
    terms = rest.split("terms:")[1].split("#\n")[0]
    assert terms.index("last_output") < terms.index("command")
    assert "lin_vel" not in terms
