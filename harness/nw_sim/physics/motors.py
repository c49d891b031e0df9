"""Motors whose torque is computed at every physics step: as a training had them (`cards.motors`).

At each physics step a motor's target is late by its delay, then passes its response; a network or
kp and kd make a torque of it and of the joint's position and velocity there. With a torque-speed
curve, torque tau at speed v stays within

    max(-limit, saturation (-1 - v / no_load)) <= tau <= min(limit, saturation (1 - v / no_load))

where |v| counts at most up to no_load (1 + limit / saturation), as `DCMotor` of Isaac Lab has it.
MuJoCo keeps torques within their limits.

Before the first target a motor has been told to hold the joints where the trial begins; errors and
velocities of a network's history, and what it remembers, begin as zeros.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nw_policies.cards.motors import DcMotor, Motor, NetworkMotor
from nw_policies.executor import NEXT
from nw_policies.motor_network import INPUT, TORQUE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_policies.executor import Program
    from nw_sim.physics.model import Actuators

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """A group of motors of a robot."""

    motor: Motor
    joints: npt.NDArray[np.intp]
    """(N,) positions among the robot's joints."""
    program: Program | None = None
    """Of a group with a network, for N joints."""


class Motors:
    """The motors of a world, and what they remember.

    Args:
        actuators: with the groups, and the gains of all joints.
        timestep: of the physics, s.

    Attributes:
        memory: all that the next torques depend on besides the state of the physics; it is kept in
            place.
    """

    def __init__(self, actuators: Actuators, timestep: float) -> None:
        self._groups = [_Group(drive, actuators, timestep) for drive in actuators.drives]
        ends = [0, *accumulate(group.size for group in self._groups)]
        self.memory: Array = np.zeros(ends[-1])
        for group, (start, end) in zip(self._groups, pairwise(ends), strict=True):
            group.lay(self.memory[start:end])

    def reset(self, held: Array) -> None:
        """Begin at rest.

        Args:
            held: (J,) the targets that count before the first one.
        """
        self.memory[:] = 0.0
        for group in self._groups:
            group.reset(held)

    def drive(self, targets: Array, positions: Array, velocities: Array, out: Array) -> None:
        """Write the torques of one physics step.

        Args:
            targets: (J,) as for `World.step`.
            positions: (J,) rad, at the beginning of the physics step.
            velocities: (J,) rad / s.
            out: (J,) N m; only joints of a group are written.
        """
        for group in self._groups:
            group.drive(targets, positions, velocities, out)


