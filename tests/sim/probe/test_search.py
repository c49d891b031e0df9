"""Which other cards are told: those under which a policy measurably does better than it did."""

import pytest

from nw_base.errors import PolicyError
from nw_scenes.robots import get_robot
from nw_sim.probe.findings import attempts
from nw_sim.probe.following import follow, motions, own_way

GO1 = get_robot("go1")


@pytest.fixture
def tried(rig_that_says):
    """Return the attempts on a hand-made rig, each better than those before."""

    def tried(card, walk, *, thorough=True):
        rig = rig_that_says(walk)
        written = list(follow(rig, card, motions(card) or own_way(card)))
        return list(attempts(rig, card, GO1, written, thorough=thorough))

    return tried


def words(tried):
    return [one.hypothesis.words for one in tried]


def hips_of(card):
    scale = card.control.scale
    return scale.get("hip") if isinstance(scale, dict) else scale


@pytest.fixture
def with_halved_hips(commanded, obeys):
    """Return a maker of walks: shares of commands as written, and others with half the hips."""

    def make(shares, otherwise, **more):
        def walk(card, _):
            is_other = card.observations == commanded.observations and hips_of(card) == 0.25
            return obeys(card, shares, **more) if is_other else obeys(card, otherwise)

        return walk

    return make


@pytest.mark.parametrize(
    ("shares", "helps", "mends"),
    [
        ((0.95, 0.95, 0.95), True, True),
        ((0.61, 0.7, 0.7), True, True),  # No more than some reach under their own cards.
        ((0.59, 1.0, 1.0), True, False),
        ((1.0, 1.7, 1.0), True, False),
        ((0.5, 0.37, 0.5), True, False),
        ((0.38, 0.38, 0.38), False, False),
    ],
    ids=str,
)
def test_the_best_is_told_by_how_much_it_helps(
    commanded, tried, with_halved_hips, shares, helps, mends
):
    (best,) = tried(commanded, with_halved_hips(shares, (0.3, 0.3, 0.3)))
    assert best.hypothesis.words == "the scale of the hips halved"
    assert (best.helps, best.mends) == (helps, mends)
    assert best.figures.startswith(f"ahead {shares[0]:.2f} (was 0.30), to the left {shares[1]:.2f}")


@pytest.mark.parametrize(("before", "helps"), [(0.59, True), (0.61, False)])
def test_a_command_that_is_missed_no_longer_helps_by_itself(
    commanded, tried, with_halved_hips, before, helps
):
    (best,) = tried(commanded, with_halved_hips((0.68, 1.0, 1.0), (before, 0.95, 0.95)))
    assert (best.helps, best.mends) == (helps, helps)


def test_a_card_that_is_no_better_is_not_told(commanded, obeys, tried):
    assert tried(commanded, lambda card, _: obeys(card, (0.3, 0.3, 0.3))) == []
    assert tried(commanded, lambda card, _: obeys(card, outcome="fell")) == []


@pytest.mark.parametrize(
    ("changes", "is_told"),
    [({}, True), ({"tilt": 0.31}, False), ({"outcome": "fell"}, False)],
    ids=str,
)
def test_who_stumbles_under_the_first_command_is_given_up(
    commanded, tried, with_halved_hips, changes, is_told
):
    found = tried(commanded, with_halved_hips((1.0, 1.0, 1.0), (0.1, 0.1, 0.1), **changes))
    assert len(found) == is_told


def test_a_card_under_which_it_falls_in_one_turn_helps_and_does_not_mend(commanded, obeys, tried):
    def walk(card, _):
        if hips_of(card) != 0.25:
            return obeys(card, (0.1, 0.1, 0.1))
        turns = card.command.source == "constant" and card.command.velocity[2] < 0.0
        return obeys(card, outcome="fell" if turns else None)

    *_, best = tried(commanded, walk)
    assert best.helps
    assert not best.mends
    assert best.figures.endswith("turning right 1.00 and fell (was 0.10)")


def test_without_commands_it_has_to_get_ahead(uncommanded, walked, tried):
    def walk(card, _):
        return walked((0.7 if hips_of(card) == 0.125 else 0.1, 0.0, 0.0))

    (best,) = tried(uncommanded, walk)
    assert best.figures == "on its way 0.87 (was 0.12)"
    assert best.mends


def test_a_likelier_change_is_told_unless_another_is_clearly_better(commanded, obeys, tried):
    def walk(better):
        shares = {1.0: 0.88, 0.25: better}
        return lambda card, _: obeys(card, [shares.get(hips_of(card), 0.2)] * 3)

    doubled, halved = "the scale of the hips doubled", "the scale of the hips halved"
    assert words(tried(commanded, walk(0.9))) == [doubled]
    assert words(tried(commanded, walk(0.96))) == [doubled, halved]


def test_an_order_of_frames_by_term_needs_more_than_to_be_no_worse(commanded, obeys, tried):
    plain = commanded.model_dump(by_alias=True)
    plain["observations"]["obs"]["history"] = {"steps": 6}
    card = type(commanded).model_validate(plain)

    def walk(other, _):
        is_by_term = other.observations["obs"].history.by == "term"
        return obeys(other, [0.9 if is_by_term or hips_of(other) == 0.25 else 0.3] * 3)

    assert words(tried(card, walk)) == ["the scale of the hips halved"]


def test_only_scales_are_tried_where_it_follows_but_weakly(commanded, obeys, tried):
    def walk(card, _):
        is_other = card.observations != commanded.observations or hips_of(card) == 0.25
        return obeys(card, [1.0 if is_other else 0.7] * 3)

    found = tried(commanded, walk, thorough=False)
    assert words(found) == ["the scale of the hips halved"]
    assert found[-1].helps


def test_an_order_of_joints_and_scales_are_found_together(commanded, obeys, tried):
    def walk(card, _):
        is_ordered = card.control.joints is not None and card.control.joints[0] == "FL_hip"
        scales = {term.term: term.scale for term in card.observations["obs"].terms}
        is_scaled = (scales["ang_vel"], scales["joint_vel"]) == (0.25, 1.0)
        return obeys(card, outcome=None if is_ordered and is_scaled else "fell")

    assert words(tried(commanded, walk)) == [
        "the joints in the order FL FR RL RR, leg by leg, and the scale of `ang_vel` 0.25"
    ]


def test_cards_that_cannot_be_run_are_passed_over(commanded, obeys, tried):
    def walk(card, _):
        if card.observations != commanded.observations:
            raise PolicyError("no such terms")
        return obeys(card, [0.3 if card.control == commanded.control else 1.0] * 3)

    assert words(tried(commanded, walk)) == [
        "the joints in the order FR FL RR RL, all hips, then all thighs, then all calves"
    ]
