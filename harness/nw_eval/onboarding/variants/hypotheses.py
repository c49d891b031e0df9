"""What else a card might have meant: other scales, orders and signs, other histories."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from nw_eval.cards import Card, JointControl
from nw_eval.cards.joints import joint_order, short_name
from nw_eval.cards.observations import ProprioObservation
from nw_eval.onboarding.variants.controls import other_controls
from nw_eval.onboarding.variants.joint_signs import scaled_cards, turned_cards
from nw_eval.onboarding.variants.terms import (
    absolute_terms,
    framed_terms,
    moved_terms,
    other_velocities,
    scaled_terms,
    swapped_terms,
    turned_terms,
)
from nw_eval.onboarding.variants.written import changed_lines
from nw_eval.robots import RobotSpec, get_robot

TRIED = (
    "orders, signs and scales of joints, history, scales, signs, frames and order of terms, "
    "meaning, rate and delay of actions, poses, gains, the other robots, orders with scales"
)
"""What is changed, in words."""

_LEGS = (
    ("FR", "FL", "RR", "RL"),
    ("FL", "FR", "RL", "RR"),
    ("RR", "RL", "FR", "FL"),
    ("RL", "RR", "FL", "FR"),
)
_KINDS = ("hip", "thigh", "calf")


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """One change of a card, in words."""

    words: str
    card: Card

    def advice(self, card: Card) -> str:
        """Say what to write on the card that it changes, each key on a line of its own."""
        lines = "".join(f"\n    {line}" for line in changed_lines(card, self.card))
        return f"with {self.words}; if trained that way, write{lines}"


def hypotheses(card: Card, robot: RobotSpec) -> Iterator[Hypothesis]:
    """Yield the changes of one thing that are worth a try, likely ones first."""
    yield from _possible(
        *scaled_terms(card),
        *_orders(card, robot),
        *_histories(card, "order"),
        *turned_terms(card),
        *scaled_cards(card, robot),
        *turned_cards(card, robot),
        *absolute_terms(card),
        *swapped_terms(card),
        *moved_terms(card),
        *framed_terms(card),
        *other_velocities(card),
        *other_controls(card, robot),
        *_histories(card, "by"),
    )


def scale_hypotheses(card: Card, robot: RobotSpec) -> Iterator[Hypothesis]:
    """Yield other scales of the action only: what a policy that follows, but weakly, may miss."""
    yield from _possible(*scaled_cards(card, robot))


def double_hypotheses(card: Card, robot: RobotSpec) -> Iterator[Hypothesis]:
    """Yield changes of two things that newcomers from one stack to another forget together."""
    for order, ordered in _orders(card, robot):
        scaled = scaled_terms(ordered, some=False)
        yield from _possible(*((f"{order}, and {scales}", both) for scales, both in scaled))


def _possible(*changes: tuple[str, Card]) -> Iterator[Hypothesis]:
    """Yield those with which the robot can stand.

    A robot that cannot take its default pose was trained in no stack.
    """
    for words, changed in changes:
        if _can_stand(changed, get_robot(changed.robot)):
            yield Hypothesis(words=words, card=changed)


def _can_stand(card: Card, robot: RobotSpec) -> bool:
    joints = JointControl.from_card(card, robot)
    ranges = np.array(robot.joint_ranges)[joints.order]
    return bool(
        ((ranges[:, 0] <= joints.default_pose) & (joints.default_pose <= ranges[:, 1])).all()
    )


def _orders(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    own = joint_order(card.control.joints or robot.joints, robot.joints)
    for legs, by_leg in product(_LEGS, (True, False)):
        pairs = product(legs, _KINDS) if by_leg else ((leg, k) for k, leg in product(_KINDS, legs))
        joints = [f"{leg}_{kind}" for leg, kind in pairs]
        known = {short_name(joint) for joint in robot.joints}
        if set(joints) != known or (joint_order(joints, robot.joints) == own).all():
            continue
        control = card.control.model_copy(update={"joints": joints})
        kinds = "leg by leg" if by_leg else "all hips, then all thighs, then all calves"
        words = f"the joints in the order {' '.join(legs)}, {kinds}"
        yield words, card.model_copy(update={"control": control})


def _histories(card: Card, key: Literal["order", "by"]) -> Iterator[tuple[str, Card]]:
    for name, observation in card.observations.items():
        if not isinstance(observation, ProprioObservation):
            continue
        history = observation.history
        if history is None or history.steps == 1:
            continue
        if key == "by" and observation.select is not None:
            continue
        one, other = {"order": ("oldest_first", "newest_first"), "by": ("step", "term")}[key]
        value = other if getattr(history, key) == one else one
        changed = observation.model_copy(
            update={"history": history.model_copy(update={key: value})}
        )
        observations = {**card.observations, name: changed}
        words = f"`{name}` with {key}: {value}"
        yield words, card.model_copy(update={"observations": observations})
