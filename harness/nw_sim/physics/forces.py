"""The forces of one control step: on feet and watched parts, of the motors, and on the trunk.

Contact forces are added up on the few parts of the robot that anything asks about.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from nw_base import same_bits
from nw_sim.physics.binding import MjData, MjModel
from nw_sim.physics.body import Places, geoms_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_scenes.robots import RobotSpec


Array = npt.NDArray[np.float64]


CONTACT_THRESHOLD = 2.0
"""A foot is in contact above this force, N."""


class Forces(NamedTuple):
    """What a control step left to be felt."""

    feet: Array
    """(F,) N, contact force on each foot in the order of `robot.feet`."""
    monitored: Array
    """(M,) N, contact force on each monitored part."""
    torques: Array
    """(J,) N m, of the servos after clipping, without joint damping."""
    acceleration: Array
    """(6,) of the trunk: linear in the world's axes, m / s^2, angular in its own, rad / s^2. Of a
    robot whose IMU sits on another body, of that body: angular, then linear without gravity, both
    in its axes."""
    contacts: npt.NDArray[np.bool_]
    """(F,) whether each foot is in contact."""
    previous_contacts: npt.NDArray[np.bool_]
    """(F,) the same, one control step ago."""

    @property
    def largest(self) -> float:
        """The largest contact force on any monitored part, N."""
        return max(self.monitored.tolist(), default=0.0)


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
    return same_bits.product(acceleration[:3] - gravity, R_world_trunk) + circling


class PhysicsRate:
    """Torques and rates of the motors in each physics step of the newest control step.

    Args:
        model: compiled model.
        data: its state.
        substeps: physics steps in a control step, S.
        joints: of the velocities, those of the motors, in the order of the motors.

    Attributes:
        servo: (S, J) N m, what each servo gave after clipping, without damping.
        rates: (S, J) rad/s, at the end of each physics step.
    """

    def __init__(self, model: MjModel, data: MjData, substeps: int, joints: Places) -> None:
        # Views of the simulation's memory, which stays where it is.
        self._force, self._velocity, self._joints = data.actuator_force, data.qvel, joints
        self._own = data.qvel[joints] if isinstance(joints, slice) else None
        self.servo = np.zeros((substeps, len(self._force)))
        self.rates = np.zeros((substeps, len(self._force)))
        self._rows = list(zip(self.servo, self.rates, strict=True))
        self._damping = model.dof_damping[joints].copy()

    def take(self, substep: int) -> None:
        """Keep the physics step that was just made."""
        servo, rates = self._rows[substep]
        servo[:] = self._force
        rates[:] = self._velocity[self._joints] if self._own is None else self._own

    def motor_torques(self, servo: Array, rates: Array) -> Array:
        """Return the torques of the motors, (..., J) N m: the servos' and their damping.

        MuJoCo's Euler integrator takes damping at the velocity of the physics step's end.

        Args:
            servo: as the attribute, (..., J).
            rates: of the same physics steps, (..., J).
        """
        return servo - self._damping * rates


class ContactForces:
    """Adds up contact forces on chosen parts of a robot.

    Args:
        model: compiled model.
        robot: its `touches` says whether `names` are of geoms or of bodies. Forces on the geoms of
            a body add up, and contacts of the robot with itself are left out.
        names: the order of every result.
        in_contact_frames: add each contact's force in that contact's own frame, unrotated and
            unsigned, as the published evaluation does. Otherwise forces are rotated to the world,
            where they act on the named part.
    """

    def __init__(
        self, model: MjModel, robot: RobotSpec, names: Sequence[str], *, in_contact_frames: bool
    ) -> None:
        unique = list(dict.fromkeys(names))
        parts = geoms_of(model, robot, unique)
        self._row = {geom: row for row, geoms in enumerate(parts) for geom in geoms}
        self._count = len(parts)
        # A part may be asked for twice, as a foot and as one that is monitored.
        self._order = None if len(unique) == len(names) else [unique.index(name) for name in names]
        own: list[int] = []
        if robot.touches == "body":
            roots = model.body_rootid[model.geom_bodyid]
            own = np.flatnonzero(roots == model.body(robot.root).id).tolist()
        self._own = frozenset(own)  # geoms that do not count when they touch each other
        self._in_contact_frames = in_contact_frames

    def read(self, data: MjData, solved: Array | None = None) -> Array:
        """Return the magnitude of the summed force on each part, (len(names),) in N.

        Args:
            data: with its contacts.
            solved: constraint forces by row, as a solver left them; where it has fewer rows than a
                contact asks for, those are 0. None = those of `data`.
        """
        contact = data.contact
        row_of, own = self._row, self._own
        # A robot touches the ground at a few places: plain numbers take a third of NumPy's calls.
        watched = [
            (index, row_of.get(first), row_of.get(second))
            for index, (first, second) in enumerate(contact.geom.tolist())
            if (first in row_of or second in row_of) and not (first in own and second in own)
        ]
        if not watched:
            return np.zeros(self._count if self._order is None else len(self._order))
        rows: list[float] = (data.efc_force if solved is None else solved).tolist()
        rows += [0.0] * (data.nefc - len(rows))
        starts, sizes = contact.efc_address.tolist(), contact.dim.tolist()
        friction, frames = contact.friction.tolist(), contact.frame.tolist()
        forces = [(0.0, 0.0, 0.0)] * self._count
        for index, first, second in watched:
            if starts[index] < 0:  # It lies within the margin and pushes nothing.
                continue
            x, y, z = _contact_force(rows, starts[index], sizes[index], friction[index])
            sign = 1.0
            if not self._in_contact_frames:
                # Rows of the frame are its axes: transposed, it rotates to the world.
                ax, ay, az, bx, by, bz, cx, cy, cz = frames[index]
                x, y, z = (
                    x * ax + y * bx + z * cx,
                    x * ay + y * by + z * cy,
                    x * az + y * bz + z * cz,
                )
                sign = -1.0
            # Force and frame are those of the first geom acting on the second.
            if first is not None:
                sum_x, sum_y, sum_z = forces[first]
                forces[first] = sum_x + sign * x, sum_y + sign * y, sum_z + sign * z
            if second is not None:
                sum_x, sum_y, sum_z = forces[second]
                forces[second] = sum_x + x, sum_y + y, sum_z + z
        norms = np.array([math.sqrt(x * x + y * y + z * z) for x, y, z in forces])
        return norms if self._order is None else norms[self._order]


def _contact_force(
    rows: Sequence[float], start: int, size: int, friction: Sequence[float]
) -> tuple[float, float, float]:
    """Return a contact's force in its own frame, N: normal, then tangents.

    What `mj_contactForce` does for pyramidal cones, which every model here has, but from rows that
    need not be the solver's present ones.

    Args:
        rows: constraint forces.
        start: the contact's first row.
        size: its dimensions: 1 without friction, else 3, 4 or 6.
        friction: (5,) its coefficients.
    """
    if size == 1:
        return rows[start], 0.0, 0.0
    # Each pair of rows holds the two opposite edges of the pyramid along one axis.
    a, b, c, d = rows[start : start + 4]
    normal = a + b + c + d
    for edge in rows[start + 4 : start + 2 * (size - 1)]:
        normal += edge
    return normal, (a - b) * friction[0], (c - d) * friction[1]
