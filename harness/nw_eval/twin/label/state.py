"""All that a labelling decides, as one value that is never changed, only followed by another."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError
from nw_eval.scenes.limits import REACH, WAYPOINTS
from nw_eval.twin.label.crop import CropBox
from nw_eval.twin.label.placement import Placement, Point, as_point, mapped
from nw_eval.words import Task


@dataclass(frozen=True, kw_only=True)
class StartPose:
    """Where the robot starts.

    Attributes:
        position: on the ground; world, m.
        yaw: where it looks, rad; 0 = along x.
    """

    position: Point
    yaw: float


@dataclass(frozen=True, kw_only=True)
class LabelState:
    """One state of a labelling.

    Attributes:
        task: what the trail asks of the robot.
        waypoints: in order, on top of what the robot steps on; world, m.
        start: None = 1 m before the first waypoint, looking at it.
        placement: of the files that were opened.
        crop: what is kept of the place, after it was placed; None = all.
        markers: two at most, for measuring; world, m.

    Raises:
        UsageError: a point is no place for a waypoint, or there are too many.
    """

    task: Task
    waypoints: tuple[Point, ...] = ()
    start: StartPose | None = None
    placement: Placement = field(default_factory=Placement)
    crop: CropBox | None = None
    markers: tuple[Point, ...] = ()

    def __post_init__(self) -> None:
        if len(self.waypoints) > WAYPOINTS:
            raise UsageError(f"{len(self.waypoints)} waypoints", fix=f"give {WAYPOINTS} at most")
        points = [*self.waypoints, *self.markers]
        if self.start is not None:
            points.append(self.start.position)
        for point in points:
            if not all(abs(part) <= REACH for part in point):
                raise UsageError(
                    f"a point at {list(point)}",
                    fix=f"points lie within {REACH:g} m of the origin: shift or scale the place",
                )

    def moved(self, delta: NDArray[np.float64]) -> LabelState:
        """Return the state after the place was moved by a (4, 4) similarity.

        Waypoints, start and markers move along. The crop's middle does too, and its size scales,
        but its sides stay along the axes.

        Raises:
            SceneError: the place's scale would be out of bounds.
            UsageError: a point would be too far away.
        """
        scale = float(np.linalg.det(delta[:3, :3])) ** (1 / 3)
        start, crop = self.start, self.crop
        if start is not None:
            x, y, _ = delta[:3, :3] @ [math.cos(start.yaw), math.sin(start.yaw), 0.0]
            (position,) = _moved((start.position,), delta)
            start = StartPose(position=position, yaw=math.atan2(y, x))
        if crop is not None:
            low, high = np.array(crop.low), np.array(crop.high)
            middle = mapped((low + high)[None] / 2, delta)[0]
            half = (high - low) / 2 * scale
            crop = CropBox(low=as_point(middle - half), high=as_point(middle + half))
        return replace(
            self,
            placement=Placement.of(delta @ self.placement.matrix),
            waypoints=_moved(self.waypoints, delta),
            start=start,
            crop=crop,
            markers=_moved(self.markers, delta),
        )


def _moved(points: tuple[Point, ...], delta: NDArray[np.float64]) -> tuple[Point, ...]:
    if not points:
        return ()
    return tuple(as_point(row) for row in mapped(np.array(points), delta))
