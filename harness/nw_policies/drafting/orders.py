"""In which order simulators count the joints of a robot."""

from __future__ import annotations

from xml.etree.ElementTree import fromstring

from nw_policies.cards.joints import short_name
from nw_policies.drafting.layouts import TYPE_BY_TYPE
from nw_scenes.robots import RobotSpec


def isaac_lab_order(robot: RobotSpec) -> tuple[str, ...]:
    """Return the short names of a robot's joints as trainings in Isaac Lab count them.

    Those of Unitree's quadrupeds begin with the left legs, though files of the robots may begin
    with the right ones; others are `level_by_level`.
    """
    own = sorted(map(short_name, robot.joints))
    return TYPE_BY_TYPE if own == sorted(TYPE_BY_TYPE) else level_by_level(robot)


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
