"""What further rounds may bring to a run that was not decided, and whether they do."""

from __future__ import annotations

from math import nan

import numpy as np
import pytest

from nw_eval.stats.bank import (
    Bank,
    Evidence,
    GateRules,
    Margins,
    Progress,
    progress_after,
    rounds_for,
)

SCENES, STARTS = 8, 60
RULES = GateRules(tiers=("supporting",) * SCENES)
rng = np.random.default_rng(12)
BASELINE = (rng.random((STARTS, SCENES, 4)) < 0.98).cumprod(-1).sum(-1) / 4
BANK = Bank.of(BASELINE.T)


def scores(chance: float, rounds: int, seed: int = 1) -> np.ndarray:
    luck = np.random.default_rng(seed).random((rounds, SCENES, 4))
    return (luck < chance).cumprod(-1).sum(-1) / 4


def after(candidate: np.ndarray, rules: GateRules = RULES, **known: tuple[int, ...]) -> Progress:
    return progress_after(
        BANK, candidate, BASELINE, rules, waypoints=[4] * SCENES, repetitions=300, **known
    )


def test_each_round_that_is_left_has_its_chance() -> None:
    found = after(scores(0.98, 5))
    assert len(found.passed) == len(found.regressed) == STARTS - 5
    assert list(found.settled) == sorted(found.settled)
    assert found == after(scores(0.98, 5))
    assert after(scores(0.98, STARTS)).settled == ()


def test_a_good_run_will_likely_pass_and_a_bad_one_be_convicted() -> None:
    good, bad = after(scores(0.97, 2)), after(scores(0.85, 3))
    assert good.passed[-1] > 0.9
    assert bad.regressed[-1] > 0.9
    soon, late = rounds_for(good.passed, 0.5), rounds_for(good.passed, 0.9)
    assert soon is not None
    assert late is not None
    assert soon < late


def test_the_evidence_so_far_counts() -> None:
    # After ten good rounds the next one nearly surely passes; after none it does not.
    ten = after(scores(1.0, 10))
    assert ten.passed[0] > 0.9 > after(scores(1.0, 2)).passed[0]
    evidence = Evidence.before(BANK, Margins())
    for candidate, baseline in zip(scores(1.0, 10), BASELINE, strict=False):
        evidence = evidence.after(candidate, baseline)
    assert evidence.values.passed > 20.0


def test_a_scene_that_is_named_already_holds_back_no_pass() -> None:
    candidate = scores(1.0, 6)
    candidate[:, 0] = 0.5
    rules = GateRules(tiers=RULES.tiers, margins=Margins(max_drop=0.3, tolerate=0.1))
    free, held = after(candidate, rules, named=(0,)), after(candidate, rules)
    assert free.passed[0] > held.passed[0] + 0.3


def test_of_what_is_missing_nothing_is_learnt() -> None:
    gap = scores(0.98, 5)
    gap[2, 3] = nan
    assert after(gap).passed[4] < after(scores(0.98, 5)).passed[4] + 0.1
    assert after(np.full((3, SCENES), nan)).passed[-1] < 0.9
    with pytest.raises(ValueError, match=r"success 2\.0"):
        after(np.full((3, SCENES), 2.0))
