"""The `control` part of a draft: what actions mean, and the motors that they drive."""

from __future__ import annotations

from collections.abc import Sequence

from nw_eval.policies.inspect.exporter import ExporterMetadata
from nw_eval.policies.inspect.guesses import FrameGuess
from nw_eval.policies.inspect.text import CHECK, number, per_joint
from nw_eval.policies.joints import short_name
from nw_eval.robots import RobotSpec


def control_lines(
    exporter: ExporterMetadata | None, robot: RobotSpec, guesses: Sequence[FrameGuess]
) -> list[str]:
    """Return the lines of `control`.

    Args:
        exporter: what the file says.
        robot: whose own values stand where the file says nothing.
        guesses: who may have laid out what the policy sees, and so ordered its joints.
    """
    known = exporter or ExporterMetadata()
    lines = [
        "control:",
        f"  rate: 50  {CHECK} actions per second of the training",
        f"  action: joint_position_offset  {CHECK} target = default_pose + scale * action",
    ]
    if known.action_scale:
        lines.append(f"  scale: {per_joint(known.action_scale)}")
    else:
        lines.append(f"  scale: 0.25  {CHECK} rad for each unit of action")
    lines += _joints(known, robot, guesses)
    if known.default_joint_pos:
        lines.append(f"  default_pose: {per_joint(known.default_joint_pos)}")
    else:
        pose = _by_joint(robot, robot.default_pose)
        lines.append(f"  # default_pose: {pose}  {CHECK} the {robot.name}'s own is used")
    for name, values, own in (
        ("kp", known.joint_stiffness, robot.kp),
        ("kd", known.joint_damping, robot.joint_damping),
    ):
        if values:
            lines.append(f"  {name}: {per_joint(values)}")
        else:
            lines.append(f"  {name}: {number(own)}  {CHECK} the {robot.name}'s own")
    if known.default_joint_pos or known.joint_stiffness:
        lines.append("  # The exporter rounds these numbers to three decimals.")
    for name, own, unit in (
        ("torque_limits", _by_joint(robot, robot.torque_limits), "N m"),
        ("armature", number(robot.armature), "kg m^2"),
        ("friction_loss", number(robot.friction_loss), "N m"),
    ):
        said = f"{unit}; not in the file: the {robot.name}'s own is used"
        lines.append(f"  # {name}: {own}  {CHECK} {said}")
    lines.append(f"  delay_steps: 0  {CHECK} control steps between an action and its effect")
    return lines


def _joints(known: ExporterMetadata, robot: RobotSpec, guesses: Sequence[FrameGuess]) -> list[str]:
    own = [short_name(joint) for joint in robot.joints]
    names = [short_name(name) for name in known.joint_names]
    if names and sorted(names) == sorted(own):
        return [f"  joints: [{', '.join(names)}]"]
    if names:
        return [
            f"  # The file names the joints {', '.join(known.joint_names)[:400]}",
            f"  joints: [{', '.join(own)}]  {CHECK} they are not the {robot.name}'s",
        ]
    others = list(dict.fromkeys(guess.joints for guess in guesses if guess.joints))
    ask = "the order of the checkpoint" + (": this one, or one of these" if others else "")
    lines = [f"  joints: [{', '.join(own)}]  {CHECK} {ask}"]
    for order in others:
        who = ", ".join(dict.fromkeys(g.source for g in guesses if g.joints == order))
        lines.append(f"  # {who}: [{', '.join(order)}]")
    return lines


def _by_joint(robot: RobotSpec, values: Sequence[float]) -> str:
    """Return values as a mapping, by the kind of joint where that says it all."""
    names = [short_name(joint) for joint in robot.joints]
    kinds = [name.rpartition("_")[2] for name in names]
    by_kind = dict(zip(kinds, values, strict=True))
    if all(by_kind[kind] == value for kind, value in zip(kinds, values, strict=True)):
        pairs = by_kind.items()
    else:
        pairs = zip(names, values, strict=True)
    return f"{{{', '.join(f'{name}: {number(value)}' for name, value in pairs)}}}"
