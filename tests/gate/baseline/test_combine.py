from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.errors import IncomparableError
from nw_eval.gate import judge
from nw_eval.gate.baseline.combine import combined, judge_run, settled
from nw_eval.gate.baseline.holding.sentinel import watch
from nw_eval.gate.baseline.judge import compare
from nw_eval.reporting import headline
from nw_eval.results.bank import trajectory
from nw_eval.results.bank.against import Against
from nw_eval.results.provenance import BaselineInfo, PolicyInfo, recheck_key
from nw_eval.suite import Gate

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_eval.gate.baseline.comparison import Comparison
    from nw_eval.gate.verdict import Verdict
    from nw_eval.results.bank import SavedBank
    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row

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


def test_the_same_policy_passes_neither_though_nothing_ran_nor_though_the_bar_fails(
    run_scene: Make, against: Comparison
) -> None:
    same = replace(against, basis="same", word="PASS", reasons=("the same policy",))
    nothing = judge([], Gate(success_rate=0.75), {"a": 0})
    assert combined(nothing, same).verdict == "INFRASTRUCTURE"
    low = judge(run_scene("a", [0] * 20), Gate(success_rate=0.75), {"a": 20})
    assert combined(low, same).verdict == "REGRESSED"
    # An error is a hole, whoever the policy is.
    crashed = judge(run_scene("a", [None]), Gate(), {"a": 1})
    assert combined(crashed, same).verdict == "INFRASTRUCTURE"


def of_the_baseline_itself(make_run: Make, *, ran: float, **changes: Any) -> tuple[RunInfo, Gate]:
    """Return the run of a baseline's own policy, of which one start ran again, and its gate."""
    policy = PolicyInfo(name="go1-act-rgb", card_digest="b1" * 32, checkpoint_digest="bb" * 32)
    run = make_run(
        ["a", "b"], 20, drawn_from=60, drawn_for=recheck_key(7), stopped_after=1, policy=policy,
        **changes,
    )  # fmt: skip
    return run, Gate(success_rate=ran)


def in_bits(rows: list[Row], bank: SavedBank) -> SavedBank:
    """Return a bank that has the bits of some rows at their starts."""
    ways = {(row.scene, row.seed_index): trajectory(row) for row in rows}
    starts = tuple(
        replace(start, trajectory=ways.get((start.scene, start.seed_index), start.trajectory))
        for start in bank.panels[0].starts
    )
    return replace(bank, panels=(replace(bank.panels[0], starts=starts), *bank.panels[1:]))


def judged_by(bank: SavedBank, rows: list[Row], run: RunInfo, gate: Gate) -> Verdict:
    info = BaselineInfo(name="shipped", path="x", sha256="5a" * 32)
    return judge_run(rows, run, gate, Against(info=info, bank=bank, content=b""))


