from __future__ import annotations

import re
from dataclasses import replace
from math import comb
from typing import Any

import numpy as np
import pytest

from nw_base.errors import StoreError
from nw_eval.suite import Gate
from nw_gate.absolute import courses, how_most_failed, judge
from nw_gate.stats.betting import lower_bound, upper_bound

BAR = Gate(success_rate=0.75)


def gate(**settings: Any) -> Gate:
    return Gate(success_rate=0.75, **settings)


def test_a_run_whose_lower_bound_reaches_the_bar_passes(run_scene):
    rows = run_scene("a", [4] * 20) + run_scene("b", [4] * 20)
    verdict = judge(rows, BAR, {"a": 20, "b": 20})
    assert (verdict.verdict, verdict.exit_code) == ("PASS", 0)
    assert verdict.success == 1.0
    assert verdict.interval.low == lower_bound([np.ones(20), np.ones(20)])
    assert verdict.interval.high == 1.0
    assert verdict.n == verdict.planned == 40
    assert "bar is 0.75" in verdict.reasons[0]


def test_a_run_whose_upper_bound_misses_the_bar_is_regressed(run_scene):
    verdict = judge(run_scene("a", [1] * 20 + [2] * 20), BAR, {"a": 40})
    assert (verdict.verdict, verdict.exit_code) == ("REGRESSED", 1)
    assert verdict.interval.high == upper_bound([np.r_[[0.25] * 20, [0.5] * 20]]) < 0.75


def test_anything_between_is_inconclusive_and_gives_the_chance_that_more_would_decide(run_scene):
    poor, good = [4] * 8 + [1] * 2, [4] * 9 + [2]
    verdict = judge(run_scene("a", poor) + run_scene("b", good), BAR, {"a": 10, "b": 10})
    assert (verdict.verdict, verdict.exit_code) == ("INCONCLUSIVE", 3)
    told = verdict.reasons[1]
    assert told.startswith("20 trials in each scene (now 10) decide the bar with ")
    assert told.endswith("; --resume with more --trials adds them")
    twice, four_times = (int(share) for share in re.findall(r"(\d+) %", told))
    assert 20 < twice < four_times < 95


def test_trials_that_scenes_have_unequal_numbers_of_are_told_in_all(run_scene):
    rows = run_scene("a", [4] * 8 + [1] * 2) + run_scene("b", [4] * 6 + [2])
    verdict = judge(rows, BAR, {"a": 10, "b": 7}, drawn=rows)
    assert verdict.verdict == "INCONCLUSIVE"
    assert verdict.reasons[1].startswith("34 trials (now 17) decide the bar with ")


def test_too_few_trials_for_the_bar_are_told_even_if_perfect(run_scene):
    verdict = judge(run_scene("a", [4] * 4), BAR, {"a": 4})
    assert verdict.verdict == "INCONCLUSIVE"
    assert (
        "4 trials cannot reach this bar even if all are perfect: run 15 trials in each scene at "
        "least (--trials 15)" in (verdict.reasons[1])
    )


def test_success_at_the_bar_is_told_as_unlikely_to_be_decided_soon(run_scene):
    verdict = judge(
        run_scene("a", [0] * 5 + [1] * 3 + [2] * 4 + [3] * 3 + [4] * 25), BAR, {"a": 40}
    )
    assert (verdict.verdict, verdict.success) == ("INCONCLUSIVE", 0.75)
    twice, four_times = (int(share) for share in re.findall(r"(\d+) %", verdict.reasons[1]))
    assert twice < 25
    assert four_times < 50


def test_scenes_weigh_equally(run_scene):
    rows = run_scene("a", [4] * 90) + run_scene("b", [0] * 10)
    assert judge(rows, BAR, {"a": 90, "b": 10}).success == 0.5


def test_an_error_that_is_left_blocks_whatever_the_score(run_scene):
    verdict = judge(run_scene("a", [4] * 60 + [None]), BAR, {"a": 61})
    assert (verdict.verdict, verdict.exit_code) == ("INFRASTRUCTURE", 4)
    assert verdict.success == 1.0  # The error does not count as a failure.
    assert verdict.errors == 1
    (reason,) = verdict.reasons
    assert reason.startswith("1 trial ended in errors (1 crashed), first a-060: signal 11")
    assert "--resume" in reason


