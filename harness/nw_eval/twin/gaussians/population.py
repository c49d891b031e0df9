"""Gaussians that are trained, and what the optimiser remembers of each."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.splat.gaussians import ARRAYS, Gaussians, concatenate
from nw_eval.twin.gaussians.config import Rates
from nw_eval.twin.gaussians.images import Gradients
from nw_eval.twin.gaussians.kernels.rows import adam
from nw_eval.twin.gaussians.rasteriser import Threads

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
