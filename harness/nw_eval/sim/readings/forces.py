"""The forces of one control step: on feet and watched parts, of the motors, and on the trunk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

CONTACT_THRESHOLD = 2.0
"""A foot is in contact above this force, N."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Forces:
    """What a control step left to be felt."""

    feet: Array
    """(4,) N, contact force on each foot in the order of `robot.feet`."""
    monitored: Array
    """(M,) N, contact force on each watched geom."""
    torques: Array
    """(12,) N m, of the servos after clipping, without joint damping."""
    acceleration: Array
    """(6,) of the trunk: linear in the world's axes, m / s^2, angular in its own, rad / s^2."""
    contacts: npt.NDArray[np.bool_]
    """(4,) whether each foot is in contact."""
    previous_contacts: npt.NDArray[np.bool_]
    """(4,) the same, one control step ago."""

    @cached_property
    def largest(self) -> float:
        """The largest contact force on any watched geom, N; judge and log both ask."""
        return float(self.monitored.max(initial=0.0))


def specific_force(
    at: Sequence[float], *, acceleration: Array, rates: Array, R_world_trunk: Array, gravity: Array
) -> Array:
    """Return what an accelerometer on the trunk reads: acceleration minus gravity.

    It is what MuJoCo's accelerometer reads at a site there.

    Args:
        at: (3,) where it sits, trunk frame, m.
        acceleration: (6,) of the trunk, as in `Forces`.
        rates: (3,) angular velocity of the trunk, trunk frame, rad / s.
        R_world_trunk: (3, 3).
        gravity: (3,) world frame, m / s^2.

    Returns:
        (3,) m / s^2, trunk frame.
    """
    # Plain cross products: `np.cross` takes longer than all the rest.
    px, py, pz = at
    wx, wy, wz = rates.tolist()
    ax, ay, az = acceleration[3:].tolist()
    # Speed of the point around the origin, and what its circling adds: w x (w x p) + a x p.
    vx, vy, vz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
    circling = np.array(
        [
            wy * vz - wz * vy + ay * pz - az * py,
            wz * vx - wx * vz + az * px - ax * pz,
            wx * vy - wy * vx + ax * py - ay * px,
        ]
    )
    return R_world_trunk.T @ (acceleration[:3] - gravity) + circling
