"""What a gate would show of policies that it has not met, from baselines and from rows."""

from __future__ import annotations

import dataclasses

import pytest

from nw_base.errors import IncomparableError, StoreError
from nw_gate.baseline.power_forecast import (
    NOTHING_MORE,
    about_more_trials,
    in_a_sentence,
    outset_of_baseline,
    outset_of_rows,
)
from nw_gate.settings import Gate
from nw_gate.stats.baseline.curve import CurvePoint, Progress

GOOD = [1.0] * 29 + [0.75]
GATE = Gate.model_validate({"max_drop": 0.2, "tiers": {"d": "informational", "b": "critical"}})


@pytest.fixture
def panel(make_run, make_baseline):
    run = make_run("abcd", 30)
    return make_baseline(run, dict.fromkeys("abcd", GOOD)).panels[0]


def test_a_baseline_is_counted_by_waypoints_without_scenes_that_are_not_judged(panel):
    outset = outset_of_baseline(panel, GATE)
    assert [course.counts.tolist() for course in outset.seen] == [[0, 0, 0, 1, 29]] * 3
    assert outset.rules.tiers == ("supporting", "critical", "supporting")
    assert (outset.scenes, outset.starts, outset.known) == (3, 30, True)
    assert outset.baseline == pytest.approx(1 - 0.25 / 30)
    assert (outset.rules.alpha_pass, outset.rules.alpha_regr) == (pytest.approx(0.05), 0.01)
    assert (outset.rules.margins.max_drop, outset.budget) == (0.2, 60)


def test_no_more_trials_are_foreseen_than_a_baseline_has_starts(make_run, make_baseline):
    small = make_baseline(make_run("ab", 8), {name: [1.0] * 8 for name in "ab"}).panels[0]
    assert outset_of_baseline(small, GATE).budget == 16


def test_a_policy_that_failed_by_itself_counts_as_in_a_comparison(panel):
    failed = dataclasses.replace(panel.starts[0], outcome="policy_failed", success=0.5)
    changed = dataclasses.replace(panel, starts=(failed, *panel.starts[1:]))
    assert outset_of_baseline(changed, GATE).seen[0].counts.tolist() == [1, 0, 0, 1, 28]


def test_a_task_without_waypoints_counts_what_was_completed(panel):
    ends = [1.0, 0.0, *[1.0] * 28]
    starts = [
        dataclasses.replace(
            start, task_kind="reach", success=end, waypoints_reached=0, waypoints_total=0
        )
        for start, end in zip(panel.starts, ends * 4, strict=True)
    ]
    outset = outset_of_baseline(dataclasses.replace(panel, starts=tuple(starts)), GATE)
    assert [course.counts.tolist() for course in outset.seen] == [[1, 29]] * 3
    assert outset.baseline == pytest.approx(29 / 30)


def test_rows_are_counted_where_they_have_a_result(make_run, run_rows):
    rows = run_rows(make_run("ab", 5), {"a": [1.0, None, 0.5, 1.0, 1.0], "b": [1.0] * 5})
    outset = outset_of_rows(rows, GATE, starts=60)
    assert [course.counts.tolist() for course in outset.seen] == [[0, 0, 1, 0, 3], [0, 0, 0, 0, 5]]
    assert (outset.starts, outset.known) == (60, False)
    assert outset.baseline == pytest.approx((0.875 + 1.0) / 2)
    crashed = run_rows(make_run("a", 2), {"a": [None, None]})
    with pytest.raises(StoreError, match="no trial of the run has a result"):
        outset_of_rows(crashed, GATE, starts=60)


def test_cells_of_perturbations_are_scenes_of_their_own(make_run, run_rows):
    icy = ("a", (("friction", 0.5),))
    run = make_run("a", 2, suite={"perturb": {"friction": (0.5, 1.0)}})
    rows = run_rows(run, {icy: [0.5, 0.5], ("a", (("friction", 1.0),)): [1.0, 1.0]})
    outset = outset_of_rows(rows, GATE, starts=60)
    assert [course.counts.tolist() for course in outset.seen] == [[0, 0, 2, 0, 0], [0, 0, 0, 0, 2]]


