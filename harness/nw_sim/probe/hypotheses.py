"""What else a card might have meant: cards that differ from it in one respect.

Other scales, orders and signs of joints, other histories and terms, other motors: pose, gains,
rate, latency, meaning of actions, robot. What a card forgets there is the robot's own or usual, and
not always what a policy was trained on.

Where another stack counts a joint's angle the other way round, its numbers have the other sign in
the targets, in the observations and in the default pose. A card says so with a negative
`control.scale`, and with a negative `scale` of the terms `joint_pos` and `joint_vel`; its
`default_pose` is in the robot's own directions.

A change of terms is made in every observation of the card that lists terms: what a stack does with
a number, it does everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import chain, combinations, product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PolicyError
from nw_policies.cards import Card, JointControl, actuator_values
from nw_policies.cards.joints import all_joints, joint_order, joint_values, short_name
from nw_policies.cards.model import CONTROL_RATE
from nw_policies.cards.observations import AnyObservation, ProprioObservation
from nw_policies.cards.terms import (
    AngularVelocity,
    AnyTerm,
    JointPosition,
    JointVelocity,
    LinearVelocity,
    term_size,
)
from nw_policies.drafting.notation import changed_lines, flow, listed, per_joint
from nw_scenes.robots import BUILT_IN, RobotSpec, get_robot

TRIED = (
    "orders, signs and scales of joints, history, scales, signs, frames and order of terms, "
    "meaning, rate and delay of actions, poses, gains, the other robots, orders with scales"
)
"""What is changed, in words."""
_LEGS = {4: ((0, 1, 2, 3), (1, 0, 3, 2), (2, 3, 0, 1), (3, 2, 1, 0)), 2: ((0, 1), (1, 0))}
"""Orders of the legs, by how many there are, as places in the robot's own order."""


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """One change of a card, in words."""

    words: str
    card: Card

    def advice(self, card: Card) -> str:
        """Say what to write on the card that it changes, each key on a line of its own."""
        lines = "".join(f"\n    {line}" for line in changed_lines(card, self.card))
        return f"with {self.words}; if trained that way, write{lines}"