def test_missing_trials_block_and_are_counted_by_scene(run_scene):
    verdict = judge(run_scene("a", [4] * 60), BAR, {"a": 62, "b": 3})
    assert verdict.exit_code == 4
    assert verdict.reasons == ("5 trials missing (a 2, b 3); --resume runs them",)


@pytest.mark.parametrize("planned", [{}, {"a": 0}])
def test_no_trials_can_never_pass(planned):
    for settings in (BAR, Gate()):
        verdict = judge([], settings, planned)
        assert verdict.exit_code == 4
        assert verdict.success is None
        assert "nothing can pass without trials" in verdict.reasons[0]


def test_a_critical_scene_without_a_result_blocks(run_scene):
    critical = gate(tiers={"b": "critical"})
    absent = judge(run_scene("a", [4] * 60), critical, {"a": 60})
    assert absent.exit_code == 4
    assert "critical scene b has no result" in absent.reasons[0]
    crashed = judge(run_scene("a", [4] * 60) + run_scene("b", [None]), critical, {"a": 60, "b": 1})
    assert crashed.exit_code == 4
    assert any("critical scene b has no result" in reason for reason in crashed.reasons)


def test_a_critical_scene_far_below_the_bar_convicts_though_the_mean_passes(run_scene):
    rows = [row for k in range(9) for row in run_scene(f"s{k}", [4] * 20)]
    rows += run_scene("weak", [1] * 20)
    planned = {row.scene: 20 for row in rows}
    assert judge(rows, BAR, planned).verdict == "PASS"
    verdict = judge(rows, gate(tiers={"weak": "critical"}), planned)
    assert verdict.exit_code == 1
    assert verdict.reasons[0].startswith("critical scene weak alone: success is at most 0.")
    # Two poor trials prove nothing.
    few = [row for row in rows if row.scene != "weak"] + run_scene("weak", [1] * 2)
    planned["weak"] = 2
    assert judge(few, gate(tiers={"weak": "critical"}), planned).verdict != "REGRESSED"


def test_informational_scenes_are_reported_and_do_not_count(run_scene):
    rows = run_scene("a", [4] * 40) + run_scene("toy", [0] * 40)
    verdict = judge(rows, gate(tiers={"toy": "informational"}), {"a": 40, "toy": 40})
    assert verdict.verdict == "PASS"
    assert verdict.success == 1.0
    assert verdict.n == 40
    assert [(item.scene, item.mean) for item in verdict.per_scene] == [("a", 1.0), ("toy", 0.0)]
    alone = judge(run_scene("toy", [4] * 40), gate(tiers={"*": "informational"}), {"toy": 40})
    assert alone.exit_code == 4


def test_without_a_bar_nothing_passes_it_only_ran(run_scene):
    verdict = judge(run_scene("a", [0] * 4), Gate(), {"a": 4})
    assert (verdict.verdict, verdict.exit_code, verdict.bar) == ("RAN", 0, None)
    assert verdict.reasons == (
        "4 trials ran and nothing was judged: the suite sets no gate.success_rate",
    )


def test_without_a_bar_errors_and_missing_trials_still_block(run_scene):
    assert judge(run_scene("a", [0] * 4), Gate(), {"a": 5}).verdict == "INFRASTRUCTURE"
    assert judge(run_scene("a", [4, None]), Gate(), {"a": 2}).verdict == "INFRASTRUCTURE"


WEAK = "1 scene below the bar by itself: weak completed "


@pytest.mark.parametrize(
    ("good", "word"), [([4] * 20, "PASS"), ([2] * 20, "REGRESSED"), ([4, None], "INFRASTRUCTURE")]
)
def test_a_scene_whose_whole_interval_lies_below_the_bar_is_named_whatever_the_verdict(
    run_scene, good, word
):
    rows = [row for k in range(9) for row in run_scene(f"s{k}", good)]
    rows += run_scene("weak", [1] * 20)
    planned = {row.scene: len(good) for row in rows} | {"weak": 20}
    verdict = judge(rows, BAR, planned)
    assert verdict.verdict == word
    named = [reason for reason in verdict.reasons if "below the bar" in reason]
    if word == "REGRESSED":
        (reason,) = named
        assert reason.startswith("10 scenes below the bar by themselves: weak completed 0 of 20, ")
        assert reason.endswith("; and 7 more")
    else:
        (reason,) = named
        assert reason == f"{WEAK}0 of 20, success 0.250"


