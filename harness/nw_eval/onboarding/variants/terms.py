"""The same policy whose terms have other scales, signs, another order or another meaning.

Each change is made in every observation of the card that lists terms: what a stack does with a
number, it does everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations

from nw_eval.cards import Card
from nw_eval.cards.observations import AnyObservation, ProprioObservation
from nw_eval.cards.terms import AngularVelocity, AnyTerm, JointPosition, LinearVelocity, term_size
from nw_eval.onboarding.variants.written import flow, listed

Scale = float | list[float]

_LEGGED_GYM: dict[str, Scale] = {
    "joint_vel": 0.05,
    "ang_vel": 0.25,
    "lin_vel": 2.0,
    "command": [2.0, 2.0, 0.25],
}
"""Its scales, which many stacks took over, and many others did not."""
_VELOCITIES: dict[str, type[AngularVelocity | LinearVelocity]] = {
    "ang_vel": AngularVelocity,
    "lin_vel": LinearVelocity,
}
_OTHER = {"lin_vel": "ang_vel", "ang_vel": "lin_vel"}
_SIGNED = {"gravity", "ang_vel", "delta_yaw"}


def scaled_terms(card: Card, *, some: bool = True) -> Iterator[tuple[str, Card]]:
    """Yield cards with or without the scales of legged_gym: each alone, then several together.

    Args:
        card: whose terms they are.
        some: whether those between one and all are tried too.
    """
    terms = {term.term: term for term in _terms(card)}
    known = {name: _LEGGED_GYM[name] for name in terms if name in _LEGGED_GYM}
    missing = {name: scale for name, scale in known.items() if terms[name].scale != scale}
    written: dict[str, Scale] = {name: 1.0 for name in known if terms[name].scale != 1.0}
    for count in range(1, len(known) + 1):
        for wanted in (missing, written):
            if not some and 1 < count < len(wanted):
                continue
            for names in combinations(wanted, count):
                scales = {name: wanted[name] for name in names}
                words = [f"`{name}` {flow(scale)}" for name, scale in scales.items()]
                yield f"the scale of {listed(words)}", _with_scales(card, scales)


def turned_terms(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield cards in which a term, or a side of the command, has the other sign."""
    for name, term in {term.term: term for term in _terms(card)}.items():
        if name in _SIGNED and isinstance(term.scale, float):
            yield f"the sign of `{name}` reversed", _with_scales(card, {name: -term.scale})
        elif name == "command":
            x, y, yaw = term.scale if isinstance(term.scale, list) else [term.scale] * 3
            for scale in ([x, -y, yaw], [x, y, -yaw], [x, -y, -yaw]):
                yield "the sign of a part of `command` reversed", _with_scales(card, {name: scale})


def absolute_terms(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield the card whose joint positions are counted from the other place."""
    own = [term.relative for term in _terms(card) if isinstance(term, JointPosition)]
    if own:
        relative = not own[0]
        counted = "from `default_pose`" if relative else "from 0"
        yield f"`joint_pos` counted {counted}", _changed(card, lambda term: _from(term, relative))


def framed_terms(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield cards whose velocities are along other axes."""
    found = {term.term: term for term in _terms(card)}
    for name, term in found.items():
        if isinstance(term, AngularVelocity | LinearVelocity):
            frames = ("trunk", "world") if name == "ang_vel" else ("trunk", "world", "yaw")
            for frame in frames:
                if frame != term.frame:
                    words = f"`{name}` along the axes of the {frame}"
                    yield words, _changed(card, lambda old, n=name, f=frame: _along(old, n, f))


def other_velocities(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield cards with the angular velocity in the linear one's place, or the other way round."""
    known = {term.term for term in _terms(card)}
    for name, observation in card.observations.items():
        if not isinstance(observation, ProprioObservation) or observation.terms is None:
            continue
        names = [term.term for term in observation.terms]
        for place, term in enumerate(observation.terms):
            if term.term not in _VELOCITIES or (other := _OTHER[term.term]) in known:
                continue
            shared = term.model_dump(include={"scale", "offset", "clip"}, exclude_defaults=True)
            terms = list(observation.terms)
            terms[place] = _VELOCITIES[other].model_validate({"term": other, **shared})
            changed = observation.model_copy(update={"terms": terms})
            which = ""
            if names.count(term.term) > 1:
                which = "the second " if term.term in names[:place] else "the first "
            words = f"`{other}` in place of {which}`{term.term}` in `{name}`"
            yield words, _with_observations(card, {name: changed})


def moved_terms(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield cards in which `command` stands at another place among the terms."""
    for name, observation in card.observations.items():
        if not isinstance(observation, ProprioObservation) or observation.terms is None:
            continue
        names = [term.term for term in observation.terms]
        if names.count("command") != 1:
            continue
        others = list(observation.terms)
        term = others.pop(own := names.index("command"))
        for place in range(len(names)):
            if place != own:
                terms = [*others[:place], term, *others[place:]]
                changed = observation.model_copy(update={"terms": terms})
                where = f"behind `{others[place - 1].term}`" if place else "first"
                yield f"`command` {where} in `{name}`", _with_observations(card, {name: changed})


def swapped_terms(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield cards in which two terms of equal size are exchanged, neighbours first."""
    for name, observation in card.observations.items():
        if not isinstance(observation, ProprioObservation) or observation.terms is None:
            continue
        terms = observation.terms
        pairs = sorted(combinations(range(len(terms)), 2), key=lambda pair: pair[1] - pair[0])
        for i, j in pairs:
            one, other = terms[i], terms[j]
            is_change = one.term != other.term and "constant" not in {one.term, other.term}
            if is_change and term_size(one) == term_size(other):
                swapped = list(terms)
                swapped[i], swapped[j] = other, one
                changed = observation.model_copy(update={"terms": swapped})
                words = f"`{one.term}` and `{other.term}` of `{name}` exchanged"
                yield words, _with_observations(card, {name: changed})


def _terms(card: Card) -> Iterator[AnyTerm]:
    for observation in card.observations.values():
        if isinstance(observation, ProprioObservation):
            yield from observation.terms or ()


def _with_scales(card: Card, scales: dict[str, Scale]) -> Card:
    def change(term: AnyTerm) -> AnyTerm:
        if term.term not in scales:
            return term
        return term.model_copy(update={"scale": scales[term.term]})

    return _changed(card, change)


def _along(term: AnyTerm, name: str, frame: str) -> AnyTerm:
    return term if term.term != name else term.model_copy(update={"frame": frame})


def _from(term: AnyTerm, relative: bool) -> AnyTerm:
    if not isinstance(term, JointPosition):
        return term
    return term.model_copy(update={"relative": relative})


def _changed(card: Card, change: Callable[[AnyTerm], AnyTerm]) -> Card:
    changed: dict[str, AnyObservation] = {}
    for name, observation in card.observations.items():
        if isinstance(observation, ProprioObservation) and observation.terms is not None:
            terms = [change(term) for term in observation.terms]
            changed[name] = observation.model_copy(update={"terms": terms})
    return _with_observations(card, changed)


def _with_observations(card: Card, changed: dict[str, AnyObservation]) -> Card:
    return card.model_copy(update={"observations": {**card.observations, **changed}})
