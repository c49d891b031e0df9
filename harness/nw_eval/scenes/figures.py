"""A scene in figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from nw_eval.scenes.mesh import FACE_KINDS
from nw_eval.scenes.scene import Scene

Point = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class SceneFigures:
    """What a scene holds. Lengths in metres, angles in radians, world frame."""

    name: str
    title: str
    task: str
    digest: str
    licence: str
    spawn: Point
    heading: float
    """Yaw of the spawn."""
    ground: float
    """Height of the ground plane."""
    solids: Mapping[str, int]
    """What physics touches: how many of each kind, by its name."""
    triangles: Mapping[str, int]
    """What rays meet: how many triangles of each kind, the most first."""
    splat: str | None
    """Key of the splat in the cache; None without one."""
    trail: tuple[Point, ...]
    """Waypoints, in order."""


def figures(scene: Scene) -> SceneFigures:
    """Return a scene's figures."""
    solids = Counter(type(solid).__name__ for solid in scene.solids)
    kinds = Counter(FACE_KINDS[kind] for kind in scene.mesh().kinds.tolist())
    return SceneFigures(
        name=scene.name,
        title=scene.title,
        task=scene.task,
        digest=scene.digest,
        licence=scene.licence,
        spawn=scene.spawn.position,
        heading=scene.spawn.yaw,
        ground=scene.ground.z,
        solids=dict(sorted(solids.items())),
        triangles=dict(kinds.most_common()),
        splat=None if scene.splat is None else scene.splat.key,
        trail=tuple((x, y, z) for x, y, z in scene.trail.tolist()),
    )
