"""Which numbers of an observation come from which term of the card."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards import Card, JointControl
from nw_eval.cards.observations import AnyObservation, ProprioObservation
from nw_eval.cards.terms import AnyTerm, Constant, term_size
from nw_eval.onboarding.notation import settings
from nw_eval.robots import RobotSpec
from nw_eval.sensors import ObservationSpec
from nw_eval.sensors.proprio import Proprio
from nw_eval.sensors.sensor import Shot
from nw_eval.sensors.terms import fixed_values


@dataclass(frozen=True, kw_only=True)
class Part:
    """Numbers of one observation that belong together."""

    observation: str
    kind: str
    """The term's name, or the sensor's where it has no terms."""
    indices: NDArray[np.intp]
    """Where its numbers stand in the flattened observation; all frames of a history."""
    steps: int
    """Frames of a history that they fill; 1 without one."""
    form: str
    """Scale, offset and limits as the card has them; empty where nothing is changed."""
    limits: tuple[float, float] | None
    """What the numbers cannot leave, as the policy sees them."""
    is_fixed: bool
    """Whether they never change by design."""


def parts_of(card: Card, robot: RobotSpec, specs: tuple[ObservationSpec, ...]) -> list[Part]:
    """Return the parts of all observations, in the order of the card.

    Args:
        card: checked against the robot.
        robot: whose joints the terms count.
        specs: from `sensors.check_card`.
    """
    parts: list[Part] = []
    for spec in specs:
        observation = card.observations[spec.name]
        if isinstance(observation, ProprioObservation) and not observation.wrap:
            parts += _terms(spec.name, observation, card, robot)
        else:
            parts.append(_whole(spec, observation))
    return parts


def _whole(spec: ObservationSpec, observation: AnyObservation) -> Part:
    return Part(
        observation=spec.name,
        kind=spec.sensor,
        indices=np.arange(int(np.prod(spec.shape))),
        steps=1,
        form=" -> ".join(wrapper.wrapper for wrapper in observation.wrap),
        limits=None,
        is_fixed=False,
    )


def _terms(name: str, observation: ProprioObservation, card: Card, robot: RobotSpec) -> list[Part]:
    control = JointControl.from_card(card, robot)
    terms = observation.frame_terms
    owner = np.repeat(np.arange(len(terms)), [term_size(t, control.names) for t in terms])
    # The numbers of a frame take the way that every frame takes, each with a tag on it.
    tags = np.arange(1, len(owner) + 1, dtype=np.float32)

    def seen(**history: object) -> NDArray[np.float32]:
        every = observation
        if observation.history is not None:
            past = observation.history.model_copy(update={"start": "repeat", **history})
            every = observation.model_copy(update={"history": past})
        sample: NDArray[np.float32] = tags
        shot = Shot(step=2, moment=None, generator=np.random.default_rng)
        for wrapper in Proprio(name, every, card.command, control, robot.feet).form:
            sample = wrapper(sample, shot)
        return sample

    came_from = owner[seen(zero=None).astype(np.intp) - 1]
    is_zero = seen() == 0.0  # What `history.zero` blanks.
    steps = 1 if observation.history is None else observation.history.steps
    parts: list[Part] = []
    for index, term in enumerate(terms):
        indices = np.flatnonzero(came_from == index)
        if not indices.size:
            continue  # `select` leaves it out.
        parts.append(
            Part(
                observation=name,
                kind=term.term,
                indices=indices,
                steps=steps,
                form=_form(term),
                limits=_limits(term, observation),
                is_fixed=fixed_values(term, card.command) is not None
                or (term.term == "command" and card.command.source == "constant")
                or bool(is_zero[indices].all()),
            )
        )
    return parts


def _form(term: AnyTerm) -> str:
    """Return all of a term that is not by default."""
    words: list[str] = []
    if term.clip is not None:
        words.append(f"clip {term.clip[0]:g}..{term.clip[1]:g}")
    if isinstance(term.scale, list):
        words.append("x [" + ", ".join(f"{value:g}" for value in term.scale) + "]")
    elif term.scale != 1.0:
        words.append(f"x {term.scale:g}")
    if term.offset:
        words.append(f"{term.offset:+g}")
    if isinstance(term, Constant):
        words.append(_runs(term.values))
    shown = {"term", "scale", "offset", "clip", "copies"}
    words += settings(term, but=shown | {"values"} if isinstance(term, Constant) else shown)
    return " ".join(words)


def _runs(values: list[float]) -> str:
    """Return numbers with equal ones counted: `132 x 0`."""
    runs = [(value, len(list(same))) for value, same in groupby(values)]
    return ", ".join(f"{count} x {value:g}" if count > 1 else f"{value:g}" for value, count in runs)


def _limits(term: AnyTerm, observation: ProprioObservation) -> tuple[float, float] | None:
    """Return the limits behind scale and offset; None for lists of scales, and without any."""
    if observation.clip is not None:
        return observation.clip
    if term.clip is None or isinstance(term.scale, list):
        return None
    low, high = sorted(value * term.scale + term.offset for value in term.clip)
    return (low, high)