def test_a_scene_whose_interval_reaches_the_bar_is_not_named(run_scene):
    rows = run_scene("a", [4] * 40) + run_scene("b", [4, 4, 2, 1])
    verdict = judge(rows, BAR, {"a": 40, "b": 4})
    assert verdict.per_scene[1].interval.low < 0.75 < verdict.per_scene[1].interval.high
    assert not any("below the bar" in reason for reason in verdict.reasons)


def test_a_critical_scene_that_was_left_out_is_a_hole_however_its_tier_names_it(run_scene):
    rows = run_scene("b", [4] * 40)
    for pattern in ("a", "a*", "*", "[ab]"):
        judged = judge(rows, gate(tiers={pattern: "critical"}), {"b": 40}, left_out=("a",))
        assert judged.verdict == "INFRASTRUCTURE"
        assert judged.reasons[0] == (
            "critical scene a has no result, and the suite cannot pass without it"
        )
    # One that is critical is asked for, and no other.
    for tiers in ({"a": "supporting", "*": "critical"}, {"b": "critical"}, {}):
        assert judge(rows, gate(tiers=tiers), {"b": 40}, left_out=("a",)).verdict == "PASS"


def test_the_trials_that_a_bar_needs_are_told_in_the_unit_of_trials(run_scene):
    rows = run_scene("a", [4] * 2) + run_scene("b", [4] * 2)
    (told,) = judge(rows, BAR, {"a": 2, "b": 2}).reasons[1:2]
    assert told.endswith("run 8 trials in each scene at least (--trials 8)")
    enough = run_scene("a", [4] * 8) + run_scene("b", [4] * 8)
    assert judge(enough, BAR, {"a": 8, "b": 8}).verdict == "PASS"
    cells = [
        replace(row, perturbation=(("friction", float(index % 2)),))
        for index, row in enumerate(run_scene("a", [4] * 4))
    ]
    assert judge(cells, BAR, {"a": 4}).reasons[1].endswith("(--trials 8)")


def test_a_critical_scene_of_ten_coins_is_convicted_as_often_as_the_gate_says(run_scene):
    # "One run of six": exactly, over all numbers of heads, (45 + 10 + ...) / 1024.
    critical = gate(tiers={"weak": "critical"})
    rest = [row for k in range(9) for row in run_scene(f"s{k}", [4] * 20)]
    flagged = 0.0
    for heads in range(11):
        rows = rest + run_scene("weak", [4] * heads + [0] * (10 - heads))
        planned = {row.scene: 20 for row in rest} | {"weak": 10}
        flagged += comb(10, heads) / 2**10 * (judge(rows, critical, planned).exit_code == 1)
    assert flagged == pytest.approx(1 / 6, abs=0.01)


def test_a_trial_that_appears_twice_is_refused(run_scene):
    rows = run_scene("a", [4] * 3)
    with pytest.raises(StoreError, match="trial a-001 appears twice"):
        judge([*rows, rows[1]], BAR, {"a": 4})


def test_a_scene_score_counts_everything_once(run_scene):
    (item,) = judge(run_scene("a", [4, 4, 2, None]), BAR, {"a": 6}).per_scene
    assert (item.planned, item.n, item.errors, item.missing, item.completed) == (6, 3, 1, 2, 2)
    assert item.mean == pytest.approx(2.5 / 3)


