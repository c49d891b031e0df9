"""A scene for people: in figures, from above, and on a way round it.

The way round is a camera's, which looks at the middle of the scene and stays within its walls.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.files.cache import atomic_path, followed
from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.scene import Scene

Point = tuple[float, float, float]

_MARGIN = 1.6  # m around course and spawn
_CELL = 0.02  # m
_LONGEST = 1200  # cells along a side
_TALLEST = 40.0  # inches

_ELEVATION = math.radians(22.0)
_AROUND = 0.8  # m round the course that should be in the picture
_FIELD = math.radians(60.0)
_CLEAR = 0.35  # m between the camera and what it would meet
_NEAREST = 1.0  # m from the middle
_RAYS = 360
_SMOOTH = 30  # rays to each side over which the way is rounded off

Points = NDArray[np.float64]


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


def draw_plan(scene: Scene, path: Path) -> None:
    """Draw a scene from above: ground heights by colour, course and spawn on them.

    Raises:
        StoreError: the picture cannot be written.
    """
    from matplotlib.figure import Figure

    from nw_scenes.rays import RayScene

    points = np.vstack([scene.trail[:, :2], scene.spawn.position[:2]])
    (x0, y0), (x1, y1) = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    cell = max(_CELL, (x1 - x0) / _LONGEST, (y1 - y0) / _LONGEST)
    xs, ys = np.arange(x0, x1, cell), np.arange(y0, y1, cell)
    grid = np.stack(np.meshgrid(xs, ys, indexing="xy"), axis=-1).reshape(-1, 2)
    heights = RayScene(scene.mesh()).height(grid).reshape(len(ys), len(xs))
    heights = np.where(np.isfinite(heights), heights, np.nan)
    tall = min(10 * (y1 - y0) / (x1 - x0), _TALLEST)
    figure = Figure(figsize=(10, tall + 1.2), layout="constrained")
    axes = figure.subplots()
    top = max(0.4, float(np.nanmax(scene.trail[:, 2])) + 0.1)
    low = min(-0.1, scene.ground.z)
    image = axes.imshow(
        np.clip(heights, low, top),
        origin="lower",
        extent=(x0, x1, y0, y1),
        cmap="viridis",
    )
    axes.plot(*scene.trail[:, :2].T, "o-", color="white", markeredgecolor="black", linewidth=1)
    for index, (px, py, pz) in enumerate(scene.trail.tolist()):
        axes.annotate(
            f"{index + 1}: {pz:.2f} m",
            (px, py),
            (7, 7),
            textcoords="offset points",
            bbox={"facecolor": "white", "alpha": 0.7, "pad": 1.5, "linewidth": 0},
        )
    x, y, _ = scene.spawn.position
    ahead = np.array([np.cos(scene.spawn.yaw), np.sin(scene.spawn.yaw)]) * 0.5
    axes.arrow(x, y, *ahead, width=0.04, color="red")
    # A dollar sign in a title begins no formula.
    axes.set_title(f"{scene.name}: {scene.title}", parse_math=False)
    axes.set(xlabel="x, m", ylabel="y, m")
    figure.colorbar(image, label="height of the ground, m", shrink=0.8)
    with atomic_path(followed(path)) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})


def circuit(scene: Scene, stations: int) -> tuple[Points, Points]:
    """Return a way round a scene's course, once about the vertical, starting behind the robot.

    Returns:
        Where the camera stands in turn, (stations, 3), and what it looks at, (3,); metres, world.
    """
    path = np.vstack([scene.spawn.position, scene.trail])
    low, high = path.min(axis=0), path.max(axis=0)
    target = np.append((low + high)[:2] / 2.0, high[2] + 0.2)
    wanted = (float(np.linalg.norm(high - low)) / 2.0 + _AROUND) / math.sin(_FIELD / 2.0)
    angles = scene.spawn.yaw + np.pi + np.arange(_RAYS) * (2.0 * np.pi / _RAYS)
    flat = math.cos(_ELEVATION)
    directions = np.column_stack(
        [flat * np.cos(angles), flat * np.sin(angles), np.full(_RAYS, math.sin(_ELEVATION))]
    )
    from nw_scenes.rays import RayScene

    free = RayScene(_surroundings(scene.mesh())).distance(
        np.broadcast_to(target, directions.shape), directions
    )
    distance = _rounded(np.clip(free - _CLEAR, _NEAREST, wanted))
    chosen = np.arange(stations) * _RAYS // stations
    return target + distance[chosen, None] * directions[chosen], target


def _surroundings(mesh: TriangleMesh) -> TriangleMesh:
    """Return what stands in a camera's way: the course itself is what it looks at."""
    course = [FACE_KINDS.index("ground"), FACE_KINDS.index("obstacle")]
    others = ~np.isin(mesh.kinds, course)
    return TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[others], kinds=mesh.kinds[others])


def _rounded(distance: Points) -> Points:
    """Return a smooth closed curve that is nowhere farther out than another one.

    A mean over a window of the least within such a window: each of them is at most the middle's.
    """
    windows = np.stack([np.roll(distance, k) for k in range(-_SMOOTH, _SMOOTH + 1)])
    least = windows.min(axis=0)
    return np.mean([np.roll(least, k) for k in range(-_SMOOTH, _SMOOTH + 1)], axis=0)
