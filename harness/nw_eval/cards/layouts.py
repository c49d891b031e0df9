"""Published lists of terms, by name."""

from __future__ import annotations

from typing import Literal

from nw_eval.cards.terms import (
    AngularVelocity,
    AnyTerm,
    AppliedAction,
    Constant,
    DeltaYaw,
    FootContacts,
    Imu,
    JointPosition,
    JointVelocity,
    Speed,
)

LayoutName = Literal["parkour53"]

LAYOUTS: dict[LayoutName, tuple[AnyTerm, ...]] = {
    # The 53 numbers of extreme-parkour, LucidSim and Neverwhere. Index 7 is a copy of 6, as in
    # their evaluation; 11 and 12 mask the environment kind, always (1, 0) here.
    "parkour53": (
        AngularVelocity(term="ang_vel", scale=0.25),
        Imu(term="imu"),
        DeltaYaw(term="delta_yaw", copies=2),
        Constant(term="constant", values=[0.0, 0.0]),
        Speed(term="speed"),
        Constant(term="constant", values=[1.0, 0.0]),
        JointPosition(term="joint_pos"),
        JointVelocity(term="joint_vel", scale=0.05),
        AppliedAction(term="applied_action"),
        FootContacts(term="foot_contacts", offset=-0.5),
    ),
}