def test_a_baseline_is_taken_over_where_one_start_of_every_scene_ran_again_and_is_equal(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run, gate = of_the_baseline_itself(make_run, ran=0.75)
    rows = drawn_rows(run, {"a": [1.0], "b": [1.0]})
    bank = in_bits(rows, make_bank(run, dict.fromkeys("ab", [1.0] * 60)))
    verdict = judged_by(bank, rows, run, gate)
    assert (verdict.verdict, verdict.n) == ("PASS", 120)
    over = "taken over from the baseline, 2 run again and equal"
    assert f"baseline shipped is the same policy · {over} · success 1.000" in headline(verdict, run)
    assert over in verdict.reasons[0]
    # A row of the cache has not run, and a scene of which no start ran says nothing.
    cached = [rows[0], replace(rows[1], cached=True)]
    for short in (rows[:1], cached):
        assert judged_by(bank, short, run, gate).verdict != "PASS"


@pytest.mark.parametrize(
    "change",
    [{"success": 0.5}, {"outcome": "fell"}, {"waypoints_reached": 3}, {"trajectory": "f" * 16}],
)
def test_a_start_that_ran_again_otherwise_than_the_baseline_says_is_invalid_and_named(
    make_run: Make, make_bank: Make, drawn_rows: Make, change: dict[str, Any]
) -> None:
    run, gate = of_the_baseline_itself(make_run, ran=0.75)
    rows = drawn_rows(run, {"a": [1.0], "b": [1.0]})
    bank = in_bits(rows, make_bank(run, dict.fromkeys("ab", [1.0] * 60)))
    met = rows[1].seed_index
    wrong = tuple(
        replace(start, **change) if (start.scene, start.seed_index) == ("b", met) else start
        for start in bank.panels[0].starts
    )
    bank = replace(bank, panels=(replace(bank.panels[0], starts=wrong),))
    verdict = judged_by(bank, rows, run, gate)
    assert (verdict.verdict, verdict.exit_code) == ("INVALID", 5)
    assert verdict.reasons[0].endswith("is not what its own policy does: 1 of 2 trials differ")
    assert verdict.reasons[1].startswith(f"scene b start {met}: ")
    name, value = next(iter(change.items()))
    assert f"the baseline's {value}" in verdict.reasons[1]
    assert {"trajectory": "bits"}.get(name, name) in verdict.reasons[1]
    assert "baseline shipped is not what its own policy does" in headline(verdict, run)


def test_where_bits_are_others_an_honest_baseline_is_not_invalid_and_nothing_is_taken_over(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run, gate = of_the_baseline_itself(make_run, ran=0.25)
    bank = make_bank(run, dict.fromkeys("ab", [1.0] * 50 + [0.5] * 10))
    elsewhere = {**run.engine, "cpu": "haswell"}
    here = run.model_copy(update={"engine": elsewhere, "stopped_after": 8})
    rows = drawn_rows(here, dict.fromkeys("ab", [1.0] * 7 + [0.5]))
    verdict = judged_by(bank, rows, here, gate)
    assert (verdict.verdict, verdict.n) == ("PASS", 16)
    assert "16 run again, with other bits, and nothing taken over" in headline(verdict, here)
    assert verdict.against is not None
    assert verdict.against.again is not None
    assert verdict.against.again.settled is False, "eight rounds are too few to say so"
    # The bar is for what ran: the file's scores are of no use to a policy that fails here.
    low = drawn_rows(here, dict.fromkeys("ab", [0.0] * 8))
    assert judged_by(bank, low, here, gate).verdict == "INVALID"
    low = drawn_rows(here, dict.fromkeys("ab", [0.5] * 8))
    assert judged_by(bank, low, here, Gate(success_rate=0.9)).verdict in {"REGRESSED", "INVALID"}


def test_the_same_bits_with_another_result_are_invalid_on_every_class_of_machine(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run, gate = of_the_baseline_itself(make_run, ran=0.01)
    rows = drawn_rows(run, {"a": [0.5], "b": [0.5]})
    forged = in_bits(rows, make_bank(run, dict.fromkeys("ab", [1.0] * 60)))
    elsewhere = run.model_copy(update={"engine": {**run.engine, "cpu": "haswell"}})
    verdict = judged_by(forged, rows, elsewhere, gate)
    assert verdict.verdict == "INVALID"
    assert "the same bits, other results" in verdict.reasons[0]
    assert verdict.reasons[1].startswith("scene a start ")
    assert "success 0.5, the baseline's 1.0" in verdict.reasons[1]
    # Of another candidate's baseline the sentinel finds it: its own policy ran from these starts.
    own = [replace(row, arm="baseline") for row in rows]
    seen = watch(own, elsewhere, forged, gate)
    assert seen.checked is None
    assert "the same bits, other results" in seen.moved[0]


def test_a_second_panel_that_is_true_does_not_speak_for_a_first_one_that_is_forged(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run, gate = of_the_baseline_itself(make_run, ran=0.9)
    rows = drawn_rows(run, {"a": [0.5], "b": [0.5]})
    true = in_bits(rows, make_bank(run, dict.fromkeys("ab", [0.5] * 60)))
    forged = make_bank(run, dict.fromkeys("ab", [1.0] * 60))
    infos = [
        forged.manifest.panels[0].model_copy(update={"machine": {"cpu": cpu}})
        for cpu in ("here", "there")
    ]
    both = replace(
        forged,
        manifest=forged.manifest.model_copy(update={"panels": tuple(infos)}),
        panels=(
            replace(forged.panels[0], machine=infos[0].machine),
            replace(true.panels[0], machine=infos[1].machine),
        ),
    )
    assert judged_by(both, rows, run, gate).verdict not in {"PASS", "RAN"}


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
