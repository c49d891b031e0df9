"""Low-pass filters between a policy's actions and the motors, as stacks that train with one do it.

Both kinds are one recursion over actions x, at the rate of the policy, and what was applied, y:

    y[n] = b[0] x[n] + ... + b[N] x[n-N] - a[1] y[n-1] - ... - a[N] y[n-N]

which is `ActionFilterExp` and `ActionFilterButter` of google-research's motion_imitation.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nw_eval.cards.model import CardModel

Array = NDArray[np.float64]


class ExponentialFilter(CardModel):
    """Exponential smoothing: y[n] = alpha x[n] + (1 - alpha) y[n-1]."""

    kind: Literal["exponential"]
    alpha: float = Field(gt=0.0, le=1.0)
    """Weight of the new action; 1 = no filter."""

    def coefficients(self, rate: float) -> tuple[Array, Array]:  # noqa: ARG002 - as the other one.
        """Return b and a, (2,) each."""
        return np.array([self.alpha, 0.0]), np.array([1.0, self.alpha - 1.0])


class ButterworthFilter(CardModel):
    """Butterworth low-pass, discretised by the bilinear transform as `scipy.signal.butter` is."""

    kind: Literal["butterworth"]
    cutoff: float = Field(ge=0.1)
    """Frequency of half power, Hz: below half of `control.rate`."""
    order: int = Field(default=2, ge=1, le=4)
    """Number of earlier actions that count."""

    def coefficients(self, rate: float) -> tuple[Array, Array]:
        """Return b and a, (order + 1,) each, for `rate` actions per second."""
        # The analog poles lie evenly on the left half of a circle; its radius is warped so that
        # the bilinear transform puts the cutoff where it is wanted.
        turns = np.arange(1 - self.order, self.order, 2) / (2 * self.order)
        poles = -math.tan(math.pi * self.cutoff / rate) * np.exp(1j * math.pi * turns)
        a: Array = np.asarray(np.poly((1.0 + poles) / (1.0 - poles)).real, dtype=np.float64)
        b: Array = np.asarray(np.poly(-np.ones(self.order)), dtype=np.float64)
        return b * (a.sum() / b.sum()), a


LowPass = Annotated[ExponentialFilter | ButterworthFilter, Field(discriminator="kind")]
