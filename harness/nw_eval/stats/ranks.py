"""Which ranks policies may have, as far as their trials decide.

Every policy is compared with every other by the same starts. Against "policy i is no better than
policy j in the mean over starts and scenes" bets the capital of `betting` on (1 + c_i - c_j) / 2,
which that claim holds at 1/2 at most; of an e-value E, 1/E is a p-value. Holm's procedure over all
N (N - 1) claims keeps the probability of refuting any true one at most at `error`, so all orders
that are called decided are right together with probability 1 - error. The rank of a policy lies
between 1 + how many are better significantly, and N - how many are worse significantly: all N such
sets of ranks hold their true rank together with that probability.

No distribution is assumed, and trials of two policies from one start may depend on each other.

Source: M. Mogstad, J. P. Romano, A. M. Shaikh and D. Wilhelm, "Inference for ranks with
applications to mobility across neighbourhoods and academic achievement across countries", Rev.
Econ. Stud. 91 (2024), for ranks from simultaneous comparisons; S. Holm (1979) as in `hazard`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

from nw_eval.stats.betting import Groups, evidence_above
from nw_eval.stats.hazard import holm


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
        policies: for each, one array of successes within [0, 1] for each scene; scenes, and starts
            in them, in the same order for all.
        error: at most this is the probability that any of the sets misses its policy's true rank.

    Raises:
        ValueError: the policies differ in the numbers of scenes or starts.
    """
    shapes = [tuple(len(scene) for scene in groups) for groups in policies]
    if len({*shapes}) > 1:
        raise ValueError("policies with other numbers of starts cannot be compared start by start")
    pairs = list(permutations(range(len(policies)), 2))
    ps = holm([_p_better(policies[one], policies[other]) for one, other in pairs])
    better = [pair for pair, p in zip(pairs, ps, strict=True) if p <= error]
    return tuple(
        Ranks(
            best=1 + sum(loser == index for _, loser in better),
            worst=len(policies) - sum(winner == index for winner, _ in better),
        )
        for index in range(len(policies))
    )


def _p_better(one: Groups, other: Groups) -> float:
    """Return a p-value against "the first is no better than the second"."""
    halves = [(1.0 + mine - theirs) / 2.0 for mine, theirs in zip(one, other, strict=True)]
    return min(1.0, 1.0 / evidence_above(halves, 0.5))
