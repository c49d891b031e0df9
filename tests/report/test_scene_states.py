"""Lists of tests say what the verdict says: a scene fails only where the run is REGRESSED."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from nw_eval.gate import judge
from nw_eval.gate.baseline.combine import without_bank
from nw_eval.reporting.scene_states import scene_states, worst_first
from nw_eval.suite import Gate

BAR = Gate(success_rate=0.75)


def states(verdict: Any) -> dict[str, str]:
    return {item.scene: item.state for item in scene_states(verdict)}


def rows_of(make_row: Any, **reached: list[int | None]) -> list[Any]:
    return [make_row(scene, k, to) for scene, each in reached.items() for k, to in enumerate(each)]


def test_a_scene_below_the_bar_fails_where_the_run_is_regressed_and_is_weak_where_it_passes(
    make_row: Any,
) -> None:
    bad = rows_of(make_row, good=[4] * 20, bad=[0] * 20)
    regressed = judge(bad, Gate(success_rate=0.9), {"good": 20, "bad": 20})
    assert regressed.verdict == "REGRESSED"
    assert states(regressed) == {"good": "fine", "bad": "failed"}
    good = {f"s{k}": [4] * 20 for k in range(8)}
    passing = judge(
        rows_of(make_row, **good, bad=[0, 0, 0, 2, 2]), BAR, {**dict.fromkeys(good, 20), "bad": 5}
    )
    assert passing.verdict == "PASS"
    assert states(passing)["bad"] == "weak"
    assert "failed" not in states(passing).values()


def test_a_critical_scene_that_convicts_says_so_and_an_informational_one_never_fails(
    make_row: Any,
) -> None:
    gate = Gate(success_rate=0.75, tiers={"bad": "critical", "toy": "informational"})
    rows = rows_of(make_row, good=[4] * 20, bad=[0] * 20, toy=[0] * 20)
    verdict = judge(rows, gate, {"good": 20, "bad": 20, "toy": 20})
    assert states(verdict) == {"bad": "failed", "good": "fine", "toy": "weak"}
    (bad, *_) = scene_states(verdict)
    assert bad.sentence.startswith(
        "critical, and certainly below the bar 0.75 by itself; success 0"
    )
    assert [item.scene for item in worst_first(scene_states(verdict))] == ["bad", "toy", "good"]


def test_holes_are_errors_of_their_scenes_only(make_row: Any) -> None:
    rows = rows_of(make_row, good=[4] * 4, torn=[4, None])
    verdict = judge(rows, BAR, {"good": 4, "torn": 4, "gone": 2})
    assert states(verdict) == {"gone": "error", "good": "fine", "torn": "error"}
    sentences = {item.scene: item.sentence for item in scene_states(verdict)}
    assert sentences["torn"].startswith("1 trial ended in errors; 2 trials missing; success 1.000")
    assert sentences["gone"] == "2 trials missing; no trial has a result"


def test_nothing_of_an_invalid_run_is_judged(make_row: Any) -> None:
    verdict = judge(rows_of(make_row, good=[4] * 20, bad=[0] * 20), BAR, {"good": 20, "bad": 20})
    assert set(states(without_bank(verdict, "the bank moved")).values()) == {"unjudged"}


def test_a_run_that_is_regressed_by_nothing_of_its_scenes_blames_none(make_row: Any) -> None:
    verdict = judge(rows_of(make_row, a=[4] * 20), BAR, {"a": 20})
    assert states(replace(verdict, verdict="REGRESSED")) == {"a": "fine"}
