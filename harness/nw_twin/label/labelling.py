"""The model of the label page: every decision is a new state, and every state can be gone back to.

Whoever works on the page works on `Labelling`; it needs no browser. `SceneEdits` has the line of
states and the edits of the scene: moving, levelling, scaling, cropping and measuring it.
`Labelling` adds waypoints, start, task, proposals, and the files. What follows from a state, the
scene as it lies now and the ground along the course, is built when it is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError, UsageError
from nw_base.plural import plural
from nw_base.words import Task
from nw_scenes.mesh import TriangleMesh
from nw_twin.course import CourseProposal, propose_course
from nw_twin.label.files import OpenedScene, open_place, save_label
from nw_twin.label.ground import (
    Ground,
    HeightProfile,
    Hint,
    height_profile,
    hints_on,
    start_before,
)
from nw_twin.label.published import publish_pair
from nw_twin.label.state import (
    METRES,
    Axis,
    CropBox,
    LabelState,
    Placement,
    Point,
    StartPose,
    Unit,
    as_point,
    cropped,
    level_on,
    mapped,
    shift,
    stretch,
    turn,
)
from nw_twin.place import Route


class SceneEdits:
    """A scene: its placement, its crop, and the states of undo.

    Trail, start and markers move along with the scene.

    Args:
        place: as opened.
    """

    def __init__(self, place: OpenedScene) -> None:
        self.place = place
        self._past: list[LabelState] = []
        self._future: list[LabelState] = []
        self._shown = ShownScene(place.mesh, place.state)

    @property
    def state(self) -> LabelState:
        """The current state."""
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

    @property
    def mesh(self) -> TriangleMesh:
        """The scene as it is moved and cropped now; world, m."""
        return self._shown.mesh

    @property
    def ground(self) -> Ground:
        """The scene as rays meet it."""
        return self._shown.ground

    @property
    def T_world_splat(self) -> NDArray[np.float64]:  # noqa: N802 - the field's name.
        """(4, 4), as the scene is moved now."""
        return self.state.placement.matrix @ self.place.T_world_splat

    def turn(self, axis: Axis, angle: float) -> None:
        """Turn the scene by an angle, rad, about its middle: z turns it round, x and y tilt it."""
        self._check_number("an angle", angle)
        low, high = self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)
        self._move(turn(axis, angle, as_point((low + high) / 2)))

    def shift(self, x: float, y: float, z: float) -> None:
        """Shift the scene, m."""
        for part in (x, y, z):
            self._check_number("a shift", part)
        self._move(shift((x, y, z)))

    def scale_to(self, metres: float) -> None:
        """Scale the scene so that its two markers are `metres` apart."""
        measured = self.distance
        self._check_number("a distance", metres)
        if measured is None or measured < 1e-6 or metres <= 0:
            raise UsageError(
                f"markers {measured} m apart cannot be {metres:g} m apart",
                fix="put two markers at points with a known distance, and type it",
            )
        self._move(stretch(metres / measured), to_scale=True)

    def set_unit(self, unit: Unit) -> None:
        """Say in which unit the files are that were opened; lengths that were measured go."""
        factor = METRES[unit] / self.state.placement.scale
        self._move(stretch(factor), to_scale=True)

    def flip(self) -> None:
        """Turn the scene upside down about z = 0, on which its floor then lies still."""
        low, high = self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)
        x, y, _ = as_point((low + high) / 2)
        self._move(turn("x", math.pi, (x, y, 0.0)))

    def click_floor(self, point: Point) -> None:
        """Put a point on the floor; the third one turns the scene so that all lie at z = 0."""
        points = (*self.state.floor, point)
        if len(points) < 3:
            self._check_scan()
            self._do(replace(self.state, floor=points))
        else:
            self._move(level_on(np.array(points)), floor=())

    def crop_to(self, box: CropBox | None) -> None:
        """Crop the scene to a box (world, m); None removes the crop."""
        self._check_scan()
        after = replace(self.state, crop=box)
        shown = ShownScene(self.place.mesh, after)
        if len(shown.mesh.faces) == 0:
            raise UsageError("the crop leaves nothing of the scene", fix="make it larger")
        self._do(after)

    def mark(self, point: Point) -> None:
        """Put a marker; a third replaces the first."""
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

    @property
    def distance_words(self) -> str:
        """The distance for people: in metres, or in units of unknown length."""
        unit = "m" if self.state.to_scale else "units"
        return "" if self.distance is None else f"{self.distance:.3f} {unit}"

    def _move(self, delta: NDArray[np.float64], **changes: Any) -> None:
        """Move the scene, and change other parts of the state in the same step."""
        self._check_scan()
        still = np.array_equal(delta, np.eye(4))
        self._do(replace(self.state if still else self.state.moved(delta), **changes))

    def _check_scan(self) -> None:
        if not self.place.is_scan:
            raise UsageError(
                f"{self.place.collision} holds boxes, which are not moved here",
                fix="edit them in that file; the waypoints and the start can be changed here",
            )

    def _do(self, state: LabelState) -> None:
        """Go on to a state, and forget what was undone; to the one that holds already, stay."""
        if state != self.state:
            self._past.append(self.state)
            self._future.clear()
            self._show(state)

    def _show(self, state: LabelState) -> None:
        same = (state.placement, state.crop) == (self.state.placement, self.state.crop)
        ground = self._shown.ground if same and self._shown.is_built else None
        self._shown = ShownScene(self.place.mesh, state, ground)

    @staticmethod
    def _check_number(what: str, number: float) -> None:
        if not math.isfinite(number):
            raise UsageError(f"{what} of {number}", fix="give a finite number")


class ShownScene:
    """A state, and what follows from it once somebody wants it.

    Args:
        opened: the mesh in the frame of its file.
        state: that places and crops it.
        ground: of a state with the same placement and crop, if one was built.
    """

    def __init__(
        self, opened: TriangleMesh, state: LabelState, ground: Ground | None = None
    ) -> None:
        self.state = state
        self._opened = opened
        self._profile: HeightProfile | None = None
        if ground is not None:
            self.ground = ground

    @property
    def is_built(self) -> bool:
        """Whether there is a `ground` already; a large one takes a second."""
        return "ground" in self.__dict__

    @property
    def mesh(self) -> TriangleMesh:
        """The scene; world, m."""
        return self.ground.mesh

    @cached_property
    def ground(self) -> Ground:
        """The scene as rays meet it."""
        mesh = self._opened
        if self.state.placement != Placement():
            vertices = mapped(mesh.vertices, self.state.placement.matrix)
            mesh = TriangleMesh(vertices=vertices, faces=mesh.faces, kinds=mesh.kinds)
        if self.state.crop is not None:
            mesh = cropped(mesh, self.state.crop)
        return Ground(mesh)

    def profile(self, start: StartPose) -> HeightProfile:
        """Return the heights from the state's start along its course."""
        if self._profile is None:
            self._profile = height_profile(self.ground, (start.position, *self.state.waypoints))
        return self._profile


