"""Training: photographs and Gaussians to begin with in, Gaussians out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nw_eval.errors import SceneError, UsageError
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.store import digest
from nw_eval.twin.gaussians.config import TrainConfig, falling
from nw_eval.twin.gaussians.densify.default import DefaultDensity
from nw_eval.twin.gaussians.densify.density import Density
from nw_eval.twin.gaussians.densify.mcmc import McmcDensity
from nw_eval.twin.gaussians.exposure import Exposures
from nw_eval.twin.gaussians.nearest import distances
from nw_eval.twin.gaussians.objective import compare
from nw_eval.twin.gaussians.photo import Photo, extent_of
from nw_eval.twin.gaussians.population import Population
from nw_eval.twin.gaussians.raster.rasteriser import Rasteriser
from nw_eval.twin.gaussians.raster.threads import Threads

_ORDER, _SAMPLE = 0, 1
"""What a generator is for: with seed and step, all that its numbers depend on."""
_LIMIT_EVERY = 10
"""Steps from one time that sizes are limited to the next."""


@dataclass(frozen=True, kw_only=True)
class TrainStep:
    """One step of a training, before it moved anything.

    Attributes:
        iteration: steps done with this one.
        photo: number of the photograph.
        loss: what was minimised.
        l1: mean absolute difference of the photograph.
        ssim: mean structural similarity.
        depth: the weighted term of depth.
        count: Gaussians after it.
    """

    iteration: int
    photo: int
    loss: float
    l1: float
    ssim: float
    depth: float
    count: int


class Trainer:
    """A training that can be left after any step and taken up again; see checkpoint.py.

    The bits of the result depend on photographs, beginning and config: not on threads, nor on
    whether it was taken up again.

    Args:
        photos: at least one, of any sizes.
        start: Gaussians to begin with.
        config: what is asked.
        threads: that share each step.

    Raises:
        UsageError: no photographs, or no Gaussians.
    """

    def __init__(
        self,
        photos: Sequence[Photo],
        start: Gaussians,
        config: TrainConfig,
        *,
        threads: int = 1,
    ) -> None:
        if not photos or len(start) == 0:
            raise UsageError(
                f"training with {len(photos)} photographs and {len(start)} Gaussians",
                fix="give at least one of each",
            )
        self.photos, self.config = tuple(photos), config
        self.iteration = 0
        self.began = digest(start)
        self.extent = extent_of(photos)
        self.population = Population(start)
        self.exposures = Exposures(len(photos))
        self.density = _density(config, self.extent, len(start))
        self._eyes = np.array([photo.camera.T_world_camera[:3, 3] for photo in photos])
        self._workers = Threads(threads)
        self._rasteriser = Rasteriser(
            preset=config.preset,
            antialiased=config.antialiased,
            background=config.background,
            workers=self._workers,
        )

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as they are; the next step changes them."""
        return self.population.gaussians

    @property
    def is_done(self) -> bool:
        """Whether all steps are done."""
        return self.iteration >= self.config.iterations

    def run(
        self, until: int | None = None, report: Callable[[TrainStep], None] | None = None
    ) -> None:
        """Take steps until so many are done, by default all.

        Args:
            until: steps done then, at most those of the config.
            report: told of each step.
        """
        last = min(self.config.iterations, until if until is not None else self.config.iterations)
        while self.iteration < last:
            step = self.step()
            if report is not None:
                report(step)

    def step(self) -> TrainStep:
        """Take one step.

        Raises:
            SceneError: the loss is no number any more.
        """
        config, rates, population = self.config, self.config.rates, self.population
        number, share = self._next_photo(), self.iteration / max(1, self.config.iterations - 1)
        photo = self.photos[number]
        degree = min(population.gaussians.sh_degree, self.iteration // config.sh_every)
        images = self._rasteriser.render(population.gaussians, photo.camera, sh_degree=degree)
        compared = compare(
            images,
            photo,
            number=number,
            exposures=self.exposures if config.exposure else None,
            ssim_weight=config.ssim_weight,
            depth_weight=falling(config.depth_weight, config.depth_weight_last, share),
            workers=self._workers,
        )
        gradients = self._rasteriser.backward(compared.upstream)
        loss = compared.value + self.density.weigh(population, gradients)
        if not math.isfinite(loss):
            raise SceneError(
                f"training of Gaussians diverged at step {self.iteration + 1}, on {photo.name}",
                fix="lower its learning rates",
            )
        self.iteration += 1
        means_rate = falling(rates.means, rates.means_last, share) * self.extent
        population.move(gradients, rates, means_rate, self.iteration, self._workers)
        if compared.to_map is not None:
            rate = falling(rates.exposure, rates.exposure_last, share)
            self.exposures.move(number, compared.to_map, rate)
        self.density.observe(gradients, photo.camera)
        generator = self._generator(_SAMPLE, self.iteration)
        self.density.after(population, self.iteration, means_rate, generator)
        if config.widest > 0.0 and self.iteration % _LIMIT_EVERY == 0:
            away = distances(population.gaussians.means, self._eyes)
            limits = np.where(away < self.extent, config.widest * away, np.inf)
            population.limit_sizes(np.maximum(limits, 1e-6))
        return TrainStep(
            iteration=self.iteration,
            photo=number,
            loss=loss,
            l1=compared.l1,
            ssim=compared.ssim,
            depth=compared.depth,
            count=len(population),
        )

    def _next_photo(self) -> int:
        """Return the photograph of the next step: all in turn, in another order each time."""
        count = len(self.photos)
        turn, place = divmod(self.iteration, count)
        return int(self._generator(_ORDER, turn).permutation(count)[place])

    def _generator(self, purpose: int, step: int) -> np.random.Generator:
        return np.random.default_rng([self.config.seed, purpose, step])


def _density(config: TrainConfig, extent: float, count: int) -> Density:
    if config.strategy == "default":
        return DefaultDensity(config.default, extent=extent, most=config.most, count=count)
    return McmcDensity(config.mcmc, most=config.most) if config.strategy == "mcmc" else Density()
