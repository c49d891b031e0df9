"""The panel of the live page: run, push, perturb, stand in the way, save."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.suite.perturb import NEUTRAL, UNITS

if TYPE_CHECKING:
    from nw_eval.view.live.stage import Stage

_BUILT_FRICTION = 1.25
_RANGES = {
    "friction": (0.05, 1.5, 0.05),
    "payload": (0.0, 10.0, 0.25),
    "push": (0.0, 2.0, 0.1),
    "strength": (0.3, 1.5, 0.05),
    "latency": (0.0, 0.2, 0.02),
    "noise": (0.0, 0.5, 0.01),
    "exposure": (0.1, 3.0, 0.1),
    "fog": (0.0, 1.0, 0.05),
    "camera_pitch": (-0.5, 0.5, 0.01),
    "camera_height": (-0.2, 0.2, 0.01),
    "field_of_view": (0.5, 1.5, 0.05),
    "missing_cones": (0.0, 1.0, 0.1),
}
"""Least, most and step of each axis of perturbation: within what a suite may name."""
_WAYS = {"ahead": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}


@dataclass(frozen=True, kw_only=True)
class Doings:
    """What the panel's buttons do.

    Attributes:
        run: go on, or stop.
        step: make one control step.
        restart: begin again.
        act: do something to the stage between two control steps.
        perturb: set an axis of perturbation.
        save: write what was done into a folder.
        show_mesh: show the mesh of the place, or its splat alone.
    """

    run: Callable[[], None]
    step: Callable[[], None]
    restart: Callable[[], None]
    act: Callable[[Callable[[Stage], None]], None]
    perturb: Callable[[str, float], None]
    save: Callable[[Path], None]
    show_mesh: Callable[[bool], None]


class LivePanel:
    """Draws the controls.

    Args:
        gui: viser's, empty.
        heading: what runs, and where.
        axes: of perturbation that the policy can feel.
        doings: what the buttons do.
        has_splat: of the place.
        save_to: the folder that is proposed.
    """

    def __init__(
        self,
        gui: Any,
        heading: str,
        *,
        axes: tuple[str, ...],
        doings: Doings,
        has_splat: bool,
        save_to: Path,
    ) -> None:
        gui.add_markdown(heading)
        self._status = gui.add_markdown("")
        self._run = gui.add_button("Play")
        self._run.on_click(lambda _: doings.run())
        gui.add_button("One step").on_click(lambda _: doings.step())
        gui.add_button("Start again").on_click(lambda _: doings.restart())
        if has_splat:
            mesh = gui.add_checkbox("Mesh", initial_value=False)
            mesh.on_update(lambda _: doings.show_mesh(mesh.value))
        self._ego = gui.add_image(np.zeros((9, 16, 3), np.uint8), label="What the policy sees")
        self._ego.visible = False
        with gui.add_folder("Push"):
            speed = gui.add_slider("m/s", min=0.1, max=2.0, step=0.1, initial_value=0.5)
            ways = gui.add_button_group("To", tuple(_WAYS))
            ways.on_click(lambda _: doings.act(_push(ways.value, speed.value)))
        with gui.add_folder("In its way"):
            gui.add_button("Drop a box").on_click(lambda _: doings.act(lambda s: s.drop_box()))
            gui.add_button("No boxes").on_click(lambda _: doings.act(lambda s: s.clear_boxes()))
            gui.add_markdown("Drag the arrows at the last waypoint to move the goal.")
        with gui.add_folder("Perturb"):
            for axis in axes:
                self._slider(gui, axis, doings)
        with gui.add_folder("Save"):
            folder = gui.add_text("Folder", str(save_to))
            gui.add_button("Save as a suite").on_click(lambda _: doings.save(Path(folder.value)))

    def status(self, words: str, *, runs: bool) -> None:
        """Say how things are."""
        self._status.content = words
        self._run.label = "Pause" if runs else "Play"

    def picture(self, image: NDArray[np.uint8]) -> None:
        """Show what the policy sees, (H, W, 3)."""
        self._ego.visible = True
        self._ego.image = image

    def _slider(self, gui: Any, axis: str, doings: Doings) -> None:
        least, most, step = _RANGES[axis]
        neutral = NEUTRAL[axis]
        unit = f", {UNITS[axis]}" if axis in UNITS else ""
        slider = gui.add_slider(
            f"{axis}{unit}",
            min=least,
            max=most,
            step=step,
            initial_value=_BUILT_FRICTION if neutral is None else neutral,
        )
        slider.on_update(lambda _: doings.perturb(axis, round(float(slider.value), 4)))


def _push(way: str, speed: float) -> Callable[[Stage], None]:
    ahead, left = _WAYS[way]
    return lambda stage: stage.push(speed * ahead, speed * left)
