"""What a card says: what the policy sees, what its actions mean, which files it is made of.

And which numbers of an observation come from which of its terms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PolicyError
from nw_policies import load_bundle
from nw_policies.bundle import Weights
from nw_policies.cards import Card, JointControl, load_card, motors_follow
from nw_policies.cards.joints import short_name
from nw_policies.cards.networks import Inputs, input_parts, listed_inputs
from nw_policies.cards.observations import AnyObservation, ProprioObservation
from nw_policies.cards.terms import AnyTerm, Constant, term_size
from nw_policies.drafting.notation import flow, settings
from nw_scenes.robots import RobotSpec, get_robot
from nw_sim.probe.hypotheses import motor_values
from nw_sim.sensors import ObservationSpec, check_card
from nw_sim.sensors.proprio import Proprio, fixed_values
from nw_sim.sensors.sensor import Shot


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
            parts += _parts_of(spec.name, observation, card, robot)
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


def _parts_of(
    name: str, observation: ProprioObservation, card: Card, robot: RobotSpec
) -> list[Part]:
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


@dataclass(frozen=True, kw_only=True)
class CardTerm:
    """A term of an observation, or a whole one without terms."""

    observation: str
    term: str
    numbers: int
    frames: int
    """Of a history, that they fill; 1 without one."""
    shape: tuple[int, ...]
    """Of the observation."""
    form: str
    """Scale, offset and limits as the card has them; empty where nothing is changed."""
    rate: float
    """Hz."""


@dataclass(frozen=True, kw_only=True)
class CardObservation:
    """An observation: how its shape comes about, and what of it is not by default."""

    name: str
    reckoning: str
    """`48 = 3 + 3 + 3 + ...`."""
    settings: tuple[str, ...]
    """`key value` in the card's notation."""


@dataclass(frozen=True, kw_only=True)
class CardFile:
    """A file of weights that a card names."""

    network: str
    """Which network of the card it is; empty for the policy's own."""
    file: str
    adapter: str
    rate: float
    """Hz at which it is asked."""
    bytes: int = 0
    sha256: str = ""
    """Hex; empty for a file that cannot be used."""
    declared: str = ""
    """The digest that the card says, if it is another one."""
    problem: str | None = None
    """Why it cannot be used."""


@dataclass(frozen=True, kw_only=True)
class CardJoint:
    """A joint as the policy drives it. Angles in rad, torques in N m."""

    joint: str
    default: float
    scale: float
    kp: float | None
    """None where actions are torques."""
    kd: float
    torque_limit: float
    armature: float
    friction_loss: float


@dataclass(frozen=True, kw_only=True)
class CardSummary:
    """A card, and what follows from it for its robot. Short words are in the card's notation."""

    path: Path
    card: Card
    command: str
    """Its source, and all of its settings."""
    options: Mapping[str, str]
    """`options`, `output` and `recurrent`, where the card has them."""
    files: tuple[CardFile, ...]
    """The policy's own first; none for a policy without weights."""
    terms: tuple[CardTerm, ...]
    observations: tuple[CardObservation, ...]
    inputs: tuple[str, ...]
    """What the checkpoint and the networks are given: `input proprio = body | depth`."""
    action: tuple[str, ...]
    """What an action means: its kind, limits, rate, delay and filter."""
    joints: tuple[CardJoint, ...]
    """In the policy's order."""


def card_summary(
    path: Path, *, checkpoint: Path | None = None, allow_code: bool = False
) -> CardSummary:
    """Return what a card says. The checkpoint that it names may be missing.

    Args:
        path: the card.
        checkpoint: weights to use with the card.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        PolicyError: the card has problems, alone or with its robot; `checkpoint` cannot be used.
    """
    card = load_card(path)
    robot = get_robot(card.robot)
    specs = check_card(card, robot, where=path, code_from=path.parent if allow_code else None)
    return CardSummary(
        path=path,
        card=card,
        command=_command(card),
        options={
            key: flow(value)
            for key in ("options", "output", "recurrent")
            if (value := getattr(card, key))
        }
        | (
            {"cameras": flow({k: v.model_dump(exclude_defaults=True) for k, v in cameras.items()})}
            if (cameras := card.cameras)
            else {}
        ),
        files=_files(card, path, checkpoint),
        terms=_terms(card, robot, specs),
        observations=tuple(_observation(card, spec) for spec in specs),
        inputs=tuple(_inputs(card)),
        action=_action(card),
        joints=_joints(card, robot),
    )


