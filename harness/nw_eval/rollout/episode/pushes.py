"""Pushes: the trunk is given a speed now and then."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

EVERY = 150
"""Control steps from one push to the next: 3 s."""
_FIRST = 50
"""Control steps before the first at least."""
_LONGEST = 600 * 50
"""Control steps of the longest trial."""


class Pushes:
    """When and whereto a trial's robot is pushed: known before it begins, so nothing to remember.

    Args:
        speed: that a push adds to the trunk's, m/s.
        generator: draws the first step, then a direction for each push.
    """

    def __init__(self, speed: float, generator: np.random.Generator) -> None:
        self._first = int(generator.integers(_FIRST, EVERY))
        angles = generator.uniform(-math.pi, math.pi, _LONGEST // EVERY + 1)
        self._velocities = speed * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def at(self, step: int) -> NDArray[np.float64] | None:
        """Return the velocity (2,) m/s, world frame, that is added before a step; mostly None."""
        since = step - self._first
        return self._velocities[since // EVERY] if since >= 0 and since % EVERY == 0 else None
