"""Robots: listed, explained, drafted from a model file, stood on the ground."""

from __future__ import annotations

import os
import shutil
from base64 import b64decode
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.api.paths import as_path

if TYPE_CHECKING:
    from os import PathLike

    from nw_sim.probe.robot_check import CheckedRobot, RobotSummary


@dataclass(frozen=True, kw_only=True)
class ListedRobot:
    """A robot that suites can name."""

    name: str
    joints: int
    """Those that are driven."""
    feet: int
    mass: float
    """kg."""
    height: float
    """Of the root above the ground in its pose, m."""
    place: str
    """The folder or package that it is of; `nw-eval` for a built-in one."""
    problem: str | None = None
    """Why it cannot be used; its numbers are 0 then."""


@dataclass(frozen=True, kw_only=True)
class RobotDraft:
    """A first robot.yaml for a model file, as it was written."""

    file: Path
    text: str
    to_check: int
    """How many lines a person has to look at, marked CHECK."""
    stands: bool
    """Whether the robot stood for 2 s; with fewer than three feet, held upright."""


def list_robots() -> tuple[ListedRobot, ...]:
    """Return the built-in robots, those in `robots/` of the working directory, and of packages."""
    from nw_base.errors import NwEvalError
    from nw_scenes.robots import find_robot, robot_names
    from nw_scenes.robots.standing import LevelGround
    from nw_sim.probe.robot_check import place_of

    robots: list[ListedRobot] = []
    for name in robot_names():
        try:
            robot = find_robot(name)
            spec = robot.spec
            robots.append(
                ListedRobot(
                    name=name,
                    joints=len(spec.joints),
                    feet=len(spec.feet),
                    mass=LevelGround(spec).mass,
                    height=spec.spawn_height,
                    place=place_of(robot),
                )
            )
        except NwEvalError as error:
            robots.append(
                ListedRobot(
                    name=name, joints=0, feet=0, mass=0.0, height=0.0, place="", problem=str(error)
                )
            )
    return tuple(robots)


def show_robot(robot: str) -> RobotSummary:
    """Return all that is known of a robot, and which line says what.

    Args:
        robot: a name, or a folder with a robot.yaml.

    Raises:
        UsageError: there is no such robot.
        RobotError: its folder or package cannot be used.
    """
    from nw_scenes.robots import find_robot
    from nw_sim.probe.robot_check import summary_of

    return summary_of(find_robot(robot))


def init_robot(model: str | PathLike[str], *, out: str | PathLike[str] | None = None) -> RobotDraft:
    """Derive a first robot.yaml from a model file, and drop the robot for 2 s.

    It is written beside the model, or into the folder above that holds model and meshes.

    Args:
        model: MJCF (.xml) or URDF (.urdf).
        out: a new folder for copies of model and meshes and for robot.yaml, which gives the robot
            its name; parent folders are created.

    Raises:
        RobotError: the model is no robot that can be driven.
        UsageError: there is no such model; there is a robot.yaml, or `out`, already.
        StoreError: it cannot be written.
    """
    from nw_base.errors import UsageError
    from nw_base.files.cache import atomic_path, check_place, followed
    from nw_base.files.inside import what_is
    from nw_policies.drafting.notation import lines_to_check
    from nw_scenes.robots.kept import keep
    from nw_scenes.robots.robot_file import ROBOT_FILE
    from nw_sim.probe.robot_draft import draft_robot

    model = as_path(model)
    out = as_path(out)
    if out is not None and os.path.lexists(out):
        raise UsageError(f"{out} exists already", fix="move it away, or name another with --out")
    if out is not None:
        check_place(out)
    beside = model.parent / ROBOT_FILE
    if out is None and what_is(beside) != "nothing":
        raise UsageError(f"{beside} exists already", fix="move it away, or give --out FOLDER")
    # A project's robot is named by its folder, and a card by the robot's name: they are one.
    draft, root = draft_robot(model, name="" if out is None else out.name)
    file = (root if out is None else out) / ROBOT_FILE
    if out is None and what_is(file) != "nothing":
        raise UsageError(f"{file} exists already", fix="move it away, or give --out FOLDER")
    if out is not None:
        _copy(root, draft.files, out)
    with atomic_path(followed(file)) as temporary:
        temporary.write_text(draft.text, encoding="utf-8")
    with suppress(ValueError):
        keep(file.parent, (ROBOT_FILE, *draft.files), b64decode(draft.kept))
    to_check = lines_to_check(draft.text)
    return RobotDraft(file=file, text=draft.text, to_check=to_check, stands=draft.stands)


def _copy(root: Path, files: tuple[str, ...], out: Path) -> None:
    """Copy files of a folder into a new one, which appears by one rename."""
    from nw_base.files.cache import new_folder
    from nw_base.files.inside import inside

    with new_folder(out) as folder:
        for name in files:
            target = inside(folder, name)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(inside(root, name), target)


def check_robot(robot: str, *, out: str | PathLike[str] | None = None) -> CheckedRobot:
    """Stand a robot on level ground for 2 s in its pose, with its gains, in a confined process.

    Args:
        robot: a name, or a folder with a robot.yaml.
        out: the PNG to write: the robot from outside and through its camera.

    Raises:
        UsageError: there is no such robot.
        RobotError: its folder cannot be used.
        StoreError: the picture cannot be written.
    """
    from nw_base.files.cache import atomic_path, followed
    from nw_sim.probe import robot_check

    out = as_path(out)
    if out is not None:
        followed(out)  # What can never be written is said before anything is simulated.
    checked, picture = robot_check.check_robot(robot)
    if out is not None:
        with atomic_path(followed(out)) as temporary:
            temporary.write_bytes(picture)
    return checked
