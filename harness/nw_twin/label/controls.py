"""The page's panel: what to do, what was done, and a tab for each thing that can be changed.

It is built of buttons that have keys, and of fields that follow the state.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, get_args

from nw_base.words import Task
from nw_twin.label.drawing import Cutaway
from nw_twin.label.labelling import Labelling
from nw_twin.label.state import Axis, CropBox, Point, Unit

CLICKS = ("waypoint", "chosen", "start", "marker", "floor")
_PUTS = {
    "waypoint": "adds a **waypoint**",
    "chosen": "moves the **chosen waypoint** (blue)",
    "start": "sets the **start**",
    "marker": "puts a **marker**, to measure",
    "floor": "puts a point on the **floor**: three of them, well apart, lay it level at z = 0",
}

_HELP = """\
1. Click waypoints on the ground, in order, or let a course be proposed (P).
2. Check the start (green box) and the hints.
3. Save.

Drag turns the view, right drag shifts it, the wheel zooms. Shortcuts are shown in brackets;
they are off while you type. Ctrl+K lists all.
"""

_TURNS: tuple[tuple[str, Axis], ...] = (("Turn", "z"), ("Tilt x", "x"), ("Tilt y", "y"))
_ROUND_IT = 0.01  # m from the scene to the crop that is offered

Run = Callable[[Callable[[], object]], None]
"""Runs an action, shows what it changed, or why it could not."""

Entry = tuple[str, str | None, str | None, Callable[[], object]]
"""A button in a row: name, key, modifier, and what it does."""


class Controls:
    """Builds the panel, and keeps its fields at the labelling's state.

    Args:
        gui: viser's.
        labelling: what the controls act on.
        run: wraps every action.
        save: saves; its argument says whether the published pair is written too.
        level: height above which the view is cut at first, m; None = it is not.
        has_splat: whether there is a splat to show.
        look: turns the browsers' views to the course.

    Attributes:
        chosen: index of the waypoint that is moved.
        click: the object that a click places, one of `CLICKS`.
        by_name: all buttons and keys, by their labels.
        place: the tabs of the scene itself.
    """

    def __init__(
        self,
        gui: Any,
        labelling: Labelling,
        run: Run,
        save: Callable[[bool], object],
        *,
        level: float | None = None,
        has_splat: bool = False,
        look: Callable[[], object] = lambda: None,
    ) -> None:
        self._gui = gui
        self._labelling = labelling
        self._panel = panel = ControlPanel(gui, run)
        self.by_name = panel.by_name
        self.chosen = 0
        # Where the scale is unknown, two markers come first.
        self.click = CLICKS[0] if labelling.state.to_scale else CLICKS[3]
        gui.add_markdown(_HELP)
        # Buttons, not lists and boxes: keys rest while the focus is in a field.
        panel.row(
            "Clicks (1 2 3 4 5)",
            *(
                (click, str(key), None, lambda click=click: self.set_click(click))
                for key, click in enumerate(CLICKS, 1)
            ),
        )
        self._clicks = gui.add_markdown("")
        panel.row(
            "Ctrl(+Shift)+Z",
            ("undo", "Z", "cmd/ctrl", labelling.undo),
            ("redo", "Z", "cmd/ctrl+shift", labelling.redo),
        )
        panel.button("Save (Ctrl+S)", lambda: save(False), "S", "cmd/ctrl", "green")
        panel.button(
            "Save with XML pair (Ctrl+Shift+S)", lambda: save(True), "S", "cmd/ctrl+shift", "gray"
        )
        self.status = gui.add_markdown("")
        self.chart = gui.add_html("")
        self.hints = gui.add_markdown("")
        self.place = SceneControls(
            panel,
            labelling,
            has_splat=has_splat,
            cuts=level is not None,
            click_floor=lambda: self.set_click(CLICKS[4]),
        )
        parts = [
            ("Trail", self._add_trail),
            ("Start", self._add_start),
            ("Scale", self.place.add_scale),
            ("Place", self.place.add_place),
            ("View", lambda: self.place.add_view(level, look)),
        ]
        if not labelling.state.to_scale:  # The first tab is the one that is open.
            parts.insert(0, parts.pop(2))
        tabs = gui.add_tab_group()
        for name, add in parts:
            with tabs.add_tab(name):
                add()

    def set_click(self, click: str) -> None:
        """Choose the object that a click places."""
        self.click = click

    def choose(self, step: int) -> None:
        """Choose the waypoint `step` further on, round and round."""
        self.chosen = (self.chosen + step) % max(len(self._labelling.state.waypoints), 1)

    def tell(self, text: str) -> None:
        """Show what came of an action, and whether there is something to save."""
        unsaved = "" if self._labelling.is_saved else "● Not saved yet."
        self.status.content = "\n\n".join(line for line in (text, unsaved) if line)

    def refresh(self) -> None:
        """Bring all fields to the labelling's state."""
        labelling, state = self._labelling, self._labelling.state
        count = len(state.waypoints)
        self.chosen = min(max(self.chosen, 0), max(count - 1, 0))
        self._clicks.content = f"A click {_PUTS[self.click]}."
        chosen = f"waypoint **{self.chosen + 1}** of {count} is chosen (blue)"
        self._waypoint.content = f"Task **{state.task}**; {chosen if count else 'no waypoint yet'}."
        keep(self._yaw, round(math.degrees(labelling.start.yaw), 1))
        self.place.refresh()

    def _add_trail(self) -> None:
        labelling, panel, gui = self._labelling, self._panel, self._gui
        self._waypoint = gui.add_markdown("")
        if labelling.place.cameras:
            panel.button("Propose where the camera walked (P)", labelling.propose_along_walk, "P")
            panel.button("Propose along my waypoints (O)", labelling.propose_along_trail, "O")
        else:
            panel.button("Propose along my waypoints (P)", labelling.propose_along_trail, "P")
        panel.row(
            "Edit (N F X)",
            ("add 1 m on", "N", None, self._add_waypoint),
            ("next", "F", None, lambda: self.choose(1)),
            ("remove", "X", None, lambda: labelling.remove_waypoint(self.chosen)),
        )
        panel.row(
            "Order (G H)",
            ("earlier", "G", None, lambda: self._reorder(-1)),
            ("later", "H", None, lambda: self._reorder(1)),
        )
        panel.arrows(
            "Move",
            "IKJL",
            lambda x, y: labelling.nudge_waypoint(self.chosen, x * step.value, y * step.value),
        )
        step = gui.add_number("by, m", 0.1, min=0.001, max=5.0, step=0.01)
        panel.row(
            "Put there (T M)",
            ("start", "T", None, lambda: self._at_chosen(labelling.start_at_waypoint)),
            ("marker", "M", None, lambda: self._at_chosen(labelling.mark_waypoint)),
        )
        panel.row(
            "Task",
            *(
                (task, None, None, lambda task=task: labelling.set_task(task))
                for task in get_args(Task)
            ),
        )

    def _add_start(self) -> None:
        labelling, panel, gui = self._labelling, self._panel, self._gui
        self._yaw = gui.add_number("Heading, degrees", 0.0, min=-360.0, max=360.0, step=5.0)
        panel.on_change(self._yaw, lambda: labelling.set_yaw(math.radians(self._yaw.value)))
        panel.button("1 m before the course (B)", labelling.start_before_trail, "B")
        panel.arrows("Move", "", lambda x, y: labelling.nudge_start(x * step.value, y * step.value))
        step = gui.add_number("by, m", 0.1, min=0.001, max=5.0, step=0.01)

    def _add_waypoint(self) -> None:
        self._labelling.add_waypoint()
        self.chosen = len(self._labelling.state.waypoints) - 1

    def _reorder(self, step: int) -> None:
        self._labelling.reorder_waypoint(self.chosen, self.chosen + step)
        self.chosen += step

    def _at_chosen(self, action: Callable[[int], object]) -> object:
        return action(self.chosen)


