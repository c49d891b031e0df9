"""What becomes of actions in one trial: their latency, and the filter that they pass through."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.card import Card
from nw_eval.cards.control import LowPass
from nw_eval.cards.joint_control import Action, JointControl

Array = NDArray[np.float64]


class ActionDelay:
    """Actions on their way to the motors: each is applied `steps` control steps late.

    Until the first one arrives, zeros are applied.
    """

    def __init__(self, steps: int, joints: int = 12) -> None:
        self._steps = steps
        self._joints = joints
        self._waiting: deque[Action] = deque()
        self.reset()

    def reset(self) -> None:
        """Fill the queue with zeros."""
        self._waiting = deque(np.zeros(self._joints) for _ in range(self._steps))

    def push(self, action: Action) -> Action:
        """Queue a new action and return the one to apply now."""
        self._waiting.append(action.copy())
        return self._waiting.popleft()

    def state(self) -> bytes:
        """Return the actions that still wait, oldest first."""
        return b"".join(action.tobytes() for action in self._waiting)

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of a queue of the same length."""
        actions = np.frombuffer(state, dtype=np.float64).reshape(self._steps, self._joints)
        self._waiting = deque(action.copy() for action in actions)


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
        absolute = np.array(control.kinds) == "joint_position"
        turned = absolute & (control.scale != 0.0)
        np.divide(control.default_pose, control.scale, out=rest, where=turned)
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