def test_a_policy_that_only_fails_has_regressed_and_one_fault_of_the_machine_hides_nothing(
    run_scene,
):
    failed = [
        replace(row, outcome="policy_failed", end_reason="exception", error_type="policy_error")
        for row in run_scene("a", [0] * 12)
    ]
    verdict = judge(failed, BAR, {"a": 12})
    assert (verdict.verdict, verdict.success, verdict.errors) == ("REGRESSED", 0.0, 0)
    assert verdict.per_scene[0].n == 12
    killed = run_scene("a", [0] * 12 + [None])[-1]
    verdict = judge([*failed, killed], BAR, {"a": 13})
    assert (verdict.verdict, verdict.errors) == ("INFRASTRUCTURE", 1)
    assert "1 trial ended in errors (1 crashed)" in verdict.reasons[0]


@pytest.mark.nightly
def test_a_policy_at_the_bar_rarely_passes(run_scene):
    rng = np.random.default_rng(5)
    passed = 0
    for _ in range(200):
        # True success is exactly 0.75 on average: scenes of 0.9 and 0.6, all or nothing.
        rows = [
            row
            for scene, share in (("a", 0.9), ("b", 0.6))
            for row in run_scene(scene, [4 * int(hit) for hit in rng.random(30) < share])
        ]
        passed += judge(rows, BAR, {"a": 30, "b": 30}).verdict == "PASS"
    # At most 5 % by proof; standard error 1.5 %.
    assert passed / 200 <= 0.09


def test_success_is_still_found_under_its_old_name_which_warns(run_scene):
    verdict = judge(run_scene("a", [4, 2]), BAR, {"a": 2})
    with pytest.warns(DeprecationWarning, match="Verdict.effect is now Verdict.success"):
        assert verdict.effect == verdict.success == 0.75


def test_trials_of_a_task_without_waypoints_count_as_done_or_not(run_scene):
    rows = [
        replace(row, task_kind="reach", waypoints_reached=0, waypoints_total=0)
        for row in run_scene("a", [4, 4, 0])
    ]
    (seen,) = courses({"a": rows}, judge(rows, BAR, {"a": 3}).per_scene)
    assert seen.counts.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ([4, 4], ""),
        ([1, 4], "the failed trial fell, before waypoint 2"),
        ([0, 0, 4], "all failed trials fell, before waypoint 1"),
        ([0, 1, 1], "all failed trials fell, most often before waypoint 2"),
    ],
)
def test_how_most_failed_is_said_in_one_clause(run_scene, ends, words):
    assert how_most_failed(run_scene("a", ends)) == words


def test_the_outcome_that_most_trials_had_is_told_with_where(run_scene):
    fell = run_scene("a", [2, 2, 2, 0, 4, None])
    rows = [replace(row, outcome="collided") for row in fell[:3]] + fell[3:]
    assert how_most_failed(rows) == "3 of the 4 failed trials collided, before waypoint 3"
    assert how_most_failed(rows, {row.trial_id for row in rows[:3]}) == (
        "the failed trial fell, before waypoint 1"
    )
    verdict = judge(rows[:5], gate(tiers={"b": "informational"}), {"a": 5})
    assert verdict.failures == "3 of the 4 failed trials collided, before waypoint 3"


def test_what_made_a_run_regressed_is_named(run_scene):
    rows = run_scene("a", [1] * 40)
    assert judge(rows, BAR, {"a": 40}).regressed_by == ("the bar",)
    both = judge(rows, gate(tiers={"a": "critical"}), {"a": 40})
    assert both.regressed_by == ("the bar", "critical scene a")
    one = judge(
        run_scene("a", [0] * 20) + run_scene("b", [4] * 60) + run_scene("c", [4] * 60),
        gate(tiers={"a": "critical"}),
        {"a": 20, "b": 60, "c": 60},
    )
    assert (one.verdict, one.regressed_by) == ("REGRESSED", ("critical scene a",))
    assert judge(run_scene("a", [4] * 40), BAR, {"a": 40}).regressed_by == ()


def test_a_bound_that_is_the_end_of_the_range_is_not_told(run_scene):
    failed = judge(run_scene("a", [0, 0]), BAR, {"a": 2})
    assert failed.interval.low == 0.0
    assert failed.reasons[0].startswith("success is at most 0.")
    assert failed.reasons[0].endswith("(95 % confidence), more than the bar 0.75")
    perfect = judge(run_scene("a", [4, 4]), BAR, {"a": 2})
    assert perfect.reasons[0].endswith("(95 % confidence), less than the bar 0.75")
