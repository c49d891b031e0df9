"""The page's panel: what to do, what was done, and a tab for each thing that can be changed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, get_args

from nw_eval.twin.label.labelling import Labelling
from nw_eval.twin.label.page.panel import ControlPanel, Run, keep
from nw_eval.twin.label.page.place_controls import PlaceControls
from nw_eval.words import Task

CLICKS = ("waypoint", "chosen", "start", "marker")
_PUTS = {
    "waypoint": "adds a **waypoint**",
    "chosen": "moves the **chosen waypoint** (blue)",
    "start": "sets the **start**",
    "marker": "puts a **marker**, to measure",
}

_HELP = """\
1. Click waypoints on the ground, in order, or let a trail be proposed (P).
2. Look at the start (green box) and at the hints.
3. Save.

Drag turns the view, right drag shifts it, the wheel zooms. Shortcuts are shown in brackets;
they are off while you type. Ctrl+K lists all.
"""


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
        click: what a click puts, one of `CLICKS`.
        by_name: all buttons and keys, by their labels.
        place: the tabs of the place itself.
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
        self.click = CLICKS[0]
        gui.add_markdown(_HELP)
        # Buttons, not lists and boxes: keys rest while the focus is in a field.
        panel.row(
            "Clicks (1 2 3 4)",
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
        tabs = gui.add_tab_group()
        with tabs.add_tab("Trail"):
            self._add_trail()
        with tabs.add_tab("Start"):
            self._add_start()
        self.place = PlaceControls(
            panel, labelling, tabs, level=level, has_splat=has_splat, look=look
        )

    def set_click(self, click: str) -> None:
        """Choose what a click puts."""
        self.click = click

    def choose(self, step: int) -> None:
        """Choose the waypoint `step` further on, round and round."""
        self.chosen = (self.chosen + step) % max(len(self._labelling.state.waypoints), 1)

    def tell(self, words: str) -> None:
        """Show what came of an action, and whether there is something to save."""
        unsaved = "" if self._labelling.is_saved else "● Not saved yet."
        self.status.content = "\n\n".join(line for line in (words, unsaved) if line)

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
        self._yaw = gui.add_number("Looks, degrees", 0.0, min=-360.0, max=360.0, step=5.0)
        panel.on_change(self._yaw, lambda: labelling.set_yaw(math.radians(self._yaw.value)))
        panel.button("1 m before the trail (B)", labelling.start_before_trail, "B")
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
