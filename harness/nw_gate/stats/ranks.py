"""Which ranks policies may have, as far as their trials decide.

Every policy is compared with every other by the same starts. Of a pair the trials give differences
d = c_i - c_j, within [-1, 1], and "policy i is no better than policy j in the mean over scenes"
holds their mean at 0 at most. Against it bets a capital after each whole round (the r-th start of
every scene together), with one share b of 0 to 1 for all scenes of a round:

    E_r = E_{r-1} prod_s (1 + b_r d_{s,r}).

If b_r is fixed before the round, then given the past the product has the expectation
prod_s (1 + b_r mu_s), which by the inequality of arithmetic and geometric means is at most
(1 + b_r mean(mu))^S <= 1 under the claim: E is a supermartingale, scenes need not be alike, and it
ever reaches 1 / a with probability at most a (Ville). No distribution is assumed, and trials of two
policies from one start may depend on each other. Half of the capital bets the fixed shares of
`betting`. The other half learns from the rounds before:

    b_r = min(max(m, 0) / q, c),  c in {.5, .9, .99},

where m is the mean and q the mean square of the differences before r and of five that are assumed,
with mean 1/4 and variance 0.3.

**All pairs together.** Of N policies there are N (N - 1) claims. A set of claims is refuted where
the mean of its e-values reaches 1 / error, and a claim where every set that holds it is (a closed
test). That is so where E - 1 / error is at least the sum, over all claims with an E' below
1 / error, of 1 / error - E'. It refutes what Holm's procedure does with p = 1 / E, and more. A
true claim is refuted with probability at most `error`, all claims and rounds together. The rank of
a policy lies between 1 + how many are better significantly, and N - how many are worse
significantly: all N such sets of ranks hold their true rank together with probability 1 - error.

**What ten starts decide.** Success is all or nothing, .95 of the best policy and .70 of the others,
half of each policy's luck is shared, and each scene has 10 starts; 400 comparisons (100 of 16
scenes). In % of them a pair is told apart; in brackets with fixed shares and Holm's procedure:

    scenes               1         2          4          16
    two policies      1 (1)   21 (18)    62 (52)   100 (100)
    three             0 (0)     6 (5)    45 (38)   100 (100)
    five              0 (0)     2 (1)    32 (24)   100 (100)

With waypoints, each missed with one chance, the first line is 0 (0), 26 (19), 84 (76), 100 (100).
One scene of ten starts decides nothing, and hardly could by another rule. For two policies no rule
that errs in at most 2.5 % of either claim decides more than 23 % in one scene, 60 % in two and 90 %
in four, even if it were known that success is all or nothing and that scenes are alike (Neyman and
Pearson's test of the least favourable equal policies).

Without as many trials in each scene, where whole rounds are less than three quarters of all trials,
only the fixed shares bet, once, on all trials (`betting.evidence_above`).

Source: M. Mogstad, J. P. Romano, A. M. Shaikh and D. Wilhelm, "Inference for ranks with
applications to mobility across neighbourhoods and academic achievement across countries", Rev.
Econ. Stud. 91 (2024), for ranks from simultaneous comparisons; V. Vovk and R. Wang, "E-values:
calibration, combination and applications", Ann. Statist. 49 (2021), for closed tests with means of
e-values; I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by betting",
JRSS B 86 (2024), appendix B.3 (aGRAPA), for bets that learn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_gate.stats.betting import Groups, evidence_above, log_bets, log_mixture

Floats = NDArray[np.float64]

_CAPS, _SHARES = (0.5, 0.9, 0.99), (0.25, 0.5, 0.25)
"""Largest bets of those that learn, and the parts of the capital that bet so at most."""
_ASSUMED, _MEAN, _VARIANCE = 5.0, 0.25, 0.3
"""Differences before the first round: how many, and their mean and variance."""
_WHOLE = 0.75
"""Of all trials, at least, in whole rounds, for bets by rounds."""
_MOST = 690.0
"""Of the logarithm of a capital, which is a double."""


@dataclass(frozen=True, kw_only=True)
class Ranks:
    """Ranks, 1 the best, that are not ruled out for one policy."""

    best: int
    worst: int

    @property
    def decided(self) -> bool:
        """Whether only one is left."""
        return self.best == self.worst


def possible_ranks(policies: Sequence[Groups], error: float = 0.05) -> tuple[Ranks, ...]:
    """Return the ranks that each policy may have; those of all hold together.

    Args:
        policies: for each, one array of successes within [0, 1] for each scene, and for each cell
            of what is changed in it; scenes, and starts in them, in the same order for all.
        error: at most this is the probability that any of the sets misses its policy's true rank.

    Raises:
        ValueError: the policies differ in the numbers of scenes or starts, or a value lies outside
            [0, 1].
    """
    shapes = [tuple(len(scene) for scene in groups) for groups in policies]
    if len({*shapes}) > 1:
        raise ValueError(
            "policies with different numbers of initial states cannot be compared state by state"
        )
    for scores in (np.asarray(scene) for groups in policies for scene in groups):
        if not ((scores >= 0.0) & (scores <= 1.0)).all():
            raise ValueError("a success is not between 0 and 1")
    pairs = list(permutations(range(len(policies)), 2))
    if not pairs or not sum(shapes[0]):
        return (Ranks(best=1, worst=len(policies)),) * len(policies)
    refuted = _refuted(np.stack([_evidence(policies[i], policies[j]) for i, j in pairs]), error)
    rejected_pairs = {pair for pair, is_so in zip(pairs, refuted, strict=True) if is_so}
    # Early rounds may show one of two to be better and late ones the other: neither is then.
    better = [pair for pair in rejected_pairs if pair[::-1] not in rejected_pairs]
    return tuple(
        Ranks(
            best=1 + sum(loser == index for _, loser in better),
            worst=len(policies) - sum(winner == index for winner, _ in better),
        )
        for index in range(len(policies))
    )


def _refuted(evidence: Floats, error: float) -> NDArray[np.bool_]:
    """Return which claims a closed test refutes after any round, shape (K,).

    Args:
        evidence: e-values of K claims after R rounds, shape (K, R).
        error: of all claims together.
    """
    needed = 1.0 / error
    lacking = np.maximum(needed - evidence, 0.0).sum(axis=0)
    return (evidence - needed >= lacking).any(axis=1)


def _evidence(one: Groups, other: Groups) -> Floats:
    """Return e-values against "the first is no better than the second" after rounds, shape (R,)."""
    counts = [len(scene) for scene in one]
    rounds = min(counts)
    halves = [
        (1.0 + np.asarray(mine, np.float64) - theirs) / 2.0
        for mine, theirs in zip(one, other, strict=True)
    ]
    if rounds * len(counts) < _WHOLE * sum(counts):
        return np.array([evidence_above(halves, 0.5)])
    values = np.stack([scene[:rounds] for scene in halves])
    known, places = np.unique(values, return_inverse=True)
    each = log_bets(known, 1.0, 0.5)[:, places.reshape(values.shape)]
    fixed = log_mixture(each.sum(axis=1).cumsum(axis=1).T)
    return (_capital(fixed) + _learnt(2.0 * values - 1.0)) / 2.0


def _learnt(differences: Floats) -> Floats:
    """Return the capital after each round of bets that learn from the rounds before, shape (R,).

    Args:
        differences: of trials, shape (S, R).
    """
    scenes, rounds = differences.shape
    before = _ASSUMED + scenes * np.arange(rounds)
    total = _before(differences) + _ASSUMED * _MEAN
    squares = _before(differences**2) + _ASSUMED * (_VARIANCE + _MEAN**2)
    wanted = np.maximum(total / before, 0.0) / (squares / before)
    capital = np.zeros(rounds)
    for cap, share in zip(_CAPS, _SHARES, strict=True):
        won = same_bits.log(1.0 + np.minimum(wanted, cap) * differences)
        capital += share * _capital(won.sum(axis=0).cumsum())
    return capital


def _before(values: Floats) -> Floats:
    """Return the sum of all values of the rounds before each, shape (R,)."""
    return np.concatenate([np.zeros(1), values.sum(axis=0).cumsum()[:-1]])


def _capital(logarithm: Floats) -> Floats:
    return same_bits.exp(np.minimum(logarithm, _MOST))
