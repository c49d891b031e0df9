from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nw_eval.errors import IncomparableError, StoreError
from nw_eval.gate.baseline.draw import draw_starts
from nw_eval.gate.baseline.judge import compare
from nw_eval.reporting.tables.baseline import baseline_table
from nw_eval.request import Request
from nw_eval.results.provenance import PolicyInfo
from nw_eval.suite import Gate

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_eval.results.bank import SavedBank
    from nw_eval.results.provenance import RunInfo

    Make = Callable[..., Any]

GATE = Gate(max_drop=0.1, scene_drop=0.1)
WAYS = {"drawn_from": 60}


# Means of the 16 scenes of the figures in the method's description; sixty starts each.
MEANS = [.525, .9, .9333, .9333, .9333, .95, .95, .95, .9667, .9667, 1, 1, 1, 1, 1, 1]  # fmt: skip


@pytest.fixture
def figures(make_run: Make, make_bank: Make) -> tuple[RunInfo, SavedBank]:
    """The bank of the figures, with ones in the starts that are drawn first."""
    names = [f"hurdles/{number:02d}" for number in range(16)]
    run = make_run(names, 20, drawn_from=60)
    order = draw_starts(
        [(name, ()) for name in names], 60, candidate=run.drawn_by, suite_digest=run.suite_digest
    )
    scores = {}
    for name, mean in zip(names, MEANS, strict=True):
        halves = round(120 * (1 - mean))  # Of sixty starts, each half a success short.
        values = [1.0] * 60
        for start in order[name, ()][60 - halves :]:
            values[start] = 0.5
        scores[name] = values
    return run, make_bank(run, scores)


@pytest.mark.parametrize(("alpha", "rounds"), [(1 / 6.1, 1), (1 / 45.1, 2), (1 / 46, 3)])
def test_an_unchanged_policy_passes_after_the_rounds_that_the_figures_say(
    figures: tuple[RunInfo, SavedBank], drawn_rows: Make, alpha: float, rounds: int
) -> None:
    # E_pass after rounds 1 to 4: 6.1569, 45.1495, 376.4782, 3443.4290. With M = 60, which would be
    # a claim about the panel alone, it is 46.951 and more from the second round on.
    run, bank = figures
    rows = drawn_rows(run, dict.fromkeys(run.scenes, [1.0] * 4))
    found = compare(rows, run, bank, GATE.model_copy(update={"confidence": 1 - alpha}))
    assert (found.word, found.rounds, found.budget, found.starts) == ("PASS", rounds, 20, 60)
    assert found.baseline == pytest.approx(sum(MEANS) / 16, abs=1e-4)
    assert found.drop == pytest.approx(found.baseline - 1.0)
    assert (found.basis, found.claim) == ("panel", "panel and fresh")
    assert found.interval is not None
    assert found.interval.high < found.max_drop
    assert "a drop of 0.1 is excluded" in found.reasons[0]
    assert [item.trials for item in found.scenes] == [rounds] * 16


@pytest.mark.parametrize(("alpha", "rounds"), [(1 / 406, 1), (1 / 407, 2)])
def test_a_policy_of_half_the_success_is_convicted_as_soon_as_the_figures_say(
    figures: tuple[RunInfo, SavedBank], drawn_rows: Make, alpha: float, rounds: int
) -> None:
    # E_regr after rounds 1, 2: 406.6411, 1459218.35.
    run, bank = figures
    rows = drawn_rows(run, dict.fromkeys(run.scenes, [0.5] * 4))
    found = compare(rows, run, bank, GATE.model_copy(update={"false_alarm": alpha}))
    assert (found.word, found.rounds) == ("REGRESSED", rounds)
    assert found.interval is not None
    low, high = found.interval
    assert 0.02 < low < found.drop < high
    assert found.reasons[0] == (
        f"worse than the baseline shipped by at least {low:.3f} ({100 * (1 - alpha):.4g} %) and at "
        f"most {high:.3f} (95 %)"
    )


