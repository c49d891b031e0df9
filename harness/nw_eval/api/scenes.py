"""Scenes: listed, explained, checked, drawn, built ahead."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.api.paths import as_path
from nw_eval.api.renamed import keywords_were

if TYPE_CHECKING:
    from os import PathLike

    from nw_eval.engine.listener import Listener
    from nw_places.splits import Split
    from nw_scenes.finding import SceneFinding
    from nw_scenes.overview import SceneFigures
    from nw_sim.ladders import Ladder, Rung
    from nw_sim.survey import Survey
    from nw_sim.survey.legs import Fit


@dataclass(frozen=True, kw_only=True)
class ListedScene:
    """A scene that suites can name."""

    name: str
    title: str
    waypoints: int
    split: Split | None
    """Which half of the built-in scenes it is of; None for any other scene."""
    fit: Fit | None = None
    """What it asks of a robot's legs; None where no robot was asked for."""


@dataclass(frozen=True, kw_only=True)
class CheckedScene:
    """What is wrong with a scene."""

    reference: str
    """The name or the folder that was asked about."""
    findings: tuple[SceneFinding, ...]
    """Errors first; none if nothing is worth saying."""
    survey: Survey | None
    """What was measured along its course; None where errors came before."""

    @property
    def has_errors(self) -> bool:
        """Whether results of this scene would mean nothing."""
        from nw_scenes.finding import has_errors

        return has_errors(self.findings)


@dataclass(frozen=True, kw_only=True)
class WarmUp:
    """What was made ahead of the first run."""

    kernel_seconds: float
    """To compile the kernels, or to load them from the cache."""
    scenes: tuple[str, ...]
    """Whose splats are built now."""


def list_scenes(
    patterns: Sequence[str] = (), *, robot: str | None = None
) -> tuple[ListedScene, ...]:
    """Return the scenes that match one of some globs; all built-in ones without any.

    Args:
        patterns: names or globs (default: all built-in scenes).
        robot: show the steps and gaps of each scene that this robot's legs must pass.

    Raises:
        SceneError: a pattern matches nothing.
        UsageError: there is no such robot.
    """
    from nw_places.splits import split_of
    from nw_scenes.robots import get_robot
    from nw_sim.catalogue import match_scenes

    fit = None
    if robot is not None:
        from nw_sim.survey.legs import fit_of, legs_of

        fit = partial(fit_of, legs=legs_of(get_robot(robot)))

    return tuple(
        ListedScene(
            name=scene.name,
            title=scene.title,
            waypoints=len(scene.trail),
            split=split_of(scene.name),
            fit=None if fit is None else fit(scene),
        )
        for scene in match_scenes(tuple(patterns) or ("*",))
    )


def ladders(names: Sequence[str] = ()) -> tuple[Ladder, ...]:
    """Return ladders: scenes, perturbations and commands that grow harder by one number.

    Args:
        names: ladders, folders with a `ladder.yaml`, `SCENE+AXIS`, `SCENE+speed` or
            `SCENE+turn_rate` (default: all built-in ladders and those of packages).

    Raises:
        SceneError: there is no such ladder, or it cannot be read.
        PluginError: a package's ladder or axis cannot be imported.
        FetchError, PrerequisiteError, StoreError: its scene cannot be fetched.
    """
    from nw_sim import ladders as known

    return tuple(known.ladder_named(name) for name in names) or known.ladders()


def rungs_of(name: str) -> tuple[Rung, ...]:
    """Return the rungs of a ladder from easy to hard: value, scene, and what is changed there.

    Args:
        name: of the ladder, as of `ladders`.

    Raises:
        SceneError, PluginError, FetchError, PrerequisiteError, StoreError: as `ladders`.
    """
    return ladders([name])[0].rungs


def show_scene(reference: str, *, out: str | PathLike[str] | None = None) -> SceneFigures:
    """Return a scene's figures, and draw it from above if asked.

    Args:
        reference: a built-in name, a scene folder, `neverwhere:<folder or published name>`, or
            `hub:org/name`.
        out: draw the view from above into this PNG (default: draw none).

    Raises:
        SceneError: there is no such scene, or it cannot be read.
        StoreError: the picture cannot be written.
    """
    from nw_scenes.overview import draw_plan, figures
    from nw_sim.catalogue import get_scene

    out = as_path(out)
    scene = get_scene(reference)
    if out is not None:
        draw_plan(scene, out)
    return figures(scene)


