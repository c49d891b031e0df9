"""How often the gate is wrong about policies that are exactly at a margin, by simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from measured import SEEN, real_run

from nw_eval.stats.bank import Bank, Margins, over_rounds
from nw_eval.stats.bank.simulate import chances_of, draw, success_of

NOMINAL = 0.05
CAMPAIGNS, ROUNDS, STARTS = 5000, 20, 60
PASS_AT, REGRESSED_AT = 0.10, 0.02
"""Drops at which each verdict begins to be wrong: max_drop, and `tolerate`."""


class Campaigns(NamedTuple):
    """Many gates of one policy, scores in the order drawn, shape (campaigns, rounds, S)."""

    bank: Bank
    candidate: np.ndarray
    baseline: np.ndarray
    drop: float
    """The true one."""


def error_rates() -> Iterator[tuple[str, int, float, float]]:
    """Yield what is at the margin, M, and the shares of wrong PASS and wrong REGRESSED."""
    for name, fall in FALLS.items():
        passing, convicted = (
            in_random_order(baseline, fall(baseline, drop))
            for baseline, drop in ((panel(), PASS_AT), (panel(), REGRESSED_AT))
        )
        yield name, STARTS, wrong(passing, "passed"), wrong(convicted, "regressed")
    real = in_random_order(real_run("go1-parkour"), real_run("noised"))
    name = f"real runs, reordered: weights with 30 % noise, drop {real.drop:.2f}"
    yield name, real.bank.starts, wrong(real, "passed"), wrong(real, "regressed")
    for starts in (10, 20, 40, 60):
        passing, convicted = (on_fresh_starts(starts, drop) for drop in (PASS_AT, REGRESSED_AT))
        yield "fresh starts", starts, wrong(passing, "passed"), wrong(convicted, "regressed")


def wrong(campaigns: Campaigns, evidence: str) -> float:
    """Return how often the evidence ever convinces, looking after every round.

    The other verdict ends no campaign before, so that a gate is wrong no more often than this.
    """
    margins = Margins(max_drop=campaigns.drop, tolerate=campaigns.drop)
    rounds = over_rounds(campaigns.bank, campaigns.candidate, campaigns.baseline, margins)
    highest = np.max([getattr(values, evidence) for values in rounds], axis=0)
    assert highest.shape == (CAMPAIGNS,)
    return float((highest >= 1.0 / NOMINAL).mean())


def in_random_order(baseline: np.ndarray, candidate: np.ndarray) -> Campaigns:
    """Return campaigns that differ in the order of the starts alone; panels of shape (S, M)."""
    rng = np.random.default_rng(20267)
    orders = np.broadcast_to(np.arange(baseline.shape[1]), (CAMPAIGNS, *baseline.shape))
    orders = rng.permuted(orders, axis=-1)[..., :ROUNDS]
    drawn = (
        np.take_along_axis(scores[None], orders, axis=-1).swapaxes(1, 2)
        for scores in (candidate, baseline)
    )
    return Campaigns(Bank.of(baseline), *drawn, float(baseline.mean() - candidate.mean()))


def on_fresh_starts(starts: int, drop: float) -> Campaigns:
    """Return campaigns with a bank each; the drop is that of true success, not on the panel."""
    rounds = min(starts, ROUNDS)
    drawn = draw(SEEN, starts=starts, rounds=rounds, repetitions=CAMPAIGNS)
    chances, everybody = chances_of(SEEN, success_of(SEEN) - drop), np.arange(CAMPAIGNS)
    scores = [drawn.scores(chances, number, everybody) for number in range(rounds)]
    return Campaigns(drawn.bank, np.stack(scores, axis=1), drawn.baseline, drop)


def panel(mean: float | None = None, seed: int = 20268) -> np.ndarray:
    """Return the scores of a policy as measured on hurdles, or a worse one, shape (S, M)."""
    rng = np.random.default_rng(seed)
    chances = chances_of(SEEN, success_of(SEEN) if mean is None else mean)
    waypoints = np.array([len(course.counts) - 1 for course in SEEN])
    luck = rng.random((STARTS, len(SEEN), 1))
    steps = np.arange(1, waypoints.max() + 1)
    reached = (luck < chances[:, None] ** steps) & (steps <= waypoints[:, None])
    return (reached.sum(axis=-1) / waypoints).T


def catastrophic(baseline: np.ndarray, drop: float) -> np.ndarray:
    """Some starts, anywhere, get nowhere."""
    return _fallen(baseline, drop, np.random.default_rng(1).permutation(baseline.size))


def concentrated(baseline: np.ndarray, drop: float) -> np.ndarray:
    """One scene after another fails from every start."""
    return _fallen(baseline, drop, np.arange(baseline.size)[::-1])


def asymmetric(baseline: np.ndarray, drop: float) -> np.ndarray:
    """Whatever was not perfect is now, at the price of starts that get nowhere."""
    return _fallen(np.ones_like(baseline), drop + 1.0 - baseline.mean(), _SHUFFLED)


def in_easy_scenes(baseline: np.ndarray, drop: float) -> np.ndarray:
    """Every start of the easiest scenes is half as good."""
    halved, fallen = baseline.copy(), baseline.mean() - drop
    for place in np.argsort(-baseline.mean(axis=1), kind="stable").repeat(baseline.shape[1]):
        worst = np.argmax(halved[place] == baseline[place])
        if halved.mean() <= fallen:
            break
        halved[place, worst] = baseline[place, worst] / 2
    return halved


def as_measured(baseline: np.ndarray, drop: float) -> np.ndarray:
    """A policy that finds other starts hard, and every waypoint harder."""
    return panel(float(baseline.mean()) - drop, seed=20269)


FALLS: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "some starts get nowhere": catastrophic,
    "whole scenes fail": concentrated,
    "most starts are better, some get nowhere": asymmetric,
    "half the waypoints of easy scenes": in_easy_scenes,
    "every waypoint is harder, as measured": as_measured,
}
_SHUFFLED = np.random.default_rng(2).permutation(STARTS * len(SEEN))


def _fallen(scores: np.ndarray, drop: float, order: np.ndarray) -> np.ndarray:
    """Set scores to 0, in this order, until the mean has dropped."""
    found = scores.flatten()
    for place in order:
        if scores.mean() - found.mean() >= drop:
            break
        found[place] = 0.0
    return found.reshape(scores.shape)