def test_on_fresh_starts_evidence_is_that_of_a_panel_without_end(
    make_run: Make, make_bank: Make, run_rows: Make
) -> None:
    pinned = make_run(["a"], 3)
    bank = make_bank(pinned, {"a": [1.0] * 60})
    run = make_run(["a"], 3, panel="fresh", suite={"seed": 77})
    for zeros, evidence, word in (
        (1, 3.7900, "INCONCLUSIVE"),
        (2, 20.3905, "REGRESSED"),  # E_regr (0) 8.8871; (0, 0) 221.7623.
    ):
        found = compare(run_rows(run, {"a": [0.0] * zeros}), run, bank, GATE)
        assert (found.word, found.basis, found.claim) == (word, "fresh", "fresh")
        assert found.scenes[0].evidence == pytest.approx(evidence, abs=5e-5)


def test_a_scene_that_fell_is_named_even_under_pass_and_convicts_if_critical(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    names = [f"s{number:02d}" for number in range(12)]
    run = make_run(names, 20, **WAYS)
    bank = make_bank(run, dict.fromkeys(names, [1.0] * 60))
    scores = {**dict.fromkeys(names, [1.0] * 20), "s03": [0.0] * 20}
    rows = drawn_rows(run, scores)
    gate = Gate(max_drop=0.3, tolerate=0.2, scene_drop=0.1)
    fell = [item for item in compare(rows, run, bank, gate).scenes if item.named]
    assert [(item.scene, item.baseline, item.candidate) for item in fell] == [("s03", 1.0, 0.0)]
    found = compare(rows, run, bank, gate)
    assert found.word == "PASS"
    assert "s03 fell from 1.00 to 0.00, from waypoint 1 on" in found.reasons
    critical = compare(rows, run, bank, gate.model_copy(update={"tiers": {"s03": "critical"}}))
    assert critical.word == "REGRESSED"
    assert critical.reasons[0] == "critical scene s03 fell from 1.00 to 0.00, from waypoint 1 on"
    assert not critical.mean_convicts


def test_a_report_has_the_drops_that_each_scene_s_own_trials_leave_possible(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    names = ["fell", "held", "seen"]
    run = make_run(names, 20, **WAYS)
    bank = make_bank(run, dict.fromkeys(names, [1.0] * 60))
    rows = drawn_rows(run, {**dict.fromkeys(names, [1.0] * 6), "fell": [0.0] * 6})
    gate = Gate(max_drop=0.5, tolerate=0.4, scene_drop=0.1, tiers={"seen": "informational"})
    assert {item.interval for item in compare(rows, run, bank, gate).scenes} == {None}
    found = compare(rows, run, bank, gate, foresee=True)
    fell, held, seen = sorted(found.scenes, key=lambda item: item.scene)
    assert fell.named
    assert fell.interval.low > found.scene_drop
    assert held.interval.low == 0.0
    assert 0.1 < held.interval.high < 1.0
    assert seen.interval is None
    page = baseline_table(found)
    cells = [dict(zip(page.columns, row, strict=True)) for row in page.rows]
    assert cells[0]["each alone"] == f"{fell.interval.low:.2f} to {fell.interval.high:.2f}"
    assert "99 % sure at its low end, 95 % at its high one" in page.note
    assert "each alone" not in baseline_table(found, brief=True).columns


def test_informational_scenes_are_shown_and_count_for_nothing(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run = make_run(["a", "toy"], 20, **WAYS)
    bank = make_bank(run, {"a": [1.0] * 60, "toy": [0.5] * 60})
    rows = drawn_rows(run, {"a": [1.0] * 20, "toy": [0.0] * 20})
    gate = GATE.model_copy(update={"max_drop": 0.2, "tiers": {"toy": "informational"}})
    found = compare(rows, run, bank, gate)
    assert (found.word, found.baseline, found.drop) == ("PASS", 1.0, 0.0)
    toy = found.scenes[1]
    assert (toy.tier, toy.baseline, toy.candidate) == ("informational", 0.5, 0.0)
    assert (toy.evidence, toy.named) == (1.0, False)
    with pytest.raises(IncomparableError, match="all are informational"):
        compare(rows, run, bank, Gate(tiers={"*": "informational"}))


def test_what_is_changed_in_a_scene_makes_strata_of_their_own(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run = make_run(["a"], 20, suite={"perturb": {"friction": (0.6, 1.25)}}, **WAYS)
    icy, dry = ("a", (("friction", 0.6),)), ("a", (("friction", 1.25),))
    bank = make_bank(run, {icy: [0.75] * 60, dry: [1.0] * 60})
    rows = drawn_rows(run, {icy: [0.0] * 20, dry: [1.0] * 20})
    found = compare(rows, run, bank, GATE)
    assert found.word == "REGRESSED"
    assert found.baseline == 0.875
    assert [item.name for item in found.scenes] == ["a friction 0.6", "a friction 1.25"]
    assert found.scenes[0].drop == 0.75
    assert found.scenes[0].evidence > 20
    assert found.scenes[1].evidence < 1


def test_the_policy_of_the_baseline_passes_without_a_trial(make_run: Make, make_bank: Make) -> None:
    run = make_run(["a"], 10, policy=PolicyInfo(
        name="renamed", card_digest="b1" * 32, checkpoint_digest="bb" * 32
    ))  # fmt: skip
    # A class of machine that nobody has checked, few starts and a bad baseline: no matter.
    bank = make_bank(make_run(["a"], 10, engine={**run.engine, "cpu": "other"}), {"a": [0.05] * 5})
    found = compare([], run, bank, GATE)
    assert (found.word, found.basis, found.rounds, found.drop) == ("PASS", "same", 0, None)
    assert found.reasons == ("the same policy as the baseline go1-act-rgb: none run again",)
    assert found.again is not None
    assert not found.again.taken_over, "what no trial has shown is nobody's result"
    other_card = run.model_copy(
        update={"policy": run.policy.model_copy(update={"card_digest": "b2" * 32})}
    )
    with pytest.raises(IncomparableError):
        compare([], other_card, bank, GATE)


@pytest.mark.parametrize(
    "policy",
    [
        PolicyInfo(name="object", card_digest="b1" * 32, checkpoint_digest="unnamed"),
        PolicyInfo(
            name="far",
            adapter="remote",
            card_digest="b1" * 32,
            # Of nothing: the server says not which policy it serves.
            checkpoint_digest="e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
        ),
    ],
)
def test_a_policy_that_nobody_can_identify_is_tested_even_against_itself(
    make_run: Make, make_bank: Make, policy: PolicyInfo
) -> None:
    run = make_run(["a"], 20, policy=policy, **WAYS)
    bank = make_bank(run, {"a": [1.0] * 60})
    named = bank.manifest.policy.model_copy(
        update={"card_digest": policy.card_digest, "checkpoint_digest": policy.checkpoint_digest}
    )
    bank = replace(bank, manifest=bank.manifest.model_copy(update={"policy": named}))
    assert compare([], run, bank, GATE).word == "INCONCLUSIVE"


def test_a_policy_that_failed_by_itself_scores_nothing_wherever_it_got_to(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run = make_run(["a"], 20, **WAYS)
    rows = [
        replace(row, outcome="policy_failed", end_reason="action", error_type="policy_error")
        for row in drawn_rows(run, {"a": [0.75] * 20})
    ]
    bank = make_bank(run, {"a": [0.75] * 60})
    found = compare(rows, run, bank, GATE)
    assert (found.word, found.scenes[0].candidate) == ("REGRESSED", 0.0)
    # A baseline that fails so is scored so: who fails alike is no worse.
    bank = make_bank(run, {"a": [0.75] * 40 + [1.0] * 20}, outcome="policy_failed")
    assert compare(rows, run, bank, GATE).baseline == pytest.approx(1 / 3)


def test_a_trial_without_a_result_helps_no_verdict(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run = make_run(["a", "b"], 20, **WAYS)
    bank = make_bank(run, dict.fromkeys("ab", [1.0] * 60))
    gate = Gate(max_drop=0.3)
    whole = compare(drawn_rows(run, dict.fromkeys("ab", [1.0] * 20)), run, bank, gate)
    holes = {"a": [1.0] * 20, "b": [1.0] * 3 + [None] + [1.0] * 16}
    errored = compare(drawn_rows(run, holes), run, bank, gate)
    assert (whole.word, errored.word) == ("PASS", "PASS")
    assert errored.rounds > whole.rounds > 4
    assert errored.scenes[1].trials == errored.rounds - 1
    # A row that is missing among whole rounds is as one without a result.
    rows = [row for row in drawn_rows(run, holes) if row.status == "ok"]
    assert compare(rows, run, bank, gate) == errored
    none = compare(drawn_rows(run, dict.fromkeys("ab", [None] * 20)), run, bank, gate)
    assert (none.word, none.drop, none.rounds) == ("INCONCLUSIVE", None, 20)


def test_the_waypoint_from_which_a_scene_that_fell_parts_is_named(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run = make_run(["a", "b"], 20, **WAYS)
    bank = make_bank(run, dict.fromkeys("ab", [1.0] * 60))
    rows = drawn_rows(run, {"a": [0.5] * 20, "b": [1.0] * 20})
    found = compare(rows, run, bank, GATE)
    fallen, fine = found.scenes
    # Two of four waypoints were always reached, and the third never: they part there.
    assert (fallen.named or fallen.evidence > 4, fallen.waypoint) == (True, 3)
    assert (fine.named, fine.waypoint) == (False, None)
    assert found.word == "REGRESSED"


def test_what_is_not_decided_says_what_is_known_of_the_drop(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run = make_run(["a"], 20, **WAYS)
    bank = make_bank(run, {"a": [1.0] * 60})
    found = compare(drawn_rows(run, {"a": [1.0] * 9 + [0.5]}), run, bank, GATE)
    assert found.word == "INCONCLUSIVE"
    assert found.interval is not None
    assert found.interval.low < found.tolerate < found.max_drop < found.interval.high
    assert found.reasons[0] == (
        f"the drop from the baseline shipped is 0.050 in 10 rounds, at least "
        f"{found.interval.low:.3f} (99 %) and at most {found.interval.high:.3f} (95 %): 0.1 is not "
        "excluded, more than 0.02 is not shown"
    )
    nothing = compare([], run, bank, GATE)
    assert nothing.reasons == ("not one whole round has run yet against the baseline shipped",)


def test_a_run_of_some_scenes_is_compared_in_those_and_says_so(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    whole = make_run(["a", "b"], 20, **WAYS)
    bank = make_bank(whole, {"a": [1.0] * 60, "b": [0.5] * 60})
    run = make_run(["a"], 20, request=Request(scenes=("a",)), **WAYS)
    found = compare(drawn_rows(run, {"a": [1.0] * 20}), run, bank, GATE)
    assert (found.baseline, found.left_aside) == (1.0, 1)
    assert found.reasons[-1] == (
        "the run was asked for some scenes only: 1 scene of the bank not compared"
    )


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_neither_the_order_of_rows_nor_rows_beyond_whole_rounds_change_anything(
    make_run: Make, make_bank: Make, drawn_rows: Make, data: st.DataObject
) -> None:
    score = st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0])
    panel = st.lists(score, min_size=60, max_size=60)
    run = make_run(["a", "b"], 20, **WAYS)
    scores = {"a": data.draw(panel), "b": data.draw(panel)}
    bank = make_bank(run, {"a": [1.0] * 20 + scores["a"][20:], "b": scores["b"]})
    rounds = data.draw(st.integers(0, 19))
    rows = drawn_rows(run, {name: values[:rounds] for name, values in scores.items()})
    found = compare(rows, run, bank, GATE)
    beyond = drawn_rows(run, {"a": scores["a"][: rounds + 1], "b": scores["b"][:rounds]})
    shuffled = data.draw(st.permutations(beyond))
    again = compare(shuffled, run, bank, GATE)
    assert again.reasons == (*found.reasons, "1 trial beyond whole rounds not compared")
    assert replace(again, reasons=()) == replace(found, reasons=())


def test_the_first_starts_of_a_panel_speak_of_fresh_starts_only_and_say_so(
    make_run: Make, make_bank: Make, run_rows: Make
) -> None:
    run = make_run(["a", "b", "c"], 15)
    perfect = {name: [1.0] * 15 for name in "abc"}
    bank = make_bank(run, {name: [1.0] * 45 for name in "abc"})
    found = compare(run_rows(run, perfect), run, bank, GATE)
    assert (found.word, found.claim) == ("PASS", "fresh")
    assert "the order of the starts was not drawn for this candidate" in found.reasons[-1]
    # They are taken in the order of the draw, not as they are numbered.
    order = draw_starts([("a", ())], 45, candidate=run.drawn_by, suite_digest=run.suite_digest)
    first = next(start for start in order["a", ()] if start < 15)
    failed = {**perfect, "a": [0.0 if start == first else 1.0 for start in range(15)]}
    strict = GATE.model_copy(update={"false_alarm": 0.45})
    early = compare(run_rows(run, failed), run, bank, strict)
    assert (early.word, early.rounds, early.scenes[0].candidate) == ("REGRESSED", 1, 0.0)


def test_no_claim_about_fresh_starts_takes_a_small_bank_for_all_there_is(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    # Six starts, two rounds. Of these six the drop could be .1 only if all but none of the rest
    # failed: one failure made that "impossible", and the scene was named beyond doubt.
    run = make_run("ab", 2, drawn_from=6)
    bank = make_bank(run, {"a": [1.0] * 6, "b": [1.0] * 6})
    found = compare(drawn_rows(run, {"a": [0.0, 1.0], "b": [1.0, 1.0]}), run, bank, GATE)
    assert found.claim == "panel and fresh"
    assert (found.word, [item.named for item in found.scenes]) == ("INCONCLUSIVE", [False, False])
    assert found.scenes[0].evidence < 4.0
    # With as many rounds as starts the claim is of these starts alone, and of them it is so.
    all_of_them = make_run("ab", 6, drawn_from=6)
    rows = drawn_rows(all_of_them, {"a": [0.0, *[1.0] * 5], "b": [1.0] * 6})
    known = compare(rows, all_of_them, bank, GATE)
    assert (known.claim, known.scenes[0].named) == ("panel", True)


def test_a_bank_with_too_few_starts_says_how_many_to_save(make_run: Make, make_bank: Make) -> None:
    def fails(bank: SavedBank, run: RunInfo, words: str, starts: int) -> None:
        with pytest.raises(IncomparableError, match=words) as caught:
            compare([], run, bank, GATE)
        assert caught.value.exit_code == 5
        command = f"nw-eval baseline save hurdles --policy go1-act-rgb --starts {starts}"
        assert command in str(caught.value)

    drawn = make_run(["a"], 20, drawn_from=10)
    bank = make_bank(drawn, {"a": [1.0] * 10})
    fails(bank, drawn, "has 10 starts in each scene; 20 rounds need 20", 20)
    few = make_bank(drawn, {"a": [1.0] * 40})
    found = compare([], make_run(["a"], 20, drawn_from=40), few, GATE)
    assert found.claim == "panel"
    assert "this speaks of the bank's 40 starts in each scene only" in found.reasons[-1]
    fails(few, make_run(["a"], 20), "20 rounds need 60 .3 for each", 60)
    fails(few, make_run(["a"], 20, panel="fresh", suite={"seed": 1}), "need 60", 60)


def test_a_baseline_that_nobody_can_fall_short_of_is_refused(
    make_run: Make, make_bank: Make
) -> None:
    run = make_run(["a"], 20, **WAYS)
    with pytest.raises(IncomparableError, match=r"mean success is 0.100: no policy can be worse"):
        compare([], run, make_bank(run, {"a": [0.1] * 60}), GATE)


def test_on_another_class_of_machine_the_baseline_must_have_been_checked(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    here = make_run(["a"], 20, **WAYS)
    bank = make_bank(here, {"a": [1.0] * 60})
    run = make_run(["a"], 20, engine={**here.engine, "cpu": "haswell"}, **WAYS)
    rows = drawn_rows(run, {"a": [1.0] * 20})
    with pytest.raises(IncomparableError, match=r"cpu haswell, the bank's zen 4"):
        compare(rows, run, bank, GATE)
    alike = compare(rows, run, bank, GATE, checked="bits")
    assert (alike.basis, alike.claim) == ("panel", "panel and fresh")
    in_line = compare(rows, run, bank, GATE, checked="scores")
    assert (in_line.basis, in_line.claim) == ("sample", "fresh")
    assert in_line.word == alike.word == compare(rows, here, bank, GATE).word


def test_rows_that_are_not_of_the_run_are_refused(
    make_run: Make, make_bank: Make, drawn_rows: Make
) -> None:
    run = make_run(["a"], 20, **WAYS)
    bank = make_bank(run, {"a": [1.0] * 60})
    rows = drawn_rows(run, {"a": [1.0] * 3})
    with pytest.raises(StoreError, match="appears twice"):
        compare([*rows, rows[1]], run, bank, GATE)
    with pytest.raises(StoreError, match="its checkpoint is 77777777, not cccccccc"):
        compare([replace(rows[0], checkpoint_digest="77" * 32)], run, bank, GATE)
    with pytest.raises(StoreError, match="it is the baseline's"):
        compare([replace(rows[0], arm="baseline")], run, bank, GATE)
    with pytest.raises(StoreError, match="the run has no b"):
        compare([replace(rows[0], scene="b")], run, bank, GATE)
