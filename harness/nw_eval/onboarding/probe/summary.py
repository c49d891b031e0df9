"""What a card says: what the policy sees, what its actions mean, which files it is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from nw_eval.cards import Card, JointControl, load_card, motors_follow
from nw_eval.cards.joints import short_name
from nw_eval.cards.networks import Inputs, input_parts, listed_inputs
from nw_eval.errors import PolicyError
from nw_eval.onboarding.notation import flow, settings
from nw_eval.onboarding.probe.hypotheses import motor_values
from nw_eval.onboarding.probe.parts import parts_of
from nw_eval.policies import load_bundle
from nw_eval.policies.bundle import Weights
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.sensors import ObservationSpec, check_card


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
    found: list[CardFile] = []
    if bundle.checkpoint is not None and card.checkpoint is not None:
        own = Weights(bundle.checkpoint, bundle.checkpoint_sha256)
        found.append(_file(card, "", own, str(chosen or card.checkpoint.file)))
    for name, weights in bundle.networks.items():
        found.append(_file(card, name, weights, card.networks[name].checkpoint.file))
    return tuple(found)


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
    words = ", ".join(f"{key} {flow(value)}" for key, value in fields.items())
    return f"{card.command.source} ({words})"


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
