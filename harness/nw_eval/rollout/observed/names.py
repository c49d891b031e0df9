"""What the numbers of the body are called, one by one: `joint_pos FR_hip`, `ang_vel x t-2`.

A log says it once, so that a plot can say which joint a line is, whatever order a card has.
"""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

from nw_eval.cards import terms, wrappers
from nw_eval.cards.joints import short_name
from nw_eval.cards.observations import ProprioObservation, selected_indices
from nw_eval.cards.terms import AnyTerm, term_size

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_eval.cards import Card
    from nw_eval.robots import RobotSpec

Names = tuple[str, ...]

_AXES = ("x", "y", "z")
_PARTS = {
    "ang_vel": _AXES,
    "lin_vel": _AXES,
    "gravity": _AXES,
    "acceleration": _AXES,
    "imu": ("roll", "pitch", "zero"),
    "roll_pitch": ("roll", "pitch"),
    "command": ("forward", "left", "yaw_rate"),
}
# After these each number still stands in its place.
_IN_PLACE = (
    wrappers.NoiseWrap | wrappers.Normalize | wrappers.Scale | wrappers.Clip | wrappers.Quantize
)


def action_names(card: Card, robot: RobotSpec) -> dict[str, Names]:
    """Return the names of what `/nw/policy` holds, by topic and field."""
    own = tuple(map(short_name, card.control.joints or robot.joints))
    motors = tuple(map(short_name, robot.joints))
    return {
        "/nw/policy.action": own,
        "/nw/policy.applied": own,
        "/nw/policy.targets": motors,
    }


def element_names(spec: object, joints: Sequence[str]) -> Names:
    """Return a name for each number of an observation; empty where its numbers have none.

    Args:
        spec: what the card says of it.
        joints: in the policy's order.
    """
    if not isinstance(spec, ProprioObservation):
        return ()
    if not all(isinstance(wrapper, _IN_PLACE) for wrapper in spec.wrap):
        return ()
    groups = [_of_term(term, tuple(map(short_name, joints))) for term in spec.frame_terms]
    frame = [name for group in groups for name in group]
    if spec.select is not None:
        frame = [frame[index] for index in selected_indices(spec.select, len(frame))]
    history = spec.history
    if history is None:
        return tuple(frame)
    last = 0 if history.current else 1
    ages = list(range(last, last + history.steps))
    if history.order == "oldest_first":
        ages.reverse()
    if history.by == "step":
        return tuple(_aged(name, age) for age in ages for name in frame)
    return tuple(_aged(name, age) for group in groups for age in ages for name in group)


def term_sizes(name: str, spec: object, size: int) -> tuple[tuple[str, int], ...]:
    """Return name and size of the parts of a row: the card's terms, where they are all of it."""
    if isinstance(spec, ProprioObservation):
        found = tuple((term.term, term_size(term)) for term in spec.frame_terms)
        is_whole = spec.select is None and spec.history is None and not spec.wrap
        if is_whole and sum(count for _, count in found) == size:
            return found
    return ((name, size),)


def value_paths(sizes: Sequence[tuple[str, int]]) -> list[str]:
    """Return where each number of an observation of such parts lies in its `nw.Observation`."""
    bounds = pairwise(accumulate((size for _, size in sizes), initial=0))
    return [
        f"terms[{part}].values[{index}]"
        for part, (first, end) in enumerate(bounds)
        for index in range(end - first)
    ]


def _aged(name: str, age: int) -> str:
    return f"{name} t-{age}" if age else name


def _of_term(term: AnyTerm, joints: Names) -> list[str]:
    parts = _parts(term, joints)
    return [f"{term.term} {part}" if part else term.term for part in parts]


def _parts(term: AnyTerm, joints: Names) -> Sequence[str]:
    match term:
        case (
            terms.JointPosition()
            | terms.JointVelocity()
            | terms.AppliedAction()
            | terms.LastOutput()
        ):
            return joints
        case terms.FootContacts():
            return term.feet
        case terms.GaitClock():
            return [f"{kind} {foot}" for kind in term.values for foot in range(len(term.offsets))]
        case terms.Yaw():
            return ("",) if term.values == "angle" else ("sine", "cosine")
        case terms.Speed() | terms.DeltaYaw() | terms.Constant():
            size = term_size(term)
            return ("",) if size == 1 else [str(number) for number in range(size)]
        case _:
            return _PARTS[term.term]
