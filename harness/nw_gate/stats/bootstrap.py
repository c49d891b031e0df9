"""A display interval for mean success: a Bayesian bootstrap, stratified by scene.

The scenes of a suite are the whole of what it speaks about, not a sample of scenes, so trials are
reweighted within each scene and the scenes' means are averaged with equal weight. Two departures
from the textbook, because 2 to 30 trials a scene that mostly score 1.0 defeat it:

*   Each scene also holds a pseudo-trial at 0 and one at 1, of weight 1/(2 S) each in S scenes. For
    one scene and outcomes of 0 and 1 this is the Jeffreys interval; the interval never has zero
    width. A scene of ten perfect trials is not known to be perfect.
*   The trials' Gamma weights have shape (n - 2)/n instead of 1, which makes the spread of a scene's
    mean s^2/(n - 1), the unbiased estimate; at shape 1 it is s^2/(n + 1) with the biased s^2.

Measured coverage of the nominal 95 % (5 waypoints passed in order, true means 0.28 to 0.97, 500
repetitions each): 9 scenes of 10 trials 94 to 96 %; 4 of 4 97 to 98 %; 20 of 2 93 to 95 %; one of
10 97 to 99 %. The plain percentile bootstrap covers 92 to 93 %, 70 to 91 %, and 41 to 93 % in the
first, second and last of these. With one trial in a scene no interval is honest (79 to 95 %).

Source: D. B. Rubin, "The Bayesian bootstrap", Ann. Statist. 9 (1981); J. N. K. Rao and C. F. J. Wu,
"Resampling inference with complex survey data", JASA 83 (1988) for the small-stratum correction.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from nw_gate.stats.interval import Estimate, Interval, check_confidence

_DRAWS = 4000  # Monte Carlo error of an end: under 0.002 for a width of 0.1.
_MANY = 50  # Trials from which drawing a weight for each takes longer than finding equal ones.
_SMALLEST_SHAPE = 0.3  # Of the weights, for scenes of one or two trials.


def mean_of_scenes(
    groups: Sequence[NDArray[np.float64]], confidence: float = 0.95, *, draws: int = _DRAWS
) -> Estimate:
    """Return mean success with scenes weighted equally, and its two-sided interval.

    The same values give the same interval, bit for bit: the random draws are seeded by the values.

    Args:
        groups: one array of values within [0, 1] for each scene; empty ones are left out.
        confidence: two-sided, 0.95 for 95 %.
        draws: of the mean; half as many move an end by 1.4 times as much.

    Raises:
        ValueError: there are no values at all, or the confidence is not within (0, 1).
    """
    check_confidence(confidence)
    filled = [np.sort(np.asarray(group, dtype=np.float64)) for group in groups if len(group)]
    if not filled:
        raise ValueError("no values to estimate a mean from")
    mean = float(np.mean([group.mean() for group in filled]))
    means = _draw(filled, draws)
    tail = (1.0 - confidence) / 2
    low, high = (float(end) for end in np.quantile(means, [tail, 1.0 - tail]))
    # As Brown, Cai and DasGupta (2001) do with Jeffreys' interval at the ends of the range.
    if all((group == 0.0).all() for group in filled):
        low = 0.0
    if all((group == 1.0).all() for group in filled):
        high = 1.0
    return Estimate(
        mean=mean,
        interval=Interval(min(low, mean), max(high, mean)),
        n=sum(len(group) for group in filled),
        confidence=confidence,
    )


def _draw(groups: Sequence[NDArray[np.float64]], draws: int) -> NDArray[np.float64]:
    """Return draws of the mean of scenes, shape (draws,)."""
    content = sha256(
        b"".join(len(group).to_bytes(8, "little") + group.tobytes() for group in groups)
    )
    rng = np.random.Generator(np.random.PCG64(int.from_bytes(content.digest()[:16], "little")))
    total = np.zeros(draws)
    for group in groups:
        shape = max((len(group) - 2) / len(group), _SMALLEST_SHAPE)
        shapes = np.full(len(group), shape)
        if len(group) >= _MANY:
            # Equal values may share one weight: a sum of Gammas is one, their shapes added.
            group, counts = np.unique(group, return_counts=True)  # noqa: PLW2901
            shapes = shape * counts
        weights = rng.standard_gamma(shapes, (draws, len(group)))
        pseudo = rng.standard_gamma(0.5 / len(groups), (draws, 2))
        whole = weights.sum(axis=1) + pseudo.sum(axis=1)
        total += ((weights * group).sum(axis=1) + pseudo[:, 1]) / whole
    return total / len(groups)
