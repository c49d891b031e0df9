"""The `control` part of a draft: what actions mean, and the motors that they drive."""

from __future__ import annotations

from collections.abc import Sequence

from nw_eval.cards.joints import short_name
from nw_eval.onboarding.drafting.frames import Frame
from nw_eval.onboarding.reading.exporter import ExporterMetadata
from nw_eval.onboarding.reading.text import CHECK, number, per_joint
from nw_eval.robots import RobotSpec


def control_lines(
    exporter: ExporterMetadata | None, robot: RobotSpec, frame: Frame | None
) -> list[str]:
    """Return the lines of `control`.

    Args:
        exporter: what the file says.
        robot: whose own values stand where nobody says anything.
        frame: the layout of what the policy sees, if it is guessed: its training says the rest.
    """
    known = exporter or ExporterMetadata()
    theirs = published(frame, robot) if frame else {}
    of = f"{CHECK} as {frame.name};" if frame else CHECK
    lines = [
        "control:",
        f"  rate: 50  {CHECK} actions per second of the training",
        f"  action: joint_position_offset  {CHECK} target = default_pose + scale * action",
    ]
    if known.action_scale:
        lines.append(f"  scale: {per_joint(known.action_scale)}")
    else:
        lines.append(f"  scale: {theirs.get('scale', '0.25')}  {of} rad for each unit of action")
    if "clip" in theirs:
        lines.append(f"  clip: {theirs['clip']}  {of} limits of actions, before scaling")
    lines += _joints(known, robot, frame)
    if known.default_joint_pos:
        lines.append(f"  default_pose: {per_joint(known.default_joint_pos)}")
    elif "default_pose" in theirs:
        lines.append(f"  default_pose: {theirs['default_pose']}  {of} rad")
    else:
        pose = _by_joint(robot, robot.default_pose)
        lines.append(f"  # default_pose: {pose}  {CHECK} the {robot.name}'s own is used")
    for name, values, own in (
        ("kp", known.joint_stiffness, robot.kp),
        ("kd", known.joint_damping, robot.joint_damping),
    ):
        if values:
            lines.append(f"  {name}: {per_joint(values)}")
        elif name in theirs:
            note = f"{of} the {robot.name}'s own is {number(own)}"
            lines.append(f"  {name}: {theirs[name]}  {note}")
        else:
            lines.append(f"  {name}: {number(own)}  {CHECK} the {robot.name}'s own")
    if known.default_joint_pos or known.joint_stiffness:
        lines.append("  # The exporter rounds these numbers to three decimals.")
    for name, own, unit in (
        ("torque_limits", _by_joint(robot, robot.torque_limits), "N m"),
        ("armature", number(robot.armature), "kg m^2"),
        ("friction_loss", number(robot.friction_loss), "N m"),
    ):
        note = f"{unit}; not in the file: the {robot.name}'s own is used"
        lines.append(f"  # {name}: {own}  {CHECK} {note}")
    late = theirs.get("delay_steps", "0")
    lines.append(f"  delay_steps: {late}  {CHECK} control steps between an action and its effect")
    return lines


def published(frame: Frame, robot: RobotSpec) -> dict[str, str]:
    """Return what a layout's training says of actions and motors, as a card writes it."""
    joints = frame.joints or [short_name(joint) for joint in robot.joints]
    values = {"scale": frame.scale, "joints": f"[{', '.join(joints)}]"}
    if frame.clip is not None:
        values["clip"] = number(frame.clip)
    if frame.pose is not None:
        values["default_pose"] = frame.pose
    if frame.gains is not None:
        values["kp"], values["kd"] = map(number, frame.gains)
    if frame.delay:
        values["delay_steps"] = str(frame.delay)
    return values


def _joints(known: ExporterMetadata, robot: RobotSpec, frame: Frame | None) -> list[str]:
    own = [short_name(joint) for joint in robot.joints]
    names = [short_name(name) for name in known.joint_names]
    if names and sorted(names) == sorted(own):
        return [f"  joints: [{', '.join(names)}]"]
    if names:
        return [
            f"  # The file names the joints {', '.join(known.joint_names)[:400]}",
            f"  joints: [{', '.join(own)}]  {CHECK} they are not the {robot.name}'s",
        ]
    if frame is not None and frame.joints:
        return [f"  joints: {published(frame, robot)['joints']}  {CHECK} as {frame.name}"]
    return [f"  joints: [{', '.join(own)}]  {CHECK} the order of the checkpoint"]


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
