"""One policy's action in the words of another: what it would have answered to the same effect."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards import JointControl

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_eval.cards import Card
    from nw_eval.robots import RobotSpec

Array = NDArray[np.float64]

_TORQUE = "joint_torque"


def translator(first: Card, second: Card, robot: RobotSpec) -> Callable[[Array], Array] | None:
    """Return what makes raw actions of one policy, (12,), into those of another.

    An action becomes the one that has the same joint targets. Between policies whose actions mean
    the same it stays what it is, bit for bit.

    Args:
        first: the card of the policy that acts.
        second: the card of the one that is to understand it.
        robot: that both drive.

    Returns:
        None where there is no such action: one of them answers torques, the other one positions.
    """
    if (first.control.action == _TORQUE) != (second.control.action == _TORQUE):
        return None
    own, other = JointControl.from_card(first, robot), JointControl.from_card(second, robot)
    meanings = ((own.order, other.order), (own.base, other.base), (own.scale, other.scale))
    if all(np.array_equal(a, b) for a, b in meanings):
        return lambda action: action

    def translated(action: Array) -> Array:
        wanted = own.targets(action)[other.order] - other.base
        moves = other.scale != 0.0
        return np.divide(wanted, other.scale, out=np.zeros_like(wanted), where=moves)

    return translated
