"""The last samples together."""

from __future__ import annotations

from collections import deque
from typing import Literal

import numpy as np

from nw_eval.memory import Arrays
from nw_eval.sensors.wrappers.wrapper import Sample, Shot


class Stack:
    """Samples of this moment and of those before it, oldest first.

    Args:
        steps: how many.
        axis: `first`, `last`: a new axis; `channel`: along the last one.
    """

    def __init__(self, steps: int, axis: Literal["first", "last", "channel"]) -> None:
        self._samples: deque[Sample] = deque(maxlen=steps)
        self._steps = steps
        self._axis = axis

    def __call__(self, sample: Sample, shot: Shot) -> Sample:  # noqa: ARG002 - as every wrapper.
        """Add a sample and return all."""
        # The first sample stands for those before it.
        self._samples.extend([sample] * (1 if self._samples else self._steps))
        if self._axis == "channel":
            return np.concatenate(self._samples, axis=-1)
        return np.stack(self._samples, axis=0 if self._axis == "first" else -1)

    def reset(self, rng: np.random.Generator) -> None:  # noqa: ARG002 - nothing here is random.
        """Forget earlier samples."""
        self._samples.clear()

    def state(self) -> Arrays:
        """Return the samples."""
        return {"samples": np.stack(self._samples)} if self._samples else {}

    def restore(self, state: Arrays) -> None:
        """Go back to samples."""
        self._samples.clear()
        if state:
            self._samples.extend(state["samples"])
