"""The low-pass filter between a policy's actions and the motors, in one trial."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.card import Card
from nw_eval.cards.control import LowPass
from nw_eval.cards.joint_control import Action, JointControl

Array = NDArray[np.float64]


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
