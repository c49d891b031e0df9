"""The latency of actions, in one trial."""

from __future__ import annotations

from collections import deque

import numpy as np

from nw_eval.cards.joint_control import Action


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
