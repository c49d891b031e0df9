"""What a policy is commanded, and what counts as doing it."""

import math

import numpy as np
import pytest

from nw_policies.cards import Card
from nw_sim.probe.findings import command_findings
from nw_sim.probe.following import Followed, Motion, deviation, follow, motions, own_way
from nw_sim.rollout.fault import PolicyFailedError

AHEAD = Motion(words="ahead", velocity=(0.8, 0.0, 0.0), axis=0, is_used=True)
RIGHT = Motion(words="to the right", velocity=(0.8, -0.5, 0.0), axis=1, is_used=False)


def followed(ratio, motion=AHEAD, *, fell=False):
    return Followed(motion=motion, ratio=ratio, fell=fell)


def with_command(card, **command):
    return Card.model_validate(card.model_dump(by_alias=True) | {"command": command})


@pytest.mark.parametrize(
    ("ratio", "fell", "is_missed"),
    [
        (1.0, False, False),
        (0.6, False, False),
        (1.66, False, False),
        (0.59, False, True),
        (1.68, False, True),
        (-1.0, False, True),
        (1.0, True, True),
    ],
)
def test_a_command_is_missed_below_six_tenths_above_the_inverse_and_by_a_fall(
    ratio, fell, is_missed
):
    assert followed(ratio, fell=fell).is_missed is is_missed


@pytest.mark.parametrize(
    ("ratio", "ending", "error"),
    [
        (0.9, {}, 0.1),
        (1.25, {}, 0.25),
        (-3.0, {}, 1.0),
        (3.0, {}, 1.0),
        (0.9, {"fell": True}, 1.0),
        (0.9, {"stumbled": True}, 1.0),
    ],
)
def test_an_error_is_a_share_of_the_command_and_all_of_it_for_who_stumbles(ratio, ending, error):
    one = Followed(motion=AHEAD, ratio=ratio, **{"fell": False} | ending)
    assert one.error == pytest.approx(error)


def test_commands_that_are_missed_count_for_more_than_in_their_mean():
    assert deviation([followed(0.9), followed(1.3)]) == pytest.approx(math.sqrt(0.05))
    assert deviation([followed(1.0)] * 3 + [followed(0.0)]) == pytest.approx(0.5)


def test_who_sees_no_command_is_measured_on_its_own_way(commanded, uncommanded, obeys):
    (way,) = own_way(uncommanded)
    assert (way.words, way.velocity) == ("on its way", (0.8, 0.0, 0.0))
    assert own_way(with_command(commanded, source="constant", velocity=(0.0, 0.3, 0.0))) == []
    seen = []

    class Watched:
        def record(self, card, *, seconds, level=math.inf):  # noqa: ARG002 - it walks level.
            seen.append(card.command.source)
            return obeys(card, (0.9, 1.0, 1.0), seconds=seconds)

    (one,) = follow(Watched(), uncommanded, [way])
    assert one.ratio == pytest.approx(0.9)
    assert seen == ["waypoint"]


def test_no_speed_is_tried_that_the_training_did_not_command(commanded):
    speeds = {"lin_vel_y": (-0.3, 0.05), "ang_vel_z": (-0.2, 0.2)}
    card = commanded.model_copy(update={"trained_speeds": speeds})
    tried = {one.words: one.velocity for one in motions(card)}
    assert "to the left" not in tried, "0.05 m/s is less than the sway of the steps"
    assert tried["to the right"] == (0.8, -0.3, 0.0)
    # Trials command turns under this card, whatever was trained.
    assert tried["turning left"] == (0.8, 0.0, 1.0)
    straight = with_command(card, source="trail_follower", yaw_limit=0.01)
    tried = {one.words: one.velocity for one in motions(straight)}
    assert tried["turning left"] == (0.8, 0.0, 0.2)
    every = {one.words: one.velocity for one in motions(commanded)}
    assert every["to the left"] == (0.8, 0.5, 0.0)


def test_the_second_second_is_compared_with_the_command(commanded, walked, rig_that_says):
    velocity = np.zeros((100, 3))
    velocity[:50], velocity[50:] = (9.0, 9.0, 9.0), (0.4, -0.45, 0.0)
    rig = rig_that_says(lambda _card, seconds: walked(velocity, seconds=seconds))
    ahead, right = follow(rig, commanded, [AHEAD, RIGHT])
    assert ahead.ratio == pytest.approx(0.5)
    assert right.ratio == pytest.approx(0.9)


