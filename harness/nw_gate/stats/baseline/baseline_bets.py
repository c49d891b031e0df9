"""Bets that are made from the baseline, before any trial of the candidate.

The bets of `evidence` are shares of the largest loss that can happen. Where the baseline shows that
a loss is rare, a loss deserves a far larger bet. So most of the capital is on accounts of

    f = a + l y,     y = c for PASS, 1 - c for REGRESSED,     a >= 0,  l >= 0,

where a depends on the scene, and on what the baseline did from the same start where that is known
(its class d). A null says that the mean of y over scenes and starts is at most n. As the shares w
of scene and class are those of the baseline, the mean of f is then at most

    sum_{s,d} w_sd a_sd + l n.

f is a number at least 0 of each pair of scene and start, with a known most mean: `evidence.along`
bets all of an account on it, f / (that mean), and its proof holds as it stands, without replacement
too. No bet depends on the trials, and no distribution is assumed: the claims and errors are those
of the other bets. A wrong guess of the candidate costs trials, not validity.

**How a and l are chosen.** For a guess Q of the candidate's success in each scene and class, the
f that grows fastest, max E_Q log f under sum w a + l n = 1, is where

    E_Q[1 / (a_sd + l y)] = 1 in each scene and class,     sum_{s,d} w_sd a_sd + l n = 1

(Lagrange; a convex problem, solved by Newton's method). f is the most general e-value against a
mean over random scenes: any other is below one of these (Larsson, Ramdas and Ruf). The guesses are
the baseline itself, with each waypoint that it reached kept by one chance, in order, so that the
mean drops by given amounts (`_PASSES`, `_FLAGS`); half of those for PASS add that a start often
ends as it did for the baseline. A little of every result is mixed in, so that no account is lost to
one that the baseline never had.

What it gains was simulated (docs/concepts/power.md): 10 to 13 % of the trials at a drop of .10, 16
to 28 % at .20, and 5 % more to 4 % fewer where nothing dropped.

Source: P. Gruenwald, R. de Heide and W. Koolen, "Safe testing", JRSS B 86 (2024), for
growth-optimal e-values; M. Larsson, A. Ramdas and J. Ruf, "The numeraire e-variable and reverse
information projection", Ann. Statist. 53 (2025), for E_Q[1 / f] as the condition of the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SHARE_ABOVE, SHARE_BELOW = 0.8, 0.5
"""Of the capital for PASS and for REGRESSED; the rest is on the bets of `evidence`. The baseline is
a sample of starts: where it scored more than it truly does, a policy just at `tolerate` looks worse
than it is. With .8 such a policy is REGRESSED in up to 2.1 % against 30 or 60 starts a scene, with
.5 in 1.8 % (simulated; 1 % if the baseline's mean were exact), for 5 of 80 trials more."""

_PASSES = ((0.0, 0.40), (0.2, 0.35), (0.45, 0.25))
"""Guessed drops in units of max_drop, and shares of what bets for PASS."""
_FLAGS = ((0.6, 0.3), (1.0, 0.4), (2.0, 0.3))
"""The same of what bets for REGRESSED, each at least `_BEYOND` above `tolerate`."""
_BEYOND = 0.25
_LEAST_LEFT = 0.05
"""No guess has less success than this."""
_REPEATS = 0.6
"""How often a start ends as for the baseline, in the guesses that say so."""
_HARDER, _HARDER_BY, _ANYTHING = 0.03, 0.12, 0.01
"""What every guess has of trials that are harder, and by which drop; and of any result alike."""

_ROOTS, _STEPS, _LAST_STEPS, _HALVINGS = 9, 2, 6, 40
"""Of Newton's methods for l and for a, and of a search: to `_STEP` for most guesses. What is left
makes a bet slightly poorer and no less fair, as its null follows from a and l as they are."""
_STEP = 2.0**-24
"""To which numbers are rounded: last digits that a processor adds in another order do not count."""
_MOST_LEVELS = 10
"""Results of one scene that are told apart where they are no shares of waypoints."""


class Account(NamedTuple):
    """Bets by one guess."""

    weight: float
    """Share of all capital."""
    fixed: Floats
    """a, shape (..., S, D)."""
    slope: Floats
    """l, shape (...)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BaselineBets:
    """Accounts that bet by what the baseline scored; leading axes are baselines apart."""

    levels: NDArray[np.intp]
    """k of each scene, shape (S,): its results are about 0, 1/k, ..., 1."""
    shares: Floats
    """w times S: of the starts of each scene by their class, shape (..., S, D). D is 1 where starts
    are not told apart."""
    above: tuple[Account, ...]
    """For PASS; their weights are at most 1 together."""
    below: tuple[Account, ...]
    """For REGRESSED."""

    def only(self, which: NDArray[np.intp]) -> BaselineBets:
        """Return those of some baselines, by position along the first axis."""
        if self.shares.ndim == 2:
            return self
        if self.above[0].fixed.ndim == 2:
            return replace(self, shares=self.shares[which])
        above, below = (
            tuple(Account(weight, fixed[which], slope[which]) for weight, fixed, slope in side)
            for side in (self.above, self.below)
        )
        return replace(self, shares=self.shares[which], above=above, below=below)

    def against(self, scores: Floats) -> BaselineBets:
        """Return the same bets against other baselines in the same scenes.

        Args:
            scores: success from each start, shape (..., S, M).
        """
        reached = np.rint(scores * self.levels[:, None])
        steps = range(self.shares.shape[-1])
        shares = [(reached == step).mean(axis=-1) for step in steps]
        return replace(self, shares=np.stack(shares, axis=-1))

    def null(self, account: Account, most: Floats) -> Floats:
        """Return the mean of f that a null allows.

        Args:
            account: one of these.
            most: n, the mean of y that it allows, shape (...), or any of one baseline.
        """
        fixed = (self.shares * account.fixed).sum(axis=(-2, -1)) / len(self.levels)
        return fixed + account.slope * most

    def values(
        self, account: Account, scenes: NDArray[np.intp], baseline: Floats, y: Floats
    ) -> Floats:
        """Return f of trials, each of shape (..., T).

        Args:
            account: one of these.
            scenes: of the trials.
            baseline: b, what the baseline scored from their starts.
            y: of the trials.
        """
        size = self.shares.shape[-1]
        which = scenes * size + self._classes(scenes, baseline)
        flat = account.fixed.reshape(*account.fixed.shape[:-2], -1)
        fixed = flat[which] if flat.ndim == 1 else np.take_along_axis(flat, which, axis=-1)
        return fixed + account.slope[..., None] * y

    def _classes(self, scenes: NDArray[np.intp], baseline: Floats) -> NDArray[np.intp]:
        """Return d of trials, by their scene and what the baseline scored from the same start."""
        if self.shares.shape[-1] == 1:
            return np.zeros_like(scenes)
        return np.rint(baseline * self.levels[scenes]).astype(np.intp)


def make_bets(
    scores: Floats,
    waypoints: NDArray[np.intp],
    *,
    max_drop: float,
    tolerate: float,
    by_start: bool = True,
) -> BaselineBets:
    """Return the bets that suit a baseline.

    Args:
        scores: success of the baseline from each start, shape (..., S, M); leading axes are
            baselines apart.
        waypoints: of each scene, shape (S,). Where success is no share of them, ten levels count.
        max_drop: drop of mean success that must not pass.
        tolerate: drop that must not be flagged.
        by_start: whether candidates are met from the same starts, so that a bet may depend on how
            the baseline did there.
    """
    shares_reached = scores * waypoints[:, None]
    whole = np.abs(shares_reached - np.rint(shares_reached)) < 1e-6
    levels = np.where(
        whole.reshape(-1, *whole.shape[-2:]).all(axis=(0, 2)),
        np.maximum(waypoints, 1),
        _MOST_LEVELS,
    )
    reached = np.rint(scores * levels[:, None]).astype(np.intp)
    steps = np.arange(int(levels.max()) + 1)
    counts = np.stack([(reached == step).mean(axis=-1) for step in steps], axis=-1)
    shares = counts if by_start else np.ones_like(counts[..., :1])
    values = np.minimum(steps / levels[:, None], 1.0)
    mean = scores.mean(axis=(-2, -1))
    known = _with_anything(counts, levels)
    above = list[Account]()
    for part, weight in _PASSES:
        guess = _harder(known, levels, np.full(mean.shape, part * max_drop))
        for repeats in (0.0, _REPEATS) if by_start else (0.0,):
            bets = _solve(
                _by_class(guess, repeats, shares.shape[-1]), values, shares, mean - max_drop
            )
            above.append(Account(weight, *bets))
    below = list[Account]()
    for part, weight in _FLAGS:
        drop = max(part * max_drop, tolerate + _BEYOND * max_drop)
        guess = _harder(known, levels, np.minimum(drop, np.maximum(mean - _LEAST_LEFT, 0.0)))
        bets = _solve(_by_class(guess, 0.0, 1), 1.0 - values, shares, 1.0 - (mean - tolerate))
        below.append(Account(weight, *bets))
    return BaselineBets(
        levels=levels,
        shares=shares,
        above=_weighed(above, SHARE_ABOVE),
        below=_weighed(below, SHARE_BELOW),
    )


def _weighed(accounts: list[Account], share: float) -> tuple[Account, ...]:
    total = sum(account.weight for account in accounts)
    return tuple(each._replace(weight=share * each.weight / total) for each in accounts)


def _with_anything(counts: Floats, levels: NDArray[np.intp]) -> Floats:
    """Return shares of results with a few that were not seen, shape (..., S, L)."""
    possible = (np.arange(counts.shape[-1]) <= levels[:, None]) / (levels[:, None] + 1.0)
    harder = _harder(counts, levels, np.full(counts.shape[:-2], _HARDER_BY))
    seen = (1.0 - _HARDER - _ANYTHING) * counts
    return seen + _HARDER * harder + _ANYTHING * possible


def _harder(results: Floats, levels: NDArray[np.intp], drop: Floats) -> Floats:
    """Return results of which each waypoint is kept with one chance, so that the mean drops so.

    Args:
        results: shares of 0 to k waypoints reached, shape (..., S, L).
        levels: k, shape (S,).
        drop: shape (...); at most the mean.
    """
    at_least = np.cumsum(results[..., ::-1], axis=-1)[..., ::-1]
    mean = (at_least[..., 1:].sum(axis=-1) / levels).mean(axis=-1)
    wanted = np.maximum(mean - drop, 0.0)
    low, high = np.zeros_like(mean), np.ones_like(mean)
    for _ in range(_HALVINGS):
        kept = (low + high) / 2.0
        growth = ((at_least * _powers(kept, at_least))[..., 1:].sum(axis=-1) / levels).mean(axis=-1)
        low, high = np.where(growth < wanted, kept, low), np.where(growth < wanted, high, kept)
    left = at_least * _powers(np.where(drop > 0.0, high, 1.0), at_least)
    return left - np.concatenate([left[..., 1:], np.zeros_like(left[..., :1])], axis=-1)


def _powers(kept: Floats, like: Floats) -> Floats:
    """Return kept^0, kept^1, ..., shape (..., 1, L): as products, which are the same everywhere."""
    steps = np.broadcast_to(kept[..., None, None], (*kept.shape, 1, like.shape[-1])).copy()
    steps[..., 0] = 1.0
    return np.cumprod(steps, axis=-1, dtype=np.float64)


def _by_class(guess: Floats, repeats: float, size: int) -> Floats:
    """Return a guess by result, scene and class, shape (L, ..., S, D); D is 1 if none repeats."""
    every = np.moveaxis(guess, -1, 0)[..., None]
    if not repeats:
        return every
    same = np.eye(len(every), size, dtype=np.float64).reshape(
        len(every), *[1] * (every.ndim - 2), size
    )
    return (1.0 - repeats) * every + repeats * same


def _solve(guess: Floats, values: Floats, shares: Floats, null: Floats) -> tuple[Floats, Floats]:
    """Return a and l of the bet that grows fastest if a guess is true.

    l, by Newton's method from the right, is the larger root of h(l) = sum w a(l) + l n - 1, which
    is convex because {(a, l): E[1 / (a + l y)] <= 1} is. A guess whose mean is no more than the
    null's has none but 0: then nothing is bet.

    Args:
        guess: probabilities of results, shape (L, ..., S, D), of D classes or one for all.
        values: y of the results, shape (S, L).
        shares: of classes in each scene, shape (..., S, D).
        null: n, shape (...).

    Returns:
        a, shape (..., S, D), and l, shape (...).
    """
    whole, y = shares if guess.shape[-1] > 1 else np.ones_like(shares[..., :1]), values.T[..., None]
    y = y.reshape(len(y), *[1] * null.ndim, *y.shape[1:])
    weights = whole / shares.shape[-2]
    mean = (weights * (guess * y).sum(axis=0)).sum(axis=(-2, -1))
    possible = (null > _STEP) & (mean > null)
    n = np.where(possible, null, 1.0)
    slope = 1.0 / n
    # Both bounds are at most the root: the share of y = 0, and that of Jensen's inequality.
    least, expected = (guess * (y == 0.0)).sum(axis=0), (guess * y).sum(axis=0)
    fixed = np.maximum(least, 1.0 - slope[..., None, None] * expected)
    for last in (*[False] * _ROOTS, True):
        lines = slope[..., None, None] * y
        # As l falls a rises: the one before is at most the root, and no step goes beyond it.
        for _ in range(_LAST_STEPS if last else _STEPS):
            each = guess / (fixed + lines)
            slack = each.sum(axis=0) - 1.0
            fixed = fixed + np.maximum(slack, 0.0) / (each / (fixed + lines)).sum(axis=0)
        if last:
            break
        inverse = 1.0 / (fixed + lines)
        squares = guess * inverse * inverse
        falls = (squares * y).sum(axis=0) / squares.sum(axis=0)
        over = (weights * fixed).sum(axis=(-2, -1)) + slope * n - 1.0
        rises = n - (weights * falls).sum(axis=(-2, -1))
        step = np.maximum(over, 0.0) / np.where(rises > 0.0, rises, 1.0)
        slope = np.where(possible, np.maximum(slope - step, 0.0), 0.0)
    fixed = np.where(possible[..., None, None], fixed, 1.0)
    fixed, slope = (np.rint(part / _STEP) * _STEP for part in (fixed, slope))
    return np.broadcast_to(fixed, shares.shape), slope
