"""Meaning of a policy's raw action, and the motors that it drives.

Filters between a policy's actions and the motors are as stacks have them that train with one. All
kinds are one recursion over actions x, at the rate of the policy, and what was applied, y:

    y[n] = b[0] x[n] + ... + b[N] x[n-N] - a[1] y[n-1] - ... - a[N] y[n-N]

which is `ActionFilterExp` and `ActionFilterButter` of google-research's motion_imitation. A FIR
filter has no a.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from nw_base.lens import Intrinsics, ShutterTime
from nw_policies.cards.joints import ActionKind, Held, PerJoint
from nw_policies.cards.model import CONTROL_RATE, CardModel, Limits, Rate
from nw_policies.cards.motors import Motors

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


class FirFilter(CardModel):
    """Finite impulse response: y[n] = weights[0] x[n] + weights[1] x[n-1] + ..."""

    kind: Literal["fir"]
    weights: Annotated[list[float], Field(min_length=1, max_length=50)]
    """Of the newest action first; a constant action is kept where their sum is 1."""

    def coefficients(self, rate: float) -> tuple[Array, Array]:  # noqa: ARG002 - as the others.
        """Return b and a, (N + 1,) each."""
        b = np.array([*self.weights, 0.0])
        return b, np.eye(1, len(b))[0]


LowPass = Annotated[ExponentialFilter | ButterworthFilter | FirFilter, Field(discriminator="kind")]

PHYSICS_RATE = 200
"""Physics steps per second of every protocol, unless a card says otherwise, Hz."""


MOST_PHYSICS_RATE = 2000
"""Physics steps per second at most, Hz."""

PhysicsRate = Annotated[int, Field(ge=100, le=MOST_PHYSICS_RATE)]
"""Physics steps per second, Hz."""

_NEAR = 1e-3  # share by which a rate such as 33.33 may miss a whole number of physics steps


class Control(CardModel):
    """Meaning of a raw action, and the motors that it drives."""

    rate: Rate = CONTROL_RATE
    """Actions per second, Hz. Each lasts a whole number of physics steps. A rate that divides 50 is
    held for 50 / rate control steps of 0.02 s; with any other, a control step is one action long.
    """
    physics_rate: PhysicsRate = Field(default=PHYSICS_RATE, validate_default=True)
    """Physics steps per second, Hz: a multiple of `rate`, and of 50 where that divides 50."""
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
    held: Held | None = None
    """Joints that the policy does not drive, by name, type or pattern: they are held at these
    angles, rad, or as a list at the default pose. Actions and terms of joints have no numbers for
    them, nor need `joints` and lists; a term with `leave_out: []` has all joints."""
    commanded: Annotated[list[str], Field(min_length=1, max_length=200)] | None = None
    """Joints, types or patterns whose angle at action 0 a suite's task may ask for, as its
    `targets`; None = those of `held`."""
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
    viscous_friction: PerJoint | None = None
    """Of the joints themselves, beside `kd`, N m s/rad; None = none."""
    motors: Motors | None = None
    """Groups of motors that were more than servos in the training; null = all are servos."""

    @field_validator("physics_rate")
    @classmethod
    def _whole_steps(cls, physics_rate: int, info: ValidationInfo) -> int:
        rate = info.data.get("rate", CONTROL_RATE)
        steps = physics_rate / _step_rate(rate)
        if steps < 1 - _NEAR or abs(steps - round(steps)) > _NEAR * steps:
            every = "a control step" if CONTROL_RATE % rate == 0 else "an action"
            message = f"{physics_rate} physics steps a second are {steps:.4g} for {every} of"
            message += f" {1 / _step_rate(rate):.4g} s; use `physics_rate: {_fitting(rate)}`"
            raise ValueError(f"{message}, or `rate: {_near(physics_rate, rate)}`")
        return physics_rate

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

    @model_serializer(mode="wrap")
    def _without_absent(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what came later and is not given: cards without it keep their digest."""
        fields: dict[str, Any] = dump(self)
        later = {"held", "commanded", "viscous_friction", "motors"}
        return {k: value for k, value in fields.items() if value is not None or k not in later}

    @property
    def has_torques(self) -> bool:
        """Whether the actions of all joints are torques."""
        kinds = {self.action} if isinstance(self.action, str) else set(self.action.values())
        return kinds == {"joint_torque"}

    @property
    def hold(self) -> int:
        """Control steps from one action to the next."""
        return round(_step_rate(self.rate) / self.rate)

    @property
    def substeps(self) -> int:
        """Physics steps in a control step."""
        return round(self.physics_rate / _step_rate(self.rate))

    @property
    def step_rate(self) -> float:
        """Control steps per second, Hz: 50, or the policy's own rate where that does not divide 50.

        Waypoints, sensors and logs count in control steps.
        """
        rate = self.physics_rate / self.substeps
        return int(rate) if rate == int(rate) else rate


def _step_rate(rate: float) -> float:
    return rate if CONTROL_RATE % rate else CONTROL_RATE


def _fitting(rate: float) -> str:
    """Return the physics rates from 200 on that a rate fits into, as words."""
    wanted = range(PHYSICS_RATE, MOST_PHYSICS_RATE + 1)
    steps = _step_rate(rate)
    fitting = [each for each in wanted if abs(each / steps - round(each / steps)) < 1e-9]
    return " or ".join(map(str, fitting[:3])) or "another"


def _near(physics_rate: int, rate: float) -> str:
    """Return the rates next to one that physics steps fit into, as words."""
    steps = max(1, int(physics_rate / rate))
    return " or ".join(f"{physics_rate / each:.6g}" for each in (steps + 1, steps))


class CameraMounting(CardModel):
    """How a camera is mounted, against the robot's own."""

    pitch: Annotated[float, Field(ge=-0.8, le=0.8)] = 0.0
    """Angle by which it looks farther down, rad."""
    height: Annotated[float, Field(ge=-0.3, le=0.3)] = 0.0
    """Length by which it sits higher on the trunk, m."""
    field_of_view: Annotated[float, Field(ge=0.3, le=1.5)] = 1.0
    """Factor of its vertical field of view."""
    intrinsics: Intrinsics | None = None
    """What it sees, in place of the robot's own: image size, focal lengths, principal point
    (pixels)."""
    readout: ShutterTime | None = None
    """Time from the reading of the first row to that of the last, s; None = as the robot's own."""
    exposure: ShutterTime | None = None
    """Time for which each row is exposed before it is read, s; None = as the robot's own."""

    @model_validator(mode="after")
    def _one_view(self) -> CameraMounting:
        if self.intrinsics is not None and "field_of_view" in self.model_fields_set:
            raise ValueError(
                "`field_of_view` and `intrinsics` both set the field of view; remove one of them"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_the_robots_own(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what is the robot's own, so that cards without these keys keep their digest."""
        fields = dump(self)
        for name in ("intrinsics", "readout", "exposure"):
            if getattr(self, name) is None:
                fields.pop(name, None)
        return fields
