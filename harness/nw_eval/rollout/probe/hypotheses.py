"""What else a card might have meant: the same second with other joint orders, signs, histories.

A policy under its own card walks nearly level; with the joints in another order it stumbles within
a second. So where a policy stumbles, the one change that lets it walk is most likely the mistake.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from nw_eval.errors import NwEvalError
from nw_eval.policies import Bundle, Card
from nw_eval.policies.joints import joint_order, short_name
from nw_eval.policies.observations import ProprioObservation
from nw_eval.robots import RobotSpec
from nw_eval.rollout.probe.recording import Recording, ThisBundle, record

STUMBLES = 0.3
"""Roll or pitch that a policy on flat ground does not reach under its own card, rad. Measured on
three policies: 0.07 to 0.08 with the right card, 0.28 to 1.3 with any other order of joints."""

_WALKS = 0.2  # rad; what walks leans less
_FAR = 0.3  # m; what walks gets farther than that
_SECONDS = 2.0  # Some wrong cards take longer than one to fall.
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


def stumbles(recording: Recording) -> bool:
    """Whether a policy falls, bumps or leans as none does under its own card on flat ground."""
    return recording.outcome is not None or float(recording.tilt.max()) > STUMBLES


def better_card(
    bundle: Bundle,
    robot: RobotSpec,
    *,
    scene: str,
    allow_code: bool,
    library: ThisBundle,
) -> Hypothesis | None:
    """Return the change of the card under which the policy walks most level; None if none does.

    Cards that see images are not tried: each second of theirs would be rendered again.
    """
    best: tuple[float, Hypothesis] | None = None
    try:
        for hypothesis in hypotheses(bundle.card, robot):
            library.with_card(hypothesis.card)
            try:
                made = record(
                    bundle, scene=scene, seconds=_SECONDS, allow_code=allow_code, library=library
                )
            except NwEvalError:
                continue  # Not even that: the card has it right in this respect.
            tilt = float(made.tilt.max())
            if made.outcome is None and tilt < _WALKS and made.travelled > _FAR:
                best = min(best or (tilt, hypothesis), (tilt, hypothesis), key=lambda x: x[0])
    finally:
        library.with_card(bundle.card)
    return None if best is None else best[1]


def hypotheses(card: Card, robot: RobotSpec) -> Iterator[Hypothesis]:
    """Yield the changes that are worth a try."""
    if any(spec.sensor == "splat_rgb" for spec in card.observations.values()):
        return
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
    for name, observation in card.observations.items():
        if not isinstance(observation, ProprioObservation):
            continue
        for words, changed in _variants(observation):
            observations = {**card.observations, name: changed}
            yield Hypothesis(
                words=f"`{name}` with {words}",
                card=card.model_copy(update={"observations": observations}),
            )


def _variants(
    observation: ProprioObservation,
) -> Iterator[tuple[str, ProprioObservation]]:
    history = observation.history
    if history is not None and history.steps > 1:
        other = "oldest_first" if history.order == "newest_first" else "newest_first"
        changed = history.model_copy(update={"order": other})
        yield f"order: {other}", observation.model_copy(update={"history": changed})
        if observation.select is None:
            by = "term" if history.by == "step" else "step"
            changed = history.model_copy(update={"by": by})
            yield f"by: {by}", observation.model_copy(update={"history": changed})
    terms = list(observation.terms or ())
    for index, term in enumerate(terms):
        if term.term in {"gravity", "ang_vel", "delta_yaw"} and isinstance(term.scale, float):
            turned = term.model_copy(update={"scale": -term.scale})
            changed_terms = [*terms[:index], turned, *terms[index + 1 :]]
            words = f"the sign of `{term.term}` turned"
            yield words, observation.model_copy(update={"terms": changed_terms})