Propose = Callable[[TriangleMesh, NDArray[np.float64]], CourseProposal]
"""Proposes a course on a mesh (world, m) along places where somebody walked, (N, 3)."""

NEEDS_SCALE = (
    "put two markers at points whose distance you know, type it, and scale; or set the file's unit"
)
"""What to do about a scene that is not to scale."""

_EYES = np.array([0.0, 0.0, 1.0])  # m above a course, to look at its ground; ceilings are higher
_STRIDE = 1.0  # m from the last waypoint to one that is added without a click


def open_labelling(folder: Path) -> Labelling:
    """Open a scene folder for labelling.

    Raises:
        SceneError: a file of it is missing or wrong.
    """
    return Labelling(open_place(folder))


class Labelling(SceneEdits):
    """The states of one labelling, and what can be done next. For one thread at a time.

    Every change raises UsageError for what cannot be, and then nothing has changed.

    Args:
        place: as opened.
        propose: finds a course along steps and edges.
    """

    def __init__(self, place: OpenedScene, *, propose: Propose = propose_course) -> None:
        super().__init__(place)
        self._propose = propose
        self._saved = self.state

    def snapped(self, origin: Point, direction: Point) -> Point | None:
        """Return where a ray (world, m) meets the scene; None where it does not."""
        return self._shown.ground.hit(origin, direction)

    def add_waypoint(self, point: Point | None = None, *, index: int | None = None) -> None:
        """Add a waypoint before an index, or at the end; None = 1 m on, on the ground."""
        waypoints = list(self.state.waypoints)
        waypoints.insert(len(waypoints) if index is None else index, point or self._next())
        self._do(replace(self.state, waypoints=tuple(waypoints)))

    def move_waypoint(self, index: int, point: Point) -> None:
        """Move a waypoint to a point of the scene."""
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
        """Move a waypoint to another position in the order."""
        waypoints = self._waypoints(index)
        self._waypoints(to)
        waypoints.insert(to, waypoints.pop(index))
        self._do(replace(self.state, waypoints=tuple(waypoints)))

    def start_at_waypoint(self, index: int) -> None:
        """Start where a waypoint is, which is one no more, looking at the next."""
        waypoints = self._waypoints(index)
        x, y, z = waypoints.pop(index)
        yaw = self.start.yaw
        if waypoints:
            following = waypoints[min(index, len(waypoints) - 1)]
            yaw = math.atan2(following[1] - y, following[0] - x)
        start = StartPose(position=(x, y, z), yaw=yaw)
        self._do(replace(self.state, waypoints=tuple(waypoints), start=start))

    def mark_waypoint(self, index: int) -> None:
        """Put a marker where a waypoint is."""
        self.mark(self._waypoints(index)[index])

    @property
    def walk(self) -> NDArray[np.float64]:
        """Where the cameras stood that photographed the scene, (N, 3), in order; world, m."""
        return mapped(self.place.walk, self.state.placement.matrix)

    def propose_along_walk(self) -> str:
        """Take over the course, start and task that the scene suggests where the cameras went.

        Returns:
            What was found, for people.

        Raises:
            UsageError: there are no camera positions.
            SceneError: they went less than a metre, or there is no ground below them.
        """
        if not self.place.cameras:
            raise UsageError(
                "this scene has no camera positions",
                fix="click waypoints to the end of the course, and propose a course along them",
            )
        return self._take_over(self._propose(self.mesh, self.walk))

    def propose_along_trail(self) -> str:
        """Take over the course, start and task that the scene suggests from the start to the end.

        The way goes over all waypoints; two clicks are enough.

        Returns:
            What was found, for people.

        Raises:
            UsageError: there is no waypoint, or no ground along the way.
        """
        self._check_trail()
        stops = np.array([self.start.position, *self.state.waypoints])
        try:
            return self._take_over(self._propose(self.mesh, stops + _EYES))
        except SceneError as error:
            raise UsageError(
                f"no course from the start over the waypoints: {error.message}",
                fix="put waypoints a metre or more away, where the mesh has ground",
            ) from None

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
        """Say what the course asks of the robot."""
        self._do(replace(self.state, task=task))

    @property
    def start(self) -> StartPose:
        """Where the robot starts, whether somebody said so or not."""
        return self.state.start or start_before(self.state.waypoints, self._shown.ground)

    @property
    def course(self) -> Route:
        """Task, course and start, as stages of a build pass them on."""
        start = self.start
        return Route(
            task=self.state.task,
            trail=np.array(self.state.waypoints).reshape(-1, 3),
            spawn=start.position,
            yaw=start.yaw,
        )

    def profile(self) -> HeightProfile:
        """Return the height of the ground from the start along the course."""
        return self._shown.profile(self.start)

    def hints(self) -> tuple[Hint, ...]:
        """Return what the shipped policy can be expected to do on this course."""
        stops = (self.start.position, *self.state.waypoints)
        return hints_on(stops, self.profile())

    @property
    def words(self) -> str:
        """The current state in one line of text."""
        state = self.state
        where = ", ".join(f"{part:.2f}" for part in self.start.position)
        unit = "" if state.to_scale else ", not to scale"
        return f"{state.task}, {plural(len(state.waypoints), 'waypoint')}, start at {where}{unit}"

    @property
    def is_saved(self) -> bool:
        """Whether the files have the current state; markers are not saved."""
        current, saved = (replace(one, markers=(), floor=()) for one in (self.state, self._saved))
        return current == saved

    def save(self) -> Path:
        """Write the current state into the opened scene folder.

        An undone state can be saved, too: all states refer to the files as opened.

        Returns:
            The folder.

        Raises:
            UsageError: there is no waypoint.
            SceneError: what would be saved cannot be loaded.
            StoreError: it cannot be written.
        """
        self._check_trail()
        state = self.state
        is_still = state.placement == Placement() and state.crop is None
        save_label(
            self.place,
            course=self.course,
            mesh=None if is_still else self.mesh,
            T_world_opened=state.placement.matrix,
            to_scale=state.to_scale,
        )
        self._saved = state
        return self.place.folder

    def publish(self, folder: Path) -> Path:
        """Write the scene the published way, XML pair, meshes and splat; return its folder.

        Raises:
            UsageError: there is no waypoint, or the scene is not to scale.
            SceneError: the splat cannot be read.
            StoreError: it cannot be written.
        """
        self._check_trail()
        if not self.state.to_scale:
            raise UsageError("the scene is not to scale", fix=NEEDS_SCALE)
        return publish_pair(
            folder,
            name=self.place.name,
            course=self.course,
            mesh=self.mesh,
            splat=self.place.splat,
            T_world_splat=self.T_world_splat,
        )

    def _take_over(self, proposal: CourseProposal) -> str:
        spawn = proposal.spawn
        self._do(
            replace(
                self.state,
                task=proposal.task,
                waypoints=proposal.trail,
                start=StartPose(position=spawn.position, yaw=spawn.yaw),
            )
        )
        reasons = "; ".join(proposal.reasons)
        looks = "".join(f" Check this: {warning}." for warning in proposal.warnings)
        return f"Proposed for {proposal.task}: {reasons}.{looks}"

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
            self._check_number("a position", part)
        ground = self._shown.ground.dropped(*point)
        if ground is None:
            raise UsageError(
                f"there is no ground under x {point[0]:.2f}, y {point[1]:.2f}",
                fix="stay on the scene, or make the crop larger",
            )
        return ground

    def _check_trail(self) -> None:
        if not self.state.waypoints:
            raise UsageError("there is no waypoint", fix="click on the ground to add one")
