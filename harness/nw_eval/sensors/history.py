"""Stacks of earlier frames."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nw_eval.policies.observations import History

Frame = NDArray[np.float32]


class HistoryStack:
    """The last frames of an observation, flattened as its checkpoint was trained to read them."""

    def __init__(self, history: History, sizes: Sequence[int]) -> None:
        """Make an empty stack.

        Args:
            history: how many frames, in which order.
            sizes: how many numbers each term of a frame has.
        """
        self._history = history
        bounds = np.cumsum([0, *sizes]).tolist()
        self._terms = [slice(a, b) for a, b in pairwise(bounds)]
        # Oldest first, whatever the order of the output.
        self.frames: Frame = np.zeros((0, bounds[-1]), dtype=np.float32)

    @property
    def size(self) -> int:
        """How many numbers the output has."""
        return self._history.steps * self.frames.shape[1]

    def reset(self) -> None:
        """Forget all frames."""
        self.frames = self.frames[:0]

    def push(self, frame: Frame) -> Frame:
        """Add the present frame and return the stack, (size,) float32."""
        if not len(self.frames):
            filler = frame if self._history.start == "repeat" else np.zeros_like(frame)
            self.frames = np.repeat(filler[np.newaxis], self._history.steps, axis=0)
        pushed = np.concatenate([self.frames[1:], frame[np.newaxis]])
        shown = pushed if self._history.current else self.frames
        self.frames = pushed
        if self._history.order == "newest_first":
            shown = shown[::-1]
        if self._history.by == "term":
            return np.concatenate([shown[:, term].ravel() for term in self._terms])
        return shown.flatten()
