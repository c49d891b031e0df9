"""What is edited: a place as it was opened, and the line of states since.

Moving, scaling, cropping and measuring it are edits of the place; what follows from a state, the
place as it lies now and the ground along the course, is built once somebody wants it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.twin.label.ground import Ground, HeightProfile, height_profile
from nw_eval.twin.label.opening import OpenedPlace
from nw_eval.twin.label.state import (
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


class PlaceEdits:
    """A place: where it lies, what is kept of it, and every state that can be gone back to.

    Trail, start and markers move along with the place.

    Args:
        place: as opened.

    Attributes:
        place: as above.
    """

    def __init__(self, place: OpenedPlace) -> None:
        self.place = place
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

    @property
    def mesh(self) -> TriangleMesh:
        """The place as it is moved and cropped now; world, m."""
        return self._shown.mesh

    @property
    def ground(self) -> Ground:
        """The place as rays meet it."""
        return self._shown.ground

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
        self._move(stretch(metres / now), to_scale=True)

    def set_unit(self, unit: Unit) -> None:
        """Say in which unit the files are that were opened; lengths that were measured go."""
        factor = METRES[unit] / self.state.placement.scale
        self._move(stretch(factor), to_scale=True)

    def flip(self) -> None:
        """Turn the place upside down about z = 0, on which its floor then lies still."""
        low, high = self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)
        x, y, _ = as_point((low + high) / 2)
        self._move(turn("x", math.pi, (x, y, 0.0)))

    def click_floor(self, point: Point) -> None:
        """Put a point on the floor; the third one turns the place so that all lie at z = 0."""
        points = (*self.state.floor, point)
        if len(points) < 3:
            self._check_scan()
            self._do(replace(self.state, floor=points))
        else:
            self._move(level_on(np.array(points)), floor=())

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

    @property
    def distance_words(self) -> str:
        """The distance for people: in metres, or units where nobody knows how long one is."""
        unit = "m" if self.state.to_scale else "units"
        return "" if self.distance is None else f"{self.distance:.3f} {unit}"

    def _move(self, delta: NDArray[np.float64], **changes: Any) -> None:
        """Move the place, and change other parts of the state in the same step."""
        self._check_scan()
        still = np.array_equal(delta, np.eye(4))
        self._do(replace(self.state if still else self.state.moved(delta), **changes))

    def _check_scan(self) -> None:
        if not self.place.is_scan:
            raise UsageError(
                f"{self.place.collision} holds boxes, which are not moved here",
                fix="edit them in that file; the trail and the start can be changed here",
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
        self._shown = ShownPlace(self.place.mesh, state, ground)

    @staticmethod
    def _check_number(what: str, number: float) -> None:
        if not math.isfinite(number):
            raise UsageError(f"{what} of {number}", fix="give a finite number")


class ShownPlace:
    """A state, and what follows from it once somebody wants it.

    Args:
        opened: the mesh in the frame of its file.
        state: that places and crops it.
        ground: of a state with the same placement and crop, if one was built.

    Attributes:
        state: as above.
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
        """The place; world, m."""
        return self.ground.mesh

    @cached_property
    def ground(self) -> Ground:
        """The place as rays meet it."""
        mesh = self._opened
        if self.state.placement != Placement():
            vertices = mapped(mesh.vertices, self.state.placement.matrix)
            mesh = TriangleMesh(vertices=vertices, faces=mesh.faces, kinds=mesh.kinds)
        if self.state.crop is not None:
            mesh = cropped(mesh, self.state.crop)
        return Ground(mesh)

    def profile(self, start: StartPose) -> HeightProfile:
        """Return the heights from the state's start along its trail."""
        if self._profile is None:
            self._profile = height_profile(self.ground, (start.position, *self.state.waypoints))
        return self._profile
