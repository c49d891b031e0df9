"""What is said of commands that a policy misses, and when the search for another card ends."""

import math
from dataclasses import replace

import numpy as np
import pytest

from nw_scenes.robots import get_robot
from nw_sim.probe.findings import compare
from nw_sim.probe.hypotheses import TRIED
from nw_sim.probe.recording import Metered

GO1 = get_robot("go1")


@pytest.fixture
def compared(commanded, walked, rig_that_says):
    """Return a maker of findings: `compared(walk)`; and the rig that it ran on."""

    def compared(walk, *, completes=no_card, simulated=1000.0, deadline=math.inf, **recorded):
        rig = rig_that_says(walk, completes)
        metered = Metered(rig, simulated=simulated, deadline=deadline)
        followed, findings = compare(metered, commanded, GO1, walked(seconds=1.0, **recorded))
        return followed, [(finding.kind, finding.text) for finding in findings], rig

    return compared


def no_card(_):
    return False


def every_card(_):
    return True


def halved_hips(card):
    return isinstance(card.control.scale, dict) and card.control.scale.get("hip") == 0.25


def test_a_policy_that_follows_everything_is_asked_nothing_more(compared, obeys):
    followed, findings, rig = compared(lambda card, _: obeys(card))
    assert len(followed) == rig.asked == 5
    assert findings == []


def test_what_trials_do_not_command_is_a_note_if_no_card_mends_it(compared, obeys):
    _, findings, _ = compared(lambda card, _: obeys(card, (1.0, 0.4, 1.0)))
    assert [kind for kind, _ in findings] == ["note"] * 3
    assert "to the left, 0.20 m/s reached (40%)" in findings[0][1]
    assert findings[2][1] == (
        f"none of the changes tried helps: {TRIED}; none is better than the card"
    )


def test_where_nothing_helps_the_best_figures_are_reported(compared, obeys):
    def walk(card, _):
        return obeys(card, (1.0, 0.45 if halved_hips(card) else 0.4, 1.0))

    _, findings, _ = compared(walk)
    assert findings[-1][0] == "note"
    assert findings[-1][1].endswith(
        "; the nearest, with the scale of the hips halved: ahead 1.00 (was 1.00), "
        "to the left 0.45 (was 0.40), to the right 0.45 (was 0.40), "
        "turning left 1.00 (was 1.00), turning right 1.00 (was 1.00)"
    )


def test_a_card_that_helps_and_mends_not_everything_is_shown_with_its_figures(compared, obeys):
    def walk(card, _):
        return obeys(card, (0.9 if halved_hips(card) else 0.1, 0.5, 1.0))

    _, findings, _ = compared(walk)
    assert not any("none of the changes tried helps" in text for _, text in findings)
    kind, text = findings[-1]
    assert kind == "note"
    assert text.startswith(
        "it follows better with the scale of the hips halved; if trained that way"
    )
    assert "\n    control.scale: {hip: 0.25, thigh: 0.5, calf: 0.5}\n" in text
    assert "\n  then reached: ahead 0.90 (was 0.10), to the left 0.50 (was 0.50)," in text


def test_a_policy_that_follows_weakly_is_told_a_better_scale_and_no_fault(compared, obeys):
    def walk(card, _):
        share = 0.95 if halved_hips(card) else 0.7
        return obeys(card, (share, 1.0, share))

    _, findings, rig = compared(walk)
    assert [kind for kind, _ in findings] == ["note"]
    assert findings[0][1].startswith("it follows better with the scale of the hips halved; if")
    assert rig.asked < 20
    _, findings, _ = compared(lambda card, _: obeys(card, (0.7, 1.0, 0.7)))
    assert findings == []


@pytest.mark.parametrize(
    ("shares", "kind"), [((0.9, 0.8, 0.36), "note"), ((0.36, 0.8, 0.9), "fault")]
)
def test_a_policy_that_walks_and_hardly_turns_has_no_faulty_card(compared, obeys, shares, kind):
    """Both official G1s turn at 0.0 to 0.4 of a command, also in MuJoCo alone."""
    _, findings, _ = compared(lambda card, _: obeys(card, shares))
    missed = [kind for kind, text in findings if "reached (36%)" in text]
    assert missed
    assert set(missed) == {kind}


def test_a_policy_that_stands_still_is_told_so_once(compared, obeys):
    followed, findings, _ = compared(lambda card, _: obeys(card, (-0.001, 0.0, -0.002)))
    assert len(followed) == 5
    assert findings[0] == ("fault", "`command`: it stands still, whatever is commanded")
    assert [kind for kind, _ in findings] == ["fault", "note"]
    assert [one.words[2] for one in followed][:3] == ["0.00 m/s"] * 3


def test_a_policy_that_turns_does_not_stand_still(compared, obeys):
    _, findings, _ = compared(lambda card, _: obeys(card, (-0.001, 0.0, 1.0)))
    assert [text.partition(";")[0] for _, text in findings[:3]] == [
        "`command`: 0.8 m/s ahead, 0.00 m/s reached (0%)",
        "`command`: 0.5 m/s to the left, 0.00 m/s reached (0%)",
        "`command`: 0.5 m/s to the right, 0.00 m/s reached (0%)",
    ]