class _Group:
    """One group; its memory lies in that of all motors."""

    def __init__(self, drive: Drive, actuators: Actuators, timestep: float) -> None:
        own, motor = drive.joints, drive.motor
        self._joints, self._motor = own, motor
        follows = np.array(actuators.follows)[own]
        share = actuators.strength
        # What is told is a position, a velocity or a torque: one of the three gains acts on it.
        self._kp = np.where(follows == "position", share * actuators.kp[own], 0.0)
        is_velocity = follows == "velocity"
        self._kd = np.where(is_velocity, share * actuators.kd[own], actuators.kd[own])
        self._kv = np.where(is_velocity, self._kd, 0.0)
        self._direct = np.where(follows == "torque", share, 0.0)
        self._share = share
        self._filter = None
        if motor.response is not None:
            self._filter = discretised(*motor.response.continuous(), timestep)
        self._curve = None
        if isinstance(motor, DcMotor | NetworkMotor) and motor.saturation_torque is not None:
            assert motor.no_load_speed is not None
            limit = share * actuators.torque_limits[own]
            stall = share * motor.saturation_torque
            self._curve = limit, stall, motor.no_load_speed
        self._network = None
        self._feedback: list[str] = []
        self._shapes: list[tuple[int, ...]] = [(motor.delay, len(own))]
        self._shapes.append((0 if self._filter is None else len(self._filter[1]), len(own)))
        if isinstance(motor, NetworkMotor):
            from nw_policies.executor.network import Network

            assert drive.program is not None
            self._network = Network(drive.program)
            self._shapes += [(max(motor.history) + 1, len(own))] * 2
            memory = {k: slot.shape for k, slot in drive.program.inputs.items() if k != INPUT}
            self._feedback = list(memory)
            self._shapes += memory.values()

    @property
    def size(self) -> int:
        """How many numbers it remembers."""
        return sum(int(np.prod(shape)) for shape in self._shapes)

    def lay(self, memory: Array) -> None:
        """Take a part of the motors' memory."""
        ends = [0, *accumulate(int(np.prod(shape)) for shape in self._shapes)]
        parts = [
            memory[start:end].reshape(shape)
            for shape, (start, end) in zip(self._shapes, pairwise(ends), strict=True)
        ]
        # Earlier targets, the oldest first; the response's state, the target that is followed
        # first; errors and velocities, the newest first; and the inputs of `_feedback`.
        self._late, self._state, *rest = parts
        self._errors, self._speeds = rest[:2] or (self._late, self._late)
        self._remembered = dict(zip(self._feedback, rest[2:], strict=True))

    def reset(self, held: Array) -> None:
        self._late[:] = held[self._joints]
        self._state[:1] = held[self._joints]

    def drive(self, targets: Array, positions: Array, velocities: Array, out: Array) -> None:
        own = self._joints
        target, speed = targets[own], velocities[own]
        if len(self._late):
            newest, target = target, self._late[0].copy()
            self._late[:-1] = self._late[1:]
            self._late[-1] = newest
        if self._filter is not None:
            # Each state is a sum in one order: a product of matrices has other bits elsewhere.
            A, b = self._filter
            after = [b[row] * target for row in range(len(b))]
            for row, column in np.ndindex(A.shape):
                after[row] += A[row, column] * self._state[column]
            self._state[:] = after
            target = after[0]
        error = target - positions[own]
        if self._network is not None:
            torque = self._share * self._inferred(error, speed)
        else:
            torque = self._kp * error - self._kd * speed
            torque += (self._kv + self._direct) * target
        if self._curve is not None:
            limit, stall, no_load = self._curve
            fastest = no_load * (1.0 + limit / stall)
            share = np.minimum(np.maximum(speed, -fastest), fastest) / no_load
            highest = np.minimum(stall * (1.0 - share), limit)
            lowest = np.maximum(stall * (-1.0 - share), -limit)
            torque = np.minimum(np.maximum(torque, lowest), highest)
        out[own] = torque

    def _inferred(self, error: Array, speed: Array) -> Array:
        """Return the torques of the network, (N,) N m."""
        motor, network = self._motor, self._network
        assert isinstance(motor, NetworkMotor)
        assert network is not None
        for rows, newest in ((self._errors, error), (self._speeds, speed)):
            rows[1:] = rows[:-1].copy()
            rows[0] = newest
        columns = [
            motor.pos_scale * self._errors[motor.history],
            motor.vel_scale * self._speeds[motor.history],
        ]
        if motor.order == "vel_pos":
            columns.reverse()
        given = network({INPUT: np.concatenate(columns).T, **self._remembered})
        for name, rows in self._remembered.items():
            rows[...] = given[NEXT + name]
        return motor.torque_scale * given[TORQUE].reshape(-1).astype(np.float64)


def discretised(A: Array, b: Array, timestep: float) -> tuple[Array, Array]:
    """Return the exact step of x' = A x + b u for a u that is constant in it.

    It is the matrix exponential of [[A, b], [0, 0]] timestep, by its series and squaring: sums and
    products alone, in one order, so that the bits are the same everywhere.

    Args:
        A: (n, n).
        b: (n,).
        timestep: s.

    Returns:
        (n, n) and (n,): x is then the first times x plus the second times u.
    """
    count = len(b)
    whole: list[list[float]] = [[*A[row], b[row]] for row in range(count)]
    whole.append([0.0] * (count + 1))
    largest = timestep * max(sum(map(abs, row)) for row in whole)
    halvings = 0
    while largest > 0.5:
        largest, halvings = largest / 2.0, halvings + 1
    step = [[timestep * float(x) / 2**halvings for x in row] for row in whole]
    identity = [[float(row == column) for column in range(count + 1)] for row in range(count + 1)]
    total, term = identity, identity
    for number in range(1, 20):
        term = [[x / number for x in row] for row in _product(term, step)]
        total = [
            [x + y for x, y in zip(*rows, strict=True)] for rows in zip(total, term, strict=True)
        ]
    for _ in range(halvings):
        total = _product(total, total)
    result = np.array(total)
    return result[:count, :count], result[:count, count]


def _product(one: Sequence[Sequence[float]], other: Sequence[Sequence[float]]) -> list[list[float]]:
    columns = list(zip(*other, strict=True))
    return [
        [sum(x * y for x, y in zip(row, column, strict=True)) for column in columns] for row in one
    ]
