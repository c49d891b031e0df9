"""How often the gate is wrong about a policy that is exactly at the margin."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest

from nw_eval.stats.bank import Bank, Margins, over_rounds

SCENES, STARTS, ROUNDS, CAMPAIGNS = 6, 24, 16, 1500
ALPHA = 0.05


def panel(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A baseline and a worse candidate, (S, M): success a share of five waypoints."""
    baseline = (rng.random((SCENES, STARTS, 5)) < 0.97).cumprod(-1).sum(-1) / 5
    candidate = baseline.copy()
    if kind == "concentrated":
        candidate[0] = 0.0
    elif kind == "rare":
        candidate[:, :3] = 0.0
    elif kind == "unrelated":
        candidate = (rng.random((SCENES, STARTS, 5)) < 0.92).cumprod(-1).sum(-1) / 5
    else:
        candidate = np.maximum(baseline - 0.2, 0.0)
    return baseline, candidate


@pytest.mark.parametrize("kind", ["concentrated", "rare", "unrelated", "even"])
def test_at_the_margin_a_verdict_is_wrong_no_more_often_than_it_promises(kind: str) -> None:
    rng = np.random.default_rng(20262)
    baseline, candidate = panel(kind, rng)
    drop = float(baseline.mean() - candidate.mean())
    orders = np.broadcast_to(np.arange(STARTS), (CAMPAIGNS, SCENES, STARTS))
    orders = rng.permuted(orders, axis=-1)[..., :ROUNDS]
    drawn_candidate, drawn_baseline = (
        np.take_along_axis(scores[None], orders, axis=-1).swapaxes(1, 2)
        for scores in (candidate, baseline)
    )
    margins = Margins(max_drop=drop, tolerate=drop)
    rounds = over_rounds(Bank.of(baseline), drawn_candidate, drawn_baseline, margins)
    most = ALPHA + 3 * sqrt(ALPHA * (1 - ALPHA) / CAMPAIGNS)
    # Looking after every round, whatever the scenes would say.
    for evidence in ("passed", "regressed"):
        highest = np.max([getattr(values, evidence) for values in rounds], axis=0)
        assert highest.shape == (CAMPAIGNS,)
        assert (highest >= 1 / ALPHA).mean() <= most
