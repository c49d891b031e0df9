"""The model of the label page: every decision is a new state, and every state can be gone back to.

Whoever works on the page works on this class; it needs no browser.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.twin.label.course.profile import HeightProfile
from nw_eval.twin.label.course.reach import Hint, hints_on
from nw_eval.twin.label.crop import CropBox
from nw_eval.twin.label.folder.opening import OpenedPlace, open_place
from nw_eval.twin.label.folder.published import publish_pair
from nw_eval.twin.label.folder.saving import save_label
from nw_eval.twin.label.placement import (
    Axis,
    Placement,
    Point,
    as_point,
    shift,
    stretch,
    turn,
)
from nw_eval.twin.label.shown import ShownPlace
from nw_eval.twin.label.state import LabelState, StartPose
from nw_eval.twin.place.write import Route
from nw_eval.words import Task

Propose = Callable[[TriangleMesh, Task], Route]
"""Proposes a course on a mesh (world, m) for a task."""

_BEFORE = 1.0  # m from the start to the first waypoint, unless somebody says where it is
_STRIDE = 1.0  # m from the last waypoint to one that is added without a place


def open_labelling(folder: Path, *, propose: Propose | None = None) -> Labelling:
    """Open a scene folder for labelling.

    Raises:
        SceneError: a file of it is missing or wrong.
    """
    return Labelling(open_place(folder), propose=propose)


class Labelling:
    """The states of one labelling, and what can be done next. For one thread at a time.

    Every change raises UsageError for what cannot be, and then nothing has changed.

    Args:
        place: as opened.
        propose: what finds a trail along steps and edges; None = there is nothing that does.
    """

    def __init__(self, place: OpenedPlace, *, propose: Propose | None = None) -> None:
        self.place = place
        self.propose = propose
        self._past: list[LabelState] = []
        self._future: list[LabelState] = []
        self._shown = ShownPlace(place.mesh, place.state)

    @property
    def state(self) -> LabelState:
        """What is decided now."""
        return self._shown.state

    @property
    def can_undo(self) -> bool:
        """Whether there is a state before this one."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether a change was taken back, and nothing done since."""
        return bool(self._future)

    def undo(self) -> None:
        """Go back to the state before; at the first one, stay."""
        if self._past:
            self._future.append(self.state)
            self._show(self._past.pop())

    def redo(self) -> None:
        """Do again what `undo` took back; otherwise stay."""
        if self._future:
            self._past.append(self.state)
            self._show(self._future.pop())

    # The place.

    @property
    def mesh(self) -> TriangleMesh:
        """The place as it is moved and cropped now; world, m."""
        return self._shown.mesh

    @property
    def T_world_splat(self) -> NDArray[np.float64]:  # noqa: N802 - the field's name.
        """(4, 4), as the place is moved now."""
        return self.state.placement.matrix @ self.place.T_world_splat

    def turn(self, axis: Axis, angle: float) -> None:
        """Turn the place by an angle, rad, about its middle: z turns it round, x and y tilt it."""
        self._check_number("an angle", angle)
        low, high = self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)
        self._move(turn(axis, angle, as_point((low + high) / 2)))

    def shift(self, x: float, y: float, z: float) -> None:
        """Shift the place, m."""
        for part in (x, y, z):
            self._check_number("a shift", part)
        self._move(shift((x, y, z)))

    def scale_to(self, metres: float) -> None:
        """Scale the place so that its two markers are `metres` apart."""
        now = self.distance
        self._check_number("a distance", metres)
        if now is None or now < 1e-6 or metres <= 0:
            raise UsageError(
                f"markers {now} m apart cannot be {metres:g} m apart",
                fix="put two markers at places whose distance you know, and type it",
            )
        self._move(stretch(metres / now))

    def crop_to(self, box: CropBox | None) -> None:
        """Keep what is in a box (world, m); None = all."""
        self._check_scan()
        after = replace(self.state, crop=box)
        shown = ShownPlace(self.place.mesh, after)
        if len(shown.mesh.faces) == 0:
            raise UsageError("the crop leaves nothing of the place", fix="make it larger")
        self._do(after)

    def mark(self, point: Point) -> None:
        """Put a marker; a third takes the place of the first."""
        self._do(replace(self.state, markers=(*self.state.markers, point)[-2:]))

    def clear_markers(self) -> None:
        """Take the markers away."""
        self._do(replace(self.state, markers=()))

    @property
    def distance(self) -> float | None:
        """Metres between the two markers; None with fewer."""
        if len(self.state.markers) < 2:
            return None
        return math.dist(*self.state.markers)

    # The course.

    def snapped(self, origin: Point, direction: Point) -> Point | None:
        """Return where a ray (world, m) meets the place; None where it does not."""
        return self._shown.ground.hit(origin, direction)

    def add_waypoint(self, point: Point | None = None, *, index: int | None = None) -> None:
        """Add a waypoint before an index, or at the end; None = 1 m on, on the ground."""
        waypoints = list(self.state.waypoints)
        waypoints.insert(len(waypoints) if index is None else index, point or self._next())
        self._do(replace(self.state, waypoints=tuple(waypoints)))

    def move_waypoint(self, index: int, point: Point) -> None:
        """Move a waypoint to a point of the place."""
        waypoints = self._waypoints(index)
        waypoints[index] = point
        self._do(replace(self.state, waypoints=tuple(waypoints)))

    def nudge_waypoint(self, index: int, x: float, y: float) -> None:
        """Move a waypoint by x, y (m) over the ground."""
        old = self._waypoints(index)[index]
        self.move_waypoint(index, self._on_ground((old[0] + x, old[1] + y, old[2])))

    def remove_waypoint(self, index: int) -> None:
        """Take a waypoint away."""
        waypoints = self._waypoints(index)
        del waypoints[index]
        self._do(replace(self.state, waypoints=tuple(waypoints)))

    def reorder_waypoint(self, index: int, to: int) -> None:
        """Give a waypoint another place in the order."""
        waypoints = self._waypoints(index)
        self._waypoints(to)
        waypoints.insert(to, waypoints.pop(index))
        self._do(replace(self.state, waypoints=tuple(waypoints)))

    def propose_trail(self) -> None:
        """Take over the trail and start that `propose` finds on the place as it is.

        Raises:
            UsageError: there is nothing that proposes.
            NwEvalError: what proposes finds nothing.
        """
        if self.propose is None:
            raise UsageError("nothing here proposes trails", fix="click the waypoints")
        course = self.propose(self.mesh, self.state.task)
        self._do(
            replace(
                self.state,
                task=course.task,
                waypoints=tuple(as_point(point) for point in course.trail),
                start=StartPose(position=course.spawn, yaw=course.yaw),
            )
        )

    def set_start(self, position: Point, yaw: float | None = None) -> None:
        """Say where the robot starts; without a yaw (rad) it looks at the first waypoint."""
        if yaw is None:
            yaw = self.start.yaw
            if self.state.waypoints:
                x, y, _ = self.state.waypoints[0]
                yaw = math.atan2(y - position[1], x - position[0])
        self._check_number("a yaw", yaw)
        self._do(replace(self.state, start=StartPose(position=position, yaw=yaw)))

    def set_yaw(self, yaw: float) -> None:
        """Say where the robot looks at the start, rad."""
        self.set_start(self.start.position, yaw)

    def nudge_start(self, x: float, y: float) -> None:
        """Move the start by x, y (m) over the ground; it looks where it looked."""
        old = self.start.position
        position = self._on_ground((old[0] + x, old[1] + y, old[2]))
        self.set_start(position, self.start.yaw)

    def start_before_trail(self) -> None:
        """Start 1 m before the first waypoint, looking at it, wherever that is moved."""
        self._do(replace(self.state, start=None))

    def set_task(self, task: Task) -> None:
        """Say what the trail asks of the robot."""
        self._do(replace(self.state, task=task))

    @property
    def start(self) -> StartPose:
        """Where the robot starts, whether somebody said so or not."""
        state = self.state
        if state.start is not None:
            return state.start
        if not state.waypoints:
            return StartPose(position=(0.0, 0.0, 0.0), yaw=0.0)
        first = np.array(state.waypoints[0])
        ahead = np.array(state.waypoints[1] if len(state.waypoints) > 1 else first)[:2] - first[:2]
        yaw = math.atan2(ahead[1], ahead[0])
        x, y = first[:2] - _BEFORE * np.array([math.cos(yaw), math.sin(yaw)])
        level = float(first[2])
        ground = self._shown.ground.dropped(float(x), float(y), level)
        return StartPose(position=ground or (float(x), float(y), level), yaw=yaw)

    @property
    def course(self) -> Route:
        """Task, trail and start, as stages of a build pass them on."""
        start = self.start
        return Route(
            task=self.state.task,
            trail=np.array(self.state.waypoints).reshape(-1, 3),
            spawn=start.position,
            yaw=start.yaw,
        )

    def profile(self) -> HeightProfile:
        """Return the height of the ground from the start along the trail."""
        return self._shown.profile(self.start)

    def hints(self) -> tuple[Hint, ...]:
        """Return what the shipped policy can be expected to do on this course."""
        stops = (self.start.position, *self.state.waypoints)
        return hints_on(stops, self.profile())

    # The files.

    def save(self, folder: Path | None = None) -> Path:
        """Write what is decided into a scene folder, by default the one that was opened.

        What is undone afterwards can be saved again: all states are of the files as opened.

        Returns:
            The folder.

        Raises:
            UsageError: there is no waypoint.
            SceneError: what would be saved cannot be loaded.
            StoreError: it cannot be written.
        """
        self._check_trail()
        folder = folder or self.place.folder
        is_still = self.state.placement == Placement()
        save_label(
            folder,
            course=self.course,
            opened_collision=self.place.collision,
            mesh=None if is_still and self.state.crop is None else self.mesh,
            T_world_splat=self.T_world_splat,
        )
        return folder

    def publish(self, folder: Path) -> Path:
        """Write the scene the published way, XML pair, meshes and splat; return its folder.

        Raises:
            UsageError: there is no waypoint.
            SceneError: the splat cannot be read.
            StoreError: it cannot be written.
        """
        self._check_trail()
        return publish_pair(
            folder,
            name=self.place.name,
            course=self.course,
            mesh=self.mesh,
            splat=self.place.splat,
            T_world_splat=self.T_world_splat,
        )

    # What stands behind them.

    def _do(self, state: LabelState) -> None:
        if state == self.state:
            return
        self._past.append(self.state)
        self._future.clear()
        self._show(state)

    def _show(self, state: LabelState) -> None:
        same = (state.placement, state.crop) == (self.state.placement, self.state.crop)
        ground = self._shown.ground if same and self._shown.is_built else None
        self._shown = ShownPlace(self.place.mesh, state, ground)

    def _move(self, delta: NDArray[np.float64]) -> None:
        self._check_scan()
        if not np.array_equal(delta, np.eye(4)):
            self._do(self.state.moved(delta))

    def _waypoints(self, index: int) -> list[Point]:
        if not 0 <= index < len(self.state.waypoints):
            raise UsageError(
                f"there is no waypoint {index + 1}: there are {len(self.state.waypoints)}",
                fix="choose one that there is, or add one",
            )
        return list(self.state.waypoints)

    def _next(self) -> Point:
        start = self.start
        stops = [start.position, *self.state.waypoints]
        yaw = start.yaw
        if len(stops) > 1:
            (x0, y0, _), (x1, y1, _) = stops[-2:]
            yaw = math.atan2(y1 - y0, x1 - x0)
        x, y, z = stops[-1]
        return self._on_ground((x + _STRIDE * math.cos(yaw), y + _STRIDE * math.sin(yaw), z))

    def _on_ground(self, point: Point) -> Point:
        for part in point:
            self._check_number("a place", part)
        found = self._shown.ground.dropped(*point)
        if found is None:
            raise UsageError(
                f"there is no ground under x {point[0]:.2f}, y {point[1]:.2f}",
                fix="stay on the place, or make the crop larger",
            )
        return found

    def _check_scan(self) -> None:
        if not self.place.is_scan:
            raise UsageError(
                f"{self.place.collision} holds boxes, which are not moved here",
                fix="edit them in that file; the trail and the start can be changed here",
            )

    def _check_trail(self) -> None:
        if not self.state.waypoints:
            raise UsageError("there is no waypoint", fix="click on the ground to add one")

    @staticmethod
    def _check_number(what: str, number: float) -> None:
        if not math.isfinite(number):
            raise UsageError(f"{what} of {number}", fix="give a finite number")