class SceneControls:
    """Three tabs: scale, place and view.

    Args:
        panel: the panel that they are added to.
        labelling: the labelling that they change.
        has_splat: whether there is one to show.
        cuts: whether the view is cut at a level at first.
        click_floor: lets clicks put points on the floor.

    Attributes:
        shows_splat, shows_mesh: whether it is seen.
    """

    def __init__(
        self,
        panel: ControlPanel,
        labelling: Labelling,
        *,
        has_splat: bool,
        cuts: bool,
        click_floor: Callable[[], object],
    ) -> None:
        self._panel = panel
        self._labelling = labelling
        self._lies: object = None
        self.shows_splat, self.shows_mesh = has_splat, not has_splat
        self._cuts = cuts
        self._click_floor = click_floor
        self._measured: float | None = None
        self._bounds: tuple[Point, Point] | None = None

    @property
    def preview(self) -> CropBox | None:
        """The crop that is being typed; None if none is, or where it would hold nothing."""
        low, high = self._low.value, self._high.value
        if (low, high) == self._bounds or not all(a < b for a, b in zip(low, high, strict=True)):
            return None
        return CropBox(low=low, high=high)

    @property
    def cutaway(self) -> Cutaway:
        """The part of the scene that is shown."""
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
            self._distance.content = f"The markers are **{labelling.distance_words}** apart."
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

    def add_scale(self) -> None:
        """Add the fields and buttons of the scale to the tab that is open."""
        labelling, panel = self._labelling, self._panel
        self._distance = panel.gui.add_markdown("")
        self._metres = panel.gui.add_number(
            "It is really, m", 1.0, min=0.001, max=1000.0, step=0.001
        )
        panel.button("Scale the scene", lambda: labelling.scale_to(self._metres.value))
        panel.button("Clear markers", labelling.clear_markers)
        panel.row(
            "The scan's unit is",
            *(
                (unit, None, None, lambda unit=unit: labelling.set_unit(unit))
                for unit in get_args(Unit)
            ),
        )

    def add_place(self) -> None:
        """Add what turns, moves and crops the scene to the tab that is open."""
        labelling, panel, gui = self._labelling, self._panel, self._panel.gui
        panel.button("Three clicks on the floor (5)", self._click_floor)
        panel.button("Flip upside down", labelling.flip)
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

    def add_view(self, level: float | None, look: Callable[[], object]) -> None:
        """Add the controls of the view to the open tab."""
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
        gui.add_markdown("Hidden parts are saved, too.")

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


