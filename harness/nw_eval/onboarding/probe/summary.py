"""A card in lines of text: what the policy sees, what its actions mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards import Card, JointControl, load_card
from nw_eval.cards.joints import short_name
from nw_eval.cards.networks import Inputs, input_parts
from nw_eval.cards.observations import AnyObservation
from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.onboarding.probe.parts import parts_of
from nw_eval.onboarding.probe.report import aligned
from nw_eval.onboarding.variants.motors import motor_values
from nw_eval.onboarding.variants.written import flow, settings
from nw_eval.policies import load_bundle
from nw_eval.policies.bundle import Weights
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.sensors import check_card

_MORE = ("options", "output", "recurrent")
_MOTOR = ("torque_limits", "armature", "friction_loss")


def card_summary(path: Path, *, checkpoint: Path | None = None, allow_code: bool = False) -> str:
    """Return what a card says, as lines of text. The checkpoint that it names may be missing.

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
    rows = [("observation", "term", "numbers", "as", "sampled")]
    for part in parts_of(card, robot, specs):
        spec = next(spec for spec in specs if spec.name == part.observation)
        size = f"{len(part.indices)}"
        if part.steps > 1:
            size += f" ({part.steps} frames)"
        elif len(spec.shape) > 1:
            size = " x ".join(str(side) for side in spec.shape)
        rows.append((part.observation, part.kind, size, part.form, f"{spec.rate} Hz"))
    about = [
        f"  {clean(f'{spec.reckoning}{_settings(card.observations[spec.name])}')}" for spec in specs
    ]
    lines = [
        f"{card.name}: {card.title}" if card.title else card.name,
        f"card        {clean(path)}",
        f"licence     {card.licence or 'not stated'}",
        f"robot       {card.robot}",
        f"adapter     {card.adapter}",
        *(f"{key:10}  {clean(words)}" for key, words in _weights(card, path, checkpoint)),
        f"command     {_command(card)}",
        *(f"{key:10}  {clean(flow(value))}" for key in _MORE if (value := getattr(card, key))),
        "",
        *aligned(rows, right=set()),
        *about,
        "",
        *_inputs(card),
        *_actions(card, robot),
    ]
    return "\n".join(line.rstrip() for line in lines)


def _weights(card: Card, path: Path, checkpoint: Path | None) -> list[tuple[str, str]]:
    """Return what to say of the checkpoint, and of each network that feeds it."""
    try:
        bundle = load_bundle(path, checkpoint=checkpoint)
    except PolicyError as error:
        if checkpoint is not None or card.checkpoint is None:
            raise
        own = f"{card.checkpoint.file}: not usable: {error}"
        named = card.networks.items()
        return [("checkpoint", own), *(("network", f"{n}: {f.checkpoint.file}") for n, f in named)]
    words = "none"
    if bundle.checkpoint is not None and card.checkpoint is not None:
        own = Weights(bundle.checkpoint, bundle.checkpoint_sha256)
        words = _file(own, checkpoint or card.checkpoint.file)
        expected = card.checkpoint.sha256 or own.sha256
        if expected != own.sha256:
            words += f", not the card's {expected[:16]}"
    rows = [("checkpoint", words)]
    for name, weights in bundle.networks.items():
        network = card.networks[name]
        words = f"{_file(weights, network.checkpoint.file)}, {network.adapter}"
        rows.append(("network", f"{name}: {words}, {network.rate or card.control.rate} Hz"))
    return rows


def _file(weights: Weights, name: str | Path) -> str:
    size = weights.path.stat().st_size
    return f"{name}, {size / 1e6:.2f} MB, SHA-256 {weights.sha256[:16]}"


def _command(card: Card) -> str:
    fields = card.command.model_dump(exclude={"source"})
    words = ", ".join(f"{key} {flow(value)}" for key, value in fields.items())
    return f"{card.command.source} ({words})"


def _settings(observation: AnyObservation) -> str:
    """Return what is not by default; terms and rates stand in the table."""
    words = settings(observation, but={"sensor", "layout", "terms", "rate"})
    return f"; {', '.join(words)}" if words else ""


def _inputs(card: Card) -> list[str]:
    lines: list[str] = []
    for name, network in card.networks.items():
        lines += _made_of(f"{name}: ", network.inputs)
        for part, output in (network.outputs or {}).items():
            lines.append(f"{name}: gives {part}: {', '.join(settings(output)) or 'all of it'}")
    if card.inputs is not None:
        lines += _made_of("", card.inputs)
    return [*lines, ""] if lines else []


def _made_of(prefix: str, inputs: Inputs) -> list[str]:
    return [
        f"{prefix}input{'' if name is None else f' {name}'} = {' | '.join(parts)}"
        for name, parts in input_parts(inputs)
    ]


def _actions(card: Card, robot: RobotSpec) -> list[str]:
    control = card.control
    joints = JointControl.from_card(card, robot)
    motors = motor_values(card, robot)
    rows: list[tuple[str, ...]] = [
        ("joint", "default", "scale", "kp", "kd", "torque limit", "armature", "friction loss")
    ]
    for place, index in enumerate(joints.order.tolist()):
        rows.append(
            (
                short_name(robot.joints[index]),
                f"{joints.default_pose[place]:zg}",
                f"{joints.scale[place]:g}",
                "" if control.action == "joint_torque" else _number(motors["kp"], index),
                _number(motors["kd"], index),
                *(_number(motors[key], index) for key in _MOTOR),
            )
        )
    words = [control.action]
    if control.clip is not None:
        words.append(f"limited to {control.clip[0]:g}..{control.clip[1]:g}")
    words.append(f"{control.rate} Hz")
    if control.delay_steps:
        words.append(f"delayed by {control.delay_steps}")
    if control.filter is not None:
        words.append(f"filter {flow(control.filter)}")
    words.append(f"physics at {control.physics_rate} Hz")
    return [
        f"actions: {', '.join(words)}",
        *aligned(rows, right={1, 2, 3, 4, 5, 6, 7}),
    ]


def _number(values: NDArray[np.float64], index: int) -> str:
    return f"{values[index]:zg}"
