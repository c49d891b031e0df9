"""Terms of a reference motion: the groups of numbers that an observation of it is made of.

Definitions are those of HybridRobotics/whole_body_tracking (`tasks/tracking/mdp`), which mjlab,
unitree_rl_lab and holosoma have taken over.
"""

from __future__ import annotations

from typing import Annotated, Literal, assert_never

from pydantic import BeforeValidator, Field

from nw_policies.cards.terms import ScaledTerm, bare_word


class ReferenceJointPositions(ScaledTerm):
    """Joint positions of the motion, rad, in the order of `control.joints` (12)."""

    term: Literal["joint_positions"]
    relative: bool = False
    """Minus `control.default_pose`."""


class ReferenceJointVelocities(ScaledTerm):
    """Joint velocities of the motion, rad/s, in the order of `control.joints` (12)."""

    term: Literal["joint_velocities"]


class AnchorPosition(ScaledTerm):
    """Where the motion's anchor is, in the frame of the robot's anchor, m (3)."""

    term: Literal["anchor_position"]


class AnchorOrientation(ScaledTerm):
    """How the motion's anchor is turned, in the frame of the robot's anchor (6).

    The first two columns of the rotation matrix, row by row: R00, R01, R10, R11, R20, R21.
    """

    term: Literal["anchor_orientation_6d"]


class Phase(ScaledTerm):
    """Share of the motion that is over, 0 to 1 (1)."""

    term: Literal["phase"]


class FrameNumber(ScaledTerm):
    """Number of the motion's frame, from 0 (1): `time_step` of checkpoints that hold the motion."""

    term: Literal["frame"]


AnyReferenceTerm = (
    ReferenceJointPositions
    | ReferenceJointVelocities
    | AnchorPosition
    | AnchorOrientation
    | Phase
    | FrameNumber
)
ReferenceTerm = Annotated[
    Annotated[AnyReferenceTerm, Field(discriminator="term")], BeforeValidator(bare_word)
]


def reference_term_size(term: AnyReferenceTerm, joints: int) -> int:
    """Return how many numbers a term has on a robot with so many joints."""
    match term:
        case ReferenceJointPositions() | ReferenceJointVelocities():
            return joints
        case AnchorPosition():
            return 3
        case AnchorOrientation():
            return 6
        case Phase() | FrameNumber():
            return 1
        case _:
            assert_never(term)