_POSES = {
    "legged_gym": (0.1, 0.8, 1.0, -1.5),
    "MuJoCo Playground": (-0.1, 0.9, 0.9, -1.8),
    "MuJoCo Menagerie": (0.0, 0.9, 0.9, -1.8),
    "Unitree": (0.0, 0.67, 0.67, -1.3),
}
"""Hips outwards, front thighs, rear thighs and calves, rad."""
_GAIN_FACTORS = (2.0, 0.5, 4.0, 0.25)
_RATES = (CONTROL_RATE, CONTROL_RATE // 2)  # Hz
_DELAYS = (0, 1, 2)
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
_TURNED_IN: tuple[tuple[_Place, ...], ...] = (
    ("targets", "observations"),
    ("targets",),
    ("observations",),
    ("targets", "observations", "default pose"),
    ("default pose",),
)
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


def hypotheses(card: Card, robot: RobotSpec) -> Iterator[Hypothesis]:
    """Yield the changes of one thing that are worth a try, likely ones first."""
    yield from _possible(
        robot,
        *scaled_terms(card),
        *_orders(card, robot),
        *_histories(card, "order"),
        *turned_terms(card),
        *scaled_cards(card, robot),
        *turned_cards(card, robot),
        *absolute_terms(card),
        *swapped_terms(card, all_joints(card.control.joints, card.control.held, robot.joints)),
        *moved_terms(card),
        *framed_terms(card),
        *other_velocities(card),
        *other_controls(card, robot),
        *_histories(card, "by"),
    )


def scale_hypotheses(card: Card, robot: RobotSpec) -> Iterator[Hypothesis]:
    """Yield other scales of the action only: what a policy that follows, but weakly, may miss."""
    yield from _possible(robot, *scaled_cards(card, robot))


def double_hypotheses(card: Card, robot: RobotSpec) -> Iterator[Hypothesis]:
    """Yield changes of two things that newcomers from one stack to another forget together."""
    for order, ordered in _orders(card, robot):
        scaled = scaled_terms(ordered, some=False)
        yield from _possible(robot, *((f"{order}, and {scales}", both) for scales, both in scaled))


def _possible(robot: RobotSpec, *changes: tuple[str, Card]) -> Iterator[Hypothesis]:
    """Yield those with which the robot can stand.

    A robot that cannot take its default pose was trained in no stack.
    """
    for words, changed in changes:
        if _can_stand(changed, robot if changed.robot == robot.name else get_robot(changed.robot)):
            yield Hypothesis(words=words, card=changed)


def _can_stand(card: Card, robot: RobotSpec) -> bool:
    joints = JointControl.from_card(card, robot)
    ranges = np.array(robot.joint_ranges)[joints.order]
    return bool(
        ((ranges[:, 0] <= joints.default_pose) & (joints.default_pose <= ranges[:, 1])).all()
    )


def _orders(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    """Yield cards with other orders of joints.

    Robots name joints by leg and kind: FR_hip, left_knee. Where all legs have the same kinds, legs
    change places, and joints go leg by leg or kind by kind; else joints are sorted by name, as
    Isaac Gym sorts them.
    """
    held = card.control.held

    def order(joints: list[str] | None) -> list[int]:
        return joint_order(all_joints(joints, held, robot.joints), robot.joints).tolist()

    own = order(card.control.joints)
    named = card.control.joints if held is not None else None
    names = [short_name(joint) for joint in named or robot.joints]
    pairs = [tuple(name.split("_", 1)) for name in names]
    legs, kinds = (list(dict.fromkeys(pair[end] for pair in pairs)) for end in (0, -1))
    orders: list[tuple[str, list[str]]] = []
    if set(product(legs, kinds)) == set(pairs):
        for places, by_leg in product(_LEGS.get(len(legs), ()), (True, False)):
            turned = [legs[place] for place in places]
            both = product(turned, kinds)
            joints = [f"{leg}_{kind}" for leg, kind in both]
            if not by_leg:
                joints = [f"{leg}_{kind}" for kind, leg in product(kinds, turned)]
            how = "leg by leg" if by_leg else f"all {', then all '.join(map(_plural, kinds))}"
            orders.append((f"the joints in the order {' '.join(turned)}, {how}", joints))
    else:
        orders.append(("the joints sorted by name", sorted(names)))
    for words, joints in orders:
        if order(joints) != own:
            yield words, _with_control(card, joints=joints)


def _plural(kind: str) -> str:
    return "calves" if kind == "calf" else f"{kind}s"


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
        text = f"`{name}` with {key}: {value}"
        yield text, card.model_copy(update={"observations": observations})


def turned_cards(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    """Yield cards some of whose joints count the other way round, and what they are in words."""
    for group, patterns in _GROUPS.items():
        for places in _TURNED_IN:
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
    """Return (J,) in the policy's order: `factor` for joints that a pattern names, else 1."""
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
        observations = {
            name: _turned_observation(value, factors) for name, value in observations.items()
        }
    changed = {"control": card.control.model_copy(update=control), "observations": observations}
    return card.model_copy(update=changed)


def _turned_observation(
    observation: AnyObservation, factors: NDArray[np.float64]
) -> AnyObservation:
    if not isinstance(observation, ProprioObservation):
        return observation
    terms = [_turned_term(term, factors) for term in observation.frame_terms]
    if terms == list(observation.frame_terms):
        return observation
    return observation.model_copy(update={"layout": None, "terms": terms})


def _turned_term(term: AnyTerm, factors: NDArray[np.float64]) -> AnyTerm:
    if not isinstance(term, JointPosition | JointVelocity):
        return term
    scale: list[float] = (np.broadcast_to(term.scale, factors.shape) * factors).tolist()
    return term.model_copy(update={"scale": scale[0] if len(set(scale)) == 1 else scale})


def other_controls(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    """Yield cards with other motors, and what they are in words."""
    yield from _meanings(card)
    yield from _poses(card, robot)
    yield from _gains(card, robot)
    yield from _rates(card)
    for steps in _DELAYS:
        if steps != card.control.delay_steps:
            yield f"actions delayed by {steps}", _with_control(card, delay_steps=steps)
    yield from _robots(card)


def _meanings(card: Card) -> Iterator[tuple[str, Card]]:
    own, others = card.control.action, ("joint_position", "joint_position_offset")
    if isinstance(own, str) and own in others:
        other = others[1 - others.index(own)]
        yield f"actions that are {other}", _with_control(card, action=other)


def _poses(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    names = joint_names(card, robot)
    own = JointControl.from_card(card, robot).default_pose
    for whose, (hip, front, rear, calf) in _POSES.items():
        by_kind = {"hip": hip, "thigh": rear, "F?_thigh": front, "calf": calf}
        right = {"FR_hip": -hip, "RR_hip": -hip}
        try:
            pose = joint_values(by_kind | right, names)
        except PolicyError:
            return  # It has other joints.
        if not np.array_equal(pose, own):
            text = f"{whose}'s default pose"
            yield text, _with_control(card, default_pose=per_joint(names, pose.tolist()))


def _gains(card: Card, robot: RobotSpec) -> Iterator[tuple[str, Card]]:
    names, order = joint_names(card, robot), JointControl.from_card(card, robot).order
    motors = motor_values(card, robot)
    own = {"kp": np.array(robot.kp), "kd": np.array(robot.joint_damping)}
    if card.control.has_torques:
        return
    if any((motors[key] != value).any() for key, value in own.items()):
        gains = {key: per_joint(names, value[order].tolist()) for key, value in own.items()}
        yield "the robot's own gains", _with_control(card, **gains)
    for which in (("kp", "kd"), ("kp",), ("kd",)):
        for factor in _GAIN_FACTORS:
            new = {key: per_joint(names, (motors[key][order] * factor).tolist()) for key in which}
            words = [f"{key} {flow(value)}" for key, value in new.items()]
            yield listed(words), _with_control(card, **new)
    doubled = per_joint(names, (motors["torque_limits"][order] * 2.0).tolist())
    yield "torque limits doubled", _with_control(card, torque_limits=doubled)


def _rates(card: Card) -> Iterator[tuple[str, Card]]:
    own = card.control.rate
    for rate in _RATES:
        if rate == own:
            continue
        # What was sampled whenever the policy acts still is.
        observations = {
            name: observation.model_copy(update={"rate": rate})
            if observation.rate == own
            else observation
            for name, observation in card.observations.items()
        }
        other = _with_control(card, rate=rate).model_copy(update={"observations": observations})
        yield f"a rate of {rate} Hz", other


def _robots(card: Card) -> Iterator[tuple[str, Card]]:
    for name in BUILT_IN:
        other = card.model_copy(update={"robot": name})
        try:
            JointControl.from_card(other, get_robot(name))
        except PolicyError:
            continue  # It has other joints.
        if name != card.robot:
            yield f"{name} for a robot", other


def _with_control(card: Card, **changes: Any) -> Card:
    return card.model_copy(update={"control": card.control.model_copy(update=changes)})


def motor_values(card: Card, robot: RobotSpec) -> dict[str, NDArray[np.float64]]:
    """Return kp, kd, torque_limits, armature and friction_loss: (J,) each, in the robot's order.

    Raises:
        PolicyError: they do not fit the robot.
    """
    return actuator_values(card, robot) or {
        "kp": np.array(robot.kp),
        "kd": np.array(robot.joint_damping),
        "torque_limits": np.array(robot.torque_limits),
        "armature": np.array(robot.armature),
        "friction_loss": np.array(robot.friction_loss),
    }


def joint_names(card: Card, robot: RobotSpec) -> list[str]:
    """Return the short names of the joints in the policy's order."""
    return [short_name(robot.joints[i]) for i in JointControl.from_card(card, robot).order]


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
                scales = {name: {"scale": wanted[name]} for name in names}
                words = [f"`{name}` {flow(wanted[name])}" for name in names]
                yield f"the scale of {listed(words)}", _with_changes(card, scales)


def turned_terms(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield cards in which a term, or a side of the command, has the other sign."""
    for name, term in {term.term: term for term in _terms(card)}.items():
        if name in _SIGNED and isinstance(term.scale, float):
            turned = {name: {"scale": -term.scale}}
            yield f"the sign of `{name}` reversed", _with_changes(card, turned)
        elif name == "command":
            x, y, yaw = term.scale if isinstance(term.scale, list) else [term.scale] * 3
            for scale in ([x, -y, yaw], [x, y, -yaw], [x, -y, -yaw]):
                text = "the sign of a part of `command` reversed"
                yield text, _with_changes(card, {name: {"scale": scale}})


def absolute_terms(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield the card whose joint positions are counted from the other place."""
    own = [term.relative for term in _terms(card) if isinstance(term, JointPosition)]
    if own:
        relative = not own[0]
        counted = "from `default_pose`" if relative else "from 0"
        text = f"`joint_pos` counted {counted}"
        yield text, _with_changes(card, {"joint_pos": {"relative": relative}})


def framed_terms(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield cards whose velocities are along other axes."""
    terms = {term.term: term for term in _terms(card)}
    for name, term in terms.items():
        if isinstance(term, AngularVelocity | LinearVelocity):
            frames = ("trunk", "world") if name == "ang_vel" else ("trunk", "world", "yaw")
            for frame in frames:
                if frame != term.frame:
                    text = f"`{name}` along the axes of the {frame}"
                    yield text, _with_changes(card, {name: {"frame": frame}})


def other_velocities(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield cards with the angular velocity in the linear one's place, or the other way round."""
    known = {term.term for term in _terms(card)}
    for observation, own in _listed_terms(card):
        names = [term.term for term in own]
        for index, term in enumerate(own):
            if term.term not in _VELOCITIES or (other := _OTHER[term.term]) in known:
                continue
            shared = term.model_dump(include={"scale", "offset", "clip"}, exclude_defaults=True)
            terms = list(own)
            terms[index] = _VELOCITIES[other].model_validate({"term": other, **shared})
            which = ""
            if names.count(term.term) > 1:
                which = "the second " if term.term in names[:index] else "the first "
            text = f"`{other}` instead of {which}`{term.term}` in `{observation}`"
            yield text, _with_terms(card, {observation: terms})


def moved_terms(card: Card) -> Iterator[tuple[str, Card]]:
    """Yield cards in which `command` stands at another position among the terms."""
    for observation, others in _listed_terms(card):
        names = [term.term for term in others]
        if names.count("command") != 1:
            continue
        term = others.pop(own := names.index("command"))
        for index in range(len(names)):
            if index != own:
                terms = [*others[:index], term, *others[index:]]
                where = f"behind `{others[index - 1].term}`" if index else "first"
                text = f"`command` {where} in `{observation}`"
                yield text, _with_terms(card, {observation: terms})


def swapped_terms(card: Card, joints: Sequence[str]) -> Iterator[tuple[str, Card]]:
    """Yield cards in which two terms of equal size are swapped, neighbours first."""
    for observation, terms in _listed_terms(card):
        pairs = sorted(combinations(range(len(terms)), 2), key=lambda pair: pair[1] - pair[0])
        for i, j in pairs:
            one, other = terms[i], terms[j]
            is_change = one.term != other.term and "constant" not in {one.term, other.term}
            if is_change and term_size(one, joints) == term_size(other, joints):
                swapped = list(terms)
                swapped[i], swapped[j] = other, one
                text = f"`{one.term}` and `{other.term}` of `{observation}` swapped"
                yield text, _with_terms(card, {observation: swapped})


def _listed_terms(card: Card) -> Iterator[tuple[str, list[AnyTerm]]]:
    """Yield the name of each observation that lists terms, and those."""
    for name, observation in card.observations.items():
        if isinstance(observation, ProprioObservation) and observation.terms is not None:
            yield name, list(observation.terms)


def _terms(card: Card) -> Iterator[AnyTerm]:
    return chain.from_iterable(terms for _, terms in _listed_terms(card))


def _with_changes(card: Card, changes: Mapping[str, Mapping[str, Any]]) -> Card:
    """Return a card with other values of keys of its terms, by the term's name."""
    return _with_terms(
        card,
        {
            name: [term.model_copy(update=changes.get(term.term, {})) for term in terms]
            for name, terms in _listed_terms(card)
        },
    )


def _with_terms(card: Card, changed: Mapping[str, list[AnyTerm]]) -> Card:
    """Return a card some of whose observations list other terms."""
    observations = {
        name: card.observations[name].model_copy(update={"terms": terms})
        for name, terms in changed.items()
    }
    return card.model_copy(update={"observations": {**card.observations, **observations}})
