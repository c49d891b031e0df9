from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.errors import IncomparableError
from nw_eval.gate import judge
from nw_eval.gate.baseline.combine import combined, judge_run, settled
from nw_eval.gate.baseline.judge import compare
from nw_eval.results.bank.against import Against
from nw_eval.results.provenance import BaselineInfo
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


def test_what_was_found_out_of_a_bank_on_this_machine_is_of_that_bank_alone(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    there = make_run(["a"], 20, drawn_from=60)
    bank = make_bank(there, {"a": [1.0] * 60})
    begun = BaselineInfo(name="shipped", path="x", sha256="5a" * 32, checked="scores")
    elsewhere = {**there.engine, "cpu": "haswell"}
    run = make_run(["a"], 20, drawn_from=60, engine=elsewhere, baseline=begun)
    rows = drawn_rows(run, {"a": [1.0] * 20})
    same_file = Against(info=begun, bank=bank, content=b"")
    found = judge_run(rows, run, Gate(max_drop=0.2), same_file).against
    assert found is not None
    assert (found.basis, found.word) == ("sample", "PASS")
    assert found.curve is not None
    assert [point.drop for point in found.curve] == [0.0, 0.1, 0.2]
    other = Against(info=begun.model_copy(update={"sha256": "5b" * 32}), bank=bank, content=b"")
    with pytest.raises(IncomparableError, match="cpu haswell, the bank's zen 4"):
        judge_run(rows, run, Gate(max_drop=0.2), other)


def test_an_open_run_says_about_how_many_more_rounds_would_settle_it(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run = make_run(["a", "b"], 4, drawn_from=60)
    bank = make_bank(run, dict.fromkeys("ab", [1.0] * 55 + [0.5] * 5))
    against = Against(
        info=BaselineInfo(name="shipped", path="x", sha256="5a" * 32), bank=bank, content=b""
    )
    verdict = judge_run(drawn_rows(run, dict.fromkeys("ab", [1.0] * 4)), run, Gate(), against)
    assert verdict.verdict == "INCONCLUSIVE"
    reason = verdict.reasons[1]
    assert reason.startswith(("an even chance that ", "chance that "))
    assert reason.endswith("; --resume with more --trials runs them")
