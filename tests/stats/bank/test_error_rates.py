"""Errors at the margins: the table of docs/gate.md, and the code that it speaks of."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from error_rates import (
    CAMPAIGNS,
    FALLS,
    NOMINAL,
    PASS_AT,
    STARTS,
    error_rates,
    in_random_order,
    panel,
)
from measured import SEEN
from record_gate_page import ERRORS, recorded

from nw_eval.stats.bank import GateRules, Margins, drop_interval, over_rounds
from nw_eval.stats.bank.simulate import chances_of, draw, judge_all, success_of

TABLE = [
    (name, int(starts), *(float(share.removesuffix(" %")) / 100 for share in shares))
    for name, starts, *shares in recorded(ERRORS)
]


def most(share: float, times: int) -> float:
    """What a share may look like after so many simulations."""
    return share + 3 * sqrt(share * (1 - share) / times)


def test_the_table_shows_no_more_errors_than_a_bank_of_thrice_the_rounds_promises() -> None:
    assert len(TABLE) == len(FALLS) + 5
    for name, starts, passed, regressed in TABLE:
        # A bank that is used up knows its own drop, and nothing of fresh starts.
        if name != "fresh starts" or starts >= 60:
            assert max(passed, regressed) <= NOMINAL
    small = [max(shares) for name, starts, *shares in TABLE if starts == 10]
    assert small == [pytest.approx(0.5, abs=0.05)]


@pytest.mark.nightly
def test_the_table_is_what_the_code_does() -> None:
    for found, written in zip(error_rates(), TABLE, strict=True):
        assert found[:2] == written[:2]
        assert found[2:] == pytest.approx(written[2:], abs=0.001), found


@pytest.mark.nightly
@pytest.mark.parametrize("fall", FALLS.values(), ids=lambda fall: fall.__name__)
def test_the_interval_covers_the_drop_at_every_look(fall) -> None:
    baseline = panel()
    campaigns = in_random_order(baseline, fall(baseline, PASS_AT))
    errors, times = np.zeros(2), 100
    for candidate, known in zip(campaigns.candidate[:times], campaigns.baseline, strict=False):
        looks = [
            drop_interval(
                campaigns.bank, candidate[:r], known[:r], alpha_pass=NOMINAL, alpha_regr=NOMINAL
            )
            for r in (1, 2, 4, 8, 14, 20)
        ]
        errors += [
            any(campaigns.drop > look.high + 1e-7 for look in looks),
            any(campaigns.drop < look.low - 1e-7 for look in looks),
        ]
    assert (errors / times <= most(NOMINAL, times)).all(), errors


@pytest.mark.nightly
def test_scenes_that_are_just_within_their_margin_are_hardly_ever_named() -> None:
    baseline = np.ones((16, STARTS))
    candidate = baseline.copy()
    candidate[:, :6] = 0.0
    campaigns = in_random_order(baseline, candidate)
    rounds = over_rounds(
        campaigns.bank, campaigns.candidate, campaigns.baseline, Margins(scene_drop=0.10)
    )
    highest = np.max([values.scenes for values in rounds], axis=0)
    assert (highest >= 16 / 0.01).any(axis=1).mean() <= most(0.01, CAMPAIGNS)


@pytest.mark.nightly
def test_pass_waits_for_no_scene_that_is_named_and_errs_no_more_often_for_it() -> None:
    # One scene of sixteen falls to half, 1 -> .5; the mean by .03. Where PASS waited for scenes
    # that are named too, 70 % of such policies were left open after 249 trials.
    drawn = draw(SEEN, starts=STARTS, rounds=20, repetitions=2000)
    chances = chances_of(SEEN, success_of(SEEN))
    chances[15] = 0.741  # Four waypoints: p + p^2 + p^3 + p^4 = 2.
    rules = GateRules(tiers=("supporting",) * 16)
    ended = judge_all(drawn, chances, rules)
    assert (ended.passed > 0).mean() == pytest.approx(0.96, abs=0.02)
    assert (ended.named > 0).mean() == pytest.approx(0.72, abs=0.04)
    assert 16 * ended.rounds.mean() == pytest.approx(151, rel=0.05)
    # Such a scene, and a mean that drops by just what must not pass.
    low, high = 0.0, success_of(SEEN)
    for _ in range(40):
        middle = (low + high) / 2
        worse = chances_of(SEEN, middle)
        worse[15] = 0.741
        drops = success_of(SEEN) - _success(worse)
        low, high = (middle, high) if drops > PASS_AT else (low, middle)
    ended = judge_all(drawn, worse, rules)
    assert (ended.passed > 0).mean() <= NOMINAL


def _success(chances: np.ndarray) -> float:
    drawn = draw(SEEN, starts=1, rounds=1, repetitions=1)
    reached = [
        np.mean(chance ** np.arange(1, waypoints + 1))
        for chance, waypoints in zip(chances, drawn.waypoints, strict=True)
    ]
    return float(np.mean(reached))
