"""Which changes of a card are told: only those with which a policy walks and follows."""

import pytest

from nw_eval.errors import PolicyError
from nw_eval.robots import get_robot
from nw_eval.rollout.probe.following import Followed, motions
from nw_eval.rollout.probe.search import better_cards

GO1 = get_robot("go1")


@pytest.fixture
def told(stage_on_which):
    """Return the words of what is told of a card on a hand-made stage."""

    def told(card, walk, missed=()):
        return [better.words for better in better_cards(stage_on_which(walk), card, GO1, missed)]

    return told


def missed(card):
    return [Followed(motion=motions(card)[0], ratio=0.4, fell=False)]


@pytest.mark.parametrize(
    ("shares", "is_told"),
    [
        ((0.76, 0.76, 0.76), True),
        ((1.29, 1.29, 1.29), True),
        ((0.74, 1.0, 1.0), False),
        ((1.0, 1.31, 1.0), False),
        ((0.5, 0.37, 3.0), False),  # As a right card whose speed is too high did with another.
    ],
    ids=str,
)
@pytest.mark.parametrize("stumbles", [True, False], ids=["stumbles", "misses"])
def test_a_card_is_told_only_if_every_command_is_followed_with_it(
    commanded, obeys, told, shares, is_told, stumbles
):
    first = told(
        commanded, lambda card, _: obeys(card, shares), () if stumbles else missed(commanded)
    )
    # All are equally good here, so only the first one is told.
    assert len(first) == is_told


@pytest.mark.parametrize(
    ("changes", "is_told"),
    [
        ({}, True),
        ({"tilt": 0.21}, False),
        ({"outcome": "fell"}, False),
        ({"outcome": "collided"}, False),
        ({"travelled": 0.2}, False),
    ],
    ids=str,
)
def test_without_commands_it_has_to_get_ahead_level(uncommanded, walked, told, changes, is_told):
    assert len(told(uncommanded, lambda *_: walked(**changes))) == is_told


@pytest.mark.parametrize("changes", [{"tilt": 0.21}, {"outcome": "fell"}], ids=str)
def test_with_commands_it_has_to_walk_level_too(commanded, obeys, told, changes):
    assert told(commanded, lambda card, _: obeys(card, **changes)) == []


def test_a_fall_under_any_command_rules_a_card_out(commanded, obeys, told):
    def walk(card, _):
        turns = card.command.source == "constant" and card.command.velocity[2] < 0.0
        return obeys(card, outcome="fell" if turns else None)

    assert told(commanded, walk) == []
    assert told(commanded, walk, missed(commanded)) == []


def test_only_better_ones_follow_and_the_best_comes_last(commanded, obeys, told):
    def walk(card, _):
        scale = card.control.scale
        hips = scale.get("hip") if isinstance(scale, dict) else scale
        return obeys(card, [{0.25: 0.95, 1.0: 0.9, 0.5: 0.8}.get(hips, 0.1)] * 3)

    assert told(commanded, walk, missed(commanded)) == [
        "the scale of `lin_vel` 2",
        "the scale of the hips doubled",
        "the scale of the hips halved",
    ]


def test_cards_that_cannot_be_run_are_passed_over(commanded, obeys, told):
    def walk(card, _):
        if card.observations != commanded.observations:
            raise PolicyError("no such terms")
        return obeys(card)

    assert told(commanded, walk) == [
        "the joints in the order FR FL RR RL, all hips, then all thighs, then all calves"
    ]
