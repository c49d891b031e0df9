"""How Gaussians that are trained come and go: not at all, by the 3DGS paper, or by Monte Carlo.

`DefaultDensity` is the adaptive density control of the 3DGS paper (Kerbl et al. 2023, section 5.2).
Where the loss pulls a Gaussian about on the screen, there is too little of it: a small one is
cloned, a large one split in two that are drawn from it and are 1.6 times smaller. What has become
transparent is removed, and now and then opacities are lowered, so that only what is needed returns.
Like gsplat, we leave out the paper's limit on screen size, which its code never applies.

`McmcDensity` is 3D Gaussian Splatting as Markov Chain Monte Carlo (Kheradmand et al. 2024). The
number of Gaussians is given, and where they are is sampled: noise moves faint ones about, dead ones
move to where living ones are, and new ones come there too. N Gaussians instead of one of
opacity o have opacity 1 - (1 - o)^(1/N) each and another size, so that the picture stays what it
was (equation 9 of the paper; its double sum is one, since sum_i C(i - 1, k) = C(N, k + 1)).

Whatever the strategy, floaters are removed: Gaussians in the air near cameras, which help one
photograph and stand in the way of a robot.
"""

# ruff: noqa: ARG002 - what strategies are told; this one needs none of it.

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_splat.camera import Camera
from nw_splat.gaussians import ARRAYS, Gaussians, concatenate
from nw_twin.gaussians.config import Default, Mcmc, Rates
from nw_twin.gaussians.images import Gradients, Photo
from nw_twin.gaussians.kernels.rows import adam, perturb
from nw_twin.gaussians.rasteriser import Threads

EPSILON = 1e-15
"""Adam's, as the 3DGS paper's code has it: gradients here are tiny."""

Rows = NDArray[np.bool_] | NDArray[np.int64]


class Population:
    """Gaussians with their moments; rows belong together.

    Args:
        gaussians: taken over as a copy.
        moments: (first, second) moments, shaped like Gaussians; by default zeros.
    """

    def __init__(
        self, gaussians: Gaussians, moments: tuple[Gaussians, Gaussians] | None = None
    ) -> None:
        everyone = np.arange(len(gaussians))
        self.gaussians = gaussians.take(everyone)
        self.moments = moments or (_zeros(gaussians), _zeros(gaussians))

    def __len__(self) -> int:
        return len(self.gaussians)

    def move(
        self, gradients: Gradients, rates: Rates, means_rate: float, step: int, workers: Threads
    ) -> None:
        """Take one step of Adam.

        Args:
            gradients: of the loss.
            rates: of all but the means.
            means_rate: of these.
            step: steps taken, this one included.
            workers: who share the rows.
        """
        each = {name: (getattr(rates, name, 0.0),) * 2 for name in ARRAYS}
        each["means"] = (means_rate, means_rate)
        each["sh"] = (rates.sh_constant, rates.sh_others)
        n = len(self)
        tables = {
            name: tuple(
                getattr(source, name).reshape(n, -1)
                for source in (self.gaussians, gradients, *self.moments)
            )
            for name in ARRAYS
        }

        def block(first: int, end: int) -> None:
            for name, arrays in tables.items():
                lead = min(3, arrays[0].shape[1])
                adam(arrays, lead, each[name], EPSILON, step, first, end)

        workers.over(n, block)

    def keep(self, rows: Rows) -> None:
        """Keep these rows only."""
        self.gaussians = self.gaussians.take(rows)
        mean, square = self.moments
        self.moments = mean.take(rows), square.take(rows)

    def append(self, others: Gaussians) -> None:
        """Add Gaussians, without moments."""
        if len(others) == 0:
            return
        self.gaussians = concatenate(self.gaussians, others)
        mean, square = self.moments
        self.moments = concatenate(mean, _zeros(others)), concatenate(square, _zeros(others))

    def change(self, rows: Rows, **arrays: NDArray[Any]) -> None:
        """Give these rows other values; all that is remembered of the rows is forgotten."""
        for name, array in arrays.items():
            getattr(self.gaussians, name)[rows] = array
        for moment in self.moments:
            for name in ARRAYS:
                getattr(moment, name)[rows] = 0.0

    def limit_opacity(self, most: float) -> None:
        """Make none more opaque than this, and forget how opacities moved."""
        logit = np.float32(np.log(most / (1.0 - most)))
        np.minimum(self.gaussians.opacity_logits, logit, out=self.gaussians.opacity_logits)
        for moment in self.moments:
            moment.opacity_logits[:] = 0.0

    def limit_sizes(self, most: NDArray[np.float64]) -> None:
        """Make no standard deviation larger than these (N,)."""
        logs = np.log(most).astype(np.float32)[:, None]
        np.minimum(self.gaussians.log_scales, logs, out=self.gaussians.log_scales)

    def opacities(self) -> NDArray[np.float64]:
        """Return (N,) opacities, 0 to 1."""
        logits = self.gaussians.opacity_logits.astype(np.float64)
        return 1.0 / (1.0 + np.exp(-logits))

    def largest(self) -> NDArray[np.float64]:
        """Return (N,) the largest standard deviation of each."""
        return np.exp(self.gaussians.log_scales.max(axis=1).astype(np.float64))


