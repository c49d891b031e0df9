"""What is said of recordings that somebody made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from nw_policies import load_bundle
from nw_policies.cards import Card
from nw_policies.cards.feeding import InputSpec
from nw_scenes.robots import get_robot
from nw_sim.probe.findings import (
    Range,
    action_findings,
    card_findings,
    input_findings,
)
from nw_sim.probe.summary import Part

GO1 = get_robot("go1")


def bytes_of(walked, uncommanded, given, wanted):
    """What is noted of images of one type that go into an input of another type."""
    plain = uncommanded.model_dump(by_alias=True)
    plain["observations"] = {"rgb": {"sensor": "splat_rgb", "dtype": given}}
    image = np.zeros((100, 45, 80, 3), dtype=given)
    spec = InputSpec(name="image", shape=(1, 45, 80, 3), dtype=np.dtype(wanted))
    inputs = () if wanted is None else (spec,)
    made = replace(walked(), observations={"rgb": image}, inputs=inputs)
    card = Card.model_validate(plain | {"inputs": None})
    return [(finding.kind, finding.text) for finding in input_findings(card, [], made)]


def test_bytes_that_go_into_an_input_of_floats_are_noted(walked, uncommanded):
    text = "`rgb` gives bytes 0..255 to a float32 input; `dtype: float32` gives 0..1"
    assert bytes_of(walked, uncommanded, "uint8", "float32") == [("note", text)]


def test_bytes_that_go_into_a_network_of_floats_are_noted_too(walked, uncommanded):
    plain = uncommanded.model_dump(by_alias=True)
    plain["observations"] = {"rgb": {"sensor": "splat_rgb"}}
    checkpoint = {"file": "encoder.onnx"}
    encoder = {"adapter": "onnx", "checkpoint": checkpoint, "inputs": ["rgb"]}
    card = Card.model_validate(plain | {"networks": {"encoder": encoder}, "inputs": ["encoder"]})
    specs = [
        (InputSpec(name="image", shape=(1, 45, 80, 3), dtype=np.dtype("float32")),),
        (InputSpec(name="latent", shape=(1, 8), dtype=np.dtype("float32")),),
    ]
    made = replace(
        walked(),
        observations={"rgb": np.zeros((100, 45, 80, 3), np.uint8)},
        fed_inputs={"encoder": specs[0]},
        inputs=specs[1],
    )
    (finding,) = input_findings(card, [], made)
    assert "`rgb` gives bytes 0..255 to a float32 input" in finding.text


@pytest.mark.parametrize(
    ("given", "wanted"), [("uint8", "uint8"), ("float32", "float32"), ("uint8", None)]
)
def test_images_of_the_inputs_own_type_are_not(walked, uncommanded, given, wanted):
    assert bytes_of(walked, uncommanded, given, wanted) == []


@pytest.mark.parametrize(
    ("swing", "tilt", "said"),
    [(0.04, 0.5, []), (0.06, 0.5, ["note"]), (0.06, 0.1, [])],
    ids=["still", "stumbles", "walks"],
)
def test_that_a_joint_moves_against_its_targets_is_noted_of_who_stumbles(
    walked, uncommanded, swing, tilt, said
):
    wave = np.sin(np.arange(101) * 0.3)
    targets, positions = np.zeros((100, 12)), np.zeros((101, 12))
    targets[:, 4] = swing / 2 * wave[:-1]
    positions[1:, 4] = -0.3 * np.cumsum(targets[:, 4])
    made = replace(walked(tilt=tilt), targets=targets, positions=positions)
    found = action_findings(uncommanded, GO1, made)
    words = "FL_thigh: moves against its targets"
    assert [one.kind for one in found if words in one.text] == said


@pytest.mark.parametrize(
    ("constant", "said"),
    [
        ((12, 3), "all 15 numbers that the card feeds it are constant; name the terms"),
        ((12, 2), "the checkpoint does not react to its inputs, of which 14 of 15 are constant"),
        ((0, 0), "the checkpoint does not react to its inputs"),
    ],
)
def test_the_same_action_is_blamed_on_whom_it_is_due_to(walked, uncommanded, constant, said):
    fed = [
        Range(
            part=Part(
                observation="obs", kind=kind, indices=np.arange(size), steps=1, form="",
                limits=None, is_fixed=False,
            ),
            low=0.0, mean=0.0, high=0.0, constant=count, broken=0,
        )
        for kind, size, count in zip(("joint_pos", "command"), (12, 3), constant, strict=True)
    ]  # fmt: skip
    found = action_findings(uncommanded, GO1, walked(), fed)
    (same,) = [one for one in found if "the same at every step" in one.text]
    assert same.kind == "fault"
    assert said in same.text


@pytest.mark.parametrize(
    ("travelled", "kind", "said"),
    [(0.1, "fault", "it does not move ahead: name the term"), (1.5, "note", "was trained on")],
)
def test_who_is_told_nothing_and_does_not_go_on_lacks_a_term(
    walked, uncommanded, travelled, kind, said
):
    plain = uncommanded.model_dump(by_alias=True)
    terms = ["gravity", {"term": "constant", "value": 0.0, "width": 16}]
    plain["observations"] = {"obs": {"sensor": "proprio", "terms": terms}}
    card = Card.model_validate(plain | {"inputs": None})
    part = Part(
        observation="obs", kind="constant", indices=np.arange(3, 19), steps=1, form="",
        limits=None, is_fixed=True,
    )  # fmt: skip
    zeros = Range(part=part, low=0.0, mean=0.0, high=0.0, constant=16, broken=0)
    (finding,) = input_findings(card, [zeros], walked(travelled=travelled))
    assert finding.kind == kind
    assert said in finding.text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("hurdels/*", "`trained_on`: 'hurdels/*' names no built-in scene, and marks none as"),
        ("!gaps/none", "'!gaps/none' names no built-in scene"),
        ("hurdles/one_low_carpt", "did you mean 'hurdles/one_low_carpet'?"),
        ("split:test", "'split:test' names no built-in scene"),
        ("hurdles/*", ""),
        ("hurdles/bar@*", ""),
        ("!*/up@0.2*", ""),
        ("hurdles/bar@0.34~1", ""),
        ("hurdles/bar@9", "'hurdles/bar@9' names no built-in scene"),
        ("hurdles/baar@*", "names no built-in scene"),
        ("split:train", ""),
        ("hurdles/one_low_carpet~3", ""),
        ("./my-scene", ""),
        ("hub:lab/corridor", ""),
    ],
)
def test_a_name_in_trained_on_that_is_of_no_scene_is_noted(words, said):
    card = load_bundle("stand").card.model_copy(update={"trained_on": (words,)})
    found = list(card_findings(card))
    assert [each.kind for each in found] == ["note"] * bool(said)
    assert all(said in each.text for each in found)
