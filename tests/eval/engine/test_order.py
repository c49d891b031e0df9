"""The order of a run."""

import random
from collections import Counter
from dataclasses import replace

import pytest

from nw_base.trials import Trial
from nw_eval.engine.order import in_order, next_place


def trials(scenes=5, count=4, suite_digest="a"):
    return [
        Trial(
            suite="s",
            suite_digest=suite_digest,
            suite_seed=1,
            scene=f"hurdles/{k}",
            scene_digest=f"{k}",
            task="hurdles",
            index=index,
        )
        for k in range(scenes)
        for index in range(count)
    ]


def test_a_run_that_is_cut_short_has_met_every_scene_about_equally_often():
    ordered = in_order(trials())
    for cut in range(1, 20):
        met = Counter(trial.scene for trial in ordered[:cut])
        counts = [met[f"hurdles/{k}"] for k in range(5)]
        assert max(counts) - min(counts) <= 1


def test_the_order_does_not_depend_on_how_trials_are_listed():
    listed = trials()
    assert in_order(reversed(listed)) == in_order(listed)


def test_rounds_and_suites_meet_the_scenes_in_different_orders():
    rounds = [tuple(t.scene for t in in_order(trials())[k : k + 5]) for k in (0, 5, 10, 15)]
    assert len(set(rounds)) > 1
    other = [trial.scene for trial in in_order(trials(suite_digest="b"))]
    assert other != [trial.scene for trial in in_order(trials())]


def test_more_trials_per_scene_leave_the_earlier_ones_where_they_were():
    few, many = in_order(trials(count=2)), in_order(trials(count=6))
    assert many[: len(few)] == few


def test_workers_share_the_scenes_out_and_meet_them_in_rounds():
    waiting = list(in_order(trials(scenes=6, count=4)))
    own, met = [set(), set()], Counter()
    loads = 0
    while waiting:
        # One worker is twice as fast as the other.
        for scenes in (own[0], own[0], own[1]):
            trial = waiting.pop(next_place(waiting, own=scenes, taken=own[0] | own[1]))
            loads += trial.scene not in scenes
            scenes.add(trial.scene)
            met[trial.scene] += 1
            assert max(met.values()) - min(met[f"hurdles/{k}"] for k in range(6)) <= 1
    # Each scene once, and again where the fast one helps out; it would be 12 without a choice.
    assert loads < 12
    assert set(met.values()) == {4}


def test_a_lone_worker_takes_trials_in_their_order():
    waiting, own, taken = list(in_order(trials())), set(), []
    while waiting:
        taken.append(waiting.pop(next_place(waiting, own=own, taken=own)))
        own.add(taken[-1].scene)
    assert [trial.index for trial in taken] == [trial.index for trial in in_order(trials())]


def test_two_workers_of_one_speed_load_each_scene_once():
    waiting = list(in_order(trials(scenes=6, count=4)))
    own = [set(), set()]
    while waiting:
        for scenes in own:
            scenes.add(waiting.pop(next_place(waiting, own=scenes, taken=own[0] | own[1])).scene)
    assert len(own[0]) == len(own[1]) == 3
    assert not own[0] & own[1]


def drawn(**counts):
    """Return trials in a drawn order."""
    listed = trials(**counts)
    random.Random(4).shuffle(listed)
    return [replace(trial, place=place) for place, trial in enumerate(listed)]


def test_a_drawn_order_is_kept_whatever_the_trials_are():
    ordered = drawn()
    assert list(in_order(reversed(ordered))) == ordered
    indexes = [trial.index for trial in ordered]
    assert indexes != sorted(indexes), "not round by round"
    swapped = [replace(trial, place=len(ordered) - 1 - trial.place) for trial in ordered]
    assert [trial.id for trial in in_order(swapped)] == [trial.id for trial in reversed(ordered)]


@pytest.mark.parametrize("gone", [0, 7])
def test_a_worker_chooses_among_the_next_sixteen_of_a_drawn_order(gone):
    scenes = [f"hurdles/{k}" for k in range(40)]
    ordered = [
        replace(trial, scene=scene, place=place)
        for place, (trial, scene) in enumerate(zip(drawn(scenes=10), scenes, strict=True))
    ]
    waiting = ordered[gone:]
    for offset in (1, 15):
        own = {waiting[offset].scene, waiting[16].scene}
        assert next_place(waiting, own=own, taken=set()) == offset
    assert next_place(waiting, own={waiting[16].scene}, taken=own) == 0, "not the seventeenth"
    # Places count, not how many wait: some in between have been taken.
    assert next_place([waiting[0], *waiting[16:]], own={waiting[16].scene}, taken=set()) == 0


def test_a_worker_of_a_drawn_order_prefers_its_own_scenes_then_those_of_nobody():
    waiting = drawn(scenes=5)[:16]
    scenes = [trial.scene for trial in waiting]
    *loaded, own, free = dict.fromkeys(scenes)
    assert next_place(waiting, own={own}, taken={*loaded, own}) == scenes.index(own)
    assert next_place(waiting, own=set(), taken={*loaded, own}) == scenes.index(free)
    assert next_place(waiting, own=set(), taken={*scenes}) == 0
