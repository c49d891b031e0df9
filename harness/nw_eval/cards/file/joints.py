"""What a card says about joints, against the robot that it names: every fault with its place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from nw_eval.cards.joints import PerJoint, joint_order, joint_values, named_joints, short_name
from nw_eval.errors import PolicyError, Problem, nearest
from nw_eval.robots import get_robot, robot_names

if TYPE_CHECKING:
    from nw_eval.cards.card import Card
    from nw_eval.files.yaml_file import Location, YamlFile
    from nw_eval.robots import RobotSpec

_NEVER_NEGATIVE = ("kp", "kd", "torque_limits", "armature", "friction_loss")
_PER_JOINT = ("scale", "default_pose", *_NEVER_NEGATIVE)


def joint_problems(card: Card, file: YamlFile) -> list[Problem]:
    """Return what is wrong with the robot, the joints and their values, in file order.

    Args:
        card: valid in itself.
        file: that it was read from.
    """
    if card.robot not in robot_names():
        known = nearest(card.robot, robot_names())
        return [file.problem(("robot",), f"robot: unknown robot {card.robot!r}", known)]
    robot = get_robot(card.robot)
    own = robot.joints
    faults: list[Problem | None] = []
    joints = own
    if (named := card.control.joints) is not None:
        order = _fault(file, ("control", "joints"), lambda: joint_order(named, own))
        faults.append(order)
        joints = own if order else named
    for key in _PER_JOINT:
        value: PerJoint | None = getattr(card.control, key)
        if value is not None:
            faults += _value_problems(file, key, value, joints)
    if (pose := card.control.default_pose) is not None and not any(faults):
        faults += _range_problems(file, pose, joints, robot)
    problems = [problem for problem in faults if problem is not None]
    return sorted(problems, key=lambda problem: (problem.line, problem.column))


def _value_problems(
    file: YamlFile, key: str, value: PerJoint, joints: Sequence[str]
) -> list[Problem | None]:
    place = ("control", key)
    faults: list[Problem | None] = []
    # Where a mapping leaves joints out, the robot's own figures stand; a scale has none.
    default = None if key == "scale" else [0.0] * len(joints)
    if isinstance(value, dict):
        for name in value:
            alone = {name: value[name]}
            faults.append(
                _fault(
                    file,
                    (*place, name),
                    lambda one=alone: joint_values(one, joints, [0.0] * len(joints)),
                )
            )
    if not any(faults):
        faults.append(_fault(file, place, lambda: joint_values(value, joints, default)))
    if key in _NEVER_NEGATIVE:
        faults += [
            file.problem(where, f"control.{key}: {number:g} is negative", "give 0 or more")
            for where, number in _numbers(value, place)
            if number < 0.0
        ]
    return faults


def _range_problems(
    file: YamlFile, pose: PerJoint, joints: Sequence[str], robot: RobotSpec
) -> list[Problem]:
    """Return a problem for each number of a default pose that a joint of its cannot take."""
    ranges = {short_name(j): r for j, r in zip(robot.joints, robot.joint_ranges, strict=True)}
    names = [short_name(joint) for joint in joints]
    problems: list[Problem] = []
    for where, number in _numbers(pose, ("control", "default_pose")):
        meant = names
        if isinstance(pose, dict):
            meant = named_joints(str(where[-1]), names)
        elif isinstance(pose, list):
            meant = [names[int(where[-1])]]
        for name in meant:
            low, high = ranges[name]
            if not low <= number <= high:
                message = f"control.default_pose: {number:g} is beyond the range of {name}"
                fix = f"give radians from {low:g} to {high:g}, in the robot's own signs"
                problems.append(file.problem(where, message, fix))
                break
    return problems


def _numbers(value: PerJoint, place: Location) -> list[tuple[Location, float]]:
    """Return every number with its place."""
    if isinstance(value, dict):
        return [((*place, name), number) for name, number in value.items()]
    if isinstance(value, list):
        return [((*place, index), number) for index, number in enumerate(value)]
    return [(place, value)]


def _fault(file: YamlFile, place: Location, resolve: Callable[[], object]) -> Problem | None:
    """Return what `resolve` has to object, at a place of the file."""
    try:
        resolve()
    except PolicyError as error:
        key = ".".join(str(part) for part in place[:2])
        return file.problem(place, f"{key}: {error}")
    return None
