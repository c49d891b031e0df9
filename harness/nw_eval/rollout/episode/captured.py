"""From where a policy looked, beside where the place was photographed from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.model import CONTROL_RATE
from nw_eval.results.row import VIEW_RATE
from nw_eval.scenes.scene import Nearness

_STEPS = CONTROL_RATE // VIEW_RATE


class CapturedViews:
    """The worst camera image of the splat in each tenth of a second, of all that were up to date.

    An image is up to date from when it is taken until the next one of its camera: a slow camera's
    counts in each tenth that it lasts.

    Attributes:
        distance: m from the nearest capture camera, the largest of each tenth.
        angle: between the optical axes of both, rad, likewise.
        alpha: share of the image that the splat covers, 0 to 1, the smallest of each tenth.
    """

    def __init__(self) -> None:
        self.distance: list[float] = []
        self.angle: list[float] = []
        self.alpha: list[float] = []

    def add(self, step: int, nearness: Nearness, alpha: float) -> None:
        """Add one camera's newest image at a control step; steps only go on."""
        tenth = step // _STEPS
        while len(self.alpha) <= tenth:
            self.distance.append(0.0)
            self.angle.append(0.0)
            self.alpha.append(1.0)
        self.distance[tenth] = max(self.distance[tenth], nearness.distance)
        self.angle[tenth] = max(self.angle[tenth], nearness.angle)
        self.alpha[tenth] = min(self.alpha[tenth], alpha)

    def state(self) -> bytes:
        """Return all three, in single precision, as a row has them."""
        return np.array([self.distance, self.angle, self.alpha], dtype="<f4").tobytes()

    def restore(self, state: bytes) -> None:
        """Go back, or on, to a `state`."""
        numbers: NDArray[np.float32] = np.frombuffer(state, dtype="<f4").reshape(3, -1)
        self.distance, self.angle, self.alpha = (line.tolist() for line in numbers)
