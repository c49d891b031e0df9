"""What a gate convicts and passes at true drops: against the published curve, and in itself."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from measured import SEEN
from record_gate_page import CURVE, PICTURE, curve_table, recorded

from nw_eval.stats import SceneCounts
from nw_eval.stats.bank import GateRules, Margins, operating_curve, progress_at, rounds_for
from nw_eval.stats.bank.simulate import chances_of, draw, judge_all, success_of
from nw_eval.stats.courses import ends

BANK = [replace(course, counts=6 * course.counts) for course in SEEN]
RULES = GateRules(tiers=("supporting",) * len(SEEN))
PUBLISHED = {
    # Drop: REGRESSED and PASS in %, mean trials; both errors 5 %, max_drop .10, 60 starts.
    0.0: {0.0: (1, 99, 58), 0.02: (0, 100, 58)},
    0.02: {0.0: (11, 89, 76), 0.02: (2, 98, 84)},
    0.05: {0.0: (57, 43, 93), 0.02: (36, 64, 134)},
    0.10: {0.0: (96, 4, 63), 0.02: (95, 5, 91)},
    0.20: {0.0: (100, 0, 32), 0.02: (100, 0, 37)},
}


def few(counts: list[list[int]], *tiers: str) -> tuple[list[SceneCounts], GateRules]:
    seen = [SceneCounts(counts=np.array(each, dtype=np.int64)) for each in counts]
    return seen, GateRules(tiers=tuple(tiers or ["supporting"] * len(seen)))


@pytest.mark.parametrize("tolerate", [0.0, 0.02])
def test_the_operating_curve_is_near_the_published_one(tolerate: float) -> None:
    rules = replace(RULES, margins=Margins(tolerate=tolerate), alpha_regr=0.05)
    points = operating_curve(SEEN, rules, starts=60, drops=tuple(PUBLISHED))
    for point in points:
        regressed, passed, trials = PUBLISHED[point.drop][tolerate]
        # Two simulations of 1,000: the standard error of a difference is at most 2.2 points. What
        # the published one drew scores from is not known in full, so that more may remain.
        assert 100 * point.regressed == pytest.approx(regressed, abs=6.0), point
        assert 100 * point.passed == pytest.approx(passed, abs=6.0), point
        assert len(SEEN) * point.rounds == pytest.approx(trials, rel=0.12), point
        if point.drop >= 0.10:
            assert point.passed <= 0.05 + 0.021, point
        if point.drop <= tolerate:
            assert point.regressed <= 0.05 + 0.021, point


def test_the_page_prints_the_curve_of_this_code() -> None:
    written = recorded(CURVE)
    found = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in curve_table().split("\n")
    ]
    assert written == [cells for cells in found if len(cells) > 1]
    assert PICTURE.stat().st_size < 100_000


@pytest.mark.parametrize(("tolerate", "passed"), [(0.0, 4.0), (0.02, 5.0)])
def test_a_drop_that_is_the_same_in_all_scenes_passes_as_often_as_was_published(
    tolerate: float, passed: float
) -> None:
    # One factor on all odds spares perfect scenes: 1 to 3 % pass at .10 where 4 and 5 % were
    # published. Where every scene drops by .10, what passes is within the error of simulation.
    drawn = draw(SEEN, starts=60, rounds=20, repetitions=1000)
    mean = success_of(SEEN)
    chances = np.array(
        [
            _chance(len(course.counts) - 1, _success(chance, len(course.counts) - 1) - 0.10)
            for course, chance in zip(SEEN, chances_of(SEEN, mean), strict=True)
        ]
    )
    rules = replace(RULES, margins=Margins(tolerate=tolerate), alpha_regr=0.05)
    ended = judge_all(drawn, chances, rules)
    assert 100 * (ended.passed > 0).mean() == pytest.approx(passed, abs=2.2)


def _success(chance: float, waypoints: int) -> float:
    return float(ends(np.array(chance), waypoints) @ np.linspace(0.0, 1.0, waypoints + 1))


def _chance(waypoints: int, success: float) -> float:
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if _success(middle, waypoints) < success else (low, middle)
    return high


def test_the_same_bank_gives_the_same_curve_and_another_one_other_draws() -> None:
    one, again = (operating_curve(BANK, RULES, drops=(0.05,), repetitions=200) for _ in range(2))
    assert one == again
    other = operating_curve(BANK[::-1], RULES, drops=(0.05,), repetitions=200)
    assert other != one
    assert other[0].regressed == pytest.approx(one[0].regressed, abs=0.15)


def test_a_larger_drop_is_convicted_sooner_and_passed_less_often() -> None:
    points = operating_curve(BANK, RULES, repetitions=300)
    assert [point.drop for point in points][:3] == [0.0, 0.02, 0.04]
    assert points[-1].drop == 0.30
    # Every drop meets the same luck. A scene that is named holds back a PASS no longer, and one
    # that is suspect does: so a worse policy may now and then pass where a better one waits.
    for better, worse in pairwise(points):
        assert worse.regressed >= better.regressed
        assert worse.passed <= better.passed + 0.02
        assert better.undecided >= 0.0
    assert points[-1].rounds < 3 < points[3].rounds


def test_a_bank_that_is_known_and_one_that_is_drawn_from_it_give_nearly_one_curve() -> None:
    known = operating_curve(BANK, RULES, drops=(0.0, 0.06, 0.12))
    drawn = operating_curve(BANK, RULES, drops=(0.0, 0.06, 0.12), starts=60)
    for one, other in zip(known, drawn, strict=True):
        assert one.regressed == pytest.approx(other.regressed, abs=0.1)
        assert one.rounds == pytest.approx(other.rounds, rel=0.2)


def test_the_simulated_policy_has_the_drop_that_was_asked_for() -> None:
    drawn = draw(BANK, starts=None, rounds=20, repetitions=200)
    everybody = np.arange(200)
    assert drawn.baseline.mean() == pytest.approx(success_of(BANK), abs=0.005)
    for drop in (0.0, 0.1, 0.3):
        chances = chances_of(BANK, success_of(BANK) - drop)
        scores = [drawn.scores(chances, number, everybody).mean() for number in range(20)]
        assert success_of(BANK) - np.mean(scores) == pytest.approx(drop, abs=0.005)


def test_starts_are_drawn_once_each() -> None:
    seen, _ = few([[1, 2, 3], [0, 0, 6]])
    drawn = draw(seen, starts=None, rounds=6, repetitions=5)
    assert np.sort(drawn.baseline[..., 0]).sum(axis=1) == pytest.approx([4.0] * 5)
    assert len({tuple(order) for order in drawn.baseline[..., 0].tolist()}) > 1


def test_a_perfect_baseline_has_equals_that_never_fail() -> None:
    seen, rules = few([[0, 0, 30]] * 4)
    (same,) = operating_curve(seen, rules, drops=(0.0,), repetitions=50)
    assert (same.passed, same.regressed) == (1.0, 0.0)


def test_nobody_drops_by_more_than_the_baseline_has() -> None:
    seen, rules = few([[80, 20], [80, 20]])
    assert [point.drop for point in operating_curve(seen, rules, repetitions=20)][-1] == 0.18
    with pytest.raises(ValueError, match="mean success"):
        progress_at(seen, rules, 0.25)


def test_a_critical_scene_convicts_alone() -> None:
    counts = [[30, 30], *[[0, 60]] * 7]
    seen, rules = few(counts)
    _, strict = few(counts, *["supporting"] * 7, "critical")
    chances = np.array([0.5, 1, 1, 1, 1, 1, 1, 0.1])
    drawn = draw(seen, starts=None, rounds=20, repetitions=300)
    lenient, severe = (
        judge_all(drawn, chances, replace(each, margins=Margins(max_drop=0.3, tolerate=0.2)))
        for each in (rules, strict)
    )
    assert (lenient.convicted > 0).mean() < 0.05
    assert (severe.convicted > 0).mean() > 0.9


def test_progress_says_how_many_rounds_convict_a_drop_or_that_none_do() -> None:
    found = progress_at(BANK, RULES, 0.10)
    assert len(found.settled) == 60
    assert list(found.settled) == sorted(found.settled)
    assert found.settled[-1] == pytest.approx(1.0)
    eighty, ninety = (rounds_for(found.regressed, share) for share in (0.8, 0.9))
    assert eighty is not None
    assert ninety is not None
    assert 4 < eighty < ninety < 20
    assert found.regressed[eighty - 1] >= 0.8 > found.regressed[eighty - 2]
    # What lies between the margins passes too often for that.
    small = progress_at(BANK, RULES, 0.05)
    assert rounds_for(small.regressed, 0.8) is None
    assert small.passed[-1] > 0.5


def test_scenes_of_unequal_numbers_of_starts_are_no_bank() -> None:
    seen, rules = few([[0, 10], [0, 12]])
    with pytest.raises(ValueError, match="10 to 12 starts are no bank"):
        operating_curve(seen, rules)


def test_more_rounds_than_starts_are_refused() -> None:
    with pytest.raises(ValueError, match="20 rounds of a bank with 10 starts"):
        operating_curve(SEEN, RULES)
