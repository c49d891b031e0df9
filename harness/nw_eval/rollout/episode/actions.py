"""From a policy's raw action to what the motors are told: delayed, filtered, scaled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_eval.arrays import read_only
from nw_eval.cards.terms import EARLIER_OUTPUTS
from nw_eval.policies import ActionDelay
from nw_eval.rollout.fault import PolicyFailedError

if TYPE_CHECKING:
    from nw_eval.cards import JointControl
    from nw_eval.policies import ActionFilter

Array = NDArray[np.float64]

HUGE = 1e6
"""A joint target, rad, or torque, N m, beyond any sense, after the card's own scale and clip.

Joints turn by less than 2 pi, and motors of such robots give some hundred N m. Training stacks clip
raw actions at 100 (legged_gym's `clip_actions`), which is some 25 rad; MuJoCo itself gives up at
1e10. A target this large is a network that ran away.
"""


class Actions:
    """The actions of one trial, between its policy and its motors.

    Each is applied `delay_steps` actions after it was taken; before the first, zeros are. What is
    applied stays so until the next action is taken.

    Args:
        control: what actions mean.
        joints: names of the robot's, in its own order.
        delay_steps: actions that are applied before a new one is.
        action_filter: that applied actions pass through, at rest; None = none.

    Attributes:
        delay: the actions that wait.
        applied: the raw action that is applied, (12,).
        output: what the policy returned last, (12,).
        earlier: what it returned before that, (12,) each of `EARLIER_OUTPUTS`, the newest first.
        filter: what they pass through.
    """

    def __init__(
        self,
        control: JointControl,
        joints: tuple[str, ...],
        *,
        delay_steps: int,
        action_filter: ActionFilter | None,
    ) -> None:
        count = len(joints)
        self.delay = ActionDelay(delay_steps, count)
        self.applied = Held(np.zeros(count))
        self.output = Held(np.zeros(count))
        self.earlier = HeldRow([np.zeros(count)] * EARLIER_OUTPUTS)
        self.filter = action_filter
        self._control = control
        self._joints = joints

    def take(self, action: Array) -> None:
        """Take a new action of the policy, (12,) raw."""
        self.earlier.arrays = (self.output.array, *self.earlier.arrays[:-1])
        # A policy may write into what it has returned, and a sensor into what it is shown.
        self.output.array = read_only(action.copy())
        self.applied.array = read_only(self.delay.push(action))
        if self.filter is not None:
            self.filter.push(self.applied.array)

    def targets(self) -> Array:
        """Return what the motors are told, (12,) rad or N m, as long as there is sense in it.

        Raises:
            PolicyFailedError: a target is huge.
        """
        applied = self.applied.array if self.filter is None else self.filter.output
        targets = self._control.targets(applied)
        # No square is larger than the sum of all, which one call gives.
        if not targets.dot(targets) < HUGE * HUGE and (index := _first_huge(targets)) is not None:
            raise PolicyFailedError(
                f"the policy's action makes a target of {targets[index]:.3g} for joint "
                f"{self._joints[index]}",
                kind="action",
                fix="check the checkpoint, and `scale` and `clip` on its card",
            )
        return targets


class Held:
    """An array of float64 that is replaced as a whole, never written into."""

    def __init__(self, array: Array) -> None:
        self.array = read_only(array)

    def state(self) -> bytes:
        """Return its numbers."""
        return self.array.tobytes()

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of an array of the same shape."""
        self.array = np.frombuffer(state).reshape(self.array.shape)  # bytes: read-only, too


class HeldRow:
    """Several arrays of float64 of one shape, likewise."""

    def __init__(self, arrays: Sequence[Array]) -> None:
        self.arrays = tuple(map(read_only, arrays))

    def state(self) -> bytes:
        """Return their numbers."""
        return b"".join(map(np.ndarray.tobytes, self.arrays))

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of as many arrays of the same shape."""
        rows = np.frombuffer(state).reshape(len(self.arrays), *self.arrays[0].shape)
        self.arrays = tuple(rows)


def _first_huge(targets: Array) -> int | None:
    """Return which target is the largest, if there is no sense in it."""
    index = int(np.abs(targets).argmax())
    return None if abs(targets[index]) < HUGE else index
