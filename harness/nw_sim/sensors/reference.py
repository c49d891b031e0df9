"""Numbers of the motion that a policy tracks, as it sees them: from the robot's own anchor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, assert_never

import numpy as np
from numpy.typing import ArrayLike

from nw_base.errors import TrialError
from nw_policies.cards import reference_terms
from nw_policies.cards.joint_control import JointControl
from nw_policies.cards.observations import ReferenceObservation
from nw_policies.cards.reference_terms import reference_term_size
from nw_sim.sensors.proprio import Reader, Rows, joint_index
from nw_sim.sensors.sensor import StepContext
from nw_sim.tasks.reference import (
    Frame,
    PlacedReference,
    columns_6d,
    conjugate,
    product,
    turned,
)


class ReferenceRows(Rows):
    """Numbers of the motion that the policy tracks, seen from the robot's anchor."""

    def __init__(self, name: str, observation: ReferenceObservation, control: JointControl) -> None:
        """Prepare one reader for each term of each frame; raises as `Rows`."""
        pairs = observation.frame_terms
        super().__init__(
            name,
            observation,
            [term for term, _ in pairs],
            [reference_term_size(term, len(control.names)) for term, _ in pairs],
            [_reader(term, ahead, control) for term, ahead in pairs],
            key=f"reference {observation.ahead}",
        )


Seen = Callable[[StepContext, Frame], ArrayLike]


def _reader(term: reference_terms.AnyReferenceTerm, ahead: int, control: JointControl) -> Reader:
    """Return the function that reads a term of the motion, some control steps ahead."""
    read = _seen(term, control)
    key = f"motion {ahead}"

    def of_moment(moment: StepContext) -> ArrayLike:
        frame = moment.shared.get(key)
        if frame is None:
            frame = moment.shared[key] = _placed(moment).at(moment.step + ahead)
        return read(moment, frame)

    return of_moment


def _placed(moment: StepContext) -> PlacedReference:
    if (placed := moment.task.reference) is None:
        raise TrialError("the task gives no motion to track", fix="write task: track")
    return placed


def _seen(term: reference_terms.AnyReferenceTerm, control: JointControl) -> Seen:
    """Return what reads a term of a frame."""
    order = joint_index(control.order, len(control.order))
    pose: Any = control.default_pose
    match term:
        case reference_terms.ReferenceJointPositions():
            zero = pose if term.relative else np.zeros_like(pose)
            return lambda _, frame: frame.joint_positions[order] - zero
        case reference_terms.ReferenceJointVelocities():
            return lambda _, frame: frame.joint_velocities[order]
        case reference_terms.AnchorPosition():
            return _anchor_position
        case reference_terms.AnchorOrientation():
            return _anchor_orientation
        case reference_terms.Phase():
            return lambda moment, frame: frame.number / (len(_placed(moment).motion) - 1)
        case reference_terms.FrameNumber():
            return lambda _, frame: frame.number
        case _:
            assert_never(term)


def _anchor_position(moment: StepContext, frame: Frame) -> ArrayLike:
    places, quats = moment.world.body_poses((_placed(moment).motion.anchor,))
    return turned(conjugate(quats[0]), frame.anchor_position - places[0])


def _anchor_orientation(moment: StepContext, frame: Frame) -> ArrayLike:
    _, quats = moment.world.body_poses((_placed(moment).motion.anchor,))
    return columns_6d(product(conjugate(quats[0]), frame.anchor_quat))
