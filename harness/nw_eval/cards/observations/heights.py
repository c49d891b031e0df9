"""Heights of the ground around the robot: as the numbers of a scan, or as a map."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from nw_eval.cards.model import Limits
from nw_eval.cards.observations.base import BaseObservation

Axis = tuple[float, float, Annotated[int, Field(ge=1, le=500)]]
"""First, last and number of points, m."""
GridOrder = Literal["y_fastest", "x_fastest"]
"""Which coordinate changes from each number of a row to the next."""


class ScandotsObservation(BaseObservation):
    """Heights of the ground around the robot: clip(trunk_z + offset - ground_z), m.

    The points stand in a frame at the trunk origin that turns with the yaw only. Both axes ascend:
    the first number lies behind and to the right of the robot.
    """

    sensor: Literal["scandots"]
    x: Axis = (-0.45, 1.2, 12)
    """First, last and number of points ahead, m."""
    y: Axis = (-0.75, 0.75, 11)
    """First, last and number of points to the left, m."""
    offset: float = 0.0143 - 0.3
    """Added to the trunk's height, m. The 0.3 is extreme-parkour's; the 0.0143 is how far the
    published virtual camera on a Go1 stands from 25 m above the trunk in the default stance (it
    follows the centre of mass; on a Go2 it is 0.0170)."""
    order: GridOrder = "y_fastest"
    """`y_fastest`: from right to left, then the next row ahead. `x_fastest`: from behind to ahead,
    then the next column to the left, as the grids of Isaac Lab and mjlab (their ordering `xy`)."""
    clip: Limits = (-1.0, 1.0)
    """Limits of every number, m; where there is no ground, the upper one is read."""

    @model_serializer(mode="wrap")
    def _without_the_usual_order(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave the default `order` out, so that cards without the key keep their digest."""
        fields = dump(self)
        if self.order == "y_fastest":
            fields.pop("order", None)
        return fields


class HeightmapObservation(BaseObservation):
    """A map of ground heights around the robot, (x, y) with x ahead and y to the left, m.

    The grid turns with the yaw only. Both axes ascend, so row 0 lies behind the robot and column 0
    to its right. `scandots` is the same grid, flattened and counted downwards from the trunk.
    """

    sensor: Literal["heightmap"]
    x: Axis = (-1.0, 2.0, 31)
    """First, last and number of points ahead, m."""
    y: Axis = (-1.0, 1.0, 21)
    """First, last and number of points to the left, m."""
    relative_to: Literal["trunk", "ground", "world"] = "trunk"
    """Heights are those above the trunk's origin, above the ground under it, or above z = 0."""
    clip: Limits = (-2.0, 2.0)
    """Where there is no ground, the map reads the lower limit."""
