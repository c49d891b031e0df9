"""Sheets of pictures: a trial at six moments, and scenes from the robot's eye and from outside."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

from nw_eval.cache import atomic_path
from nw_eval.errors import StoreError
from nw_eval.robots import get_robot
from nw_eval.rollout.clock import StageClock
from nw_eval.rollout.library import Library
from nw_eval.rollout.prepare import open_trial
from nw_eval.rollout.third_person import Spectator
from nw_eval.sim import World
from nw_eval.splat.render import open_renderer
from nw_eval.splat.store import open_store

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from nw_eval.rollout.replay import Recording
    from nw_eval.scenes import Scene

Bytes = NDArray[np.uint8]

_MOMENTS = 6
_VIEW = (400, 225)
_EGO = "ego"
_ROBOT = "go1"
_LABEL = 22  # pixels
_SETTLING = 40  # control steps until a robot that was put down stands


def contact_sheet(recording: Recording) -> bytes:
    """Draw a recorded trial at six moments: from outside, and what the robot's camera saw.

    Returns:
        A PNG.

    Raises:
        StoreError: the log has no states.
    """
    states = recording.log.states()
    if not states:
        raise StoreError(f"{recording.path} has no recorded states", fix="run the trial again")
    chosen = np.unique(np.linspace(0, len(states) - 1, _MOMENTS).round().astype(int))
    width, height = _VIEW
    columns: list[tuple[str, list[Bytes]]] = []
    with open_trial(recording.job, Library(), StageClock()) as trial:
        spectator = Spectator(trial.scene, trial.renderer())
        world, trail = trial.episode.world, trial.episode.progress.waypoints
        for index in chosen:
            trial.episode.restore(states[index])
            progress = trial.episode.progress
            label = f"{world.time:.2f} s, {progress.reached} of {progress.total} waypoints"
            views = [
                spectator.beside(world, trail, width=width, height=height),
                spectator.aboard(world, trail, _EGO, width=width, height=height),
            ]
            columns.append((label, views))
    return _drawn(columns, rows=2, across=len(columns) // 2 or 1)


def write_scene_sheet(scenes: Sequence[Scene], path: Path, *, width: int = 480) -> None:
    """Draw each scene twice: from outside, and through the camera of a Go1 at its start.

    Raises:
        StoreError: the picture cannot be written.
    """
    height = width * 9 // 16
    cells: list[tuple[str, list[Bytes]]] = []
    robot = get_robot(_ROBOT)
    for scene in scenes:
        spectator = Spectator(scene, open_renderer(open_store(scene.splat_store()), "cpu"))
        with World(robot, scene) as world:
            for _ in range(_SETTLING):
                world.step(robot.default_pose)
            views = [
                spectator.beside(world, scene.trail, width=width, height=height),
                spectator.aboard(world, scene.trail, _EGO, width=width, height=height),
            ]
        cells.append((f"{scene.name}: {scene.title}", views))
    write_picture(_drawn(cells, rows=2, across=max(1, round(len(cells) ** 0.5))), path)


def write_picture(picture: bytes, path: Path) -> None:
    """Write a PNG to a file, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(picture)


def _drawn(cells: list[tuple[str, list[Bytes]]], *, rows: int, across: int) -> bytes:
    """Return a PNG of cells in a grid: each has a label and `rows` views below one another."""
    view_height, view_width, _ = cells[0][1][0].shape
    cell_height = _LABEL + rows * view_height
    down = -(-len(cells) // across)
    sheet = PillowImage.new("RGB", (across * view_width, down * cell_height), "white")
    for number, (label, views) in enumerate(cells):
        x, y = number % across * view_width, number // across * cell_height
        sheet.paste(_label(label, view_width), (x, y))
        for row, view in enumerate(views):
            sheet.paste(PillowImage.fromarray(view), (x, y + _LABEL + row * view_height))
    with BytesIO() as file:
        sheet.save(file, format="PNG", optimize=True)
        return file.getvalue()


def _label(text: str, width: int) -> PillowImage.Image:
    """Return a strip of text, cut off with an ellipsis where it does not fit."""
    strip = PillowImage.new("RGB", (width, _LABEL), "white")
    font = ImageFont.load_default(size=_LABEL - 8)
    room, cut = width - 12, text
    while cut and font.getlength(cut if cut == text else f"{cut}...") > room:
        cut = cut[:-1]
    shown = text if cut == text else f"{cut}..."
    ImageDraw.Draw(strip).text((6, 3), shown, fill="black", font=font)
    return strip
