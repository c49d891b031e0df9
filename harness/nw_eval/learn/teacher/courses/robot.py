"""The robot as a teacher trains with it: nothing to look at, and a sensor for every touch."""

from __future__ import annotations

from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

from nw_eval.robots import RobotSpec
from nw_eval.robots.spec import VISUAL_GROUP


def training_robot(robot: RobotSpec) -> RobotSpec:
    """Return the same body without visuals and cameras, with touch sensors and sites at its feet.

    The sensors are named as the geoms whose net contact force they give, (3,) N in the world, and
    come in the order of `touch_names`; so do the sites of the feet.
    """
    root = fromstring(robot.mjcf)  # noqa: S314 - our own text.
    for body in root.iter("body"):
        for part in [*body.findall("geom"), *body.findall("camera")]:
            if part.tag == "camera" or part.get("group") == str(VISUAL_GROUP):
                body.remove(part)
        for geom in body.findall("geom"):
            if geom.get("name") in robot.feet:
                name, place = geom.get("name", ""), geom.get("pos", "0 0 0")
                SubElement(body, "site", name=name, pos=place)
    sensors = SubElement(root, "sensor")
    for name in touch_names(robot):
        SubElement(
            sensors, "contact", name=name, geom1=name, data="force", reduce="netforce", num="1"
        )
    return replace(robot, mjcf=tostring(root, encoding="unicode"))


def touch_names(robot: RobotSpec) -> tuple[str, ...]:
    """Return the geoms that feel: the feet, what ends a trial, then all others that collide."""
    geoms = [name for geom in _solid(fromstring(robot.mjcf)) if (name := geom.get("name"))]  # noqa: S314
    first = (*robot.feet, *robot.monitored_geoms)
    return (*first, *(name for name in geoms if name not in first))


def _solid(root: Element) -> list[Element]:
    return [geom for geom in root.iter("geom") if geom.get("group") != str(VISUAL_GROUP)]
