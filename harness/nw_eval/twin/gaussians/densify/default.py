"""Adaptive density control of the 3DGS paper (Kerbl et al. 2023, section 5.2).

Where the loss pulls a Gaussian about on the screen, there is too little of it: a small one is
cloned, a large one split in two that are drawn from it and are 1.6 times smaller. What has become
transparent is removed, and now and then opacities are lowered, so that only what is needed returns.
Like gsplat, we leave out the paper's limit on screen size, which its code never applies.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nw_eval.splat.camera import Camera
from nw_eval.splat.gaussians import Gaussians
from nw_eval.twin.gaussians.densify.density import Density
from nw_eval.twin.gaussians.densify.settings import Default
from nw_eval.twin.gaussians.population import Population
from nw_eval.twin.gaussians.raster.images import Gradients


class DefaultDensity(Density):
    """What is known of each Gaussian since the last time some came and went.

    Args:
        settings: of the strategy.
        extent: size of the capture.
        most: Gaussians that there may be.
        count: Gaussians that there are.
    """

    remembered = ("pull", "views")

    def __init__(self, settings: Default, *, extent: float, most: int, count: int) -> None:
        self._settings, self._extent, self._most = settings, extent, most
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
        means_rate: float,  # noqa: ARG002 - means move by gradients alone here.
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
                gone |= population.largest() > settings.large * self._extent
            if not gone.all():
                population.keep(~gone)
            self.pull = np.zeros(len(population), dtype=np.float32)
            self.views = np.zeros(len(population), dtype=np.int32)
        if iteration % settings.reset_every == 0:
            population.limit_opacity(2.0 * settings.faint)

    def _grow(self, population: Population, generator: np.random.Generator) -> None:
        mean = self.pull / np.maximum(self.views, 1)
        growing = mean > self._settings.gradient
        room = max(0, self._most - len(population))
        if growing.sum() > room:  # Each adds one: those that are pulled most.
            growing[np.argsort(-mean, kind="stable")[room:]] = False
        is_small = population.largest() <= self._settings.small * self._extent
        cloned = population.gaussians.take(growing & is_small)
        splitting = growing & ~is_small
        parts = split(population.gaussians.take(splitting), self._settings.shrink, generator)
        population.keep(~splitting)
        population.append(cloned)
        population.append(parts)


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