def test_what_nobody_can_drop_from_is_refused(panel):
    with pytest.raises(IncomparableError, match="no scene counts"):
        outset_of_baseline(panel, Gate.model_validate({"tiers": {"*": "informational"}}))
    with pytest.raises(IncomparableError, match=r"mean success is 0\.992: no policy can be worse"):
        outset_of_baseline(panel, Gate.model_validate({"max_drop": 0.995}))


def test_three_points_are_foreseen_and_said(panel):
    outset = outset_of_baseline(panel, GATE)
    same, half, worse = outset.power_forecast()
    # One of each kind: every waypoint is harder, or all is completed or nothing.
    assert [[x.drop for x in points] for points in (same, half, worse)] == [
        [0.0] * 2, [0.1] * 2, [0.2] * 2
    ]  # fmt: skip
    assert min(point.passed for point in same) > 0.9
    assert max(point.passed for point in worse) <= 0.05 + 0.033
    assert outset.power_forecast() == (same, half, worse)


def test_power_is_said_as_a_range_over_how_policies_fail():
    def points(drop, *shares):
        return tuple(CurvePoint(drop=drop, passed=p, regressed=r, trials=9.0) for p, r in shares)

    found = (
        points(0.0, (0.97, 0.0), (0.999, 0.0)),
        points(0.05, (0.06, 0.2), (0.1, 0.134)),
        points(0.1, (0.03, 0.879), (0.03, 0.96)),
    )
    assert in_a_sentence(found, 320) == (
        "With at most 320 trials, this gate flags a 0.1 regression in 88 to 96 % of cases and a "
        "0.05 regression in 13 to 20 %, and passes an equally good policy in 97 to > 99 % "
        "(simulated)"
    )
    alike = (points(0.0, (0.36, 0.0)), points(0.05, (0.06, 0.001)), points(0.1, (0.03, 0.5)))
    assert in_a_sentence(alike, 1) == (
        "With at most 1 trial, this gate flags a 0.1 regression in 50 % of cases and a 0.05 "
        "regression in < 1 %, and passes an equally good policy in 36 % (simulated)"
    )


def test_a_budget_and_what_is_compared_with_can_be_said(panel):
    few = outset_of_baseline(panel, GATE, budget=12)
    assert (few.budget, few.against) == (12, "fresh")
    assert few.power_forecast()[0][0].undecided == 1.0
    assert outset_of_baseline(panel, GATE, budget=1000).budget == 90
    # A gate beside a control has to tell two policies' luck apart: it takes more pairs.
    alone = outset_of_baseline(panel, GATE)
    beside = outset_of_baseline(panel, GATE, against="control")
    assert beside.power_forecast()[2][0].trials > alone.power_forecast()[2][0].trials


@pytest.mark.parametrize(
    ("passed", "words"),
    [
        ((0.2,), "1 more trial decides with 20 % probability"),
        ((0.0, 0.2), "2 more trials decide with 20 % probability"),
        (
            (0.1, 0.5, 0.7),
            "2 more trials decide with 50 % probability, 3 with 70 %",
        ),
        ((0.6, 0.8, 0.95), "1 more trial decides with 50 % probability, 3 with 90 %"),
        ((0.1, 0.95), "2 more trials decide with 90 % probability"),
    ],
)
def test_about_how_many_more_trials_is_a_spread(passed, words):
    progress = Progress(passed=passed, regressed=tuple(0.0 for _ in passed))
    assert about_more_trials(progress) == f"if the candidate is as it looks so far, about {words}"


def test_of_a_run_that_met_all_starts_nothing_more_is_said():
    assert about_more_trials(Progress(passed=(), regressed=())) == NOTHING_MORE
