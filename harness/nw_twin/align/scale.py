"""Scale by all sources together: a posterior over its logarithm, and how far off it may be.

What a source claims says how well its own pieces agree, not how true it is: a map is stretched, a
tag is printed smaller than it should be. So each source has two terms besides its own scatter.
`_TAUS` is by how much the sources of this place disagree; it is unknown, and few sources leave it
to its prior. And each source may be wrong altogether: feet for metres, the edge of another tag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

_TAUS = np.array([0.003, 0.006, 0.012, 0.025, 0.05])
_PRIOR = np.array([0.12, 0.24, 0.34, 0.2, 0.1])
_NU = 5.0
"""Degrees of freedom of Student's t, for all sources."""
_RIGHT = 0.98
"""Probability that a source is right, to within its own scatter and the common one."""
_ANYTHING = 1.5
"""Of the logarithm of a scale that is wrong altogether: most are off by less than a factor 20."""
_VAGUEST = 3.0
"""A source that is known worse is as unknown."""
_HELD = 0.95
"""Of the posterior, within what is stated."""
_CLAIM, _USUAL = 3.0, 0.015
"""A source is right if the scale lies within so many of its standard deviations and of the usual
scatter."""
_WRONG, _DOUBTFUL = 0.05, 0.75
"""Probability of being right below which a source is wrong, and below which it may be."""
_NEAREST, _REACH, _STEPS = 1e-3, 8.0, 240
"""Of the scales that are tried on each side of a source: how near to it in its own scatter, how far
in their logarithm, and how many."""
_EXACT = 1e-10


@dataclass(frozen=True, kw_only=True)
class ScaleSource:
    """One source's answer to how long a unit of the capture is.

    Attributes:
        name: `tag`, `camera height`, `poses`, `positions` or `length`.
        scale: metres in a unit.
        sigma: its standard deviation, relative, where it is right.
        reason: what it is, for people.
    """

    name: str
    scale: float
    sigma: float
    reason: str

    @property
    def within(self) -> float:
        """Relative error that it claims to have in 95 of 100 cases at most."""
        return 1.96 * self.sigma

    def __str__(self) -> str:
        known = f"known to {min(self.within, 9.99):.0%}"
        return f"{self.name} says {self.scale:.3g} m a unit, {known} ({self.reason})"


@dataclass(frozen=True, kw_only=True)
class Scale:
    """What sources say together.

    Attributes:
        scale: metres in a unit, the most probable.
        within: relative error that it has with 95 % at most.
        right: for each source, the probability that it is.
    """

    scale: float
    within: float
    right: tuple[float, ...]

    @property
    def wrong(self) -> tuple[int, ...]:
        """Numbers of the sources that the others refute."""
        return tuple(i for i, right in enumerate(self.right) if right < _WRONG)

    @property
    def disputed(self) -> tuple[int, ...]:
        """Numbers of sources that cannot all be right, where nothing says which is wrong."""
        alone, wrong = len(self.right) == 1, self.wrong
        left = [i for i in range(len(self.right)) if i not in wrong]
        return tuple(left) if not alone and min(self.right[i] for i in left) < _DOUBTFUL else ()


def solve_scale(sources: Sequence[ScaleSource]) -> Scale:
    """Return the scale by all sources; the same ones in another unit give the same length.

    Args:
        sources: one at least.
    """
    logs = np.array([math.log(source.scale) for source in sources])
    sigmas = np.array([min(source.sigma, _VAGUEST) for source in sources])
    steps = [np.geomspace(_NEAREST * sigma, _REACH, _STEPS) for sigma in sigmas]
    tried = [log + np.concatenate([-s, [0.0], s]) for log, s in zip(logs, steps, strict=True)]
    grid = np.unique(np.concatenate(tried))
    mass = np.exp(_density(grid, logs, sigmas)) * np.gradient(grid)
    mass /= mass.sum()
    best = _climbed(float(grid[np.argmax(_density(grid, logs, sigmas))]), logs, sigmas)
    claims = _CLAIM * np.hypot(sigmas, _USUAL)
    away = np.abs(grid - best)
    order = np.argsort(away, kind="stable")
    within = float(np.interp(_HELD, np.cumsum(mass[order]), away[order]))
    return Scale(
        scale=math.exp(best),
        within=math.expm1(within),
        right=tuple(
            float(mass[np.abs(grid - a) <= b].sum()) for a, b in zip(logs, claims, strict=True)
        ),
    )


def _climbed(best: float, logs: Values, sigmas: Values) -> float:
    """Return the logarithm near another one at which the density is largest."""
    radius = 0.1 * float(sigmas.min())
    steps = np.concatenate([[0.0], np.linspace(-1.0, 1.0, 40)])
    while radius > _EXACT:
        tried = best + radius * steps
        best = float(tried[int(np.argmax(_density(tried, logs, sigmas)))])
        radius *= 0.2
    return best


def _density(at: Values, logs: Values, sigmas: Values) -> Values:
    """Return the log of the posterior, up to a constant, at logarithms of the scale (N,)."""
    away = at[:, None] - logs
    wrong = (1.0 - _RIGHT) * _student(away, np.full(len(logs), _ANYTHING))
    by_tau = [
        math.log(prior) + np.log(_RIGHT * _student(away, np.hypot(sigmas, tau)) + wrong).sum(axis=1)
        for tau, prior in zip(_TAUS, _PRIOR, strict=True)
    ]
    return np.logaddexp.reduce(by_tau, axis=0)


def _student(away: Values, sigmas: Values) -> Values:
    """Return the density of Student's t at distances (N, S) with scales (S,)."""
    norm = math.gamma((_NU + 1.0) / 2.0) / math.gamma(_NU / 2.0) / math.sqrt(_NU * math.pi)
    return norm / sigmas * np.power(1.0 + np.square(away / sigmas) / _NU, -(_NU + 1.0) / 2.0)
