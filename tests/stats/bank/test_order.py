from __future__ import annotations

import numpy as np

from nw_eval.stats.bank import order_of_starts


def order(starts: int = 60, **changes: str) -> list[int]:
    who = {"candidate_digest": "c0ffee", "suite_digest": "5eed", "scene": "hurdles/one"} | changes
    return order_of_starts(starts, **who)


def test_every_start_comes_once_in_an_order_that_never_changes() -> None:
    assert sorted(order()) == list(range(60))
    # Of sha256, and so the same everywhere: a change of it changes what was drawn for a verdict.
    assert order(8) == [3, 6, 5, 1, 7, 4, 2, 0]


def test_candidates_suites_and_scenes_have_orders_of_their_own() -> None:
    changes = [{}, {"candidate_digest": "x"}, {"suite_digest": "x"}, {"scene": "x"}]
    assert len({tuple(order(**change)) for change in changes}) == 4
    # What is hashed cannot be cut in two ways.
    assert order(candidate_digest="a", suite_digest="b/c") != order(
        candidate_digest="a/b", suite_digest="c"
    )


def test_a_larger_bank_keeps_the_order_of_the_starts_that_it_had() -> None:
    assert [start for start in order(90) if start < 60] == order(60)


def test_any_start_is_as_likely_first_as_any_other() -> None:
    firsts = [order(6, candidate_digest=str(number))[0] for number in range(3000)]
    counts = np.bincount(firsts, minlength=6)
    # Mean 500, standard deviation 20.
    assert counts.min() > 420
    assert counts.max() < 580
