"""The findings about any scene that a suite can name: built in, a folder, or published."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nw_eval.catalogue.brought import brought
from nw_eval.catalogue.find import folder_of, open_scene, parse_reference
from nw_eval.errors import SceneError
from nw_eval.scenes.check import check_scene
from nw_eval.scenes.finding import SceneFinding, has_errors, unreadable
from nw_eval.scenes.folder import inspect_folder
from nw_eval.scenes.neverwhere import PREFIX, inspect_published
from nw_eval.scenes.scene import Scene
from nw_eval.survey import Survey, survey_scene
from nw_eval.survey.trail import trail_findings
from nw_eval.words import Robot


@dataclass(frozen=True, kw_only=True)
class InspectedScene:
    """What is known about a scene.

    Attributes:
        findings: all that is wrong or remarkable, errors first.
        survey: what was measured along its trail; None where errors came before.
    """

    findings: tuple[SceneFinding, ...]
    survey: Survey | None


def inspect_scene(
    reference: str | Path, *, robot: Robot = "go1", read_splat: bool = True
) -> InspectedScene:
    """Return all that is wrong or remarkable about a scene for a robot, and its figures.

    Its trail is gone along with eye and feet only where nothing else is an error.

    Args:
        reference: what `get_scene` understands.
        robot: whose stance, camera and length count.
        read_splat: look at the splat as well; a built-in scene generates it for that.

    Raises:
        FetchError, PrerequisiteError, StoreError: as `brought`.
    """
    try:
        scene, found = _checked(reference, read_splat=read_splat)
        if scene is not None:
            found = (*found, *trail_findings(scene, robot))
        surveyed = None
        if scene is not None and not has_errors(found):
            surveyed = survey_scene(scene, robot=robot, read_splat=read_splat)
            found = (*found, *surveyed.findings)
    except SceneError as error:
        return InspectedScene(findings=unreadable(error), survey=None)
    order = ("error", "warning", "note")
    return InspectedScene(
        findings=tuple(sorted(found, key=lambda finding: order.index(finding.severity))),
        survey=surveyed,
    )


def _checked(
    reference: str | Path, *, read_splat: bool
) -> tuple[Scene | None, tuple[SceneFinding, ...]]:
    """Return a scene, if it could be read, and what its files, start and waypoints are like."""
    plain, collision = parse_reference(str(reference))
    here = brought(plain)
    if here.startswith(PREFIX):
        published = inspect_published(here, collision=collision)
        return published.scene, published.findings
    folder = folder_of(here)
    if folder is not None:
        scene, found = inspect_folder(folder, collision=collision)
    else:
        scene, found = open_scene(here, collision), ()
    return scene, (*found, *check_scene(scene, read_splat=read_splat))
