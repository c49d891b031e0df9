"""Sheets of pictures: a trial at six moments, and scenes from the robot's eye and from outside."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import StoreError
from nw_eval.files.cache import atomic_path, followed
from nw_eval.robots import get_robot
from nw_eval.rollout.library import Library
from nw_eval.rollout.prepare import open_trial
from nw_eval.rollout.replaying.third_person import Spectator
from nw_eval.rollout.result import StageClock
from nw_eval.sensors.drawing.sheet import Cell, draw_sheet
from nw_eval.sim import World
from nw_eval.splat.render import open_renderer
from nw_eval.splat.store import open_store

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from nw_eval.rollout.replaying.logged import LoggedTrial
    from nw_eval.scenes import Scene

_MOMENTS = 6
_VIEW = (400, 225)
_EGO = "ego"
_ROBOT = "go1"
_SETTLING = 40  # control steps until a robot that was put down stands


def contact_sheet(logged: LoggedTrial) -> bytes:
    """Draw a recorded trial at six moments: from outside, and what the robot's camera saw.

    Returns:
        A PNG.

    Raises:
        StoreError: the log has no states.
    """
    states = logged.log.states()
    if not states:
        raise StoreError(f"{logged.path} has no recorded states", fix="run the trial again")
    chosen = np.unique(np.linspace(0, len(states) - 1, _MOMENTS).round().astype(int))
    width, height = _VIEW
    cells: list[Cell] = []
    with open_trial(logged.job, Library(), StageClock()) as trial:
        splat = None if trial.scene.splat is None else trial.shown()
        spectator = Spectator(trial.scene, splat)
        drawn = _as_drawn(trial.scene)
        world, trail = trial.episode.world, trial.episode.task.goal.waypoints
        for index in chosen:
            trial.episode.restore(states[index])
            label = f"{world.time:.2f} s, {trial.episode.task.standing}"
            views = [
                spectator.beside(world, trail, width=width, height=height),
                spectator.aboard(world, trail, _EGO, width=width, height=height),
            ]
            cells.append(Cell(name=label, images=views))
    return draw_sheet(cells, across=len(cells) // 2 or 1, title=_title(logged, drawn))


def write_scene_sheet(scenes: Sequence[Scene], path: Path, *, width: int = 480) -> None:
    """Draw each scene twice: from outside, and through the camera of a Go1 at its start.

    Raises:
        StoreError: the picture cannot be written.
    """
    cells = [
        Cell(
            name=scene.name,
            caption=f"{scene.title}{_as_drawn(scene)}",
            images=scene_views(scene, width=width),
        )
        for scene in scenes
    ]
    picture = draw_sheet(cells, across=max(1, round(len(cells) ** 0.5)))
    with atomic_path(followed(path)) as temporary:
        temporary.write_bytes(picture)


def scene_views(scene: Scene, *, width: int) -> list[NDArray[np.uint8]]:
    """Return a scene from outside, and through the camera of a Go1 at its start.

    Args:
        scene: its splat, or its mesh if it has none.
        width: of each view (H, W, 3), pixels; 16 to 9.
    """
    height = width * 9 // 16
    splat = None
    if scene.splat is not None:
        splat = open_renderer(open_store(scene.splat_store()), projection="ray")
    spectator, robot = Spectator(scene, splat), get_robot(_ROBOT)
    with World(robot, scene) as world:
        for _ in range(_SETTLING):
            world.step(robot.standing_targets)
        return [
            spectator.beside(world, scene.trail, width=width, height=height),
            spectator.aboard(world, scene.trail, _EGO, width=width, height=height),
        ]


def _as_drawn(scene: Scene) -> str:
    return "" if scene.splat is not None else " (no splat: its mesh is drawn)"


def _title(logged: LoggedTrial, drawn: str) -> str:
    """Return which trial this was and how it ended."""
    verdict, job = logged.verdict, logged.job
    end = verdict.get("outcome") or verdict.get("error_type") or "no outcome"
    reason = verdict.get("end_reason") or verdict.get("error_text")
    end = f"{end} ({reason})" if reason else end
    trial = f"{job.trial.scene}, trial {job.trial.index:03d}"
    return f"{trial} of {job.policy_name or job.policy}: {end}{drawn}"
