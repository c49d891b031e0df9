"""Which other cards are tried, in which order, and how they are written."""

import json

import pytest

from nw_eval.policies import Card
from nw_eval.robots import get_robot
from nw_eval.rollout.probe.hypotheses import hypotheses
from nw_eval.rollout.probe.joint_signs import turned_cards
from nw_eval.rollout.probe.written import changed_lines

GO1 = get_robot("go1")
USUAL = {"ang_vel": "0.25", "joint_vel": "0.05", "lin_vel": "2", "command": "[2, 2, 0.25]"}


def with_terms(card, *terms, **control):
    """The card with other terms, checked as one that somebody writes."""
    plain = card.model_dump(by_alias=True)
    plain["observations"] = {"obs": {"sensor": "proprio", "terms": list(terms)}}
    plain["control"] |= control
    return Card.model_validate(plain)


def tried(card):
    return {one.words: changed_lines(card, one.card) for one in hypotheses(card, GO1)}


@pytest.mark.parametrize("name", USUAL)
def test_a_scale_that_is_missing_is_written_and_one_that_is_there_is_taken_away(commanded, name):
    usual, place = USUAL[name], "observations.obs.terms: -"
    without = with_terms(commanded, name, "joint_pos")
    lines = tried(without)[f"the scale of `{name}` {usual}"]
    assert lines == [f"{place} {{term: {name}, scale: {usual}}}"]
    there = with_terms(commanded, {"term": name, "scale": json.loads(usual)}, "joint_pos")
    assert tried(there)[f"the scale of `{name}` 1"] == [f"{place} {{term: {name}}}"]
    assert f"the scale of `{name}` {usual}" not in tried(there)


def test_scales_are_tried_first_each_alone_and_then_all_together(commanded):
    card = with_terms(commanded, "ang_vel", "gravity", "joint_pos", "joint_vel", "last_output")
    words = list(tried(card))
    assert words[:3] == [
        "the scale of `ang_vel` 0.25",
        "the scale of `joint_vel` 0.05",
        "the scale of `ang_vel` 0.25 and `joint_vel` 0.05",
    ]
    assert words[3].startswith("the joints in the order")


def test_a_scale_is_changed_in_all_observations_at_once(commanded):
    plain = commanded.model_dump(by_alias=True)
    past = {"sensor": "proprio", "terms": ["joint_vel"], "history": 3}
    plain["observations"] |= {"past": past}
    lines = tried(Card.model_validate(plain))["the scale of `joint_vel` 0.05"]
    assert lines == [
        "observations.obs.terms: - {term: joint_vel, scale: 0.05}",
        "observations.past.terms: - {term: joint_vel, scale: 0.05}",
    ]


def test_only_terms_of_equal_size_are_exchanged_with_their_scales(commanded):
    card = with_terms(
        commanded, {"term": "command", "scale": 2.0}, "joint_pos", "gravity", "last_output"
    )
    exchanged = {words: lines for words, lines in tried(card).items() if "exchanged" in words}
    place, command = "observations.obs.terms:", "{term: command, scale: 2}"
    joints, past, gravity = "{term: joint_pos}", "{term: last_output}", "{term: gravity}"
    assert exchanged == {
        "`command` and `gravity` of `obs` exchanged": [
            f"{place} [{gravity}, {joints}, {command}, {past}]"
        ],
        "`joint_pos` and `last_output` of `obs` exchanged": [
            f"{place} [{command}, {past}, {gravity}, {joints}]"
        ],
    }


@pytest.mark.parametrize("relative", [True, False])
def test_joint_positions_are_counted_from_the_other_place(commanded, relative):
    card = with_terms(commanded, {"term": "joint_pos", "relative": relative})
    words = f"`joint_pos` counted from {'0' if relative else '`default_pose`'}"
    written = "{term: joint_pos, relative: false}" if relative else "{term: joint_pos}"
    assert tried(card)[words] == [f"observations.obs.terms: - {written}"]


def test_a_pose_that_the_robot_cannot_take_is_not_tried(commanded):
    # Its calves go from -2.70 to -0.92 rad: 1.8 is nothing that a Go1 can do.
    turned = "thighs and calves turned round in default pose"
    assert turned in dict(turned_cards(commanded, GO1))
    assert turned not in tried(commanded)
    assert "the hips turned round in default pose" in tried(commanded)


def test_a_pose_that_the_robot_cannot_take_has_to_be_mended(commanded):
    card = with_terms(commanded, "joint_pos", default_pose={"thigh": -0.9, "calf": 1.8})
    words = list(tried(card))
    assert "thighs and calves turned round in default pose" in words
    assert all(one.endswith("default pose") for one in words)