@pytest.mark.parametrize("outcome", ["fell", "collided"])
def test_who_ends_before_getting_up_to_speed_reached_nothing(
    commanded, walked, rig_that_says, outcome
):
    rig = rig_that_says(lambda *_: walked((0.8, 0.0, 0.0), seconds=0.6, outcome=outcome))
    (one,) = follow(rig, commanded, [AHEAD])
    assert one.ratio == 0.0
    assert one.is_missed
    assert one.fell is (outcome == "fell")


def test_a_fall_is_told_behind_what_was_reached():
    fallen = followed(0.51, Motion(words="ahead", velocity=(1.0, 0, 0), axis=0, is_used=True))
    (fault,) = command_findings([Followed(motion=fallen.motion, ratio=0.51, fell=True)])
    assert fault.kind == "fault"
    assert fault.text.startswith("`command`: 1 m/s ahead, 0.51 m/s reached (51%), and it fell; ")
    (note,) = command_findings([followed(0.4, RIGHT)])
    assert note.kind == "note"
    assert note.text.startswith("`command`: 0.5 m/s to the right, 0.20 m/s reached (40%); check")


def test_what_trials_command_is_used_and_the_rest_is_not(commanded):
    assert [(motion.words, motion.is_used) for motion in motions(commanded)] == [
        ("ahead", True),
        ("to the left", False),
        ("to the right", False),
        ("turning left", True),
        ("turning right", True),
    ]
    assert motions(commanded)[0].velocity == (commanded.command.speed, 0.0, 0.0)


def test_policies_that_see_no_velocity_command_are_given_none(uncommanded):
    assert motions(uncommanded) == []


@pytest.mark.parametrize(
    ("velocity", "used"),
    [
        ((0.8, 0.0, 0.0), [("ahead (on the card)", 0.8)]),
        ((-0.5, 0.0, 0.0), [("backwards (on the card)", 0.5)]),
        ((0.5, 0.0, 0.3), [("ahead (on the card)", 0.5), ("turning left (on the card)", 0.3)]),
        ((0.0, 0.1, 0.0), [("to the left (on the card)", 0.1)]),
        ((0.0, 0.05, -1.0), [("turning right (on the card)", 1.0)]),
        ((0.0, 0.0, 0.0), []),
    ],
    ids=str,
)
def test_a_constant_command_is_tried_as_it_is(commanded, velocity, used):
    tried = motions(with_command(commanded, source="constant", velocity=velocity))
    own = [motion for motion in tried if motion.is_used]
    assert [(motion.words, motion.size) for motion in own] == used
    assert {motion.velocity for motion in own} <= {velocity}
    others = [motion for motion in tried if not motion.is_used]
    assert velocity not in {motion.velocity for motion in others}
    assert {motion.words for motion in others} >= {"to the left", "turning left", "turning right"}


def test_the_axes_of_one_command_are_read_from_one_recording(commanded, obeys, rig_that_says):
    card = with_command(commanded, source="constant", velocity=(0.5, 0.2, 0.3))
    rig = rig_that_says(lambda card, seconds: obeys(card, (0.9, 0.8, 0.7), seconds=seconds))
    own = [motion for motion in motions(card) if motion.is_used]
    assert [one.ratio for one in follow(rig, card, own)] == pytest.approx([0.9, 0.8, 0.7])
    assert rig.asked == 1


@pytest.mark.parametrize(
    ("changes", "used"),
    [
        ({"yaw_limit": 0.001}, ["ahead"]),
        ({"yaw_gain": 0.0}, ["ahead"]),
        ({"speed": 0.05}, ["turning left", "turning right"]),
        ({"yaw_limit": 0.1}, ["ahead", "turning left", "turning right"]),
    ],
    ids=str,
)
def test_nothing_is_judged_that_is_less_than_a_tenth(commanded, changes, used):
    command = {"source": "trail_follower", "speed": 0.8} | changes
    tried = motions(with_command(commanded, **command))
    assert len(tried) == 5
    assert all(motion.size >= 0.1 for motion in tried)
    assert [motion.words for motion in tried if motion.is_used] == used


@pytest.mark.parametrize("kind", ["action", "diverged", "exception"])
def test_only_who_runs_away_under_a_command_stumbles(commanded, rig_that_says, kind):
    def walk(*_):
        raise PolicyFailedError("a target of 4e+06", kind=kind)

    rig = rig_that_says(walk)
    if kind == "exception":
        with pytest.raises(PolicyFailedError):
            list(follow(rig, commanded, [AHEAD]))
        return
    (one,) = follow(rig, commanded, [AHEAD])
    assert (one.ratio, one.fell, one.stumbled) == (0.0, False, True)
