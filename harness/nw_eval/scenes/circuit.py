"""A way round a place for a camera that looks at its middle and stays within its walls."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import FACE_KINDS, TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.scenes.scene import Scene

_ELEVATION = math.radians(22.0)
_AROUND = 0.8  # m round the trail that should be in the picture
_FIELD = math.radians(60.0)
_CLEAR = 0.35  # m between the camera and what it would meet
_NEAREST = 1.0  # m from the middle
_RAYS = 360
_SMOOTH = 30  # rays to each side over which the way is rounded off


Points = NDArray[np.float64]


def circuit(scene: Scene, stations: int) -> tuple[Points, Points]:
    """Return a way round a scene's trail, once about the vertical, starting behind the robot.

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
