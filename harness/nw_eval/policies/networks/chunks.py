"""Which action of overlapping chunks is applied now."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class ChunkQueue:
    """Predictions of past forward passes that reach the present step.

    With temporal ensembling (arXiv 2304.13705, section IV-B) the action is the mean of all
    predictions for this step, the oldest with the weight 1 and each younger one with exp(-m) of
    the weight of the one before it. Without, the newest prediction counts alone.
    """

    def __init__(self, *, ensemble: float | None) -> None:
        """Make an empty queue.

        Args:
            ensemble: m of the weights, 0 for equal ones; None for no ensembling.
        """
        self._ensemble = ensemble
        # Rows that are left of each chunk, oldest chunk first, the present step's row first.
        self.chunks: list[Array] = []

    def clear(self) -> None:
        """Forget all predictions."""
        self.chunks = []

    def add(self, chunk: Array) -> None:
        """Add a forward pass, (chunk, actions); its first row is for the present step."""
        if self._ensemble is None:
            self.chunks = []
        self.chunks.append(chunk)

    def take(self) -> Array:
        """Return the action of the present step, (actions,), and go on to the next."""
        predictions = np.stack([chunk[0] for chunk in self.chunks])
        self.chunks = [chunk[1:] for chunk in self.chunks if len(chunk) > 1]
        weights = np.exp(-(self._ensemble or 0.0) * np.arange(len(predictions)))
        return weights @ predictions / weights.sum()
