"""What else a card might have meant: other joint orders, signs and scales, other histories."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from nw_eval.policies import Card
from nw_eval.policies.joints import joint_order, short_name
from nw_eval.policies.observations import ProprioObservation
from nw_eval.robots import RobotSpec
from nw_eval.rollout.probe.joint_signs import scaled_cards, turned_cards
from nw_eval.rollout.probe.written import changed_lines

_LEGS = (
    ("FR", "FL", "RR", "RL"),
    ("FL", "FR", "RL", "RR"),
    ("RR", "RL", "FR", "FL"),
    ("RL", "RR", "FL", "FR"),
)
_KINDS = ("hip", "thigh", "calf")
_LEGGED_GYM = [2.0, 2.0, 0.25]  # Its scales of a velocity command, which many took over.


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """One change of a card, in words."""

    words: str
    card: Card

    def advice(self, card: Card) -> str:
        """Say what to write on the card that it changes, each key on a line of its own."""
        lines = "".join(f"\n    {line}" for line in changed_lines(card, self.card))
        return f"with {self.words}; if so trained, write{lines}"


def hypotheses(card: Card, robot: RobotSpec) -> Iterator[Hypothesis]:
    """Yield the changes that are worth a try."""
    yield from _orders(card, robot)
    for words, changed in (*turned_cards(card, robot), *scaled_cards(card, robot)):
        yield Hypothesis(words=words, card=changed)
    for name, observation in card.observations.items():
        if not isinstance(observation, ProprioObservation):
            continue
        for words, changed in (*_histories(observation), *_other_terms(observation)):
            observations = {**card.observations, name: changed}
            yield Hypothesis(
                words=f"`{name}` with {words}",
                card=card.model_copy(update={"observations": observations}),
            )


def _orders(card: Card, robot: RobotSpec) -> Iterator[Hypothesis]:
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
        yield Hypothesis(words=words, card=card.model_copy(update={"control": control}))


def _histories(observation: ProprioObservation) -> Iterator[tuple[str, ProprioObservation]]:
    history = observation.history
    if history is None or history.steps == 1:
        return
    order = "oldest_first" if history.order == "newest_first" else "newest_first"
    changed = history.model_copy(update={"order": order})
    yield f"order: {order}", observation.model_copy(update={"history": changed})
    if observation.select is None:
        by = "term" if history.by == "step" else "step"
        changed = history.model_copy(update={"by": by})
        yield f"by: {by}", observation.model_copy(update={"history": changed})


def _other_terms(observation: ProprioObservation) -> Iterator[tuple[str, ProprioObservation]]:
    terms = list(observation.terms or ())
    for index, term in enumerate(terms):
        scales: list[float | list[float]] = []
        words = f"the sign of `{term.term}` turned"
        if term.term in {"gravity", "ang_vel", "delta_yaw"} and isinstance(term.scale, float):
            scales = [-term.scale]
        elif term.term == "command":
            words = "another scale of `command`"
            x, y, yaw = term.scale if isinstance(term.scale, list) else [term.scale] * 3
            scales = [1.0, _LEGGED_GYM, [x, -y, yaw], [x, y, -yaw], [x, -y, -yaw]]
        for scale in scales:
            if scale != term.scale:
                other = term.model_copy(update={"scale": scale})
                changed = [*terms[:index], other, *terms[index + 1 :]]
                yield words, observation.model_copy(update={"terms": changed})
