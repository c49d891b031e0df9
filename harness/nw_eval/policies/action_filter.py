"""Low-pass filters between a policy's actions and the motors, as stacks that train with one do it.

Both kinds are one recursion over actions x, at the rate of the policy, and what was applied, y:

    y[n] = b[0] x[n] + ... + b[N] x[n-N] - a[1] y[n-1] - ... - a[N] y[n-N]

which is `ActionFilterExp` and `ActionFilterButter` of google-research's motion_imitation.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nw_eval.policies.model import CardModel
from nw_eval.policies.policy import Action

if TYPE_CHECKING:
    from nw_eval.policies.card import Card
    from nw_eval.policies.control import JointControl

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


class ActionFilter:
    """A filter of one trial's actions. Made anew for each trial; it starts at rest.

    Args:
        low_pass: from the card.
        rate: actions per second, Hz.
        rest: (12,) the raw action that came before the first one.
        limits: of raw actions, before they are filtered.
    """

    def __init__(
        self, low_pass: LowPass, *, rate: float, rest: Array, limits: tuple[float, float]
    ) -> None:
        b, a = low_pass.coefficients(rate)
        self._first = float(b[0])
        self._b, self._a = b[1:, np.newaxis], a[1:, np.newaxis]
        self._limits = limits
        # Earlier actions and what was made of them, (order, 12) each, the newest first.
        self._x = np.tile(rest, (len(b) - 1, 1))
        self._y = self._x.copy()

    @classmethod
    def from_card(cls, card: Card, control: JointControl) -> ActionFilter | None:
        """Return the filter of a card that is at rest in its default pose; None without one."""
        if card.control.filter is None:
            return None
        rest = np.zeros_like(control.scale)
        if card.control.action == "joint_position":
            np.divide(control.default_pose, control.scale, out=rest, where=control.scale != 0.0)
        return cls(
            card.control.filter,
            rate=card.control.rate,
            rest=rest,
            limits=(control.low, control.high),
        )

    @property
    def output(self) -> Action:
        """What it returned last, (12,)."""
        return self._y[0]

    def push(self, action: Action) -> Action:
        """Take a new raw action, (12,), and return the one to apply."""
        x = np.clip(action, *self._limits)
        past = (self._b * self._x).sum(axis=0) - (self._a * self._y).sum(axis=0)
        self._x = np.vstack([x, self._x[:-1]])
        self._y = np.vstack([self._first * x + past, self._y[:-1]])
        return self.output

    def state(self) -> bytes:
        """Return the earlier actions and what was made of them."""
        return np.stack([self._x, self._y]).tobytes()

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of a filter of the same order."""
        self._x, self._y = np.frombuffer(state).reshape(2, *self._x.shape).copy()
