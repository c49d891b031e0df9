"""What every strategy does at a step; this one lets Gaussians neither come nor go."""

# ruff: noqa: ARG002 - what strategies are told; this one needs none of it.
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.splat.camera import Camera
from nw_eval.twin.gaussians.population import Population
from nw_eval.twin.gaussians.raster.images import Gradients


class Density:
    """A strategy, called three times at each step."""

    remembered: tuple[str, ...] = ()
    """Attributes that are arrays and all that it knows from one step to the next."""

    def weigh(self, population: Population, gradients: Gradients) -> float:
        """Add the gradient of terms of its own; return what they add to the loss."""
        return 0.0

    def observe(self, gradients: Gradients, camera: Camera) -> None:
        """Note what a view's gradient tells."""

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

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what is remembered, by name."""
        return {name: getattr(self, name) for name in self.remembered}