def _zeros(gaussians: Gaussians) -> Gaussians:
    return replace(gaussians, **{name: np.zeros_like(getattr(gaussians, name)) for name in ARRAYS})


MOST_IN_PLACE = 50
"""Gaussians that one is replaced by at most; more count as so many, as in the paper's code."""

_BELOW_ONE = 1.0 - 2.0**-23

_IN_FRONT = 0.25
"""Share of a depth by which a Gaussian is well in front of it."""
_LOOKS = 0.5
"""Confidence, summed over photographs, that must look through a floater."""
_CLOSE = 0.5
"""Share of the nearest depth of a photograph, before which what it alone shows is a floater."""


class Density:
    """A strategy, called three times at each step."""

    remembered: tuple[str, ...] = ()
    """Attributes that are arrays and all that it knows from one step to the next."""

    def weigh(self, population: Population, gradients: Gradients) -> float:
        """Add the gradient of the strategy's own terms; return their loss."""
        return 0.0

    def observe(self, gradients: Gradients, camera: Camera) -> None:
        """Accumulate the statistics of a view's gradient."""

    def after(
        self,
        population: Population,
        iteration: int,
        means_rate: float,
        generator: np.random.Generator,
    ) -> None:
        """Change the population where it is time for it.

        Args:
            population: that is changed.
            iteration: steps done.
            means_rate: learning rate of the means at this step.
            generator: of this step.
        """

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """Keep the statistics of these rows; the other rows are removed."""
        for name, array in self.arrays().items():
            setattr(self, name, array[rows])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the statistics by name."""
        return {name: getattr(self, name) for name in self.remembered}


class DefaultDensity(Density):
    """Statistics of each Gaussian since the last change of their number.

    Args:
        settings: of the strategy.
        extent: size of the capture.
        most: Gaussians that there may be.
        count: Gaussians that there are.
        middle: (3,) of the cameras. What is farther from it than `extent` is small and large in
            relation to that distance, so that a sky stays.
    """

    remembered = ("pull", "views")

    def __init__(
        self,
        settings: Default,
        *,
        extent: float,
        most: int,
        count: int,
        middle: NDArray[np.float64] | None = None,
    ) -> None:
        self._settings, self._extent, self._most = settings, extent, most
        self._middle = np.zeros(3) if middle is None else middle
        self.pull = np.zeros(count, dtype=np.float32)
        self.views = np.zeros(count, dtype=np.int32)

    def observe(self, gradients: Gradients, camera: Camera) -> None:
        """Note how far the loss would move each visible centre, in half images."""
        half = np.array([camera.width / 2.0, camera.height / 2.0], dtype=np.float32)
        self.pull += np.linalg.norm(gradients.centres * half, axis=1)
        self.views += gradients.visible

    def after(
        self,
        population: Population,
        iteration: int,
        means_rate: float,
        generator: np.random.Generator,
    ) -> None:
        """Clone, split, remove and reset; see `Density.after`."""
        settings = self._settings
        if iteration >= settings.last:
            return
        if iteration > settings.first and iteration % settings.every == 0:
            self._grow(population, generator)
            gone = population.opacities() < settings.faint
            if iteration > settings.reset_every:
                gone |= population.largest() > settings.large * self._reach(population)
            if not gone.all():
                population.keep(~gone)
            self.pull = np.zeros(len(population), dtype=np.float32)
            self.views = np.zeros(len(population), dtype=np.int32)
        if iteration % settings.reset_every == 0:
            population.limit_opacity(2.0 * settings.faint)

    def _reach(self, population: Population) -> NDArray[np.float64]:
        """Return (N,) distances from the cameras' middle, at least the size of the capture."""
        away = population.gaussians.means - self._middle
        return np.maximum(np.linalg.norm(away, axis=1), self._extent)

    def _grow(self, population: Population, generator: np.random.Generator) -> None:
        mean = self.pull / np.maximum(self.views, 1)
        growing = mean > self._settings.gradient
        room = max(0, self._most - len(population))
        if growing.sum() > room:  # Each adds one: those that are pulled most.
            growing[np.argsort(-mean, kind="stable")[room:]] = False
        is_small = population.largest() <= self._settings.small * self._reach(population)
        cloned = population.gaussians.take(growing & is_small)
        splitting = growing & ~is_small
        parts = split(population.gaussians.take(splitting), self._settings.shrink, generator)
        population.keep(~splitting)
        population.append(cloned)
        population.append(parts)


