"""A card in lines of text: what the policy sees, what its actions mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import PolicyError
from nw_eval.policies import Card, JointControl, actuator_values, load_bundle, load_card
from nw_eval.policies.joints import short_name
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.rollout.probe.parts import parts_of
from nw_eval.rollout.probe.report import aligned
from nw_eval.sensors import check_card


def card_summary(path: Path, *, allow_code: bool = False) -> str:
    """Return what a card says, as lines of text. Its checkpoint may be missing.

    Raises:
        PolicyError: the card has problems, alone or with its robot.
    """
    card = load_card(path)
    robot = get_robot(card.robot)
    specs = check_card(card, robot, code_from=path.parent if allow_code else None)
    rows = [("observation", "term", "numbers", "as", "sampled")]
    for part in parts_of(card, robot, specs):
        spec = next(spec for spec in specs if spec.name == part.observation)
        size = f"{len(part.indices)}"
        if part.steps > 1:
            size += f" ({part.steps} frames)"
        elif len(spec.shape) > 1:
            size = " x ".join(str(side) for side in spec.shape)
        rows.append((part.observation, part.kind, size, part.form, f"{spec.rate} Hz"))
    sums = [f"  {spec.reckoning}" for spec in specs]
    lines = [
        f"{card.name}: {card.title}" if card.title else card.name,
        f"card        {path}",
        f"licence     {card.licence or 'not said'}",
        f"robot       {card.robot}",
        f"adapter     {card.adapter}",
        f"checkpoint  {_checkpoint(card, path)}",
        f"command     {_command(card)}",
        "",
        *aligned(rows, right=set()),
        *sums,
        "",
        *_inputs(card),
        *_actions(card, robot),
    ]
    return "\n".join(line.rstrip() for line in lines)


def _checkpoint(card: Card, path: Path) -> str:
    if card.checkpoint is None:
        return "none"
    try:
        bundle = load_bundle(path)
    except PolicyError as error:
        return f"{card.checkpoint.file}: not usable: {error}"
    size = 0 if bundle.checkpoint is None else bundle.checkpoint.stat().st_size
    return f"{card.checkpoint.file}, {size / 1e6:.2f} MB, SHA-256 {bundle.checkpoint_sha256[:16]}"


def _command(card: Card) -> str:
    fields = card.command.model_dump(exclude={"source"})
    settings = ", ".join(f"{key} {value}" for key, value in fields.items())
    return f"{card.command.source} ({settings})"


def _inputs(card: Card) -> list[str]:
    if card.inputs is None:
        return []
    lines = [f"input {name} = {' | '.join(parts)}" for name, parts in card.inputs.items()]
    return [*lines, ""]


def _actions(card: Card, robot: RobotSpec) -> list[str]:
    control = card.control
    joints = JointControl.from_card(card, robot)
    motors = actuator_values(card, robot) or {
        "kp": np.full(len(robot.joints), robot.kp),
        "kd": np.full(len(robot.joints), robot.joint_damping),
        "torque_limits": np.array(robot.torque_limits),
    }
    rows = [("joint", "default", "scale", "kp", "kd", "torque limit")]
    for place, index in enumerate(joints.order.tolist()):
        rows.append(
            (
                short_name(robot.joints[index]),
                f"{joints.default_pose[place]:g}",
                f"{joints.scale[place]:g}",
                "" if control.action == "joint_torque" else _number(motors["kp"], index),
                _number(motors["kd"], index),
                _number(motors["torque_limits"], index),
            )
        )
    words = [control.action]
    if control.clip is not None:
        words.append(f"limited to {control.clip[0]:g}..{control.clip[1]:g}")
    words.append(f"{control.rate} Hz")
    if control.delay_steps:
        words.append(f"{control.delay_steps} late")
    words.append(f"physics at {control.physics_rate} Hz")
    return [
        f"actions: {', '.join(words)}",
        *aligned(rows, right={1, 2, 3, 4, 5}),
    ]


def _number(values: NDArray[np.float64], index: int) -> str:
    return f"{values[index]:g}"
