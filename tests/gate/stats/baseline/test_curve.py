"""What a gate convicts and passes at true drops: against recorded gates, and in itself."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from gate_cells import ALL, HURDLES, baseline_of, recorded_cells
from measured import SEEN
from record_gate_page import (
    BOUND,
    CURVE,
    ERRORS,
    PICTURE,
    POWER,
    bound_table,
    cells_of,
    curve,
    curve_table,
    error_table,
    outset,
    power_table,
    recorded,
)

from nw_gate.stats.baseline.curve import (
    chances_of,
    draw,
    operating_curve,
    progress_at,
    success_of,
    trials_for,
)
from nw_gate.stats.baseline.evidence import Margins
from nw_gate.stats.baseline.trials import TrialRules, settle_all
from nw_gate.stats.power import SceneCounts

REFERENCE = [replace(course, counts=6 * course.counts) for course in SEEN]
RULES = TrialRules(tiers=("supporting",) * len(SEEN))
BUDGET = 20 * len(SEEN)


def few(counts: list[list[int]], *tiers: str) -> tuple[list[SceneCounts], TrialRules]:
    seen = [SceneCounts(counts=np.array(each, dtype=np.int64)) for each in counts]
    return seen, TrialRules(tiers=tuple(tiers or ["supporting"] * len(seen)))


@pytest.mark.parametrize("baseline", [HURDLES, ALL])
@pytest.mark.parametrize("against", ["fresh", "panel", "control"])
def test_the_operating_curve_is_near_the_gates_that_were_recorded(baseline, against):
    # Those draw scores from the starts of the baseline, with a fall that is the same for all
    # waypoints and not for their odds: shares may differ by more than two simulations do, which is
    # 3 points.
    cells = {
        cell.drop: found
        for cell, found in recorded_cells()
        if (cell.question, cell.kind, cell.alpha_regr) == ("power", "harder", 0.01)
        and (cell.baseline, cell.claim) == (baseline, against)
    }
    start = outset(baseline_of(baseline))
    tiers = ("supporting",) * start.scenes
    if against == "fresh" and start.rules.tiers == tiers:  # As on the page.
        points = [point for point in curve(baseline_of(baseline)) if point.drop in cells]
    else:
        rules, drops = replace(start.rules, tiers=tiers), tuple(cells)
        points = operating_curve(
            start.seen, rules, budget=start.budget, drops=drops, against=against
        )
    assert [point.drop for point in points] == [0.0, 0.05, 0.1, 0.2]
    for point in points:
        found, arms = cells[point.drop], 2 if against == "control" else 1
        # One point is further off, as docs/concepts/power.md says.
        worst = (baseline, against, point.drop) == (HURDLES, "panel", 0.05)
        assert 100 * point.regressed == pytest.approx(found.regressed, abs=8.0), point
        assert 100 * point.passed == pytest.approx(found.passed, abs=10.5 if worst else 8.0), point
        assert arms * point.trials == pytest.approx(found.trials, rel=0.25), point
        if point.drop >= 0.10:
            assert point.passed <= 0.05 + 0.021, point
        if point.drop == 0.0:
            assert point.regressed <= 0.01 + 0.01, point


def test_the_page_prints_the_curve_of_this_code():
    assert recorded(CURVE) == cells_of(curve_table())
    assert recorded(BOUND) == cells_of(bound_table())
    assert PICTURE.stat().st_size < 100_000


def test_the_page_sums_up_the_recorded_gates():
    assert recorded(ERRORS) == cells_of(error_table())
    assert recorded(POWER) == cells_of(power_table())


def test_one_scene_of_sixteen_that_falls_to_half_passes_or_convicts_as_the_page_says():
    start, scene = outset(baseline_of(HURDLES)), 14
    drawn = draw(
        start.seen,
        starts=None,
        budget=start.budget,
        repetitions=2000,
        margins=start.rules.margins,
    )
    chances = chances_of(start.seen, start.baseline)
    # From 1 to .5, in three waypoints: p + p^2 + p^3 = 1.5.
    assert start.seen[scene].counts.tolist() == [0, 0, 0, 60]
    chances[scene] = 0.691
    trials = drawn.trials(chances)
    assert trials.candidate[trials.scenes == scene].mean() == pytest.approx(0.5, abs=0.01)
    tiers = ["supporting"] * 16
    decisions = settle_all(drawn.reference, trials, TrialRules(tiers=tuple(tiers)))
    assert np.mean([decision.word == "PASS" for decision in decisions]) == pytest.approx(
        0.91, abs=0.02
    )
    assert np.mean([scene in decision.named for decision in decisions]) == pytest.approx(
        0.50, abs=0.03
    )
    assert np.mean([decision.trials for decision in decisions]) == pytest.approx(118, rel=0.03)
    tiers[scene] = "critical"
    decisions = settle_all(drawn.reference, trials, TrialRules(tiers=tuple(tiers)))
    flagged = np.mean([decision.word == "REGRESSED" for decision in decisions])
    assert flagged == pytest.approx(0.66, abs=0.03)


def test_the_same_baseline_gives_the_same_curve_and_another_one_other_draws():
    one, again = (
        operating_curve(REFERENCE, RULES, budget=BUDGET, drops=(0.05,), repetitions=200)
        for _ in range(2)
    )
    assert one == again
    other = operating_curve(REFERENCE[::-1], RULES, budget=BUDGET, drops=(0.05,), repetitions=200)
    assert other != one
    assert other[0].regressed == pytest.approx(one[0].regressed, abs=0.15)


def test_a_larger_drop_is_convicted_sooner_and_passed_less_often():
    points = operating_curve(REFERENCE, RULES, budget=BUDGET, repetitions=300)
    assert [point.drop for point in points][:3] == [0.0, 0.01, 0.02]
    assert points[-1].drop == 0.30
    # Every drop meets the same luck. A scene that is named holds back a PASS no longer, and one
    # that is suspect does: so a worse policy may now and then pass where a better one waits.
    for better, worse in pairwise(points):
        assert worse.regressed >= better.regressed
        assert worse.passed <= better.passed + 0.02
        assert better.undecided >= 0.0
    assert points[-1].trials < 32
    assert points[3].trials > 64


def test_a_baseline_that_is_known_and_one_that_is_drawn_from_it_give_nearly_one_curve():
    known = operating_curve(REFERENCE, RULES, budget=BUDGET, drops=(0.0, 0.06, 0.12))
    drawn = operating_curve(REFERENCE, RULES, budget=BUDGET, drops=(0.0, 0.06, 0.12), starts=60)
    for one, other in zip(known, drawn, strict=True):
        assert one.regressed == pytest.approx(other.regressed, abs=0.1)
        assert one.trials == pytest.approx(other.trials, rel=0.2)


def test_the_simulated_policy_has_the_drop_that_was_asked_for():
    drawn = draw(REFERENCE, starts=None, budget=BUDGET, repetitions=200)
    assert drawn.baseline.mean() == pytest.approx(success_of(REFERENCE), abs=0.005)
    for drop in (0.0, 0.1, 0.3):
        trials = drawn.trials(chances_of(REFERENCE, success_of(REFERENCE) - drop))
        assert success_of(REFERENCE) - trials.candidate.mean() == pytest.approx(drop, abs=0.005)


def test_a_worse_policy_does_no_better_in_any_trial():
    drawn, mean = draw(REFERENCE, starts=None, budget=BUDGET, repetitions=50), success_of(REFERENCE)
    drops = (0.0, 0.05, 0.2)
    better, worse, worst = (drawn.trials(chances_of(REFERENCE, mean - drop)) for drop in drops)
    assert (better.candidate >= worse.candidate).all()
    assert (worse.candidate >= worst.candidate).all()
    assert (better.scenes == worst.scenes).all()


def test_scenes_and_starts_are_one_random_draw_without_replacement():
    seen, _ = few([[1, 2, 3], [0, 0, 6]])
    drawn = draw(seen, starts=None, budget=12, repetitions=500)
    assert np.sort(drawn.baseline * (1 - drawn.scenes)).sum(axis=1) == pytest.approx([4.0] * 500)
    assert (drawn.scenes.sum(axis=1) == 6).all()
    # Not round by round: the first trial is of either scene, and so is the second.
    again = (drawn.scenes[:, 0] == drawn.scenes[:, 1]).mean()
    assert again == pytest.approx(5 / 11, abs=0.07)
    short = draw(seen, starts=None, budget=3, repetitions=500)
    assert short.scenes.shape == (500, 3)
    assert short.scenes.mean() == pytest.approx(0.5, abs=0.05)


def test_what_a_gate_speaks_of_decides_what_its_evidence_takes_for_given():
    kinds = ("fresh", "panel", "control")
    fresh, panel, control = (
        draw(REFERENCE, starts=None, budget=BUDGET, repetitions=5, against=against).reference
        for against in kinds
    )
    assert (fresh.starts, panel.starts, control.paired) == (np.inf, 60, True)
    points = [
        operating_curve(
            REFERENCE, RULES, budget=BUDGET, drops=(0.0,), repetitions=100, against=against
        )[0]
        for against in kinds
    ]
    # A finite panel is settled sooner than fresh starts are, and these than a difference of two.
    assert points[1].trials < points[0].trials < points[2].trials


def test_a_perfect_baseline_has_equals_that_never_fail():
    seen, rules = few([[0, 0, 30]] * 4)
    (same,) = operating_curve(seen, rules, budget=80, drops=(0.0,), repetitions=50)
    assert (same.passed, same.regressed) == (1.0, 0.0)


def test_nobody_drops_by_more_than_the_baseline_has():
    seen, rules = few([[80, 20], [80, 20]])
    points = operating_curve(seen, rules, budget=40, repetitions=20)
    assert [point.drop for point in points][-1] == 0.15
    with pytest.raises(ValueError, match="mean success"):
        progress_at(seen, rules, 0.25)


def test_a_critical_scene_convicts_alone():
    counts = [[30, 30], *[[0, 60]] * 7]
    seen, rules = few(counts)
    _, strict = few(counts, *["supporting"] * 7, "critical")
    chances = np.array([0.5, 1, 1, 1, 1, 1, 1, 0.1])
    drawn = draw(seen, starts=None, budget=160, repetitions=300)
    lenient, severe = (
        settle_all(
            drawn.reference,
            drawn.trials(chances),
            replace(each, margins=Margins(max_drop=0.3, tolerate=0.2)),
        )
        for each in (rules, strict)
    )
    assert np.mean([decision.word == "REGRESSED" for decision in lenient]) < 0.05
    assert np.mean([decision.word == "REGRESSED" for decision in severe]) > 0.9


def test_progress_says_how_many_trials_convict_a_drop_or_that_none_do():
    found = progress_at(REFERENCE, RULES, 0.10)
    assert len(found.settled) == 60 * 16
    assert list(found.settled) == sorted(found.settled)
    assert found.settled[-1] == pytest.approx(1.0)
    eighty, ninety = (trials_for(found.regressed, share) for share in (0.8, 0.9))
    assert eighty is not None
    assert ninety is not None
    assert 4 * 16 < eighty < ninety < 20 * 16
    assert found.regressed[eighty - 1] >= 0.8 > found.regressed[eighty - 2]
    # What lies between the margins passes too often for that.
    small = progress_at(REFERENCE, RULES, 0.05)
    assert trials_for(small.regressed, 0.8) is None
    assert small.passed[-1] > 0.5


def test_progress_after_the_budget_is_the_curve():
    (point,) = operating_curve(REFERENCE, RULES, budget=960, drops=(0.06,), repetitions=200)
    found = progress_at(REFERENCE, RULES, 0.06, repetitions=200)
    assert found.passed[-1] == pytest.approx(point.passed)
    assert found.regressed[-1] == pytest.approx(point.regressed)


def test_scenes_with_unequal_numbers_of_initial_states_are_not_a_baseline():
    seen, rules = few([[0, 10], [0, 12]])
    with pytest.raises(ValueError, match="10 to 12 initial states are not a baseline"):
        operating_curve(seen, rules, budget=20)


def test_more_trials_than_there_are_starts_are_refused():
    with pytest.raises(ValueError, match="320 trials of 16 scenes with 10 initial states each"):
        operating_curve(SEEN, RULES, budget=320)