class ControlPanel:
    """Adds buttons to viser's panel, all of them in the list of commands too (Ctrl+K).

    Args:
        gui: viser's.
        run: wraps every action.

    Attributes:
        by_name: the controls by label.
    """

    def __init__(self, gui: Any, run: Run) -> None:
        self.gui = gui
        self._run = run
        self.by_name: dict[str, Any] = {}

    def row(self, label: str, *entries: Entry) -> None:
        """Add buttons side by side."""
        group = self.gui.add_button_group(label, [name for name, *_ in entries])
        actions = {name: action for name, _, _, action in entries}
        group.on_click(lambda _: self._run(actions[group.value]))
        for name, key, modifier, action in entries:
            self.by_name[f"{label}: {name}"] = group
            self.command(f"{label}: {name}", key, modifier, action)

    def arrows(self, label: str, keys: str, move: Callable[[float, float], object]) -> None:
        """Add buttons along x and y of the world, with keys in this order, or none."""
        ways = (("+x", 1, 0), ("-x", -1, 0), ("+y", 0, 1), ("-y", 0, -1))
        self.row(
            f"{label} ({' '.join(keys)})" if keys else label,
            *(
                (name, keys[i] if keys else None, None, lambda x=x, y=y: move(x, y))
                for i, (name, x, y) in enumerate(ways)
            ),
        )

    def button(
        self,
        label: str,
        action: Callable[[], object],
        key: str | None = None,
        modifier: str | None = None,
        color: str | None = None,
    ) -> None:
        """Add a button."""
        button = self.gui.add_button(label, color=color)
        button.on_click(lambda _: self._run(action))
        self.by_name[label] = button
        self.command(label, key, modifier, action)

    def command(
        self, label: str, key: str | None, modifier: str | None, action: Callable[[], object]
    ) -> None:
        """Add a command, with a key or without one."""
        command = self.gui.add_command(label, hotkey=key, modifier=modifier)
        command.on_trigger(lambda _: self._run(action))
        self.by_name[f"key {label}"] = command

    def on_change(self, field: Any, action: Callable[[], object]) -> None:
        """Do something when somebody changes a field."""
        # A field that the page itself sets has no client; it only follows the state.
        field.on_update(lambda event: self._run(action) if event.client_id is not None else None)


def keep(field: Any, value: object) -> None:
    """Bring a field to a value."""
    if field.value != value:
        field.value = value