def test_a_policy_that_falls_does_not_stand_still(compared, obeys):
    _, findings, _ = compared(lambda card, _: obeys(card, (0.0, 0.0, 0.0), outcome="fell"))
    assert all("and it fell" in text for _, text in findings[:5])


def test_a_card_with_which_all_is_followed_and_a_trial_is_better_is_a_fault(compared, obeys):
    def walk(card, _):
        return obeys(card, (1.0, 1.0, 1.0 if halved_hips(card) else 0.4))

    _, findings, _ = compared(walk, completes=halved_hips)
    assert [kind for kind, _ in findings] == ["fault"] * 3
    assert findings[2][1].startswith(
        "it follows with the scale of the hips halved; if trained that way"
    )


@pytest.mark.parametrize(
    ("completes", "missed"), [(every_card, "note"), (no_card, "fault")], ids=["both", "neither"]
)
def test_a_card_that_is_no_better_in_a_trial_is_a_note(compared, obeys, completes, missed):
    """A right card may turn at half of what it is told, and complete every trial."""

    def walk(card, _):
        return obeys(card, (1.0, 1.0, 1.0 if halved_hips(card) else 0.4))

    _, findings, _ = compared(walk, completes=completes)
    assert [kind for kind, _ in findings] == [missed, missed, "note"]
    assert findings[2][1].startswith("it follows better with the scale of the hips halved; if")


def test_a_card_under_which_only_the_sides_are_slow_is_not_a_fault(compared, obeys):
    """So go right cards; a change that mends the sides can cost success in trials."""

    def walk(card, _):
        return obeys(card, (1.0, 1.0 if halved_hips(card) else 0.4, 1.0))

    _, findings, _ = compared(walk)
    assert [kind for kind, _ in findings] == ["note"] * 3
    assert findings[2][1].startswith("it follows better with the scale of the hips halved; if")


def test_a_card_under_which_it_goes_the_other_way_is_a_fault(compared, obeys):
    def walk(card, _):
        return obeys(card, (1.0, 1.0 if halved_hips(card) else -0.9, 1.0))

    _, findings, _ = compared(walk)
    assert [kind for kind, _ in findings] == ["note", "note", "fault"]


def test_a_stumbling_policy_is_told_with_which_card_it_walks(compared, obeys):
    def walk(card, _):
        return obeys(card, tilt=0.1 if halved_hips(card) else 0.5)

    followed, findings, _ = compared(walk, tilt=0.5)
    assert followed == []
    assert len(findings) == 1
    assert findings[0][1].startswith(
        "it walks with the scale of the hips halved; if trained that way"
    )


def test_what_was_found_before_the_budget_was_used_up_is_reported(commanded, compared, obeys):
    def walk(card, _):
        # The first other card already does; a better one comes later.
        first = card.observations != commanded.observations
        return obeys(card, (1.0, 1.0 if halved_hips(card) else 0.8 if first else 0.4, 1.0))

    everything = compared(walk)
    cut = compared(walk, simulated=25.0)  # 10 s for the commands, 10 s for each card that follows.
    assert len(everything[0]) == len(cut[0]) == 5
    assert "the hips halved" in everything[1][-1][1]
    assert [kind for kind, _ in cut[1]] == ["note"] * 4
    assert "with the scale of `lin_vel` 2;" in cut[1][2][1]
    assert cut[1][3][1] == "cut off after 26 s of simulation: not every other card was tried"
    assert cut[2].asked == 13


def test_a_policy_too_slow_for_its_commands_does_not_pass(compared, obeys):
    followed, findings, rig = compared(lambda card, _: obeys(card), deadline=0.0)
    assert followed == []
    assert rig.asked == 0
    words = "cut off after 0 s of simulation: not every command was tried"
    assert findings == [("fault", words)]


def test_no_other_card_is_tried_on_a_policy_that_sees_images(compared, obeys):
    _, findings, rig = compared(lambda card, _: obeys(card), tilt=0.5, sees_images=True)
    assert rig.asked == 0
    assert findings == []
    assert compared(lambda card, _: obeys(card), tilt=0.5)[2].asked > 0


@pytest.mark.parametrize(
    ("reached", "acts", "said"),
    [
        (0.02, True, [("fault", "`command`: it stands still")]),
        (0.3, True, [("note", "`command`: 0.8 m/s on its way, 0.30 m/s reached (38%)")]),
        (0.9, True, []),
        (0.02, False, []),
    ],
)
def test_a_policy_without_commands_is_let_go_on_its_way(
    uncommanded, walked, rig_that_says, reached, acts, said
):
    rig = rig_that_says(lambda *_: walked((reached, 0.0, 0.0)), no_card)
    metered = Metered(rig, simulated=1000.0)
    actions = np.outer(np.sin(np.arange(50.0)), np.full(12, acts))
    followed, findings = compare(
        metered, uncommanded, GO1, replace(walked(seconds=1.0), actions=actions)
    )
    assert [(one.kind, one.text.partition(";")[0]) for one in findings[:1]] == said
    assert [one.motion.words for one in followed] == (["on its way"] if acts else [])
    assert any("none of the changes tried helps" in one.text for one in findings) == bool(said)
