"""What a ledger's verdicts are worth together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from nw_eval.cli.verbs.ledger import ledger_page
from nw_gate.ledger_report import ledger_report

if TYPE_CHECKING:
    from nw_gate.ledger import LedgerEntry


def test_false_alarms_are_at_most_the_sum_of_what_each_test_was_set_to(make_entry):
    report = ledger_report([make_entry(days=day, checkpoint=day) for day in range(101)])
    assert report.against_baselines.tests == 101
    assert report.against_baselines.regressed == pytest.approx(1.01)
    assert report.against_baselines.passed == pytest.approx(5.05)
    assert report.against_bars.tests == 0
    assert report.per_year == pytest.approx(365.25)
    page = ledger_page(report)
    assert "from 2026-11-01 to 2027-02-09: 365 gates a year at this rate" in page
    assert "1 false REGRESSED (3.7 a year) if no candidate is worse than is tolerated" in page
    assert "5 false PASS if every candidate is worse by max_drop" in page


def test_a_bar_with_critical_scenes_convicts_wrongly_twice_as_often(make_entry):
    plain = make_entry(bar=0.75, baseline=None)
    alone = tuple(scene.model_copy(update={"alone": True}) for scene in plain.seen)
    critical = make_entry(bar=0.75, baseline=None, seen=alone, checkpoint=1)
    assert ledger_report([plain]).against_bars.regressed == pytest.approx(0.05)
    assert ledger_report([critical]).against_bars.regressed == pytest.approx(0.10)
    assert ledger_report([critical]).against_bars.passed == pytest.approx(0.05)


def test_critical_scenes_of_a_baseline_convict_wrongly_up_to_twice_as_often(make_entry):
    baseline = make_entry().baseline
    for critical, expected in ((0, 0.01), (1, 0.0125), (4, 0.02)):
        against = baseline.model_copy(update={"scenes": 4, "critical": critical})
        report = ledger_report([make_entry(baseline=against)])
        assert report.against_baselines.regressed == pytest.approx(expected)
    # An older ledger says of each scene that was seen whether it convicts alone.
    alone = tuple(scene.model_copy(update={"alone": True}) for scene in make_entry().seen)
    older = ledger_report([make_entry(seen=alone)])
    assert older.against_baselines.regressed == pytest.approx(0.02)


def test_gated_scores_convict_wrongly_too_and_share_the_error_of_success(make_entry):
    half = make_entry().baseline.model_copy(update={"alpha_regr": 0.005})
    power = {"mean_power": (None, 60.0, 0.0, 300.0)}
    report = ledger_report([make_entry(baseline=half, scores=power)])
    assert report.against_baselines.regressed == pytest.approx(0.01)
    barred = make_entry(baseline=None, scores={"mean_power": (90.0, None, 0.0, 300.0)})
    assert ledger_report([barred]).against_bars.regressed == pytest.approx(0.05)


def test_scenes_that_were_picked_after_a_look_are_a_test_of_their_own(make_entry):
    all_four = dict.fromkeys("abcd", "supporting")
    first = make_entry(word="REGRESSED", tiers=all_four)
    picked = make_entry(days=1, tiers={"a": "supporting", "b": "supporting"})
    eased = make_entry(days=2, tiers={**all_four, "d": "informational"})
    looser = first.baseline.model_copy(update={"scene_drop": 0.3})
    margin = make_entry(days=3, tiers=all_four, baseline=looser)
    report = ledger_report([first, picked, eased, margin])
    assert report.judged_again == 0
    assert report.rerolls[0].tests == 4
    assert report.rerolls[0].words == ("REGRESSED", "PASS", "PASS", "PASS")


def test_exports_of_one_network_are_one_candidate(make_entry):
    entries = [
        make_entry(days=day, checkpoint=day, computes="cc" * 32, panel="pinned") for day in range(4)
    ]
    report = ledger_report(entries)
    assert (report.judged_again, report.rerolls, report.best_of_many) == (3, (), ())
    tries = [
        each.model_copy(update={"suite_digest": f"{day:064x}"}) for day, each in enumerate(entries)
    ]
    (reroll,) = ledger_report(tries).rerolls
    assert (reroll.tests, reroll.exports) == (4, 4)
    assert "step-3 (00000000) on hurdles, 4 exports of one policy: 4 tests" in ledger_page(
        ledger_report(tries)
    )


def test_candidates_that_went_the_same_way_from_every_start_they_share_are_one(make_entry):
    def told(number: int, **ways: str) -> LedgerEntry:
        return make_entry(
            days=number, checkpoint=number, computes=f"{number:064x}", trajectories=ways
        )

    first = told(1, a="w1", b="w2", c="w3")
    same = told(2, b="w2", c="w3", d="w4")
    differs = told(3, a="w1", b="other")
    apart = told(4, e="w1")
    report = ledger_report([first, same, differs, apart])
    (reroll,) = report.rerolls
    assert (reroll.digest, reroll.tests, reroll.exports) == (first.candidate_digest, 2, 2)
    assert report.judged_again == 0, "each was drawn in an order of its own"
    (best,) = report.best_of_many
    assert best.candidates == 3


def test_a_verdict_of_an_older_version_is_of_the_candidate_with_its_files(make_entry):
    older = make_entry(word="REGRESSED")
    newer = make_entry(days=1, computes="cc" * 32)
    again = make_entry(days=2, checkpoint=7, computes="cc" * 32, suite_digest="ab" * 32)
    (reroll,) = ledger_report([older, newer, again]).rerolls
    assert (reroll.tests, reroll.exports) == (3, 2)


def test_what_chance_has_no_part_in_is_no_test(make_entry):
    same = make_entry().baseline.model_copy(update={"basis": "same"})
    entries = [
        make_entry(baseline=same),
        make_entry(word="INFRASTRUCTURE", checkpoint=1),
        make_entry(word="INVALID", checkpoint=2),
    ]
    report = ledger_report(entries)
    assert (report.entries, report.against_baselines.tests) == (3, 0)
    assert report.against_baselines.regressed == 0.0


def test_judging_the_same_trials_again_is_no_reroll_and_another_panel_or_rule_is(make_entry):
    first = make_entry(word="REGRESSED")
    again = make_entry(word="REGRESSED", days=1, run="resumed", trials=80)
    report = ledger_report([first, again])
    assert (report.judged_again, report.rerolls) == (1, ())
    looser = first.baseline.model_copy(update={"max_drop": 0.2})
    tries = [
        first,
        make_entry(word="INCONCLUSIVE", days=1, suite_digest="ab" * 32),
        make_entry(word="PASS", days=2, baseline=looser),
    ]
    (reroll,) = ledger_report(tries).rerolls
    assert reroll.tests == 3
    assert reroll.words == ("REGRESSED", "INCONCLUSIVE", "PASS")
    assert reroll.false_regressed == pytest.approx(0.03)
    assert reroll.false_passed == pytest.approx(0.15)
    page = ledger_page(ledger_report(tries))
    assert "step-0 (00000000) on hurdles: 3 tests (1 REGRESSED, 1 INCONCLUSIVE, 1 PASS)" in page
    assert "REGRESSED at most 3 %, PASS at most 15 %" in page


def test_another_rule_for_a_score_is_another_test(make_entry):
    plain, gated = make_entry(), make_entry(scores={"mean_power": (None, 60.0, 0.0, 300.0)})
    again = make_entry(days=1.0, scores={"mean_power": (None, 60.0, 0.0, 300.0)})
    wider = make_entry(scores={"mean_power": (None, 80.0, 0.0, 300.0)})
    assert gated.test == again.test
    assert len({plain.test, gated.test, wider.test}) == 3


def test_with_bar_and_baseline_either_convicts_and_both_must_pass(make_entry):
    tries = [make_entry(bar=0.75), make_entry(bar=0.75, suite_digest="ab" * 32)]
    (reroll,) = ledger_report(tries).rerolls
    assert reroll.false_regressed == pytest.approx(2 * (0.05 + 0.01))
    assert reroll.false_passed == pytest.approx(2 * 0.05)


def test_the_best_of_many_on_one_panel_shows_more_than_it_is(make_entry):
    entries = [
        make_entry(checkpoint=number, bar=0.75, success=0.9 + 0.01 * (number == 3))
        for number in range(8)
    ]
    (best,) = ledger_report(entries).best_of_many
    assert (best.candidates, best.best, best.shown) == (8, "step-3", 0.91)
    assert best.digest == entries[3].candidate_digest
    # Eight normal draws of standard deviation .3 / sqrt(40): 1.42 times that, less for the limit 1.
    assert 0.03 < best.overstated < 0.07
    assert best.any_passes is not None
    assert best.any_passes < 0.05 * 8
    page = ledger_page(ledger_report(entries))
    assert f"of 8 candidates the best, step-3 ({best.digest[:8]}), shows 0.910" in page
    assert "`--seed-set fresh` confirms the chosen one" in page
    assert ledger_report(entries[:1]).best_of_many == ()


def test_candidates_on_panels_of_their_own_are_no_choice(make_entry):
    entries = [
        make_entry(checkpoint=number, panel="fresh", suite_digest=f"{number:064x}")
        for number in range(3)
    ]
    assert ledger_report(entries).best_of_many == ()


def test_an_empty_ledger_says_so_and_a_short_one_foretells_no_year(make_entry):
    assert ledger_page(ledger_report([])) == "no verdicts"
    headed = ledger_page(ledger_report([make_entry()], head="0123456789abcdef"))
    assert headed.endswith(
        "head 0123456789abcdef: kept elsewhere, --head shows later whether the end was cut off"
    )
    short = ledger_report([make_entry(), make_entry(days=2, checkpoint=1)])
    assert short.per_year is None
    assert "too few days to estimate the gates of a year" in ledger_page(short)
