"""Suites of one scene or a few: what their defaults come to, by simulation."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from nw_eval.api.baselines_saved import starts_for
from nw_gate.settings import Gate
from nw_gate.stats.baseline.baseline_bets import make_bets
from nw_gate.stats.baseline.evidence import Reference
from nw_gate.stats.baseline.trials import DrawnTrials, TrialRules, settle_all

GATES = 2000


@cache
def baselines(scenes: int, starts: int) -> tuple[np.ndarray, Reference]:
    """Return what each baseline scored, shape (GATES, S, M), and what a gate knows of it."""
    known = np.random.default_rng(3).random((GATES, scenes, starts)) < 0.9
    known = known.astype(float)
    bets = make_bets(known, np.ones(scenes, dtype=np.intp), max_drop=0.1, tolerate=0.02)
    return known, Reference(means=known.mean(axis=-1), starts=starts, bets=bets).fresh()


def words(scenes: int, drop: float, *, starts: int, rounds: int) -> list[str]:
    """Return how gates end of a policy that fails at once more often, by `drop` in every scene.

    The baseline completes .9 of its trials; each gate has a baseline of its own.
    """
    known, reference = baselines(scenes, starts)
    rng = np.random.default_rng(4)
    order = np.argsort(rng.random((GATES, scenes * starts)), axis=-1)[:, : rounds * scenes]
    trials = DrawnTrials(
        scenes=order // starts,
        candidate=(rng.random(order.shape) < 0.9 - drop).astype(float),
        baseline=np.take_along_axis(known.reshape(GATES, -1), order, axis=-1),
    )
    rules = TrialRules(tiers=("supporting",) * scenes)
    return [decision.word for decision in settle_all(reference, trials, rules)]


def most(nominal: float) -> float:
    return nominal + 3.0 * (nominal * (1.0 - nominal) / GATES) ** 0.5


@pytest.mark.parametrize("scenes", [1, 2, 5])
def test_the_defaults_of_few_scenes_hold_their_errors_and_let_equal_policies_pass(scenes):
    starts = starts_for(scenes)
    rounds = Gate().rounds_for(scenes, starts)
    assert rounds * scenes >= 200
    assert starts * scenes >= 400
    same, at_tolerate, at_most = (
        words(scenes, drop, starts=starts, rounds=rounds) for drop in (0.0, 0.02, 0.10)
    )
    assert same.count("PASS") / GATES > 0.84
    assert at_tolerate.count("REGRESSED") / GATES <= most(0.01)
    assert at_most.count("PASS") / GATES <= most(0.05)
    assert at_most.count("REGRESSED") / GATES > 0.45


def test_twenty_trials_of_one_scene_seldom_reach_a_verdict_and_as_many_as_starts_err_more():
    few = words(1, 0.0, starts=60, rounds=20)
    assert few.count("PASS") / GATES < 0.15
    assert words(1, 0.02, starts=60, rounds=60).count("REGRESSED") / GATES > most(0.01)


@pytest.mark.parametrize(
    ("scenes", "starts", "rounds"),
    [(1, None, 200), (2, None, 100), (16, None, 20), (64, 60, 20), (1, 60, 30), (1, 30, 20),
     (1, 12, 12), (3, 400, 67)],
)  # fmt: skip
def test_the_default_of_trials_follows_the_scenes_and_stops_at_half_of_the_starts(
    scenes, starts, rounds
):
    assert Gate().rounds_for(scenes, starts) == rounds
    assert Gate(rounds=7).rounds_for(scenes, starts) == 7
