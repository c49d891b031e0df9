"""The page's panel: five folders in the order of work, each button with its key."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, get_args

from nw_eval.twin.label.crop import CropBox
from nw_eval.twin.label.labelling import Labelling
from nw_eval.twin.label.placement import Axis, Point
from nw_eval.words import Task

Run = Callable[[Callable[[], object]], None]
"""Runs an action, shows what it changed, or why it could not."""

Entry = tuple[str, str | None, str | None, Callable[[], object]]
"""A button in a row: name, key, modifier, and what it does."""

CLICKS = ("add waypoint", "move waypoint", "start", "marker")

_HELP = (
    "**A click** on the place puts what is chosen here. Drag turns the view, right drag shifts it. "
    "**Keys**: those in brackets; Ctrl+K lists all; Tab goes from field to field."
)


class Controls:
    """Builds the panel, and keeps its fields at the labelling's state.

    Args:
        gui: viser's.
        labelling: what the controls act on.
        run: wraps every action.
        save: saves; its argument says whether the published pair is written too.

    Attributes:
        chosen: index of the waypoint that `move waypoint` and the trail's buttons act on.
    """

    def __init__(
        self, gui: Any, labelling: Labelling, run: Run, save: Callable[[bool], object]
    ) -> None:
        self._gui = gui
        self._labelling = labelling
        self._run = run
        self._save = save
        self.chosen = 0
        self.by_name: dict[str, Any] = {}
        gui.add_markdown(_HELP)
        self._click = gui.add_dropdown("A click puts", CLICKS, initial_value=CLICKS[0])
        for key, click in enumerate(CLICKS, 1):
            self._command(
                f"A click puts: {click}", str(key), None, lambda click=click: self.set_click(click)
            )
        self._row(
            "Ctrl(+Shift)+Z",
            ("undo", "Z", "cmd/ctrl", labelling.undo),
            ("redo", "Z", "cmd/ctrl+shift", labelling.redo),
        )
        self._button("Save (Ctrl+S)", self._save_all, "S", "cmd/ctrl", "green")
        self.status = gui.add_markdown("")
        self._add_trail()
        self._add_start()
        self._add_scale()
        self._add_place()
        self._add_save()

    @property
    def click(self) -> str:
        """What a click puts: one of `CLICKS`."""
        return self._click.value

    def set_click(self, click: str) -> None:
        """Choose what a click puts."""
        self._click.value = click

    def refresh(self) -> None:
        """Bring all fields to the labelling's state."""
        labelling, state = self._labelling, self._labelling.state
        count = len(state.waypoints)
        self.chosen = min(max(self.chosen, 0), max(count - 1, 0))
        self._waypoint.content = (
            f"Waypoint **{self.chosen + 1}** of {count} is chosen (blue)."
            if count
            else "No waypoint yet: click on the ground."
        )
        _keep(self._task, state.task)
        _keep(self._yaw, round(math.degrees(labelling.start.yaw), 1))
        distance = labelling.distance
        self._distance.content = (
            "Put two markers (3) where you know the distance."
            if distance is None
            else f"The markers are **{distance:.3f} m** apart."
        )

    def choose(self, step: int) -> None:
        """Choose the waypoint `step` further on, round and round."""
        self.chosen = (self.chosen + step) % max(len(self._labelling.state.waypoints), 1)

    # The folders.

    def _add_trail(self) -> None:
        labelling = self._labelling
        with self._gui.add_folder("1 Trail"):
            self._task = self._gui.add_dropdown(
                "Task", get_args(Task), initial_value=labelling.state.task
            )
            self._on_change(self._task, lambda: labelling.set_task(self._task.value))
            if labelling.propose is not None:
                self._button("Propose a trail (P)", labelling.propose_trail, "P")
            self._waypoint = self._gui.add_markdown("")
            self._row(
                "Edit (N F X)",
                ("add 1 m on", "N", None, self._add_waypoint),
                ("next", "F", None, lambda: self.choose(1)),
                ("remove", "X", None, lambda: labelling.remove_waypoint(self.chosen)),
            )
            self._row(
                "Order (G H)",
                ("earlier", "G", None, lambda: self._reorder(-1)),
                ("later", "H", None, lambda: self._reorder(1)),
            )
            self._arrows(
                "Move",
                "IKJL",
                lambda x, y: labelling.nudge_waypoint(self.chosen, x * step.value, y * step.value),
            )
            step = self._gui.add_number("by, m", 0.1, min=0.001, max=5.0, step=0.01)
            self.chart = self._gui.add_html("")
            self.hints = self._gui.add_markdown("")

    def _add_start(self) -> None:
        labelling = self._labelling
        with self._gui.add_folder("2 Start"):
            self._yaw = self._gui.add_number("Looks, degrees", 0.0, min=-360.0, max=360.0, step=5.0)
            self._on_change(self._yaw, lambda: labelling.set_yaw(math.radians(self._yaw.value)))
            self._button("1 m before the trail (B)", labelling.start_before_trail, "B")
            self._arrows(
                "Move", "", lambda x, y: labelling.nudge_start(x * step.value, y * step.value)
            )
            step = self._gui.add_number("by, m", 0.1, min=0.001, max=5.0, step=0.01)

    def _add_scale(self) -> None:
        labelling = self._labelling
        with self._gui.add_folder("3 Scale", expand_by_default=False):
            self._distance = self._gui.add_markdown("")
            metres = self._gui.add_number("It is really, m", 1.0, min=0.001, max=1000.0, step=0.001)
            self._button("Scale the place", lambda: labelling.scale_to(metres.value))
            self._button("Clear markers", labelling.clear_markers)

    def _add_place(self) -> None:
        labelling, gui = self._labelling, self._gui
        with gui.add_folder("4 Place", expand_by_default=False):
            self.splat = gui.add_checkbox("Show the splat", initial_value=True)
            self.mesh = gui.add_checkbox("Show the mesh", initial_value=True)
            for shown in (self.splat, self.mesh):
                self._on_change(shown, lambda: None)
            angle = gui.add_number("Turn by, degrees", 5.0, min=0.01, max=180.0, step=0.1)
            axes: tuple[tuple[str, Axis], ...] = (("Turn", "z"), ("Tilt x", "x"), ("Tilt y", "y"))
            for label, axis in axes:

                def by(sign: int, axis: Axis = axis) -> None:
                    labelling.turn(axis, sign * math.radians(angle.value))

                self._row(
                    label,
                    ("left", None, None, lambda by=by: by(1)),
                    ("right", None, None, lambda by=by: by(-1)),
                )
            offset = gui.add_vector3("Shift by, m", (0.0, 0.0, 0.0), step=0.01)
            self._button("Shift", lambda: labelling.shift(*offset.value))
            vertices = labelling.mesh.vertices
            low = gui.add_vector3("Crop from, m", _rounded(vertices.min(axis=0) - 0.01), step=0.01)
            high = gui.add_vector3("Crop to, m", _rounded(vertices.max(axis=0) + 0.01), step=0.01)
            self._button("Crop", lambda: labelling.crop_to(CropBox(low=low.value, high=high.value)))
            self._button("Take the crop back", lambda: labelling.crop_to(None))

    def _add_save(self) -> None:
        with self._gui.add_folder("5 Save", expand_by_default=False):
            self._pair = self._gui.add_checkbox("Also the XML pair", initial_value=False)

    def _save_all(self) -> object:
        return self._save(self._pair.value)

    # What they are made of.

    def _add_waypoint(self) -> None:
        self._labelling.add_waypoint()
        self.chosen = len(self._labelling.state.waypoints) - 1

    def _reorder(self, step: int) -> None:
        self._labelling.reorder_waypoint(self.chosen, self.chosen + step)
        self.chosen += step

    def _arrows(self, label: str, keys: str, move: Callable[[float, float], object]) -> None:
        """Add buttons along x and y of the world, and keys for them in this order."""
        ways = (("+x", 1, 0), ("-x", -1, 0), ("+y", 0, 1), ("-y", 0, -1))
        self._row(
            f"{label} ({' '.join(keys)})" if keys else label,
            *(
                (name, keys[i] if keys else None, None, lambda x=x, y=y: move(x, y))
                for i, (name, x, y) in enumerate(ways)
            ),
        )

    def _row(self, label: str, *entries: Entry) -> None:
        """Add buttons side by side, each with its key."""
        group = self._gui.add_button_group(label, [name for name, *_ in entries])
        actions = {name: action for name, _, _, action in entries}
        group.on_click(lambda _: self._run(actions[group.value]))
        for name, key, modifier, action in entries:
            self.by_name[f"{label}: {name}"] = group
            if key is not None:
                self._command(f"{label}: {name}", key, modifier, action)

    def _button(
        self,
        label: str,
        action: Callable[[], object],
        key: str | None = None,
        modifier: str | None = None,
        color: str | None = None,
    ) -> None:
        button = self._gui.add_button(label, color=color)
        button.on_click(lambda _: self._run(action))
        self.by_name[label] = button
        if key is not None:
            self._command(label, key, modifier, action)

    def _command(
        self, label: str, key: str, modifier: str | None, action: Callable[[], object]
    ) -> None:
        command = self._gui.add_command(label, hotkey=key, modifier=modifier)
        command.on_trigger(lambda _: self._run(action))
        self.by_name[f"key {label}"] = command

    def _on_change(self, field: Any, action: Callable[[], object]) -> None:
        # A field that the page itself sets has no client; it only follows the state.
        field.on_update(lambda event: self._run(action) if event.client_id is not None else None)


def _keep(field: Any, value: object) -> None:
    if field.value != value:
        field.value = value


def _rounded(values: Any) -> Point:
    x, y, z = (round(float(value), 2) for value in values)
    return x, y, z
