"""A candidate's limit is judged by a baseline's, by a fixed one, or by both."""

from itertools import product

import numpy as np
import pytest

from nw_base.errors import IncomparableError, UsageError
from nw_gate import Ladder, LimitGate, LimitMargins, find_limit
from nw_gate.limits.against import Claims
from nw_gate.limits.wealth import Wealth

STEPS = Ladder(name="step", unit="m", rungs=tuple(0.02 * i for i in range(1, 13)))
FALLS = Ladder(name="clearance", unit="m", rungs=tuple(0.6 - 0.02 * i for i in range(12)))


def cliff(limit):
    return lambda trial: trial.rung <= limit


def baseline(limit=7, ladder=STEPS, **options):
    options = {"confidence": LimitMargins(max_drop=1.0).baseline_confidence, **options}
    return find_limit(ladder, cliff(limit), **options)


def judged(margins, policy, **options):
    gate = LimitGate(margins, **options)
    while (trial := gate.next) is not None:
        gate.tell(trial, policy(trial))
    return gate.verdict


@pytest.mark.parametrize(
    ("limit", "word"), [(8, "PASS"), (7, "PASS"), (4, "REGRESSED"), (-1, "REGRESSED")]
)
@pytest.mark.parametrize("ladder", [STEPS, FALLS], ids=["rises", "falls"])
def test_a_cliff_is_judged_by_where_it_lies(limit, word, ladder):
    found = judged(LimitMargins(max_drop=0.04), cliff(limit), baseline=baseline(ladder=ladder))
    assert found.word == word
    assert len(found.candidate.trials) <= 20


def test_the_verdict_says_both_limits_in_units():
    found = judged(LimitMargins(max_drop=0.04), cliff(3), baseline=baseline(width=1))
    assert found.sentence.startswith("step: the limit is lower than the baseline's, shown by ")
    assert "(baseline 0.16 m, not 0.18 m; candidate" in found.sentence


@pytest.mark.parametrize("ladders", [1, 2, 5])
def test_a_baseline_as_sure_as_the_margins_ask_lets_a_worse_candidate_be_regressed(ladders):
    margins = LimitMargins(max_drop=0.04, ladders=ladders)
    sure = baseline(confidence=margins.baseline_confidence)
    assert judged(margins, cliff(3), baseline=sure).word == "REGRESSED"


def test_a_baseline_with_too_little_evidence_is_said_to_lack_it():
    found = judged(LimitMargins(max_drop=0.04), cliff(3), baseline=baseline(confidence=0.9), most=9)
    assert found.word == "INCONCLUSIVE"
    assert "find its limit at a confidence of 0.9950" in found.sentence


def test_trials_run_around_the_limit_of_the_baseline_and_from_other_starts():
    saved = baseline()
    gate = LimitGate(LimitMargins(max_drop=0.04), baseline=saved)
    while (trial := gate.next) is not None:
        assert trial.number >= saved.tried[trial.rung]
        assert 3 <= trial.rung <= 10
        gate.tell(trial, trial.rung <= 7)
    with pytest.raises(UsageError, match="not asked for"):
        gate.tell((saved.trials[0][0], 0), True)


@pytest.mark.parametrize(("limit", "word"), [(7, "PASS"), (4, "PASS"), (3, "REGRESSED")])
def test_a_fixed_limit_needs_no_baseline(limit, word):
    found = judged(LimitMargins(at_least=0.10), cliff(limit), ladder=STEPS)
    assert (found.word, found.baseline) == (word, None)
    assert "0.1 m" in found.sentence


def test_on_a_falling_ladder_the_fixed_limit_is_the_largest_that_passes():
    margins = LimitMargins(at_least=0.5)
    assert judged(margins, cliff(5), ladder=FALLS).word == "PASS"
    found = judged(margins, cliff(4), ladder=FALLS)
    assert (found.word, "above 0.5 m" in found.sentence) == ("REGRESSED", True)


def test_a_pass_needs_both_and_either_makes_it_regressed():
    both = LimitMargins(max_drop=0.04, at_least=0.18)
    assert judged(both, cliff(8), baseline=baseline()).word == "PASS"
    assert judged(both, cliff(7), baseline=baseline()).word == "REGRESSED"
    assert judged(LimitMargins(max_drop=0.04), cliff(7), baseline=baseline()).word == "PASS"


