"""Which numbers of an observation are fixed by the card itself."""

import pytest

from nw_policies.cards import Card
from nw_scenes.robots import get_robot
from nw_sim.probe.summary import parts_of
from nw_sim.sensors import check_card

GO1 = get_robot("go1")


def fixed(card, history):
    """The terms of a frame of gravity (0:3) and delta_yaw (3:5) that never change."""
    terms = ["gravity", {"term": "delta_yaw", "copies": 2}]
    observation = {"sensor": "proprio", "terms": terms, "history": {"steps": 3} | history}
    plain = card.model_dump(by_alias=True)
    plain |= {"observations": {"past": observation}, "inputs": None}
    made = Card.model_validate(plain)
    return [part.kind for part in parts_of(made, GO1, check_card(made, GO1)) if part.is_fixed]


@pytest.mark.parametrize("by", ["step", "term"])
@pytest.mark.parametrize("start", ["repeat", "zeros"])
def test_numbers_that_read_zero_in_the_past_are_fixed_if_only_the_past_is_seen(
    uncommanded, by, start
):
    past = {"zero": ["3:5"], "current": False, "by": by, "start": start}
    assert fixed(uncommanded, past) == ["delta_yaw"]


@pytest.mark.parametrize(
    "history",
    [{"current": False}, {"zero": ["3:5"]}, {"zero": [3], "current": False}],
    ids=["no zeros", "present frame seen", "one of two"],
)
def test_they_are_not_fixed_if_one_of_them_can_change(uncommanded, history):
    assert fixed(uncommanded, history) == []
