"""Training: photographs and Gaussians to begin with in, Gaussians out.

A training on disk is gone on with later, with the bits that it would have had without a break.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import NwEvalError, SceneError, StoreError, UsageError
from nw_base.files.cache import DamagedError, read_sealed, sealed_path
from nw_base.memory import pack, unpack
from nw_splat.gaussians import ARRAYS, Gaussians
from nw_splat.store import digest
from nw_twin.gaussians.config import TrainConfig, falling
from nw_twin.gaussians.density import (
    DefaultDensity,
    Density,
    McmcDensity,
    Population,
    floaters,
)
from nw_twin.gaussians.images import Photo, extent_of
from nw_twin.gaussians.initial import distances
from nw_twin.gaussians.loss import Exposures, compare
from nw_twin.gaussians.rasteriser import Rasteriser, Threads

_ORDER, _SAMPLE = 0, 1
"""What a generator is for: with seed and step, all that its numbers depend on."""
_LIMIT_EVERY = 10
"""Steps from one time that sizes are limited to the next."""
_PRUNED = frozenset({5, 6, 7, 8, 9})
"""Tenths of a training after which floaters are removed; what is left learns on."""

FORMAT = 5
"""Changes with the arrays of a checkpoint, and with what a step does to them."""

_PARTS = ("values", "mean", "square")
_COUNTS = ("iteration", "floaters")
_EXPOSURES = ("maps", "mean", "square", "steps")


@dataclass(frozen=True, kw_only=True)
class TrainStep:
    """One step of a training, before it moved anything.

    Attributes:
        iteration: steps done with this one.
        photo: number of the photograph.
        loss: the minimised value.
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
    """A training that can be left after any step and taken up again; see `save_training`.

    The bits of the result depend on photographs, beginning and config: not on threads, nor on
    whether it was taken up again.

    Args:
        photos: at least one, of any sizes.
        start: Gaussians to begin with.
        config: of the training.
        threads: that share each step.

    Attributes:
        floaters: Gaussians that were removed because they hung in the air near cameras.

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
        self._coarse = tuple(photo.halved() for photo in photos) if config.coarse > 0.0 else ()
        self.iteration = 0
        self.began = digest(start)
        self.extent = extent_of(photos)
        self.population = Population(start)
        self.exposures = Exposures(len(photos))
        self._eyes = np.array([photo.camera.T_world_camera[:3, 3] for photo in photos])
        self.density = _density(config, self.extent, self._eyes.mean(axis=0), len(start))
        self.floaters = 0
        self._workers = Threads(threads)
        self._rasteriser = Rasteriser(
            preset=config.preset,
            antialiased=config.antialiased,
            projection=config.projection,
            background=config.background,
            workers=self._workers,
        )

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians as they are; the next step changes them."""
        return self.population.gaussians

    def marked(self) -> Gaussians:
        """Return the Gaussians, marked with the rasterize mode of their training."""
        return replace(
            self.gaussians,
            rasterize_mode="antialiased" if self.config.antialiased else "classic",
            projection=self.config.projection,
        )

    @property
    def is_done(self) -> bool:
        """Whether all steps are done."""
        return self.iteration >= self.config.iterations

    @property
    def steps_left(self) -> tuple[int, int]:
        """Steps to come: with pictures of half the size, and with whole ones."""
        coarse = max(0, self._coarse_steps - self.iteration)
        return coarse, self.config.iterations - self.iteration - coarse

    @property
    def _coarse_steps(self) -> int:
        return int(self.config.coarse * self.config.iterations)

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
            SceneError: the loss is not a number any more.
        """
        config, rates, population = self.config, self.config.rates, self.population
        number, share = self._next_photo(), self.iteration / max(1, self.config.iterations - 1)
        photo = (self._coarse if self.iteration < self._coarse_steps else self.photos)[number]
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
        tenth, rest = divmod(10 * self.iteration, config.iterations)
        if tenth in _PRUNED and rest < 10:
            self._prune()
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

    def _prune(self) -> None:
        gone = floaters(self.population.gaussians.means, self.photos, self.extent)
        if gone.any() and not gone.all():
            self.population.keep(~gone)
            self.density.keep(~gone)
            self.floaters += int(gone.sum())

    def _next_photo(self) -> int:
        """Return the photograph of the next step: all in turn, in another order each time."""
        count = len(self.photos)
        turn, place = divmod(self.iteration, count)
        return int(self._generator(_ORDER, turn).permutation(count)[place])

    def _generator(self, purpose: int, step: int) -> np.random.Generator:
        return np.random.default_rng([self.config.seed, purpose, step])


def _density(
    config: TrainConfig, extent: float, middle: NDArray[np.float64], count: int
) -> Density:
    if config.strategy == "default":
        return DefaultDensity(
            config.default, extent=extent, most=config.most, count=count, middle=middle
        )
    return McmcDensity(config.mcmc, most=config.most) if config.strategy == "mcmc" else Density()


def save_training(path: Path, trainer: Trainer) -> None:
    """Write a training's state; a reader sees the old file or the new one whole.

    Raises:
        StoreError: the file cannot be written.
    """
    population = trainer.population
    parts = zip(_PARTS, (population.gaussians, *population.moments), strict=True)
    arrays: dict[str, NDArray[Any]] = {
        f"{part}.{name}": getattr(gaussians, name) for part, gaussians in parts for name in ARRAYS
    }
    arrays |= {f"exposure.{name}": getattr(trainer.exposures, name) for name in _EXPOSURES}
    arrays |= {f"density.{name}": array for name, array in trainer.density.arrays().items()}
    for name in _COUNTS:
        arrays[name] = np.array(getattr(trainer, name), dtype=np.int64)
    arrays["about"] = np.frombuffer(
        _about(trainer.photos, trainer.began, trainer.config), dtype=np.uint8
    )
    with sealed_path(path) as temporary:
        temporary.write_bytes(pack(arrays))


def resume_training(
    path: Path,
    photos: Sequence[Photo],
    start: Gaussians,
    config: TrainConfig,
    *,
    threads: int = 1,
) -> Trainer:
    """Return a training as it was saved.

    Args:
        path: of `save_training`.
        photos: as before.
        start: the Gaussians that the training began with, not its current ones.
        config: as before.
        threads: any number.

    Raises:
        StoreError: there is none, it is damaged, or it is of other photographs, began with other
            Gaussians, or was asked for other things.
    """
    try:
        arrays = unpack(bytes(read_sealed(path)))
    except (OSError, DamagedError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise StoreError(
            f"{path}: no training to resume: {reason}", fix="start a new one"
        ) from error
    about, began = arrays.pop("about", np.zeros(0, dtype=np.uint8)).tobytes(), digest(start)
    if about != _about(photos, began, config):
        raise StoreError(
            f"{path} is of a training with other photographs, another mesh or other options",
            fix="continue it with the same inputs, or start a new one",
        )
    try:
        trainer = _restored(arrays, photos, config, threads)
    except (KeyError, ValueError, NwEvalError) as error:
        raise StoreError(
            f"{path}: arrays of a training are missing or do not belong together: {error}",
            fix="start a new one",
        ) from error
    trainer.began = began
    return trainer


def _restored(
    arrays: dict[str, NDArray[Any]], photos: Sequence[Photo], config: TrainConfig, threads: int
) -> Trainer:
    values, mean, square = (
        Gaussians(
            **{name: arrays[f"{part}.{name}"] for name in ARRAYS},
            rasterize_mode=None,
            projection=None,
            notes=(),
        )
        for part in _PARTS
    )
    trainer = Trainer(photos, values, config, threads=threads)
    for part in (mean, square):
        for name in ARRAYS:
            _check(getattr(part, name), getattr(values, name))
    trainer.population = Population(values, (mean, square))
    for owner, names, kind in (
        (trainer.exposures, _EXPOSURES, "exposure"),
        (trainer.density, trainer.density.remembered, "density"),
    ):
        for name in names:
            array = arrays[f"{kind}.{name}"]
            _check(array, getattr(owner, name))
            setattr(owner, name, array)
    for name in _COUNTS:
        _check(arrays[name], np.array(0, dtype=np.int64))
        setattr(trainer, name, int(arrays[name]))
    if not 0 <= trainer.iteration <= config.iterations:
        raise ValueError(f"{trainer.iteration} steps of {config.iterations}")
    return trainer


def _check(array: NDArray[Any], like: NDArray[Any]) -> None:
    if array.shape != like.shape or array.dtype != like.dtype:
        raise ValueError(f"{array.dtype} {array.shape} instead of {like.dtype} {like.shape}")


def _about(photos: Sequence[Photo], began: str, config: TrainConfig) -> bytes:
    """Return what a training is of: its config, its photographs, and what it began with."""
    shown = [(photo.name, photo.digest()) for photo in photos]
    of = {"format": FORMAT, "photos": shown, "began": began, "config": asdict(config)}
    return json.dumps(of).encode()
