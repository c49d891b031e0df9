"""What further trials may bring to a run that was not decided, and whether they do."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from nw_gate.baseline.power_forecast import outset_of_baseline
from nw_gate.results.baseline_file import read_baseline
from nw_gate.settings import Gate
from nw_gate.stats.baseline.baseline_bets import make_bets
from nw_gate.stats.baseline.curve import (
    Progress,
    chances_of,
    progress_from,
    scores_of,
    success_of,
    trials_for,
)
from nw_gate.stats.baseline.evidence import Floats, Margins, Places, Reference
from nw_gate.stats.baseline.trials import DrawnTrials, TrialRules, settle, settle_all
from nw_gate.stats.power import SceneCounts

BASELINES = Path(__file__).parents[4] / "reports" / "baselines"
SCENES, STARTS = 8, 60
ALL = SCENES * STARTS
RULES = TrialRules(tiers=("supporting",) * SCENES)
rng = np.random.default_rng(12)
BASELINE = (rng.random((SCENES, STARTS, 4)) < 0.98).cumprod(-1).sum(-1) / 4
REFERENCE = Reference.of(BASELINE)
SEEN = [SceneCounts.of(reached.tolist(), [4]) for reached in np.rint(4 * BASELINE).astype(int)]
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
    reference: Reference = REFERENCE,
) -> Progress:
    return progress_from(
        reference,
        trials,
        rules,
        known=np.arange(ALL) < count,
        seen=SEEN,
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
            end = settle(REFERENCE, whole, RULES, np.arange(ALL) < 16 + more)
            ends[place] += end.word != "undecided"
            found[place] += progress.settled[more - 1]
    assert ends[0] < 35
    assert ends[2] > 45
    assert found / 60 == pytest.approx(ends / 60, abs=0.13)


def of_hurdles(drop: float, kind: str) -> tuple[Floats, Places, list[SceneCounts]]:
    """Return scores of 1200 policies on the committed hurdles, their scenes, and its counts.

    The drop is one factor of the odds in all scenes, or a share of trials that reach nothing.
    """
    panel = read_baseline(BASELINES / "hurdles" / "go1-parkour.parquet").panels[0]
    seen = list(outset_of_baseline(panel, Gate()).seen)
    starts, gates = seen[0].trials, np.random.default_rng(round(100 * drop))
    order = gates.permuted(np.tile(np.arange(len(seen) * starts), (1200, 1)), axis=1)
    scenes = order // starts
    lost = drop if kind == "odds" else 0.0
    k = np.array([len(course.counts) - 1 for course in seen])
    chances = chances_of(seen, success_of(seen) - lost)
    scores = scores_of(gates.random(scenes.shape), chances, scenes, k)
    nothing = gates.random(scenes.shape) < (drop - lost) / success_of(seen)
    return np.where(nothing, 0.0, scores), scenes, seen


@pytest.mark.nightly
def test_of_open_runs_against_the_committed_hurdles_as_many_are_decided_as_is_said():
    budget, within = 320, {0.5: list[bool](), 0.9: list[bool]()}
    for drop, kind in product((0.03, 0.06, 0.08, 0.1), ("odds", "nothing")):
        scores, scenes, seen = of_hurdles(drop, kind)
        rules = TrialRules(tiers=("supporting",) * len(seen))
        known_scores = np.array([np.repeat(c.values, c.counts) for c in seen])
        k = np.array([len(c.counts) - 1 for c in seen])
        bets = make_bets(known_scores, k, max_drop=0.1, tolerate=0.02, by_start=False)
        reference = Reference(means=known_scores.mean(axis=1), bets=bets)
        whole = DrawnTrials(scenes=scenes, candidate=scores, baseline=reference.means[scenes])
        first = settle_all(reference, whole.only(np.arange(len(scores)), budget), rules)
        is_open = [gate for gate, end in enumerate(first) if end.word == "undecided"][:16]
        known = np.arange(scenes.shape[-1]) < budget
        for gate in is_open:
            one = DrawnTrials(
                scenes=scenes[gate], candidate=scores[gate], baseline=reference.means[scenes[gate]]
            )
            end = settle(reference, one, rules)
            more = sum(place >= budget for place in (*range(end.mean), *end.followed))
            found = progress_from(reference, one, rules, known=known, seen=seen, repetitions=100)
            for share, decided in within.items():
                if (number := trials_for(found.settled, share)) is not None:
                    decided.append(end.word != "undecided" and more <= number)
    assert min(map(len, within.values())) > 40
    assert {share: np.mean(decided) for share, decided in within.items()} == {
        0.5: pytest.approx(0.5, abs=0.2),
        0.9: pytest.approx(0.9, abs=0.15),
    }


def test_what_has_ended_beyond_the_trial_that_is_waited_for_is_known():
    # Place 39 still runs; 16 later ones have ended: one more trial judges 17.
    trials = run(1.0, 56)
    known = (np.arange(ALL) < 56) & (np.arange(ALL) != 39)
    found = progress_from(REFERENCE, trials, RULES, known=known, seen=SEEN, repetitions=300)
    assert len(found.passed) == ALL - 55
    assert found.passed[0] > 0.9


def test_a_scene_that_is_named_already_holds_back_no_pass():
    trials = run(1.0, 80)
    fails = replace(trials, candidate=np.where(trials.scenes == 0, 0.0, trials.candidate))
    suspect = np.flatnonzero(trials.scenes == 0)[:2]
    held = replace(trials, candidate=trials.candidate.copy())
    held.candidate[suspect] = 0.0
    rules = TrialRules(tiers=RULES.tiers, margins=Margins(max_drop=0.3, tolerate=0.2))
    assert settle(REFERENCE, fails, rules, np.arange(ALL) < 80).named == (0,)
    waiting = settle(REFERENCE, held, rules, np.arange(ALL) < 80)
    assert after(fails, 80, rules).passed[0] == 1.0
    assert waiting.waits_for == (0,) or waiting.word == "PASS"


def test_a_run_that_only_waits_for_a_scene_needs_trials_of_that_scene_alone():
    ones, scenes = np.ones(240), np.tile(np.arange(4), 60)
    candidate = np.where(np.isin(np.arange(240), [3, 7]), 0.0, 1.0)
    rules = TrialRules(tiers=("supporting",) * 4, margins=Margins(max_drop=0.5))
    reference = Reference(means=np.ones(4))
    whole = DrawnTrials(scenes=scenes, candidate=candidate, baseline=ones)
    known = np.arange(240) < settle(reference, whole, rules).mean
    decision = settle(reference, whole, rules, known)
    assert (decision.word, decision.waits_for) == ("undecided", (3,))
    perfect = [SceneCounts.of([4] * 60, [4])] * 4
    found = progress_from(reference, whole, rules, known=known, seen=perfect, repetitions=200)
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
    found = after(beside, 40, reference=Reference.control(SCENES))
    assert found == after(trials, 40, reference=Reference.control(SCENES))
    assert 0.0 < found.passed[100] < after(trials, 40).passed[100]