def test_a_drop_that_is_tolerated_is_not_regressed():
    margins = LimitMargins(max_drop=0.08, tolerate=0.06)
    assert judged(margins, cliff(5), baseline=baseline(width=1)).word == "PASS"
    assert judged(LimitMargins(max_drop=0.08), cliff(5), baseline=baseline(width=1)).word != (
        "INCONCLUSIVE"
    )
    assert judged(margins, cliff(2), baseline=baseline(width=1)).word == "REGRESSED"


def test_a_candidate_at_the_share_stays_inconclusive():
    flip = lambda trial: trial.number % 2 == 0  # noqa: E731
    found = judged(LimitMargins(at_least=0.1), flip, ladder=STEPS, most=40)
    assert (found.word, len(found.candidate.trials)) == ("INCONCLUSIVE", 40)
    assert "40 trials do not settle the limit" in found.sentence


def test_a_baseline_that_clears_nothing_cannot_be_fallen_short_of():
    found = judged(LimitMargins(max_drop=0.02), cliff(-1), baseline=baseline(-1), most=40)
    assert found.word != "REGRESSED"


def test_ladders_and_claims_share_the_false_alarm():
    assert LimitMargins(max_drop=1.0).alpha_regressed == 0.01
    assert LimitMargins(max_drop=1.0, at_least=2.0, ladders=5).alpha_regressed == 0.001
    one, many = (
        judged(LimitMargins(max_drop=0.04, ladders=n), cliff(2), baseline=baseline())
        for n in (1, 8)
    )
    assert len(one.candidate.trials) < len(many.candidate.trials)


def test_a_verdict_has_its_e_value_for_every_limit_that_the_baseline_may_have():
    saved, ladder = baseline(width=2), STEPS
    margins = LimitMargins(max_drop=0.04, tolerate=0.02)
    claims = Claims.of(ladder, margins, saved)
    failed, cleared = np.exp(saved.wealth.failed[0]), np.exp(saved.wealth.cleared[0])
    rng = np.random.default_rng(0)
    seen = set()
    for scale in product((0.0, 4.0, 8.0), repeat=2):
        wealth = Wealth.at_start(1, 12)
        wealth.most_cleared[0] = scale[0] * (0.7 + 0.3 * rng.random(12))
        wealth.most_failed[0] = scale[1] * (0.7 + 0.3 * rng.random(12))
        won, lost = np.exp(wealth.most_cleared[0]), np.exp(wealth.most_failed[0])
        # Two rungs lower and one rung lower, by the formulas of the module.
        passes = [(1 + failed[I]) / 2 * won[max(0, I - 2)] for I in range(12)]
        falls = [(1 + (cleared[I + 1] if I < 11 else 1.0)) / 2 * lost[I - 1] for I in range(1, 12)]
        known = (1 + cleared[:2]) / 2  # The limit is below rung 0, or rung 0: nothing is lower.
        word = "INCONCLUSIVE"
        if min(falls) >= 100 and known.min() >= 100:
            word = "REGRESSED"
        if min(passes) >= 20:
            word = "PASS"
        assert claims.word(wealth) == word
        seen.add(word)
    assert seen == {"PASS", "REGRESSED", "INCONCLUSIVE"}


@pytest.mark.parametrize(
    "margins",
    [
        {},
        {"max_drop": 0.1, "tolerate": 0.2},
        {"max_drop": -1.0},
        {"max_drop": 0.1, "false_alarm": 0.0},
        {"max_drop": 0.1, "confidence": 1.0},
        {"at_least": 1.0, "ladders": 0},
    ],
)
def test_margins_that_do_not_fit_are_refused(margins):
    with pytest.raises(UsageError):
        LimitMargins(**margins)


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(IncomparableError, match="no baseline"):
        LimitGate(LimitMargins(max_drop=1.0), ladder=STEPS)
    with pytest.raises(IncomparableError, match="another ladder"):
        LimitGate(LimitMargins(max_drop=1.0), ladder=FALLS, baseline=baseline())
    with pytest.raises(UsageError, match="no ladder"):
        LimitGate(LimitMargins(at_least=1.0))
    with pytest.raises(UsageError, match=r"at_least 1 m is beyond .* 0.24 m"):
        LimitGate(LimitMargins(at_least=1.0), ladder=STEPS)
