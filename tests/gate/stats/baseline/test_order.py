from __future__ import annotations

import numpy as np

from nw_gate.stats.baseline.trials import order_of_starts, order_of_trials


def order(starts: int = 60, **changes: str) -> list[int]:
    who = {"candidate_digest": "c0ffee", "suite_digest": "5eed", "scene": "hurdles/one"} | changes
    return order_of_starts(starts, **who)


def test_every_start_comes_once_in_an_order_that_never_changes():
    assert sorted(order()) == list(range(60))
    # Of sha256, and so the same everywhere: a change of it changes what was drawn for a verdict.
    assert order(8) == [3, 6, 5, 1, 7, 4, 2, 0]


def test_candidates_suites_and_scenes_have_orders_of_their_own():
    changes = [{}, {"candidate_digest": "x"}, {"suite_digest": "x"}, {"scene": "x"}]
    assert len({tuple(order(**change)) for change in changes}) == 4
    # What is hashed cannot be cut in two ways.
    assert order(candidate_digest="a", suite_digest="b/c") != order(
        candidate_digest="a/b", suite_digest="c"
    )


def test_a_larger_baseline_keeps_the_order_of_the_starts_that_it_had():
    assert [start for start in order(90) if start < 60] == order(60)


def test_any_start_is_as_likely_first_as_any_other():
    firsts = [order(6, candidate_digest=str(number))[0] for number in range(3000)]
    counts = np.bincount(firsts, minlength=6)
    # Mean 500, standard deviation 20.
    assert counts.min() > 420
    assert counts.max() < 580


def all_trials(starts: int, candidate: str = "candidate", scenes: str = "abcd"):
    return order_of_trials(list(scenes), starts, candidate_digest=candidate, suite_digest="suite")


def test_all_pairs_of_a_scene_and_a_start_come_once_and_scenes_in_no_fixed_order():
    drawn = all_trials(50)
    assert sorted(drawn) == [(scene, start) for scene in range(4) for start in range(50)]
    first = [all_trials(50, f"candidate {number}")[0] for number in range(400)]
    counts = [sum(scene == place for place, _ in first) for scene in range(4)]
    assert max(abs(count - 100) for count in counts) < 40  # Four and a half standard deviations.
    assert len({start for _, start in first}) > 45
    # Nor is a round of the scenes hidden in it.
    assert sum(len({scene for scene, _ in drawn[i : i + 4]}) == 4 for i in range(0, 200, 4)) < 20


def test_each_scene_meets_its_starts_in_the_order_that_it_has_alone():
    drawn = all_trials(50)
    for place, scene in enumerate("abcd"):
        alone = order_of_starts(50, candidate_digest="candidate", suite_digest="suite", scene=scene)
        assert [start for where, start in drawn if where == place] == alone


def test_scenes_left_out_and_starts_added_do_not_change_the_order_of_the_others():
    drawn = all_trials(50)
    assert all_trials(50, scenes="abc") == [pair for pair in drawn if pair[0] < 3]
    assert all_trials(20) == [pair for pair in drawn if pair[1] < 20]
