"""Intervals of the figures: what leaving out one policy at a time changes.

The policies at hand stand for more of their kind, each measured by as many trials, so policies are
resampled and trials are not: which policies one has is most of the uncertainty, and resampling
trials alone covers 16 to 94 % where 95 % is meant. The interval is of what sets of N such policies
show in the mean.

Each policy is left out once (Tukey's jackknife), on a scale on which the figure spreads evenly:
Fisher's z for correlations, the logarithm of (m + .01) / (1.01 - m) for MMRV. The interval is
Student's, with N - 1 degrees of freedom. Drawing policies with replacement does worse: from equal
policies come ties and perfect ranks that no set of N has, and the percentile intervals of MMRV
cover 46 to 74 %. Where leaving out any policy changes nothing, the spread is not zero but unseen,
and the interval is all of the range.

Measured coverage of 95 %, with 5 to 20 policies of true success .1 to .95 and simulators that are
wrong about them by 0, .15 or .4 (standard deviation): 94 to 97 % for Pearson, 95 to 100 % for
Spearman, 94 to 100 % for MMRV.

Source: J. W. Tukey, Ann. Math. Statist. 29 (1958) 614; R. G. Miller, "The jackknife - a review",
Biometrika 61 (1974), also on choosing the scale.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from nw_eval.stats.agreement.figures import FIGURES, FigureName, Floats
from nw_eval.stats.interval import Interval
from nw_eval.stats.student import t_quantile

FEWEST = 5
"""Policies. The interval of four still holds, and spans nine tenths of all there is."""

_NEAR = 0.9999  # A correlation of 1 without one policy is as far as this from the others.
_SMALL = 0.01  # Of MMRV: a tenth of a policy's success, in one of ten policies.


def jackknife(
    name: FigureName, real: Floats, simulated: Floats, confidence: float
) -> Interval | None:
    """Return the interval of a figure; None where the figure itself does not exist.

    Args:
        name: of the figure.
        real: success of N policies on the robot, shape (N,), N at least `FEWEST`.
        simulated: of the same policies in the simulator.
        confidence: two-sided.
    """
    figure, n = FIGURES[name], len(real)
    value = figure(real, simulated)
    if not np.isfinite(value):
        return None
    others = ~np.eye(n, dtype=bool)
    without = figure(
        *(np.broadcast_to(x, (n, n))[others].reshape(n, n - 1) for x in (real, simulated))
    )
    low, high = (0.0, 1.0) if name == "mmrv" else (-1.0, 1.0)
    if not np.isfinite(without).all() or np.ptp(without) < 1e-12:
        return Interval(low, high)
    scaled = _scaled(name, without)
    error = sqrt((n - 1) / n * float(((scaled - scaled.mean()) ** 2).sum()))
    middle, half = float(_scaled(name, value)), t_quantile(confidence, n - 1) * error
    ends = (_unscaled(name, end) for end in (middle - half, middle + half))
    return Interval(*(min(max(end, low), high) for end in ends))


def _scaled(name: FigureName, values: Floats) -> Floats:
    if name == "mmrv":
        return np.log((values + _SMALL) / (1.0 + _SMALL - values))
    return np.arctanh(np.clip(values, -_NEAR, _NEAR))


def _unscaled(name: FigureName, value: float) -> float:
    if name == "mmrv":
        return float((1.0 + 2 * _SMALL) / (1.0 + np.exp(-value)) - _SMALL)
    return float(np.tanh(value))
