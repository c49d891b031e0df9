"""An action of one policy in the words of another has the same effect."""

import numpy as np
import pytest

from nw_policies.cards import JointControl
from nw_policies.cards.load import card_of
from nw_scenes.robots import get_robot
from nw_sim.rollout.replaying.policy_switch import translator

GO1 = get_robot("go1")
ACTION = np.linspace(-1.5, 2.0, 12)


def card(**control):
    return card_of(
        {"nw-policy": 1, "name": "any", "robot": "go1", "adapter": "zero", "control": control}
    )


OFFSET = card(action="joint_position_offset", scale=0.25, clip=[-1.0, 1.0])
ABSOLUTE = card(action="joint_position", scale=0.5, joints=list(GO1.joints[::-1]))
TORQUE = card(action="joint_torque", scale=20.0)


@pytest.mark.parametrize(("first", "second"), [(OFFSET, ABSOLUTE), (ABSOLUTE, OFFSET)])
def test_a_translated_action_has_the_same_joint_targets(first, second):
    translated = translator(first, second, GO1)(0.1 * ACTION)
    wanted = JointControl.from_card(first, GO1).targets(0.1 * ACTION)
    unlimited = card(**{**second.control.model_dump(exclude_defaults=True), "clip": None})
    found = JointControl.from_card(unlimited, GO1).targets(translated)
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_what_the_first_card_clips_was_never_done():
    translated = translator(OFFSET, ABSOLUTE, GO1)(ACTION)
    wanted = JointControl.from_card(OFFSET, GO1).targets(np.clip(ACTION, -1.0, 1.0))
    np.testing.assert_allclose(0.5 * translated[::-1], wanted, atol=1e-12)


def test_between_cards_of_one_meaning_an_action_stays_what_it_is_to_the_bit():
    softer = card(action="joint_position_offset", scale=0.25, kp=15.0, delay_steps=2)
    assert translator(OFFSET, softer, GO1)(ACTION) is ACTION


def test_there_are_no_words_for_torques_among_positions():
    assert translator(TORQUE, OFFSET, GO1) is None
    assert translator(OFFSET, TORQUE, GO1) is None
    twice = card(action="joint_torque", scale=10.0)
    np.testing.assert_array_equal(translator(TORQUE, twice, GO1)(ACTION), 2.0 * ACTION)


def test_a_joint_that_the_second_card_does_not_move_gets_no_action():
    still = card(action="joint_position_offset", scale=[0.0] * 3 + [0.25] * 9)
    translated = translator(OFFSET, still, GO1)(ACTION)
    assert not translated[:3].any()
    assert np.isfinite(translated).all()
