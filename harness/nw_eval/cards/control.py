"""What a raw action of a policy means, and the motors that it drives.

Low-pass filters between a policy's actions and the motors are as stacks have them that train with
one. Both kinds are one recursion over actions x, at the rate of the policy, and what was applied,
y:

    y[n] = b[0] x[n] + ... + b[N] x[n-N] - a[1] y[n-1] - ... - a[N] y[n-N]

which is `ActionFilterExp` and `ActionFilterButter` of google-research's motion_imitation.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from nw_eval.cards.joints import ActionKind, PerJoint
from nw_eval.cards.model import CONTROL_RATE, CardModel, Limits

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

PHYSICS_RATE = 200
"""Physics steps per second of every protocol, unless a card says otherwise, Hz."""


def _control_rate(rate: int) -> int:
    if rate < 1 or CONTROL_RATE % rate:
        message = f"{rate} actions a second do not fit the {CONTROL_RATE} Hz of every trial"
        raise ValueError(f"{message}, in which waypoints, sensors and logs count; {_SLOWER}")
    return rate


_SLOWER = "use 50, 25, 10, 5, 2 or 1, or export a policy of one of these rates"

ControlRate = Annotated[int, AfterValidator(_control_rate)]


def _physics_rate(rate: int) -> int:
    if rate % CONTROL_RATE or not 2 * CONTROL_RATE <= rate <= 2000:
        message = f"{rate} physics steps a second are not a multiple of {CONTROL_RATE} up to 2000"
        raise ValueError(f"{message}; use 200 (the default), 250, 500 or 1000")
    return rate


PhysicsRate = Annotated[int, AfterValidator(_physics_rate)]


class Control(CardModel):
    """What a raw action means, and the motors that it drives."""

    rate: ControlRate = CONTROL_RATE
    """Actions per second, Hz. Below 50 each action is held for 50 / rate control steps."""
    physics_rate: PhysicsRate = PHYSICS_RATE
    """Physics steps per second, Hz: a multiple of 50."""
    action: ActionKind | Annotated[dict[str, ActionKind], Field(min_length=1, max_length=200)]
    """Joint target = default pose + scale * action, or scale * action; or velocity, or torque, =
    scale * action. One word for all joints, or words by joint, type or pattern, as for `scale`."""
    scale: PerJoint = 1.0
    """rad, rad/s or N m for each unit of action."""
    clip: Limits | None = None
    """Limits of the raw action, before scaling."""
    delay_steps: int = Field(default=0, ge=0, le=10)
    """Actions that are applied before a new one is: its latency, in periods of `rate`."""
    filter: LowPass | None = None
    """Low-pass on the raw action, behind limits and latency and before scaling; null = none."""
    joints: list[str] | None = None
    """Names in the checkpoint's order, for actions and observations; None = the robot's order."""
    default_pose: PerJoint | None = None
    """rad; None = the robot's."""
    kp: PerJoint | None = None
    """Position gain, N m/rad; None = the robot's, here and below."""
    kd: PerJoint | None = None
    """Joint damping, N m s/rad; None = none where actions are torques. Where actions are
    velocities it is the gain: torque = kd * (target - velocity)."""
    torque_limits: PerJoint | None = None
    """N m."""
    armature: PerJoint | None = None
    """kg m^2."""
    friction_loss: PerJoint | None = None
    """N m."""

    @field_validator("kp")
    @classmethod
    def _only_for_positions(cls, kp: PerJoint | None, info: ValidationInfo) -> PerJoint | None:
        if kp is not None and info.data.get("action") == "joint_torque":
            raise ValueError("kp has no meaning for torques; remove it, or choose another `action`")
        return kp

    @field_validator("filter")
    @classmethod
    def _below_half_the_rate(cls, low_pass: LowPass | None, info: ValidationInfo) -> LowPass | None:
        rate = info.data.get("rate", CONTROL_RATE)
        if isinstance(low_pass, ButterworthFilter) and not low_pass.cutoff < rate / 2:
            message = f"a cutoff of {low_pass.cutoff:g} Hz is not below half of {rate} actions a"
            raise ValueError(f"{message} second; give less than {rate / 2:g}, or remove `filter`")
        return low_pass

    @property
    def has_torques(self) -> bool:
        """Whether the actions of all joints are torques."""
        kinds = {self.action} if isinstance(self.action, str) else set(self.action.values())
        return kinds == {"joint_torque"}

    @property
    def hold(self) -> int:
        """Control steps of 0.02 s from one action to the next."""
        return CONTROL_RATE // self.rate


class CameraMounting(CardModel):
    """How a camera is mounted, against the robot's own."""

    pitch: Annotated[float, Field(ge=-0.8, le=0.8)] = 0.0
    """Angle by which it looks farther down, rad."""
    height: Annotated[float, Field(ge=-0.3, le=0.3)] = 0.0
    """Length by which it sits higher on the trunk, m."""
    field_of_view: Annotated[float, Field(ge=0.3, le=1.5)] = 1.0
    """Factor of its vertical field of view."""
