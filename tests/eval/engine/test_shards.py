"""Parts of a plan: every trial in one of them, of any stretch as many as in any other."""

from itertools import permutations
from random import Random
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nw_base.errors import UsageError
from nw_eval.engine.order import in_order, plan_digest, shard_of, shards_of
from nw_eval.suite import expand, new_suite
from nw_gate.results.request import Request, Shard


def plan(scenes=3, rounds=4, frictions=(), seed=1, lot=None):
    suite = new_suite(
        {
            "nw-eval": 1,
            "name": "s",
            "robot": "go1",
            "policy": "stand",
            "trials": rounds,
            "seed": seed,
            "scenes": ["*"],
            "perturb": {"friction": frictions},
        }
    )
    places = [
        SimpleNamespace(name=f"p/{k}", task="flat", digest=f"{k:02d}" * 32) for k in range(scenes)
    ]
    if lot is None:
        return expand(suite, places)
    # As against a baseline: all pairs of a scene and a start in random order, as many of them.
    pairs = [
        (place.name, cell, start)
        for place in places
        for cell in suite.perturb.cells
        for start in range(9)
    ]
    Random(lot).shuffle(pairs)
    return expand(suite, places, pairs[: rounds * len(places) * len(suite.perturb.cells)])


@given(
    scenes=st.integers(1, 9),
    rounds=st.integers(1, 7),
    cells=st.integers(0, 3),
    seed=st.integers(0, 99),
    data=st.data(),
)
def test_every_trial_is_in_one_part_and_every_round_is_shared_evenly(
    scenes, rounds, cells, seed, data
):
    trials = plan(scenes, rounds, tuple(0.4 + 0.1 * k for k in range(cells)), seed)
    count = data.draw(st.integers(1, len(trials)))
    parts = [part for part, _ in shards_of(trials, count)]
    assert sorted(t.id for part in parts for t in part) == sorted(t.id for t in trials)
    sizes = [len(part) for part in parts]
    assert max(sizes) - min(sizes) <= 1
    for number in range(rounds):
        here = [sum(trial.index == number for trial in part) for part in parts]
        assert max(here) - min(here) <= 1


@given(rounds=st.integers(1, 4), count=st.integers(1, 3), data=st.data())
def test_a_part_does_not_depend_on_how_trials_are_listed_or_on_rounds_that_come_later(
    rounds, count, data
):
    trials = plan(rounds=rounds)
    shard = Shard(index=data.draw(st.integers(1, count)), count=count)
    listed = data.draw(st.permutations(trials))
    part, info = shard_of(listed, shard)
    assert (part, info) == shard_of(trials, shard)
    assert (part, info) == shards_of(trials, count)[shard.index - 1]
    more, later = shard_of(plan(rounds=rounds + 2), shard)
    assert {t.id for t in part} == {t.id for t in more if t.index < rounds}
    assert later.plan != info.plan, "it is a part of another plan"


@given(
    rounds=st.integers(1, 5),
    cells=st.integers(0, 2),
    lot=st.integers(0, 99),
    count=st.integers(1, 5),
    data=st.data(),
)
def test_parts_of_a_drawn_order_share_out_every_stretch_of_it_evenly(
    rounds, cells, lot, count, data
):
    frictions = tuple(0.4 + 0.1 * k for k in range(cells))
    trials = plan(5, rounds, frictions, lot=lot)
    parts = [part for part, _ in shards_of(data.draw(st.permutations(trials)), count)]
    for number, part in enumerate(parts):
        assert [trial.place for trial in part] == [*range(number, len(trials), count)]
        assert list(part) == list(trials[number::count])
    more = [part for part, _ in shards_of(plan(5, rounds + 1, frictions, lot=lot), count)]
    for part, longer in zip(parts, more, strict=True):
        assert [t.id for t in longer[: len(part)]] == [t.id for t in part], "others come behind"


def test_no_part_has_one_scene_alone_where_another_order_would_give_it_that():
    # Round robin over scenes as they are listed: with as many parts as scenes each has its own.
    parts = [part for part, _ in shards_of(plan(scenes=4, rounds=8), 4)]
    assert all(len({trial.scene for trial in part}) > 1 for part in parts)


def test_a_plan_is_known_by_its_trials_and_by_nothing_else():
    same = {plan_digest(in_order(listed)) for listed in permutations(plan(scenes=2, rounds=2))}
    assert len(same) == 1
    others = [plan(2, 3), plan(3, 2), plan(2, 2, (0.5,)), plan(2, 2, seed=2), plan(2, 2, (), 1)]
    digests = [plan_digest(in_order(trials)) for trials in others]
    assert digests[-1] in same
    assert len({*digests, *same}) == 5


def test_a_plan_in_another_drawn_order_is_another_plan():
    order = plan(2, 9, lot=1)
    same = {plan_digest(in_order(listed)) for listed in (order, order[::-1])}
    assert same == {plan_digest(order)}
    shuffled = plan(2, 9, lot=2)
    assert {trial.id for trial in shuffled} == {trial.id for trial in order}
    assert plan_digest(shuffled) not in same | {plan_digest(in_order(plan(2, 9)))}


NO_PARTS = ("0/3", "4/3", "1", "1/0", "-1/2", "1/2/3", "a/b", " 1/2", "", "1/1000000000")


@pytest.mark.parametrize("words", NO_PARTS)
def test_words_that_name_no_part_are_refused(words):
    with pytest.raises(UsageError, match="give I/N, such as 1/3, with I from 1 to N"):
        Request.of("smoke", shard=words)


def test_a_part_without_a_trial_is_refused():
    trials = plan(scenes=2, rounds=1)
    assert shard_of(trials, None) == (trials, None)
    with pytest.raises(UsageError, match="--shard 3/3: there is nothing in it, the run has 2 tri"):
        shard_of(trials, Shard(index=3, count=3))
    for count in (0, 3):
        with pytest.raises(UsageError, match="give a number from 1 to 2"):
            shards_of(trials, count)
