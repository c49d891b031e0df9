"""Which other cards are tried, in which order, and how they are written."""

import json
from dataclasses import replace

import pytest
from ruamel.yaml import YAML

from nw_policies.cards import Card
from nw_policies.drafting.notation import changed_lines, flow
from nw_scenes.robots import get_robot
from nw_sim.probe.hypotheses import double_hypotheses, hypotheses, turned_cards

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


BIPED = [
    f"{side}_{kind}_joint"
    for side in ("left", "right")
    for kind in ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
]
ANYMAL = [f"{leg}_{kind}" for leg in ("LF", "LH", "RF", "RH") for kind in ("HAA", "HFE", "KFE")]
UNLIKE = [*(f"left_{n}" for n in "abcde"), *(f"right_{n}" for n in "abcde"), "waist", "head"]


@pytest.mark.parametrize(
    ("joints", "orders"), [(BIPED, 3), (ANYMAL, 7), (list(GO1.joints), 7), (UNLIKE, 1)]
)
def test_a_robot_with_any_names_of_joints_has_other_orders_tried(commanded, joints, orders):
    robot = replace(GO1, joints=tuple(joints))
    motors = dict.fromkeys(("kp", "kd", "torque_limits", "armature", "friction_loss"))
    card = with_terms(
        commanded, "gravity", "joint_pos", joints=None, scale=0.5, default_pose=0.1, **motors
    )
    wide = replace(robot, joint_ranges=((-3.0, 3.0),) * 12)
    found = [one for one in hypotheses(card, wide) if "joints" in one.words]
    tried = [one for one in found if one.words.startswith("the joints ")]
    assert len(tried) == orders
    own = [name.removesuffix("_joint") for name in joints]
    for one in tried:
        assert sorted(one.card.control.joints) == sorted(own)
        assert one.card.control.joints != own
    assert len({tuple(one.card.control.joints) for one in tried}) == orders


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
    exchanged = {words: lines for words, lines in tried(card).items() if "swapped" in words}
    place, command = "observations.obs.terms:", "{term: command, scale: 2}"
    joints, past, gravity = "{term: joint_pos}", "{term: last_output}", "{term: gravity}"
    assert exchanged == {
        "`command` and `gravity` of `obs` swapped": [
            f"{place} [{gravity}, {joints}, {command}, {past}]"
        ],
        "`joint_pos` and `last_output` of `obs` swapped": [
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
    turned = "the signs of thighs and calves reversed in default pose"
    assert turned in dict(turned_cards(commanded, GO1))
    assert turned not in tried(commanded)
    assert "the signs of the hips reversed in default pose" in tried(commanded)


def test_a_pose_that_the_robot_cannot_take_has_to_be_mended(commanded):
    card = with_terms(commanded, "joint_pos", default_pose={"thigh": -0.9, "calf": 1.8})
    words = list(tried(card))
    assert "the signs of thighs and calves reversed in default pose" in words
    assert all(one.endswith("default pose") for one in words)


LEGGED_GYM = (
    "{FR_hip: -0.1, FL_hip: 0.1, RR_hip: -0.1, RL_hip: 0.1, "
    "FR_thigh: 0.8, FL_thigh: 0.8, RR_thigh: 1, RL_thigh: 1, calf: -1.5}"
)


@pytest.mark.parametrize(
    ("words", "lines"),
    [
        ("actions that are joint_position", ["control.action: joint_position"]),
        ("kp 70 and kd 1", ["control.kp: 70", "control.kd: 1"]),
        ("kp 8.75", ["control.kp: 8.75"]),
        ("kd 2", ["control.kd: 2"]),
        ("the robot's own gains", ["control.kp: 20"]),
        ("torque limits doubled", ["control.torque_limits: {hip: 47.4, thigh: 47.4, calf: 71.1}"]),
        ("a rate of 25 Hz", ["control.rate: 25", "observations.obs.rate: 25"]),
        ("actions delayed by 2", ["control.delay_steps: 2"]),
        ("go2 for a robot", ["robot: go2"]),
        (
            "MuJoCo Menagerie's default pose",
            ["control.default_pose: {hip: 0, thigh: 0.9, calf: -1.8}"],
        ),
        ("legged_gym's default pose", [f"control.default_pose: {LEGGED_GYM}"]),
    ],
)
def test_other_motors_are_written_in_lines_that_a_card_takes(commanded, words, lines):
    (hypothesis,) = [one for one in hypotheses(commanded, GO1) if one.words == words]
    assert changed_lines(commanded, hypothesis.card) == lines
    again = Card.model_validate(hypothesis.card.model_dump(by_alias=True))
    assert again == hypothesis.card


def test_what_a_card_already_says_is_not_tried(commanded):
    words = tried(commanded)
    assert not {"a rate of 50 Hz", "actions delayed by 0", "go1 for a robot"} & set(words)
    assert "MuJoCo Playground's default pose" not in words
    torques = with_terms(commanded, "joint_pos", action="joint_torque", kp=None)
    assert not [one for one in tried(torques) if one.startswith(("kp", "kd", "actions that"))]


def test_a_command_is_tried_at_every_place_among_the_terms(commanded):
    card = with_terms(commanded, "command", "gravity", "joint_pos")
    moved = {words: lines for words, lines in tried(card).items() if "behind" in words}
    place = "observations.obs.terms:"
    assert moved == {
        "`command` behind `gravity` in `obs`": [
            f"{place} [{{term: gravity}}, {{term: command}}, {{term: joint_pos}}]"
        ],
        "`command` behind `joint_pos` in `obs`": [
            f"{place} [{{term: gravity}}, {{term: joint_pos}}, {{term: command}}]"
        ],
    }


def test_velocities_are_tried_along_other_axes_and_for_each_other(commanded):
    scaled = {"term": "ang_vel", "scale": 0.25}
    words = tried(with_terms(commanded, scaled, "gravity"))
    place = "observations.obs.terms:"
    assert words["`ang_vel` along the axes of the world"] == [
        f"{place} - {{term: ang_vel, scale: 0.25, frame: world}}"
    ]
    assert words["`lin_vel` instead of `ang_vel` in `obs`"] == [
        f"{place} [{{term: lin_vel, scale: 0.25}}, {{term: gravity}}]"
    ]
    twice = tried(with_terms(commanded, "lin_vel", "lin_vel"))
    assert [one for one in twice if "instead of" in one] == [
        "`ang_vel` instead of the first `lin_vel` in `obs`",
        "`ang_vel` instead of the second `lin_vel` in `obs`",
    ]


def test_orders_are_tried_together_with_one_scale_and_with_all(commanded):
    card = with_terms(commanded, "ang_vel", "joint_vel", "command")
    first = "the joints in the order FR FL RR RL, all hips, then all thighs, then all calves, and"
    words = [one.words for one in double_hypotheses(card, GO1)]
    assert words[:4] == [
        f"{first} the scale of `ang_vel` 0.25",
        f"{first} the scale of `joint_vel` 0.05",
        f"{first} the scale of `command` [2, 2, 0.25]",
        f"{first} the scale of `ang_vel` 0.25, `joint_vel` 0.05 and `command` [2, 2, 0.25]",
    ]
    assert len(words) == 7 * 4


def test_a_pattern_is_written_so_that_it_is_read_again():
    pose = {"?L_hip": 0.1, "*_calf": -1.5, "F?_thigh": 0.8}
    assert flow(pose) == '{"?L_hip": 0.1, "*_calf": -1.5, F?_thigh: 0.8}'
    assert YAML(typ="safe", pure=True).load(flow(pose)) == pose
