"""Motors as a training had them, where they were more than servos with a limit of torque.

A motor of a group gets its torque from us at every physics step, as explicit actuators do in Isaac
Lab (`IdealPDActuator`, `DCMotor`, `DelayedPDActuator`, `ActuatorNetMLP`, `ActuatorNetLSTM`) and
motors in legged_gym; its damping is part of that torque. Joints of no group are servos of MuJoCo.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from nw_base.errors import PolicyError, nearest
from nw_policies.cards.joints import named_joints, short_name
from nw_policies.cards.model import CardModel
from nw_policies.cards.networks import Checkpoint

Array = NDArray[np.float64]

MOST_STEPS = 100
"""Physics steps that a motor looks back or is late, at most."""
Steps = Annotated[int, Field(ge=0, le=MOST_STEPS)]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class FirstOrder(CardModel):
    """The target that a motor follows comes up to its own as y' = (u - y) / time_constant."""

    time_constant: float = Field(ge=1e-4, le=1.0)
    """s, until 63 % of a step."""

    def continuous(self) -> tuple[Array, Array]:
        """Return A (n, n) and b (n,) of x' = A x + b u, where x[0] is the target followed."""
        rate = 1.0 / self.time_constant
        return np.array([[-rate]]), np.array([rate])


class SecondOrder(CardModel):
    """The target that a motor follows comes up to its own as y'' = w^2 (u - y) - 2 damping w y'."""

    frequency: float = Field(ge=0.1, le=1000.0)
    """Natural frequency, Hz: w = 2 pi times it."""
    damping: float = Field(gt=0.0, le=10.0)
    """Damping ratio; below 1 it overshoots."""

    def continuous(self) -> tuple[Array, Array]:
        """As of `FirstOrder`; x[1] is the rate of the target."""
        w = 2.0 * np.pi * self.frequency
        return np.array([[0.0, 1.0], [-w * w, -2.0 * self.damping * w]]), np.array([0.0, w * w])


class MotorGroup(CardModel):
    """What motors of all kinds have in common: whose they are, and how late a target acts."""

    joints: Name | Annotated[list[Name], Field(min_length=1, max_length=200)] = "*"
    """Joints, types or patterns, as for `kp`; no joint is in two groups."""
    delay: Steps = 0
    """Physics steps by which a target is late."""
    response: FirstOrder | SecondOrder | None = None
    """How a motor comes up to a new target; null = at once."""


class PdMotor(MotorGroup):
    """kp (target - position) - kd velocity, within `torque_limits`: Isaac Lab's IdealPDActuator."""

    kind: Literal["pd"]


class DcMotor(MotorGroup):
    """As `pd`, within the torque-speed curve of a direct-current motor too."""

    kind: Literal["dc"]
    saturation_torque: float = Field(gt=0.0, le=1e5)
    """N m at rest (stall torque)."""
    no_load_speed: float = Field(gt=0.0, le=1e4)
    """rad/s at which no torque is left."""


class NetworkMotor(MotorGroup, Checkpoint):
    """A network's torque, of errors of position and of velocities; it has no kp and kd."""

    kind: Literal["network"]
    history: Annotated[list[Steps], Field(min_length=1, max_length=MOST_STEPS)] = Field(
        default_factory=lambda: [0]
    )
    """Physics steps back of the errors and velocities that it takes, in its order."""
    order: Literal["pos_vel", "vel_pos"] = "pos_vel"
    """Whether errors of position come first, or velocities."""
    pos_scale: float = 1.0
    """Of errors, target - position, rad; -1 for a network that takes position - target."""
    vel_scale: float = 1.0
    """Of velocities, rad/s."""
    torque_scale: float = 1.0
    """N m for each unit that it gives."""
    saturation_torque: Annotated[float, Field(gt=0.0, le=1e5)] | None = None
    """As of `dc`; null = no torque-speed curve."""
    no_load_speed: Annotated[float, Field(gt=0.0, le=1e4)] | None = None
    """As of `dc`; given with `saturation_torque`."""

    @model_validator(mode="after")
    def _whole_curve(self) -> NetworkMotor:
        if (self.saturation_torque is None) != (self.no_load_speed is None):
            message = "a curve needs `saturation_torque` and `no_load_speed`; give both or none"
            raise ValueError(message)
        return self


Motor = Annotated[PdMotor | DcMotor | NetworkMotor, Field(discriminator="kind")]
Motors = Annotated[list[Motor], Field(min_length=1, max_length=50)]


def motor_places(motors: Sequence[Motor], joints: Sequence[str]) -> list[NDArray[np.intp]]:
    """Return, for each group of motors, the positions of its joints among `joints`.

    Raises:
        PolicyError: a name means no joint, or a joint is in two groups.
    """
    names = [short_name(joint) for joint in joints]
    taken: dict[str, int] = {}
    places: list[NDArray[np.intp]] = []
    for number, group in enumerate(motors):
        own: set[str] = set()
        for key in [group.joints] if isinstance(group.joints, str) else group.joints:
            hits = named_joints(key, names)
            if not hits:
                raise PolicyError(
                    f"{key!r} of group {number} names no joint", fix=nearest(short_name(key), names)
                )
            own.update(hits)
        for name in sorted(own & set(taken)):
            raise PolicyError(
                f"{name} is in the groups {taken[name]} and {number}",
                fix="name each joint in one group",
            )
        taken |= dict.fromkeys(own, number)
        places.append(np.array([i for i, name in enumerate(names) if name in own], dtype=np.intp))
    return places