def _terms(
    card: Card, robot: RobotSpec, specs: tuple[ObservationSpec, ...]
) -> tuple[CardTerm, ...]:
    by_name = {spec.name: spec for spec in specs}
    return tuple(
        CardTerm(
            observation=part.observation,
            term=part.kind,
            numbers=len(part.indices),
            frames=part.steps,
            shape=by_name[part.observation].shape,
            form=part.form,
            rate=by_name[part.observation].rate,
        )
        for part in parts_of(card, robot, specs)
    )


def _observation(card: Card, spec: ObservationSpec) -> CardObservation:
    # Terms and rates are told apart.
    own = settings(card.observations[spec.name], but={"sensor", "layout", "terms", "rate"})
    return CardObservation(name=spec.name, reckoning=spec.reckoning, settings=tuple(own))


def _files(card: Card, path: Path, chosen: Path | None) -> tuple[CardFile, ...]:
    """Return the checkpoint's file, and that of each network that feeds it."""
    try:
        bundle = load_bundle(path, checkpoint=chosen)
    except PolicyError as error:
        if chosen is not None or card.checkpoint is None:
            raise
        own = _file(card, "", None, card.checkpoint.file, problem=str(error))
        fed = card.networks.items()
        return (own, *(_file(card, name, None, network.checkpoint.file) for name, network in fed))
    files: list[CardFile] = []
    if bundle.checkpoint is not None and card.checkpoint is not None:
        own = Weights(bundle.checkpoint, bundle.checkpoint_sha256)
        files.append(_file(card, "", own, str(chosen or card.checkpoint.file)))
    for name, weights in bundle.networks.items():
        files.append(_file(card, name, weights, card.networks[name].checkpoint.file))
    return tuple(files)


def _file(
    card: Card, network: str, weights: Weights | None, file: str, problem: str | None = None
) -> CardFile:
    part = card.networks[network] if network else card
    rate = card.networks[network].rate if network else None
    declared = None if part.checkpoint is None else part.checkpoint.sha256
    is_other = weights is not None and declared is not None and declared != weights.sha256
    return CardFile(
        network=network,
        file=file,
        adapter=part.adapter,
        rate=rate or card.control.rate,
        bytes=0 if weights is None else weights.path.stat().st_size,
        sha256="" if weights is None else weights.sha256,
        declared=declared if is_other and declared is not None else "",
        problem=problem,
    )


def _command(card: Card) -> str:
    fields = card.command.model_dump(exclude={"source"})
    text = ", ".join(f"{key} {flow(value)}" for key, value in fields.items())
    return f"{card.command.source} ({text})"


def _inputs(card: Card) -> list[str]:
    lines: list[str] = []
    for name, network in card.networks.items():
        lines += _made_of(f"{name}: ", network.inputs)
        for part, output in (network.outputs or {}).items():
            lines.append(f"{name}: gives {part}: {', '.join(settings(output)) or 'all of it'}")
    if card.inputs is not None:
        lines += _made_of("", card.inputs)
    return lines


def _made_of(prefix: str, inputs: Inputs) -> list[str]:
    listed = listed_inputs(inputs)
    return [
        f"{prefix}input{'' if name is None else f' {name}'} = "
        + (f"list of {', '.join(parts)}" if name in listed else " | ".join(parts))
        for name, parts in input_parts(inputs)
    ]


def _action(card: Card) -> tuple[str, ...]:
    control = card.control
    words = [control.action if isinstance(control.action, str) else flow(control.action)]
    if control.clip is not None:
        words.append(f"limited to {control.clip[0]:g}..{control.clip[1]:g}")
    words.append(f"{control.rate} Hz")
    if control.delay_steps:
        words.append(f"delayed by {control.delay_steps}")
    if control.filter is not None:
        words.append(f"filter {flow(control.filter)}")
    words.append(f"physics at {control.physics_rate} Hz")
    return tuple(words)


def _joints(card: Card, robot: RobotSpec) -> tuple[CardJoint, ...]:
    control = JointControl.from_card(card, robot)
    motors = motor_values(card, robot)
    has_gains = [follow == "position" for follow in motors_follow(card, robot)]
    return tuple(
        CardJoint(
            joint=short_name(robot.joints[index]),
            default=float(control.default_pose[place]),
            scale=float(control.scale[place]),
            kp=float(motors["kp"][index]) if has_gains[index] else None,
            kd=float(motors["kd"][index]),
            torque_limit=float(motors["torque_limits"][index]),
            armature=float(motors["armature"][index]),
            friction_loss=float(motors["friction_loss"][index]),
        )
        for place, index in enumerate(control.order.tolist())
    )
