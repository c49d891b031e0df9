"""Moving, scaling, cropping and measuring a place."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.twin.label.course.ground import Ground
from nw_eval.twin.label.crop import CropBox
from nw_eval.twin.label.edited import Edited
from nw_eval.twin.label.placement import (
    Axis,
    Point,
    as_point,
    shift,
    stretch,
    turn,
)
from nw_eval.twin.label.shown import ShownPlace


class PlaceEdits(Edited):
    """Where a place lies, and what is kept of it. Trail, start and markers move along."""

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

    def _move(self, delta: NDArray[np.float64]) -> None:
        self._check_scan()
        if not np.array_equal(delta, np.eye(4)):
            self._do(self.state.moved(delta))

    def _check_scan(self) -> None:
        if not self.place.is_scan:
            raise UsageError(
                f"{self.place.collision} holds boxes, which are not moved here",
                fix="edit them in that file; the trail and the start can be changed here",
            )