@keywords_were(suite="out")
def check_scenes(
    references: Sequence[str],
    *,
    robot: str = "go1",
    out: str | PathLike[str] | None = None,
    policy: str | None = None,
) -> tuple[CheckedScene, ...]:
    """Return what is wrong with scenes; one that cannot be read is a finding, too.

    Args:
        references: built-in names, scene folders, `neverwhere:<folder or published name>`, or
            `hub:org/name`.
        robot: the robot whose feet, camera and legs are used.
        out: write a suite of the scenes to this file if no scene has errors.
        policy: the suite's policy (default: one that has a card for the robot).

    Raises:
        UsageError: no scene is named, so nothing would be checked; the suite is there already; or a
            policy is named and no suite.
        StoreError: the suite cannot be written.
    """
    from nw_base.errors import UsageError
    from nw_base.files.cache import followed
    from nw_base.files.inside import what_is
    from nw_sim.catalogue import inspect_scene

    out = as_path(out)
    if not references:
        raise UsageError("no scene to check", fix="name one, or its folder")
    if policy is not None and out is None:
        raise UsageError(f"--policy {policy} needs --out", fix="add --out, or drop it")
    if out is not None and what_is(followed(out)) == "file":
        raise UsageError(f"{out} is there already", fix="name another file, or remove it")
    checked: list[CheckedScene] = []
    for reference in references:
        inspected = inspect_scene(reference, robot=robot)
        checked.append(
            CheckedScene(reference=reference, findings=inspected.findings, survey=inspected.survey)
        )
    if out is not None and not any(scene.has_errors for scene in checked):
        _write_suite(out, references, robot, policy)
    return tuple(checked)


def _write_suite(path: Path, references: Sequence[str], robot: str, policy: str | None) -> None:
    """Write a suite of scenes; paths in it start from its own folder."""
    from nw_eval.suite.load import robot_from, write_ready_suite
    from nw_sim.catalogue import from_folder

    place, robot = policy, robot_from(path.parent, robot)
    if policy is not None and "/" in policy and Path(policy).exists():
        # Paths start at the suite.
        place = Path(os.path.relpath(policy, path.parent)).as_posix()
    scenes = [from_folder(each, path.parent) for each in references]
    write_ready_suite(path, path.stem, scenes, robot=robot, policy=place)


def render_scenes(
    patterns: Sequence[str] = (),
    *,
    out: str | PathLike[str],
    width: int = 480,
    listener: Listener | None = None,
) -> Path:
    """Draw scenes from the robot's eye and from outside into one PNG, and return its path.

    Args:
        patterns: names or globs (default: all built-in scenes).
        out: the PNG to write.
        width: pixels across each view.
        listener: receives how far splats have been built.

    Raises:
        SceneError: no such scene.
        StoreError: the picture cannot be written.
    """
    from nw_base.files.cache import followed
    from nw_eval.engine.listener import NullListener
    from nw_eval.engine.prepare import build_splats
    from nw_sim.catalogue import match_scenes
    from nw_sim.rollout.replaying.film import write_scene_sheet

    out = as_path(out)
    followed(out)  # What can never be written is said before anything is drawn.
    references = match_scenes(tuple(patterns) or ("*",))
    build_splats(references, listener or NullListener())
    write_scene_sheet(references, out, width=width)
    return out


def warmup(scenes: Sequence[str] = (), *, listener: Listener | None = None) -> WarmUp:
    """Compile the kernels into the cache, and build the splats of scenes ahead.

    Args:
        scenes: names or globs of scenes whose splats are built (default: none, only kernels).
        listener: receives how far splats have been built.

    Raises:
        SceneError: a pattern matches nothing, or a splat cannot be made.
    """
    from nw_eval.engine.listener import NullListener
    from nw_eval.engine.prepare import build_splats
    from nw_sim.catalogue import match_scenes
    from nw_sim.warmup import warmup as compile_kernels

    seconds = compile_kernels()
    references = match_scenes(tuple(scenes)) if scenes else ()
    build_splats(references, listener or NullListener())
    return WarmUp(kernel_seconds=seconds, scenes=tuple(scene.name for scene in references))