def floaters(
    means: NDArray[np.float32], photos: Sequence[Photo], reach: float
) -> NDArray[np.bool_]:
    """Return which Gaussians hang in the air near cameras.

    One does where photographs look through it, to a depth well behind, with more confidence than
    others see a surface there; and where one photograph alone shows it, much nearer than whatever
    that photograph knows the depth of.

    Args:
        means: (N, 3) of the Gaussians.
        photos: those without depths say nothing.
        reach: distance from a camera up to which it may look through one.
    """
    through, on = np.zeros((2, len(means)))
    close, views = np.zeros(len(means), dtype=bool), np.zeros(len(means), dtype=np.int64)
    for photo in photos:
        camera, inverse = photo.camera, photo.inverse_depth
        T = np.linalg.inv(camera.T_world_camera)
        x, y, z = np.einsum("ij,nj->in", T[:3, :3], means.astype(np.float64)) + T[:3, 3:]
        rows = np.flatnonzero(z > camera.near)
        column = np.floor(x[rows] / z[rows] * camera.fx + camera.cx)
        row = np.floor(y[rows] / z[rows] * camera.fy + camera.cy)
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        rows, at = rows[inside], (row[inside].astype(int), column[inside].astype(int))
        views[rows] += 1
        if inverse is None:
            continue
        sure = (inverse > 0.0).astype(np.float32) if photo.confidence is None else photo.confidence
        nearest = _nearest_beside(np.where(sure > 0.0, inverse, np.float32(0.0)))[at]
        own, sure_there = 1.0 / z[rows], sure[at]
        is_front = (1.0 - _IN_FRONT) * own > nearest
        through[rows] += sure_there * (is_front & (z[rows] < reach))
        on[rows] += sure_there * (~is_front & ((1.0 + _IN_FRONT) * own > inverse[at]))
        known = inverse[(sure > 0.0) & (inverse > 0.0)]
        if len(known):
            close[rows] |= _CLOSE * own > np.quantile(known, 0.99)
    return ((through >= _LOOKS) & (through > on)) | (close & (views == 1))


def _nearest_beside(inverse: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the largest of each pixel (H, W) and its eight neighbours: edges are uncertain."""
    for axis in (0, 1):
        edged = np.pad(inverse, [(1, 1) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        inverse = np.lib.stride_tricks.sliding_window_view(edged, 3, axis=axis).max(axis=-1)
    return inverse


def split(gaussians: Gaussians, shrink: float, generator: np.random.Generator) -> Gaussians:
    """Return two Gaussians for each: means drawn from it, axes `shrink` times shorter."""
    rows = np.tile(np.arange(len(gaussians)), 2)
    twice = gaussians.take(rows)
    own = generator.standard_normal((len(twice), 3)) * np.exp(twice.log_scales)
    return replace(
        twice,
        means=twice.means + turned(twice.quats, own),
        log_scales=twice.log_scales - np.float32(np.log(shrink)),
    )


def turned(quats: NDArray[np.float32], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors (N, 3) along own axes in the world, by quaternions (N, 4) of any length."""
    q = quats.astype(np.float64)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    w, axis = q[:, :1], q[:, 1:]
    across = np.cross(axis, vectors)
    return vectors + 2.0 * (w * across + np.cross(axis, across))


class McmcDensity(Density):
    """Moves, adds and shakes Gaussians.

    Args:
        settings: of the strategy.
        most: Gaussians that there are to be at last.
    """

    def __init__(self, settings: Mcmc, *, most: int) -> None:
        self._settings, self._most = settings, most

    def weigh(self, population: Population, gradients: Gradients) -> float:
        """Add the gradient of the weights on opacity and size; return their loss."""
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
    """Return opacity and factor on the size of each of `number` Gaussians instead of one.

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
