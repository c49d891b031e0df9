"""What further trials may bring to a run that was not decided, and whether they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nw_gate.stats.bank.curve import Progress, progress_from, trials_for
from nw_gate.stats.bank.evidence import Bank, Margins
from nw_gate.stats.bank.trials import DrawnTrials, TrialRules, settle

SCENES, STARTS = 8, 60
ALL = SCENES * STARTS
RULES = TrialRules(tiers=("supporting",) * SCENES)
rng = np.random.default_rng(12)
BASELINE = (rng.random((SCENES, STARTS, 4)) < 0.98).cumprod(-1).sum(-1) / 4
BANK = Bank.of(BASELINE)
ORDER = rng.permutation(ALL)


def run(chance: float, count: int, seed: int = 1) -> DrawnTrials:
    """All trials in the order drawn, of which the first have ended."""
    luck = np.random.default_rng(seed).random((ALL, 4))
    candidate = (luck < chance).cumprod(-1).sum(-1) / 4
    return DrawnTrials(
        scenes=ORDER // STARTS,
        candidate=np.where(np.arange(ALL) < count, candidate, np.nan),
        baseline=BASELINE.ravel()[ORDER],
    )


def after(
    trials: DrawnTrials,
    count: int,
    rules: TrialRules = RULES,
    bank: Bank = BANK,
) -> Progress:
    return progress_from(
        bank,
        trials,
        rules,
        known=np.arange(ALL) < count,
        waypoints=[4] * SCENES,
        repetitions=300,
    )


def test_each_trial_that_is_left_has_its_chance():
    found = after(run(0.98, 40), 40)
    assert len(found.passed) == len(found.regressed) == ALL - 40
    assert list(found.settled) == sorted(found.settled)
    assert found == after(run(0.98, 40), 40)
    assert after(run(0.98, ALL), ALL).settled == ()


def test_a_good_run_will_likely_pass_and_a_bad_one_be_convicted():
    good, bad = after(run(0.97, 16), 16), after(run(0.85, 24), 24)
    assert good.passed[-1] > 0.9
    assert bad.regressed[-1] > 0.9
    soon, late = trials_for(good.passed, 0.5), trials_for(good.passed, 0.9)
    assert soon is not None
    assert late is not None
    assert soon < late


def test_the_trials_so_far_count():
    # After forty perfect trials a few more pass; after ten they do not.
    assert after(run(1.0, 35), 35).passed[9] > 0.9 > after(run(1.0, 10), 10).passed[9]


def test_the_ends_that_are_simulated_are_those_that_come():
    # Policies of all kinds, as likely good as bad: what is said of them comes true on average.
    ends, found, kinds = np.zeros(3), np.zeros(3), np.linspace(0.85, 1.0, 60)
    for seed, chance in enumerate(kinds):
        whole, first = run(chance, ALL, seed), np.arange(ALL) < 16
        progress = after(replace(whole, candidate=np.where(first, whole.candidate, np.nan)), 16)
        for place, more in enumerate((16, 48, 128)):
            end = settle(BANK, whole, RULES, np.arange(ALL) < 16 + more)
            ends[place] += end.word != "undecided"
            found[place] += progress.settled[more - 1]
    assert ends[0] < 35
    assert ends[2] > 45
    assert found / 60 == pytest.approx(ends / 60, abs=0.13)


def test_what_has_ended_beyond_the_trial_that_is_waited_for_is_known():
    # Place 39 still runs; 16 later ones have ended: one more trial judges 17.
    trials = run(1.0, 56)
    known = (np.arange(ALL) < 56) & (np.arange(ALL) != 39)
    found = progress_from(BANK, trials, RULES, known=known, waypoints=[4] * SCENES, repetitions=300)
    assert len(found.passed) == ALL - 55
    assert found.passed[0] > 0.9


def test_a_scene_that_is_named_already_holds_back_no_pass():
    trials = run(1.0, 80)
    fails = replace(trials, candidate=np.where(trials.scenes == 0, 0.0, trials.candidate))
    suspect = np.flatnonzero(trials.scenes == 0)[:2]
    held = replace(trials, candidate=trials.candidate.copy())
    held.candidate[suspect] = 0.0
    rules = TrialRules(tiers=RULES.tiers, margins=Margins(max_drop=0.3, tolerate=0.2))
    assert settle(BANK, fails, rules, np.arange(ALL) < 80).named == (0,)
    waiting = settle(BANK, held, rules, np.arange(ALL) < 80)
    assert after(fails, 80, rules).passed[0] == 1.0
    assert waiting.waits_for == (0,) or waiting.word == "PASS"


def test_a_run_that_only_waits_for_a_scene_needs_trials_of_that_scene_alone():
    ones, scenes = np.ones(240), np.tile(np.arange(4), 60)
    candidate = np.where(np.isin(np.arange(240), [3, 7]), 0.0, 1.0)
    rules = TrialRules(tiers=("supporting",) * 4, margins=Margins(max_drop=0.4))
    bank = Bank(means=np.ones(4))
    whole = DrawnTrials(scenes=scenes, candidate=candidate, baseline=ones)
    known = np.arange(240) < settle(bank, whole, rules).mean
    decision = settle(bank, whole, rules, known)
    assert (decision.word, decision.waits_for) == ("undecided", (3,))
    found = progress_from(bank, whole, rules, known=known, waypoints=[4] * 4, repetitions=200)
    # Sixty starts of the scene, of which some have been met: nothing is judged after those.
    last = 60 - int((scenes[known] == 3).sum())
    assert found.settled[0] < 0.5 < found.settled[last - 1]
    assert found.settled[last - 1] == found.settled[-1]


def test_of_what_is_missing_nothing_is_learnt():
    trials = run(0.98, 40)
    gap = replace(trials, candidate=trials.candidate.copy())
    gap.candidate[19] = np.nan
    assert after(gap, 40).passed[40] < after(trials, 40).passed[40] + 0.1
    nothing = replace(trials, candidate=np.full(ALL, np.nan))
    assert after(nothing, 24).passed[-1] < 0.9


def test_beside_a_control_its_trials_to_come_are_simulated_too():
    trials = run(0.98, 40)
    beside = replace(trials, baseline=np.where(np.arange(ALL) < 40, trials.baseline, np.nan))
    found = after(beside, 40, bank=Bank.control(SCENES))
    assert found == after(trials, 40, bank=Bank.control(SCENES))
    assert 0.0 < found.passed[100] < after(trials, 40).passed[100]
