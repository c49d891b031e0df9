from __future__ import annotations

import numpy as np
import pytest

from nw_eval.stats.bank import Bank, Margins, Values, decide, over_rounds


def values(passed: float, regressed: float, *scenes: float) -> Values:
    return Values(np.array(passed), np.array(regressed), np.array(scenes))


def two(*tiers: str) -> list:
    return list(tiers or ("supporting", "supporting"))


def test_before_the_first_round_nothing_is_decided() -> None:
    ruling = decide([], two())
    assert (ruling.word, ruling.rounds, ruling.named) == ("undecided", 0, ())


def test_evidence_must_reach_one_over_alpha() -> None:
    assert decide([values(19.9, 99.9, 1, 1)], two()).word == "undecided"
    assert decide([values(20.0, 1.0, 1, 1)], two()).word == "PASS"
    assert decide([values(1.0, 100.0, 1, 1)], two()).word == "REGRESSED"
    assert decide([values(20.0, 1.0, 1, 1)], two(), alpha_pass=0.01).word == "undecided"
    assert decide([values(1.0, 20.0, 1, 1)], two(), alpha_regr=0.05).word == "REGRESSED"


def test_the_first_round_that_settles_it_does_whatever_comes_after() -> None:
    rounds = [values(2, 1, 1, 1), values(30, 1, 1, 1), values(5, 500, 1, 999)]
    ruling = decide(rounds, two())
    assert (ruling.word, ruling.rounds, ruling.named) == ("PASS", 2, ())


def test_a_round_that_would_do_both_convicts() -> None:
    assert decide([values(1e6, 1e6, 1, 1)], two()).word == "REGRESSED"


def test_pass_waits_while_a_scene_is_suspect() -> None:
    rounds = [values(30, 1, 1, 4.0), values(40, 1, 1, 5.0)]
    held = decide(rounds, two())
    assert (held.word, held.rounds, held.waits_for, held.named) == ("undecided", 2, (1,), ())
    cleared = decide([*rounds, values(50, 1, 1, 3.9)], two())
    assert (cleared.word, cleared.rounds, cleared.waits_for) == ("PASS", 3, ())
    # A suspect scene holds back nothing where the mean alone would not pass.
    assert decide([values(10, 1, 1, 5.0)], two()).waits_for == ()


def test_a_scene_is_named_at_the_shared_error_and_stays_named_under_pass() -> None:
    # Two scenes at .01: each must reach 200.
    assert decide([values(1, 1, 199.0, 1)], two()).named == ()
    rounds = [values(1, 1, 200.0, 1), values(30, 1, 3.0, 1)]
    assert decide(rounds[:1], two()).named == (0,)
    ruling = decide(rounds, two())
    assert (ruling.word, ruling.named) == ("PASS", (0,))


def test_a_critical_scene_that_is_named_convicts_alone() -> None:
    rounds = [values(30, 0.1, 1, 200.0)]
    spared = decide(rounds, two("critical", "supporting"))
    assert (spared.word, spared.named) == ("PASS", (1,))
    ruling = decide(rounds, two("supporting", "critical"))
    assert (ruling.word, ruling.named) == ("REGRESSED", (1,))


def test_pass_waits_for_a_suspect_and_no_longer_for_a_scene_that_is_named() -> None:
    held = [values(30, 1, 1, 4.0), values(30, 1, 1, 199.0)]
    assert decide(held, two()).waits_for == (1,)
    ruling = decide([*held, values(30, 1, 1, 200.0)], two())
    assert (ruling.word, ruling.rounds, ruling.named, ruling.waits_for) == ("PASS", 3, (1,), ())
    # Another scene is still waited for.
    both = decide([*held, values(30, 1, 4.0, 200.0)], two())
    assert (both.word, both.named, both.waits_for) == ("undecided", (1,), (0,))


def test_an_unchanged_policy_passes_and_a_scene_that_broke_is_named() -> None:
    baseline = np.full((16, 60), 0.9)
    bank = Bank.of(baseline)
    ones = np.full((20, 16), 0.9)
    unchanged = decide(over_rounds(bank, ones, ones, Margins()), ["supporting"] * 16)
    assert unchanged.word == "PASS"
    assert unchanged.rounds < 10
    broken = ones.copy()
    broken[:, 3] = 0.0
    rounds = over_rounds(bank, broken, ones, Margins())
    assert decide(rounds, ["supporting"] * 16).named == (3,)
    critical = ["supporting"] * 3 + ["critical"] + ["supporting"] * 12
    assert decide(rounds, critical).word == "REGRESSED"


def test_scenes_that_are_not_judged_are_refused() -> None:
    with pytest.raises(ValueError, match="scene 1 is informational"):
        decide([values(1, 1, 1, 1)], two("critical", "informational"))


def test_tiers_of_other_scenes_are_refused() -> None:
    with pytest.raises(ValueError, match="3 tiers for scenes of shape"):
        decide([values(1, 1, 1, 1)], ["supporting"] * 3)


@pytest.mark.parametrize("alphas", [{"alpha_pass": 0.0}, {"alpha_regr": 5.0}])
def test_alphas_that_are_no_probabilities_are_refused(alphas: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"write 0\.05 for 5 %"):
        decide([], two(), **alphas)
