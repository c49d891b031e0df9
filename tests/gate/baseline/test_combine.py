from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.gate import judge
from nw_eval.gate.baseline.combine import combined, settled
from nw_eval.gate.baseline.judge import compare
from nw_eval.suite import Gate

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_eval.gate.baseline.comparison import Comparison

    Make = Callable[..., Any]


@pytest.fixture
def against(make_run: Make, make_bank: Make) -> Comparison:
    run = make_run(["a"], 20, drawn_from=60)
    return compare([], run, make_bank(run, {"a": [1.0] * 60}), Gate())


@pytest.mark.parametrize(
    ("bar", "baseline", "word", "exit_code", "is_settled"),
    [
        ("PASS", "PASS", "PASS", 0, True),
        ("RAN", "PASS", "PASS", 0, True),
        ("PASS", "REGRESSED", "REGRESSED", 1, True),
        ("RAN", "REGRESSED", "REGRESSED", 1, True),
        ("REGRESSED", "PASS", "REGRESSED", 1, True),
        ("REGRESSED", "INCONCLUSIVE", "REGRESSED", 1, True),
        ("INCONCLUSIVE", "REGRESSED", "REGRESSED", 1, True),
        ("PASS", "INCONCLUSIVE", "INCONCLUSIVE", 3, False),
        ("RAN", "INCONCLUSIVE", "INCONCLUSIVE", 3, False),
        ("INCONCLUSIVE", "PASS", "INCONCLUSIVE", 3, False),
        ("INFRASTRUCTURE", "PASS", "INFRASTRUCTURE", 4, False),
        ("INFRASTRUCTURE", "REGRESSED", "INFRASTRUCTURE", 4, True),
    ],
)
def test_bar_and_baseline_must_both_pass_and_either_convicts(
    run_scene: Make, against: Comparison, bar: str, baseline: str, word: str, exit_code: int,
    is_settled: bool,
) -> None:  # fmt: skip
    verdict = replace(judge(run_scene("a", [4] * 20), Gate(), {"a": 20}), verdict=bar)
    comparison = replace(against, word=baseline, reasons=("of the baseline",))
    both = combined(verdict, comparison)
    assert (both.verdict, both.exit_code, both.against) == (word, exit_code, comparison)
    assert {"of the baseline", *verdict.reasons} == set(both.reasons)
    assert settled(verdict, comparison) is is_settled


def test_what_decides_speaks_first(run_scene: Make, against: Comparison) -> None:
    verdict = judge(run_scene("a", [4] * 20), Gate(success_rate=0.75), {"a": 20})
    fell = replace(against, word="REGRESSED", reasons=("it fell",))
    assert combined(verdict, fell).reasons[0] == "it fell"
    low = judge(run_scene("a", [0] * 20), Gate(success_rate=0.75), {"a": 20})
    fine = replace(against, word="PASS", reasons=("no worse",))
    assert combined(low, fine).reasons == (*low.reasons, "no worse")


def test_the_same_policy_passes_though_nothing_ran_and_not_though_the_bar_fails(
    run_scene: Make, against: Comparison
) -> None:
    same = replace(against, basis="same", word="PASS", reasons=("the same policy",))
    nothing = judge([], Gate(success_rate=0.75), {"a": 0})
    assert nothing.verdict == "INFRASTRUCTURE"
    both = combined(nothing, same)
    assert (both.verdict, both.exit_code, both.reasons) == ("PASS", 0, ("the same policy",))
    low = judge(run_scene("a", [0] * 20), Gate(success_rate=0.75), {"a": 20})
    assert combined(low, same).verdict == "REGRESSED"
    # An error is a hole, whoever the policy is.
    crashed = judge(run_scene("a", [None]), Gate(), {"a": 1})
    assert combined(crashed, same).verdict == "INFRASTRUCTURE"
