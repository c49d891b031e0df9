"""The same policy with joints that turn the other way, or farther, for one unit of its action.

Where another stack counts a joint's angle the other way round, its numbers have the other sign in
the targets, in the observations and in the default pose. A card says so with a negative
`control.scale`, and with a negative `scale` of the terms `joint_pos` and `joint_vel`; its
`default_pose` is in the robot's own directions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards import Card, JointControl
from nw_eval.cards.observations import AnyObservation, ProprioObservation
from nw_eval.cards.terms import AnyTerm, JointPosition, JointVelocity
from nw_eval.onboarding.variants.motors import joint_names
from nw_eval.onboarding.variants.written import listed, per_joint
from nw_eval.robots import RobotSpec

_Place = Literal["targets", "observations", "default pose"]

_GROUPS = {
    "the hips": ("*_hip",),
    "the right hips": ("?R_hip",),
    "the left hips": ("?L_hip",),
    "thighs and calves": ("*_thigh", "*_calf"),
    "the right legs": ("?R_*",),
    "all joints": ("*",),
}
_SCALES = (
    ("the hips", 2.0, "doubled"),
    ("the hips", 0.5, "halved"),
    ("all joints", 2.0, "doubled"),
    ("all joints", 0.5, "halved"),
)
_PLACES: tuple[tuple[_Place, ...], ...] = (
    ("targets", "observations"),
    ("targets",),
    ("observations",),
    ("targets", "observations", "default pose"),
    ("default pose",),
)


def turned_cards(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    """Yield cards some of whose joints count the other way round, and what they are in words."""
    for group, patterns in _GROUPS.items():
        for places in _PLACES:
            signs = _factors(card, robot, patterns, -1.0)
            yield (
                f"the signs of {group} reversed in {listed(places)}",
                _times(card, robot, signs, places),
            )


def scaled_cards(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    """Yield cards with other scales of the action, and what they are in words."""
    # Without a scale on the card, it may be the one that most stacks have.
    missing = [("all joints", 0.25, "divided by 4")] if card.control.scale == 1.0 else []
    for group, factor, words in (*missing, *_SCALES):
        factors = _factors(card, robot, _GROUPS[group], factor)
        yield f"the scale of {group} {words}", _times(card, robot, factors, ("targets",))


def _factors(
    card: Card, robot: RobotSpec, patterns: Sequence[str], factor: float
) -> NDArray[np.float64]:
    """Return (12,) in the policy's order: `factor` for joints that a pattern names, else 1."""
    named = [any(fnmatchcase(name, p) for p in patterns) for name in joint_names(card, robot)]
    return np.where(named, factor, 1.0)


def _times(
    card: Card, robot: RobotSpec, factors: NDArray[np.float64], places: Sequence[_Place]
) -> Card:
    joints, names = JointControl.from_card(card, robot), joint_names(card, robot)
    control: dict[str, Any] = {}
    if "targets" in places:
        control["scale"] = per_joint(names, (joints.scale * factors).tolist())
    if "default pose" in places:
        control["default_pose"] = per_joint(names, (joints.default_pose * factors).tolist())
    observations: dict[str, AnyObservation] = dict(card.observations)
    if "observations" in places:
        observations = {name: _seen(value, factors) for name, value in observations.items()}
    changed = {"control": card.control.model_copy(update=control), "observations": observations}
    return card.model_copy(update=changed)


def _seen(observation: AnyObservation, factors: NDArray[np.float64]) -> AnyObservation:
    if not isinstance(observation, ProprioObservation):
        return observation
    terms = [_term(term, factors) for term in observation.frame_terms]
    if terms == list(observation.frame_terms):
        return observation
    return observation.model_copy(update={"layout": None, "terms": terms})


def _term(term: AnyTerm, factors: NDArray[np.float64]) -> AnyTerm:
    if not isinstance(term, JointPosition | JointVelocity):
        return term
    scale: list[float] = (np.broadcast_to(term.scale, factors.shape) * factors).tolist()
    return term.model_copy(update={"scale": scale[0] if len(set(scale)) == 1 else scale})
