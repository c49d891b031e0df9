"""Hazards add up to success, and a waypoint is named wrongly no oftener than it may be."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from math import comb

import numpy as np
import pytest

from nw_gate.stats.hazard import (
    differences,
    differences_over,
    first_partings,
    hazards,
    holm,
)
from nw_gate.stats.interval import fisher, newcombe

# Newcombe (1998), Table II, method 10; and statsmodels 0.15.0, confint_proportions_2indep(newcomb).
NEWCOMBE = [
    ((56, 70), (48, 80), (0.052431, 0.333873)),
    ((9, 10), (3, 10), (0.170523, 0.809018)),
    ((6, 7), (2, 7), (0.058228, 0.806250)),
    ((5, 56), (0, 29), (-0.038137, 0.192560)),
    ((0, 10), (0, 20), (-0.161125, 0.277533)),
    ((10, 10), (0, 20), (0.679086, 1.0)),
    ((10, 10), (0, 10), (0.607509, 1.0)),
]
# scipy 1.17.1, fisher_exact.
FISHER = [
    ((8, 10), (1, 6), 0.034965034965034975),
    ((10, 10), (5, 10), 0.032507739938080496),
    ((3, 10), (3, 10), 1.0),
    ((0, 10), (0, 12), 1.0),
    ((60, 60), (2, 5), 0.0002289377289377289),
    ((12, 17), (7, 20), 0.04885311168621127),
]


@pytest.mark.parametrize(("larger", "smaller", "expected"), NEWCOMBE)
def test_the_interval_of_a_difference_is_newcombes(larger, smaller, expected):
    assert newcombe(smaller, larger) == pytest.approx(expected, abs=1e-6)
    low, high = newcombe(larger, smaller)
    assert (-high, -low) == pytest.approx(expected, abs=1e-6)


def test_without_trials_a_share_may_be_anything():
    assert newcombe((0, 0), (0, 0)) == (-1.0, 1.0)
    low, high = newcombe((0, 0), (10, 10))
    assert low < 0.0
    assert high == 1.0


@pytest.mark.parametrize(("first", "second", "expected"), FISHER)
def test_fishers_test_is_scipys(first, second, expected):
    assert fisher((first, second)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (3, 5), (4, 4), (6, 2)])
def test_fishers_test_errs_no_oftener_than_it_says_whatever_the_share(n, m):
    tables = [(x, y, fisher(((x, n), (y, m)))) for x in range(n + 1) for y in range(m + 1)]
    for share in (Fraction(1, 20), Fraction(3, 10), Fraction(1, 2)):
        for level in sorted({p for _, _, p in tables}):
            refuted = sum(
                comb(n, x) * comb(m, y) * share ** (x + y) * (1 - share) ** (n + m - x - y)
                for x, y, p in tables
                if p <= level
            )
            assert refuted <= level + 1e-12


def test_with_strata_fishers_test_is_the_sum_over_all_their_tables():
    strata = [((3, 4), (1, 5)), ((2, 2), (3, 6)), ((0, 3), (2, 3))]
    likelihood = {0: Fraction(1)}
    for (x, n), (y, m) in strata:
        tables = {
            k: Fraction(comb(n, k) * comb(m, x + y - k), comb(n + m, x + y))
            for k in range(n + 1)
            if 0 <= x + y - k <= m
        }
        likelihood = {
            total: sum(p * tables.get(total - before, 0) for before, p in likelihood.items())
            for total in range(1 + sum(n for (_, n), _ in strata))
        }
    seen = sum(x for (x, _), _ in strata)
    expected = sum(p for p in likelihood.values() if p <= likelihood[seen])
    assert fisher(*strata) == pytest.approx(float(expected), rel=1e-12)


def test_a_hard_scene_that_one_met_more_often_is_no_difference_between_policies():
    # Misses of the first waypoint: all in the hard scene, none in the easy one, for both.
    scenes = [([9, 1], [0, 0]), ([0, 2], [0, 20])]
    (over,) = differences_over([([9, 0], [1, 0]), ([0, 1], [0, 9])])
    assert over.p == 1.0
    assert (over.first.failed, over.first.trials) == (9, 10)
    assert (over.second.failed, over.second.trials) == (1, 10)
    assert fisher(((9, 10), (1, 10))) < 0.01
    assert differences_over(scenes[:1]) == differences(*scenes[0])


def test_over_scenes_of_other_lengths_those_that_are_longer_speak_of_their_ends():
    _, second = differences_over([([0, 5], [0, 5]), ([0, 5, 1], [0, 0, 6])])
    assert (second.waypoint, second.first.trials, second.first.failed) == (2, 6, 5)
    assert second.p == differences([0, 5, 1], [0, 0, 6])[1].p


@pytest.mark.parametrize("counts", [((3, 2), (0, 1)), ((-1, 2), (0, 1)), ((1, 2), (2, 1))])
def test_counts_that_cannot_be_are_refused(counts):
    with pytest.raises(ValueError, match="successes of"):
        fisher(counts)


def test_hazards_are_the_shares_of_those_that_came_so_far():
    first, second, third = hazards([2, 0, 3, 5])
    assert (first.waypoint, first.trials, first.failed, first.share) == (1, 10, 2, 0.2)
    assert (second.trials, second.failed, second.share) == (8, 0, 0.0)
    assert (third.trials, third.failed, third.share) == (8, 3, 0.375)
    assert third.interval.low < 0.375 < third.interval.high


def test_mean_success_is_what_the_hazards_make_it():
    ends = [4, 1, 0, 7, 3, 9]
    left, reached = 1.0, 0.0
    for hazard in hazards(ends):
        left *= 1.0 - hazard.share
        reached += left
    mean = sum(k * count for k, count in enumerate(ends)) / sum(ends)
    assert reached == pytest.approx(mean)


def test_where_nobody_came_there_is_no_hazard_and_nothing_is_known():
    _, second = hazards([4, 0, 0])
    assert second.share is None
    assert second.interval == (0.0, 1.0)
    assert differences([4, 0, 0], [0, 2, 2])[1].p == 1.0


@pytest.mark.parametrize("ends", [[], [3], [3, -1]])
def test_ends_that_are_none_are_refused(ends):
    with pytest.raises(ValueError, match="are not numbers of trials"):
        hazards(ends)


def test_scenes_of_different_length_are_not_compared():
    with pytest.raises(ValueError, match="2 waypoints cannot be compared with 1"):
        differences([0, 0, 4], [0, 4])


def first_parting(first, second, error=0.05):
    """Return where two policies part in the only scene that is looked at."""
    return first_partings({0: (first, second)}, error).get(0)


def test_the_first_parting_is_where_the_trouble_is_not_where_fewer_arrive():
    # Both lose half at waypoint 3; the second also loses most at waypoint 2.
    parting = first_parting([0, 0, 10, 10], [0, 17, 2, 1])
    assert parting is not None
    assert parting.waypoint == 2
    assert (parting.first.failed, parting.first.trials) == (0, 20)
    assert (parting.second.failed, parting.second.trials) == (17, 20)
    assert parting.compared == 3
    assert parting.adjusted_p == pytest.approx(3 * parting.p)
    assert parting.interval.low > 0.5


def test_a_better_policy_parts_too_and_the_difference_has_its_sign():
    parting = first_parting([0, 17, 2, 1], [0, 0, 10, 10])
    assert parting is not None
    assert parting.interval.high < -0.5


def test_what_one_look_would_show_many_looks_do_not():
    pair = ([0, 10], [5, 5])  # Fisher's p is .0325.
    assert first_parting(*pair) is not None
    assert (
        first_partings({scene: pair if scene == 0 else ([0, 10], [0, 10]) for scene in (0, 1)})
        == {}
    )


def test_a_few_trials_against_a_baseline_of_many_can_part():
    parting = first_parting([0, 0, 0, 60], [0, 3, 0, 2])
    assert parting is not None
    assert parting.waypoint == 2


def test_holm_adjusts_as_the_paper_does():
    # Worked by hand: .01 x 4, .02 x 3, then .03 x 2 = .06 is no less than .06, .04 x 1 below it.
    assert holm([0.04, 0.01, 0.03, 0.02]) == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert holm([]) == ()


def test_equal_policies_are_told_apart_no_oftener_than_the_error_by_enumeration():
    """Every outcome of four trials each over two waypoints, with its probability."""
    ways = {(a, b): p for a, b, p in _ends(4, (0.3, 0.5))}
    for error in (0.05, 0.2, 0.5):
        wrong = sum(
            ways[one] * ways[two]
            for one, two in product(ways, repeat=2)
            if first_parting(_whole(one, 4), _whole(two, 4), error)
        )
        assert wrong <= error


def _ends(n, chances):
    """Each number of trials that end at waypoint 1 and at 2, with its probability."""
    first, second = chances
    for a in range(n + 1):
        for b in range(n - a + 1):
            p = comb(n, a) * first**a * (1 - first) ** (n - a)
            yield a, b, p * comb(n - a, b) * second**b * (1 - second) ** (n - a - b)


def _whole(ends, n):
    return [*ends, n - sum(ends)]


@pytest.mark.nightly
@pytest.mark.parametrize("chances", [(0.02,) * 5, (0.1,) * 5, (0.02, 0.3, 0.02, 0.02, 0.3)])
def test_sixteen_scenes_of_equal_policies_are_parted_in_at_most_one_suite_of_twenty(chances):
    """Simulated 2,000 times with ten trials each: wrong 0, 0 and 1 time (nominal 100).

    Fisher's test is discrete: among ten trials with few failures it cannot err as often as it may,
    and Holm's procedure counts waypoints at which it cannot err at all.
    """
    rng = np.random.default_rng(12)
    wrong = 0
    for _ in range(2000):
        pairs = {scene: (_draw(rng, chances), _draw(rng, chances)) for scene in range(16)}
        wrong += bool(first_partings(pairs))
    assert wrong / 2000 <= 0.05


def _draw(rng, chances):
    left, ends = 10, []
    for chance in chances:
        ends.append(int(rng.binomial(left, chance)))
        left -= ends[-1]
    return [*ends, left]
