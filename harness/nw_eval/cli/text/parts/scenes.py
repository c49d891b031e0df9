"""Scenes as lines of text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.plural import plural

if TYPE_CHECKING:
    from nw_eval.api import CheckedScene, ListedScene
    from nw_eval.scenes.overview import SceneFigures


def scene_table(scenes: Sequence[ListedScene]) -> str:
    """Return a line for each scene: name, waypoints, split, title."""
    width = max(len(scene.name) for scene in scenes)
    return "\n".join(
        f"{scene.name:{width}}  {plural(scene.waypoints, 'waypoint'):11}  {scene.split or '-':5}  "
        f"{scene.title}"
        for scene in scenes
    )


def scene_page(scene: SceneFigures) -> str:
    """Return all figures of one scene."""
    x, y, z = scene.spawn
    solids = ", ".join(f"{count} {kind}" for kind, count in scene.solids.items())
    kinds = ", ".join(f"{count:,} {kind}" for kind, count in scene.triangles.items())
    lines = [
        f"name       {scene.name}",
        f"title      {scene.title}",
        f"task       {scene.task}",
        f"digest     {scene.digest}",
        f"licence    {scene.licence}",
        f"spawn      x {x:.2f}  y {y:.2f}  z {z:.2f} m, heading {scene.heading:.2f} rad",
        f"ground     z {scene.ground:.3f} m",
        f"solids     {solids}",
        f"mesh       {sum(scene.triangles.values()):,} triangles: {kinds}",
        f"splat      {'none' if scene.splat is None else scene.splat[:16]}",
    ]
    for index, (px, py, pz) in enumerate(scene.trail):
        label = "trail" if index == 0 else ""
        lines.append(f"{label:<10} {index + 1}: x {px:.2f}  y {py:.2f}  z {pz:.2f} m")
    return "\n".join(lines)


def findings_text(scenes: Sequence[CheckedScene]) -> str:
    """Return a line for each figure and finding of each scene, and one where nothing is wrong."""
    from nw_eval.survey import survey_lines

    lines: list[str] = []
    for scene in scenes:
        name = clean(scene.reference)
        if scene.survey is not None:
            lines += [f"{name}: {line}" for line in survey_lines(scene.survey)]
        lines += [f"{name}: {finding}" for finding in scene.findings]
        if not scene.findings:
            lines.append(f"{name}: nothing wrong")
    return "\n".join(lines)
