"""The page's controls of the place itself: its scale, how it lies, what is kept and shown of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from nw_eval.twin.label.crop import CropBox
from nw_eval.twin.label.labelling import Labelling
from nw_eval.twin.label.page.cutaway import Cutaway
from nw_eval.twin.label.page.panel import ControlPanel, keep
from nw_eval.twin.label.placement import Axis, Point

_TURNS: tuple[tuple[str, Axis], ...] = (("Turn", "z"), ("Tilt x", "x"), ("Tilt y", "y"))
_ROUND_IT = 0.01  # m from the place to the crop that is offered


class PlaceControls:
    """Three tabs: scale, place and view.

    Args:
        panel: what they are added to.
        labelling: what they act on.
        tabs: viser's tab group.
        level: height above which the view is cut at first, m; None = it is not.
        has_splat: whether there is one to show.
        look: turns the browsers' views to the course.

    Attributes:
        shows_splat, shows_mesh: whether it is seen.
    """

    def __init__(
        self,
        panel: ControlPanel,
        labelling: Labelling,
        tabs: Any,
        *,
        level: float | None,
        has_splat: bool,
        look: Callable[[], object],
    ) -> None:
        self._panel = panel
        self._labelling = labelling
        self._lies: object = None
        self.shows_splat, self.shows_mesh = has_splat, not has_splat
        self._cuts = level is not None
        self._measured: float | None = None
        self._bounds: tuple[Point, Point] | None = None
        with tabs.add_tab("Scale"):
            self._add_scale()
        with tabs.add_tab("Place"):
            self._add_place()
        with tabs.add_tab("View"):
            self._add_view(level, look)

    @property
    def preview(self) -> CropBox | None:
        """The crop that is being typed; None while nobody does, or where it would hold nothing."""
        low, high = self._low.value, self._high.value
        if (low, high) == self._bounds or not all(a < b for a, b in zip(low, high, strict=True)):
            return None
        return CropBox(low=low, high=high)

    @property
    def cutaway(self) -> Cutaway:
        """What is shown of the place."""
        return Cutaway(level=self._level.value if self._cuts else None)

    def refresh(self) -> None:
        """Bring all fields to the labelling's state."""
        labelling, state = self._labelling, self._labelling.state
        distance = labelling.distance
        if distance is None:
            self._distance.content = (
                "Put two markers where you know a distance: choose **marker** (4) and click twice, "
                "or M at two waypoints."
            )
        else:
            self._distance.content = f"The markers are **{distance:.3f} m** apart."
        if distance is not None and distance != self._measured:
            keep(self._metres, round(distance, 3))
        self._measured = distance
        if (state.placement, state.crop) != self._lies:
            self._lies = (state.placement, state.crop)
            vertices = labelling.mesh.vertices
            self._bounds = (
                _rounded(vertices.min(axis=0) - _ROUND_IT),
                _rounded(vertices.max(axis=0) + _ROUND_IT),
            )
            for field, corner in zip((self._low, self._high), self._bounds, strict=True):
                keep(field, corner)

    def _add_scale(self) -> None:
        labelling, panel = self._labelling, self._panel
        self._distance = panel.gui.add_markdown("")
        self._metres = panel.gui.add_number(
            "It is really, m", 1.0, min=0.001, max=1000.0, step=0.001
        )
        panel.button("Scale the place", lambda: labelling.scale_to(self._metres.value))
        panel.button("Clear markers", labelling.clear_markers)

    def _add_place(self) -> None:
        labelling, panel, gui = self._labelling, self._panel, self._panel.gui
        angle = gui.add_number("Turn by, degrees", 5.0, min=0.01, max=180.0, step=0.1)
        for label, axis in _TURNS:

            def by(sign: int, axis: Axis = axis) -> None:
                labelling.turn(axis, sign * math.radians(angle.value))

            panel.row(
                label,
                ("left", None, None, lambda by=by: by(1)),
                ("right", None, None, lambda by=by: by(-1)),
            )
        offset = gui.add_vector3("Shift by, m", (0.0, 0.0, 0.0), step=0.01)
        panel.button("Shift", lambda: labelling.shift(*offset.value))
        panel.button("Put the floor under the start at z = 0", self._level_floor)
        self._low = gui.add_vector3("Crop from, m", (0.0, 0.0, 0.0), step=0.05)
        self._high = gui.add_vector3("Crop to, m", (0.0, 0.0, 0.0), step=0.05)
        for corner in (self._low, self._high):
            panel.on_change(corner, lambda: None)  # Draws the box.
        panel.button(
            "Crop to the pink box",
            lambda: labelling.crop_to(CropBox(low=self._low.value, high=self._high.value)),
        )
        panel.button("Take the crop back", lambda: labelling.crop_to(None))

    def _add_view(self, level: float | None, look: Callable[[], object]) -> None:
        panel, gui = self._panel, self._panel.gui
        panel.row(
            "Show, hide (V C R)",
            ("splat", "V", None, self._toggle_splat),
            ("mesh", "C", None, self._toggle_mesh),
            ("roof", "R", None, self._toggle_roof),
        )
        self._level = gui.add_number(
            "Roof: above, m", round(1.2 if level is None else level, 2), step=0.1
        )
        panel.on_change(self._level, lambda: None)
        panel.button("Look at the course (Y)", look, "Y")
        gui.add_markdown("What is hidden is saved with the rest.")

    def _toggle_splat(self) -> None:
        self.shows_splat = not self.shows_splat

    def _toggle_mesh(self) -> None:
        self.shows_mesh = not self.shows_mesh

    def _toggle_roof(self) -> None:
        self._cuts = not self._cuts

    def _level_floor(self) -> None:
        self._labelling.shift(0.0, 0.0, -self._labelling.start.position[2])


def _rounded(values: Any) -> Point:
    x, y, z = (round(float(value), 2) for value in values)
    return x, y, z
