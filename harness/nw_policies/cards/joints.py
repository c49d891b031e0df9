"""Values for each joint, as people write them on a card."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Annotated, Literal, get_args
from xml.etree.ElementTree import fromstring

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict

from nw_base.errors import PolicyError, nearest
from nw_base.plural import plural

if TYPE_CHECKING:
    from nw_scenes.robots import RobotSpec

Number = Annotated[float, Strict()]
"""A number and nothing that could be read as one: `kp: true` and `kp: "35"` are slips."""

ActionKind = Literal["joint_position_offset", "joint_position", "joint_velocity", "joint_torque"]
"""What an action of a joint means."""

PerJoint = Number | list[Number] | dict[str, Number]
"""One number for all joints; a list in the order of `control.joints`; or a mapping.

The keys of a mapping are joints ("FR_hip"), types ("hip") or patterns ("F*_thigh"). Where two of
them name the same joint, the more exact one counts: a joint over a pattern over a type; of two
patterns, the later one.
"""


Held = Annotated[list[str], Field(min_length=1)] | Annotated[dict[str, Number], Field(min_length=1)]
"""Joints that are held: joints, types or patterns; with angles, rad, or at the default pose."""


def short_name(joint: str) -> str:
    """Return the name of a joint without the `_joint` that URDF files append."""
    return joint.removesuffix("_joint")


def level_by_level(robot: RobotSpec) -> tuple[str, ...]:
    """Return the short names of a robot's joints as PhysX counts the links of an articulation.

    It goes from the root level by level, those of one level in the order of their parents.
    """
    found: list[str] = []
    level = fromstring(robot.mjcf).findall("worldbody/body")  # noqa: S314 - our own text.
    while level:
        joints = (joint.get("name", "") for body in level for joint in body.findall("joint"))
        found += [short_name(joint) for joint in joints if joint in robot.joints]
        level = [child for body in level for child in body.findall("body")]
    own = tuple(map(short_name, robot.joints))
    return tuple(found) if sorted(found) == sorted(own) else own


def joint_order(wanted: Sequence[str], joints: Sequence[str]) -> NDArray[np.intp]:
    """Return, for each wanted name, its index among a robot's joints.

    Raises:
        PolicyError: a name is unknown or repeated, or a joint of the robot is not named.
    """
    known = [short_name(joint) for joint in joints]
    names = [short_name(name) for name in wanted]
    for name in names:
        if name not in known:
            raise PolicyError(f"unknown joint {name!r}", fix=nearest(name, known))
        if names.count(name) > 1:
            raise PolicyError(f"joint {name!r} is named twice", fix="name every joint once")
    missing = [name for name in known if name not in names]
    if missing:
        raise PolicyError(
            f"{len(names)} joints are named, {', '.join(missing)} are not",
            fix=f"name all {len(known)} joints in the checkpoint's order",
        )
    return np.array([known.index(name) for name in names], dtype=np.intp)


def named_joints(key: str, names: Sequence[str]) -> list[str]:
    """Return those of the short `names` that a key of a mapping means: a joint, type or pattern."""
    pattern = short_name(key)
    return [name for name in names if name.endswith(f"_{pattern}") or fnmatchcase(name, pattern)]


def held_places(held: Held | None, joints: Sequence[str]) -> dict[int, float | None]:
    """Return the positions in `joints` of those that are held, and at which angle.

    Returns:
        rad; None = at the default pose.

    Raises:
        PolicyError: a key names no joint, or every joint is held.
    """
    names = [short_name(joint) for joint in joints]
    angles = dict.fromkeys(held, None) if isinstance(held, list) else held or {}
    places: dict[int, float | None] = {}
    for key, angle in sorted(angles.items(), key=lambda item: _exactness(item[0], names)):
        hits = named_joints(key, names)
        if not hits:
            raise PolicyError(f"{key!r} names no joint", fix=nearest(short_name(key), names))
        places |= {names.index(name): angle for name in hits}
    if len(places) == len(names):
        raise PolicyError("every joint is held", fix="leave out those that the policy drives")
    return places


def all_joints(named: list[str] | None, held: Held | None, joints: Sequence[str]) -> list[str]:
    """Return the joints of a robot in a policy's order: held ones that it does not name come last.

    Args:
        named: `control.joints`.
        held: `control.held`.
        joints: the robot's.

    Raises:
        PolicyError: as `held_places`.
    """
    own = list(joints)
    if named is None or held is None:
        return own if named is None else named
    said = {short_name(name) for name in named}
    rest = [own[place] for place in sorted(held_places(held, own))]
    return [*named, *(name for name in rest if short_name(name) not in said)]


def whole_list(value: PerJoint, named: list[str] | None, own: Sequence[float | None]) -> PerJoint:
    """Return a list of numbers of the joints that a card names with the others' own behind it."""
    rest = own[len(named) :] if named is not None else []
    if not isinstance(value, list) or named is None or len(value) != len(named):
        return value
    return [*value, *(number or 0.0 for number in rest)]


def joint_values(
    value: PerJoint, joints: Sequence[str], default: Sequence[float | None] | None = None
) -> NDArray[np.float64]:
    """Return one number for each of `joints`, in their order.

    Args:
        value: what the card says.
        joints: joint names in the order that a list of values has.
        default: values for joints that a mapping does not name; None = it must name them all.

    Raises:
        PolicyError: a list of another length, a key that names no joint, a joint without a value.
    """
    if isinstance(value, list):
        if len(value) != len(joints):
            raise PolicyError(
                f"{plural(len(value), 'value')} for {len(joints)} joints",
                fix="give one value, one for each joint, or a mapping by name",
            )
        return np.array(value, dtype=np.float64)
    if not isinstance(value, dict):
        return np.full(len(joints), float(value))
    names = [short_name(joint) for joint in joints]
    result: list[float | None] = list(default) if default is not None else [None] * len(names)
    for key, number in sorted(value.items(), key=lambda item: _exactness(item[0], names)):
        hits = named_joints(key, names)
        if not hits:
            known = {*names, *(name.rsplit("_", 1)[-1] for name in names)}
            raise PolicyError(f"{key!r} names no joint", fix=nearest(short_name(key), known))
        for name in hits:
            result[names.index(name)] = number
    missing = [name for name, number in zip(names, result, strict=True) if number is None]
    if missing:
        raise PolicyError(f"no value for {', '.join(missing)}", fix="name every joint")
    return np.array(result, dtype=np.float64)


def joint_actions(
    action: ActionKind | dict[str, ActionKind], joints: Sequence[str]
) -> tuple[ActionKind, ...]:
    """Return what the action of each of `joints` means, in their order.

    Args:
        action: what the card says: one word, or words by joint, type or pattern.
        joints: joint names.

    Raises:
        PolicyError: a key names no joint, or a joint has no word.
    """
    if isinstance(action, str):
        return (action,) * len(joints)
    kinds = get_args(ActionKind)
    numbers = joint_values({key: kinds.index(kind) for key, kind in action.items()}, joints)
    return tuple(kinds[int(number)] for number in numbers)


def _exactness(key: str, names: Sequence[str]) -> int:
    """Return 0 for a type, 1 for a pattern, 2 for a joint."""
    if short_name(key) in names:
        return 2
    return int(any(sign in key for sign in "*?["))
