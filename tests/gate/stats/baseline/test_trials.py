"""The gate trial by trial: its rule, and that the same trials are judged always."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest
from gate_cells import HURDLES, scores_of
from measured import real_run

from nw_base.words import Tier
from nw_gate.stats.baseline.evidence import Margins, Reference
from nw_gate.stats.baseline.interval import drop_interval_after
from nw_gate.stats.baseline.trials import (
    CRITICAL_TRIALS,
    SUSPECT,
    DrawnTrials,
    TrialDecision,
    TrialRules,
    looks,
    most_false_alarms,
    settle,
    settle_all,
)


def one_scene(candidate: list[float], baseline: float = 1.0) -> DrawnTrials:
    return DrawnTrials(
        scenes=np.zeros(len(candidate), dtype=np.intp),
        candidate=np.array(candidate),
        baseline=np.full(len(candidate), baseline),
    )


def simulated(seed: int, gates: int, drop: float = 0.06) -> tuple[Reference, DrawnTrials]:
    """Gates on hurdles of a policy that falls in some trials; budgets of 160 trials."""
    rng, (scores, _) = np.random.default_rng(seed), scores_of(HURDLES)
    order = np.argsort(rng.random((gates, scores.size)), axis=1)[:, :160]
    scenes, starts = order // scores.shape[1], order % scores.shape[1]
    falls = rng.random(order.shape) < np.where(scenes == 3, 0.4, drop)
    known = scores[scenes, starts]
    return Reference.of(scores).fresh(), DrawnTrials(
        scenes=scenes, candidate=np.where(falls, 0.0, known), baseline=known
    )


def tiers(scenes: int = 16, *critical: int) -> tuple[Tier, ...]:
    return tuple("critical" if s in critical else "supporting" for s in range(scenes))


def cut(trials: DrawnTrials, gate: int) -> DrawnTrials:
    return DrawnTrials(
        scenes=trials.scenes[gate],
        candidate=trials.candidate[gate],
        baseline=trials.baseline[gate],
    )


PERFECT = Reference(means=np.ones(1))


def word(trials: DrawnTrials, reference: Reference = PERFECT, **rules: Any) -> str:
    """What is said of a gate of one scene."""
    return settle(reference, trials, TrialRules(tiers=tiers(1), **rules)).word


def test_before_the_first_trial_nothing_is_decided():
    rules, known = TrialRules(tiers=tiers(1)), [False] * 3
    decision = settle(PERFECT, one_scene([1.0] * 3), rules, known)
    assert (decision.word, decision.trials, decision.named) == ("undecided", 0, ())
    assert decision.pending == (0, 1, 2)


def test_evidence_must_reach_one_over_alpha():
    # E_pass of perfect trials is 20 after 37 of them, E_regr of failures 8.9 and then 221.8.
    assert word(one_scene([1.0] * 36)) == "undecided"
    assert word(one_scene([1.0] * 37)) == "PASS"
    assert word(one_scene([1.0] * 37), alpha_pass=0.01) == "undecided"
    assert word(one_scene([0.0])) == "undecided"
    assert word(one_scene([0.0, 0.0])) == "REGRESSED"
    assert word(one_scene([0.0, 0.0]), alpha_regr=0.001) == "undecided"
    assert word(one_scene([0.0]), alpha_regr=0.2) == "REGRESSED"


def test_the_first_trial_that_settles_it_does_whatever_comes_after():
    rules = TrialRules(tiers=tiers(1))
    passed = settle(PERFECT, one_scene([1.0] * 37 + [0.0] * 40), rules)
    assert (passed.word, passed.trials, passed.named, passed.pending) == ("PASS", 37, (), ())
    fell = settle(PERFECT, one_scene([0.0] * 2 + [1.0] * 400), rules)
    assert (fell.word, fell.trials) == ("REGRESSED", 2)


def test_a_trial_that_would_do_both_convicts():
    # The fourth of four starts shows that the drop is .25: below max_drop, and above tolerate.
    reference, trials = Reference(means=np.ones(1), starts=4), one_scene([0.75] * 4)
    margins = Margins(max_drop=0.26, tolerate=0.24, scene_drop=0.3)
    found = looks(reference, trials, margins)
    assert [bool(found.passed[3] == inf), bool(found.regressed[3] == inf)] == [True, True]
    assert max(found.passed[2], found.regressed[2]) < 20.0
    assert word(trials, reference, margins=margins) == "REGRESSED"
    assert word(trials, reference, margins=replace(margins, tolerate=0.25)) == "PASS"


def test_a_suspect_scene_is_waited_for_only_where_the_mean_alone_would_pass():
    decision = settle(PERFECT, one_scene([0.0, 0.0]), TrialRules(tiers=tiers(1), alpha_regr=0.001))
    assert (decision.word, decision.named, decision.waits_for) == ("undecided", (), ())


def test_a_scene_is_named_at_the_shared_error_and_stays_named_under_pass():
    # Two scenes at .01: each must reach 200. Four failures do, and later successes undo it.
    scenes = np.array([0] * 40 + [1] * 4 + [0, 1] * 60)
    candidate = np.where(np.arange(164) // 4 == 10, 0.0, 1.0)
    trials = DrawnTrials(scenes=scenes, candidate=candidate, baseline=np.ones(164))
    margins, reference = Margins(max_drop=0.2, tolerate=0.15), Reference(means=np.ones(2))
    own = looks(reference, trials, margins).own
    assert own[42] < 200.0 <= own[43]
    rules = TrialRules(tiers=tiers(2), margins=margins, alpha_pass=1e-9)
    assert settle(reference, trials.at(range(43)), rules).named == ()
    decision = settle(reference, trials, rules)
    assert (decision.word, decision.named) == ("PASS", (1,))
    assert own[decision.mean - 2 : decision.mean].max() < 200.0


def test_gates_that_are_settled_together_end_as_each_alone():
    reference, trials = simulated(seed=1, gates=40)
    rules = TrialRules(tiers=tiers(16, 3, 5))
    alone = [settle(reference, cut(trials, gate), rules) for gate in range(40)]
    together = settle_all(reference, trials, rules)
    for one, other in zip(alone, together, strict=True):
        assert replace(one, pending=()) == replace(other, pending=())
    assert len({decision.word for decision in alone}) > 1
    assert any(decision.followed for decision in alone)


@pytest.mark.parametrize("workers", [1, 3, 64])
def test_the_same_trials_are_judged_whatever_the_number_of_workers(workers):
    reference, every = simulated(seed=2, gates=12)
    rules = TrialRules(tiers=tiers(16, 3, 5))
    for gate in range(12):
        trials = cut(every, gate)
        rng = np.random.default_rng([gate, workers])
        known = np.zeros(160, dtype=bool)
        running = set[int]()
        while True:
            hidden = replace(trials, candidate=np.where(known, trials.candidate, 0.0))
            decision = settle(reference, hidden, rules, known)
            if not decision.pending:
                break
            window = decision.pending[:workers]
            running.update(place for place in window if not known[place])
            assert len(running) <= 2 * workers
            # Whichever ends first: workers differ in speed.
            done = int(rng.choice(sorted(running)))
            running.discard(done)
            known[done] = True
        assert replace(decision, pending=()) == replace(
            settle(reference, trials, rules), pending=()
        )
        judged = {*range(decision.mean), *decision.followed}
        started = set(np.flatnonzero(known).tolist()) | running
        assert judged <= started
        # Too many only by what ran beside the trial that settled the mean, or a scene.
        settled = 1 + len(set(trials.scenes[list(decision.followed)].tolist()))
        assert len(started) <= decision.trials + settled * (workers - 1)


def test_of_a_trial_that_has_not_ended_nothing_is_looked_at():
    reference, every = simulated(seed=3, gates=1)
    trials, rules = cut(every, 0), TrialRules(tiers=tiers())
    known = np.arange(160) != 20
    decision = settle(reference, trials, rules, known)
    assert (decision.word, decision.mean, decision.pending[:2]) == ("undecided", 20, (20, 21))
    assert (
        settle(
            reference,
            replace(trials, candidate=np.where(known, trials.candidate, 1.0)),
            rules,
            known,
        )
        == decision
    )


def test_pass_waits_for_a_suspect_scene_and_runs_trials_of_that_scene_alone():
    # Four scenes, of which the last fails twice, and then no more.
    scenes = np.tile(np.arange(4), 60)
    candidate = np.ones(240)
    candidate[[3, 7]] = 0.0
    trials = DrawnTrials(scenes=scenes, candidate=candidate, baseline=np.ones(240))
    margins, reference = Margins(max_drop=0.4), Reference(means=np.ones(4))
    decision = settle(reference, trials, TrialRules(tiers=tiers(4), margins=margins))
    passed = looks(reference, trials, margins)
    first = int((passed.passed >= 20.0).argmax())
    assert (decision.word, decision.mean, decision.named) == ("PASS", first + 1, ())
    assert decision.followed
    assert set(scenes[list(decision.followed)].tolist()) == {3}
    before = [place for place in range(first + 1) if scenes[place] == 3]
    assert passed.own[before[-1]] >= SUSPECT > passed.own[decision.followed[-1]]
    # One that goes on failing is named, and the mean passes in spite of it.
    fails = replace(trials, candidate=np.where(scenes == 3, 0.0, 1.0))
    margins = Margins(max_drop=0.6, tolerate=0.5)
    decision = settle(reference, fails, TrialRules(tiers=tiers(4), margins=margins))
    assert (decision.word, decision.named) == ("PASS", (3,))
    assert (
        settle(reference, fails, TrialRules(tiers=tiers(4, 3), margins=margins)).word == "REGRESSED"
    )


def test_a_scene_that_is_suspect_to_the_end_holds_a_pass_back():
    scenes = np.tile(np.arange(4), 60)
    candidate = np.where(np.isin(np.arange(240), [3, 7]), 0.0, 1.0)
    rules = TrialRules(tiers=tiers(4), margins=Margins(max_drop=0.4))
    reference, ones = Reference(means=np.ones(4)), np.ones(240)
    whole = DrawnTrials(scenes=scenes, candidate=candidate, baseline=ones)
    mean = settle(reference, whole, rules).mean
    short = DrawnTrials(scenes=scenes[:mean], candidate=candidate[:mean], baseline=ones[:mean])
    decision = settle(reference, short, rules)
    assert (decision.word, decision.waits_for, decision.pending) == ("undecided", (3,), ())


def test_no_gate_passes_before_critical_scenes_have_been_met():
    # Sixty-four scenes: the mean passes before half of them have been met.
    rng = np.random.default_rng(5)
    scenes = np.concatenate([rng.permutation(64) for _ in range(20)])
    ones = np.ones(len(scenes))
    trials, reference = (
        DrawnTrials(scenes=scenes, candidate=ones, baseline=ones),
        Reference(means=np.ones(64)),
    )
    last = int(scenes[63])
    plain = settle(reference, trials, TrialRules(tiers=tiers(64)))
    assert plain.trials == 37
    assert last not in scenes[:37]
    careful = settle(reference, trials, TrialRules(tiers=tiers(64, last)))
    assert (careful.word, careful.mean) == ("PASS", 37)
    assert scenes[list(careful.followed)].tolist() == [last] * CRITICAL_TRIALS
    failing = replace(trials, candidate=np.where(scenes == last, 0.0, 1.0))
    assert settle(reference, failing, TrialRules(tiers=tiers(64))).word == "PASS"
    decision = settle(reference, failing, TrialRules(tiers=tiers(64, last)))
    assert (decision.word, decision.named) == ("REGRESSED", (last,))


def test_what_is_missing_helps_no_verdict():
    reference, trials = simulated(seed=6, gates=30)
    holes = np.random.default_rng(6).random(trials.candidate.shape) < 0.2
    missing = looks(
        reference, replace(trials, candidate=np.where(holes, np.nan, trials.candidate)), Margins()
    )
    for score in (0.0, 1.0):
        filled = replace(trials, candidate=np.where(holes, score, trials.candidate))
        found = looks(reference, filled, Margins())
        assert (missing.passed <= found.passed * (1 + 1e-9)).all()
        assert (missing.regressed <= found.regressed * (1 + 1e-9)).all()
        assert (missing.own <= found.own * (1 + 1e-9)).all()
    control = Reference.control(16)
    missing = looks(
        control, replace(trials, baseline=np.where(holes, np.nan, trials.baseline)), Margins()
    )
    for score in (0.0, 1.0):
        found = looks(
            control, replace(trials, baseline=np.where(holes, score, trials.baseline)), Margins()
        )
        assert (missing.passed <= found.passed * (1 + 1e-9)).all()
        assert (missing.regressed <= found.regressed * (1 + 1e-9)).all()
        assert (missing.own <= found.own * (1 + 1e-9)).all()


def test_interval_and_verdict_do_not_contradict_each_other():
    reference, every = simulated(seed=7, gates=25)
    for which in (reference, Reference.control(16)):
        words = set[str]()
        for gate in range(25):
            trials, rules = cut(every, gate), TrialRules(tiers=tiers())
            decision = settle(which, trials, rules)
            first = DrawnTrials(
                scenes=trials.scenes[: decision.mean],
                candidate=trials.candidate[: decision.mean],
                baseline=trials.baseline[: decision.mean],
            )
            found = drop_interval_after(which, first)
            words.add(decision.word)
            assert (found.low > 0.02 - 1e-7) == (decision.word == "REGRESSED")
            if decision.word == "PASS":
                assert found.high < 0.10 + 1e-7
        assert "PASS" in words
    nothing = DrawnTrials(
        scenes=np.zeros(0, dtype=np.intp), candidate=np.ones(0), baseline=np.ones(0)
    )
    whole = drop_interval_after(Reference(means=np.array([0.9])), nothing)
    assert (whole.low, whole.high) == (pytest.approx(-0.1), pytest.approx(0.9))


def reordered(gates: int) -> tuple[Reference, DrawnTrials, float]:
    """Two real runs from the same 30 starts of 16 scenes, in random orders; and the true drop."""
    rng = np.random.default_rng(8)
    baseline, candidate = real_run("go1-parkour"), real_run("noised")
    order = np.array([rng.choice(baseline.size, 320, replace=False) for _ in range(gates)])
    scenes = order // baseline.shape[1]
    trials = DrawnTrials(
        scenes=scenes, candidate=candidate.ravel()[order], baseline=baseline.ravel()[order]
    )
    return Reference.of(baseline), trials, float(baseline.mean() - candidate.mean())


def test_of_real_runs_in_random_order_few_are_judged_wrongly_at_their_true_drop():
    reference, trials, drop = reordered(1000)
    assert drop == pytest.approx(0.25, abs=0.01)
    rules = TrialRules(tiers=tiers(), margins=Margins(max_drop=drop, tolerate=drop))
    words = [decision.word for decision in settle_all(reference, trials, rules)]
    assert words.count("PASS") <= 50 + 3 * 7
    assert words.count("REGRESSED") <= 10 + 3 * 4


@pytest.mark.nightly
def test_the_interval_covers_the_drop_of_real_runs_at_every_look():
    reference, every, drop = reordered(100)
    missed = np.zeros(2)
    for gate in range(100):
        trials = cut(every, gate)
        found = [
            drop_interval_after(
                reference,
                DrawnTrials(
                    scenes=trials.scenes[:count],
                    candidate=trials.candidate[:count],
                    baseline=trials.baseline[:count],
                ),
                alpha_regr=0.05,
            )
            for count in (8, 16, 32, 64, 128, 224, 320)
        ]
        missed += [
            any(drop > look.high + 1e-7 for look in found),
            any(drop < look.low - 1e-7 for look in found),
        ]
    assert (missed <= 5 + 3 * 2.2).all(), missed


def test_the_parts_of_a_gate_err_together_with_the_sum_at_most():
    def parts(**changed: float | bool | None) -> float:
        gate = {"bar": 0.05, "bar_critical": True, "baseline": 0.01, "critical": 4, "scenes": 16}
        return most_false_alarms(**{**gate, **changed})  # type: ignore[arg-type]

    assert parts() == pytest.approx(0.05 + 0.05 + 0.01 + 0.0025)
    assert parts(bar=None) == pytest.approx(0.0125)
    assert parts(critical=0, bar_critical=False) == pytest.approx(0.06)
    assert parts(baseline=None) == pytest.approx(0.10)
    with pytest.raises(ValueError, match="17 critical scenes of 16"):
        parts(critical=17)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: one_scene([1.2]), "success 1.2"),
        (lambda: replace(one_scene([1.0]), baseline=np.ones(2)), "trials of shapes"),
        (lambda: TrialRules(tiers=("informational",)), "scene 0 is informational"),
        (lambda: TrialRules(tiers=("critical",), alpha_regr=1.0), "alpha 1.0"),
        (
            lambda: settle(
                Reference(means=np.ones(2)), one_scene([1.0]), TrialRules(tiers=tiers(1))
            ),
            "1 tiers for 2 scenes",
        ),
        (
            lambda: looks(
                Reference(means=np.ones(1)), one_scene([1.0], baseline=np.nan), Margins()
            ),
            "one is missing",
        ),
        (
            lambda: looks(Reference(means=np.ones(1), starts=2), one_scene([1.0] * 3), Margins()),
            "3 draws of 2 numbers",
        ),
    ],
)
def test_what_cannot_be_judged_is_refused_by_name(make, says):
    with pytest.raises(ValueError, match=says):
        make()


def test_a_ruling_counts_the_trials_of_both_its_parts():
    decision = TrialDecision(
        word="PASS", mean=37, followed=(40, 90), named=(), waits_for=(), pending=()
    )
    assert decision.trials == 39


@pytest.mark.parametrize(("where", "drop", "wrong"), [(-4, 0.10, "PASS"), (0, 0.02, "REGRESSED")])
def test_rounds_with_a_fixed_order_of_scenes_are_judged_when_they_are_whole(where, drop, wrong):
    # All of the drop is in four scenes of sixteen, the last or the first of every round.
    rng, scenes, rounds, gates = np.random.default_rng(5), 16, 20, 2000
    level = np.full(scenes, 0.95)
    worse = np.zeros(scenes)
    worse[where : where + 4 or None] = drop * scenes / 4
    drawn = (rng.random((gates, rounds, scenes)) < level - worse).astype(float)
    which = np.tile(np.arange(scenes), (gates, rounds))
    trials = DrawnTrials(
        scenes=which, candidate=drawn.reshape(gates, -1), baseline=np.full(which.shape, 0.95)
    )
    reference, share = Reference.of(np.tile(level[:, None], (1, 60))).fresh(), {}
    for every in (1, scenes):
        rules = TrialRules(tiers=("supporting",) * scenes, look_every=every)
        words = [decision.word for decision in settle_all(reference, trials, rules)]
        share[every] = words.count(wrong) / gates
    nominal = {"PASS": 0.05, "REGRESSED": 0.01}[wrong]
    assert share[scenes] <= nominal + 3 * (nominal * (1 - nominal) / gates) ** 0.5
    assert share[1] > share[scenes], "within a round the order of scenes decides"
