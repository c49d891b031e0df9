"""3D Gaussian Splatting as Markov Chain Monte Carlo (Kheradmand et al. 2024).

The number of Gaussians is given, and where they are is sampled: noise moves faint ones about, dead
ones move to where living ones are, and new ones come there too. N Gaussians in the place of one of
opacity o have opacity 1 - (1 - o)^(1/N) each and another size, so that the picture stays what it
was (equation 9 of the paper; its double sum is one, since sum_i C(i - 1, k) = C(N, k + 1)).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.splat.gaussians import ARRAYS
from nw_eval.twin.gaussians.densify.density import Density
from nw_eval.twin.gaussians.densify.settings import Mcmc
from nw_eval.twin.gaussians.kernels.perturb import perturb
from nw_eval.twin.gaussians.population import Population
from nw_eval.twin.gaussians.raster.images import Gradients

MOST_IN_PLACE = 50
"""Gaussians that one is replaced by at most; more count as so many, as in the paper's code."""

_BELOW_ONE = 1.0 - 2.0**-23


class McmcDensity(Density):
    """Moves, adds and shakes Gaussians.

    Args:
        settings: of the strategy.
        most: Gaussians that there are to be at last.
    """

    def __init__(self, settings: Mcmc, *, most: int) -> None:
        self._settings, self._most = settings, most

    def weigh(self, population: Population, gradients: Gradients) -> float:
        """Add the gradient of the weights on opacity and size; return what they add to the loss."""
        settings, n = self._settings, len(population)
        opacity = population.opacities()
        scales = np.exp(population.gaussians.log_scales)
        slope = settings.opacity_weight / n * opacity * (1.0 - opacity)
        np.add(gradients.opacity_logits, slope, out=gradients.opacity_logits, casting="unsafe")
        np.add(
            gradients.log_scales,
            scales * np.float32(settings.scale_weight / (3 * n)),
            out=gradients.log_scales,
        )
        weighed = settings.opacity_weight * opacity.mean()
        return float(weighed + settings.scale_weight * scales.mean(dtype=np.float64))

    def after(
        self,
        population: Population,
        iteration: int,
        means_rate: float,
        generator: np.random.Generator,
    ) -> None:
        """Relocate and add where it is time for it, then shake; see `Density.after`."""
        settings = self._settings
        if settings.first < iteration < settings.last and iteration % settings.every == 0:
            opacity = population.opacities()
            dead = opacity <= settings.dead
            if dead.any() and not dead.all():
                self._replace(
                    population, np.flatnonzero(dead), np.where(dead, 0.0, opacity), generator
                )
            wanted = min(self._most, int(settings.growth * len(population)))
            more = wanted - len(population)
            if more > 0:
                self._replace(population, more, population.opacities(), generator)
        noise = generator.standard_normal((len(population), 3), dtype=np.float32)
        g = population.gaussians
        perturb(
            g.means, g.log_scales, g.quats, g.opacity_logits, noise, means_rate * settings.noise
        )

    def _replace(
        self,
        population: Population,
        places: NDArray[np.int64] | int,
        weights: NDArray[np.float64],
        generator: np.random.Generator,
    ) -> None:
        """Put a copy of sampled Gaussians into these rows, or so many behind all rows.

        A Gaussian is sampled with a chance proportional to its weight; it and its copies share
        what it was.
        """
        count = places if isinstance(places, int) else len(places)
        chosen = generator.choice(len(population), count, p=weights / weights.sum())
        sampled, copies = np.unique(chosen, return_counts=True)
        g = population.gaussians
        opacity, factor = relocated(population.opacities()[sampled], copies + 1)
        opacity = np.clip(opacity, self._settings.dead, _BELOW_ONE)
        population.change(
            sampled,
            opacity_logits=np.log(opacity / (1.0 - opacity)),
            log_scales=g.log_scales[sampled] + np.log(factor)[:, None],
        )
        if isinstance(places, int):
            population.append(population.gaussians.take(chosen))
        else:
            copy = population.gaussians.take(chosen)
            population.change(places, **{name: getattr(copy, name) for name in ARRAYS})


def relocated(
    opacity: NDArray[np.float64], number: NDArray[np.integer[Any]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return opacity and factor on the size of each of `number` Gaussians in the place of one.

    Args:
        opacity: (n,) of the one.
        number: (n,) how many take its place, at least 1.
    """
    number = np.minimum(number, MOST_IN_PLACE)
    shared = 1.0 - (1.0 - opacity) ** (1.0 / number)
    area = np.zeros_like(opacity)
    for k in range(1, MOST_IN_PLACE + 1):
        binomial = np.array([float(math.comb(int(n), k)) for n in range(MOST_IN_PLACE + 1)])
        area += binomial[number] * (-1.0) ** (k - 1) * shared**k / math.sqrt(k)
    return shared, opacity / area
