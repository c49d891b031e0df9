"""Cameras that a policy's robot has mounted otherwise than the robot of the same name here."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from nw_eval.cards.model import CardModel
from nw_eval.errors import PolicyError, nearest
from nw_eval.robots.mounting import remounted

if TYPE_CHECKING:
    from nw_eval.cards.card import Card
    from nw_eval.robots import RobotSpec


class CameraMounting(CardModel):
    """How a camera is mounted, against the robot's own."""

    pitch: Annotated[float, Field(ge=-0.8, le=0.8)] = 0.0
    """Angle by which it looks farther down, rad."""
    height: Annotated[float, Field(ge=-0.3, le=0.3)] = 0.0
    """Length by which it sits higher on the trunk, m."""
    field_of_view: Annotated[float, Field(ge=0.3, le=1.5)] = 1.0
    """Factor of its vertical field of view."""


def mounted_robot(robot: RobotSpec, card: Card) -> RobotSpec:
    """Return a robot with its cameras as a card says.

    Raises:
        PolicyError: the robot has no such camera.
    """
    if not card.cameras:
        return robot
    cameras = dict(robot.cameras)
    for name, mounting in card.cameras.items():
        if name not in cameras:
            raise PolicyError(
                f"cameras.{name}: {robot.name} has no camera {name!r}",
                fix=nearest(name, list(robot.cameras)),
            )
        cameras[name] = remounted(
            cameras[name],
            pitch=mounting.pitch,
            height=mounting.height,
            factor=mounting.field_of_view,
        )
    return replace(robot, cameras=cameras)
