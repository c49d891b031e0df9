"""Which pictures each picture is compared with, and between which depths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.capture import Capture

BEST_ANGLE = np.deg2rad(12.0)
"""Between two views of a point: less measures depth badly, more changes how things look."""
_LEAST_POINTS = 8
_MARGIN = 1.15


def neighbours_of(capture: Capture, count: int) -> list[list[int]]:
    """Return for each shot the numbers of up to `count` others, best first.

    A pair scores the points that both show, each by the angle between the two views of it: as its
    square up to `BEST_ANGLE`, and falling with the square of what is beyond.
    """
    centres = capture.centres
    scores = np.zeros((len(capture.shots), len(capture.shots)))
    for i, shot in enumerate(capture.shots):
        for j in range(i):
            shared = np.intersect1d(shot.seen, capture.shots[j].seen, assume_unique=True)
            if len(shared) >= _LEAST_POINTS:
                angles = _angles(capture.points[shared], centres[i], centres[j]) / BEST_ANGLE
                worth = np.minimum(angles, 1.0 / np.maximum(angles, 1e-9)) ** 2
                scores[i, j] = scores[j, i] = worth.sum()
    orders = np.argsort(-scores, axis=1, kind="stable")[:, :count]
    return [[int(j) for j in order if scores[i, j] > 0.0] for i, order in enumerate(orders)]


def _angles(
    points: NDArray[np.float64], one: NDArray[np.float64], other: NDArray[np.float64]
) -> NDArray[np.float64]:
    a, b = one - points, other - points
    cosine = (a * b).sum(axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) + 1e-300)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def depth_range(capture: Capture, place: int) -> tuple[float, float] | None:
    """Return the nearest and the farthest depth of a shot, or None if it shows too few points.

    They are the first and the last percentile of its points' depths, and 15 percent more. The
    nearest is no farther than points of other shots that lie in its picture: what is close is often
    plain, and was matched elsewhere.
    """
    shot = capture.shots[place]
    camera, T = shot.camera, shot.camera.T_camera_world
    local = capture.points @ T[:3, :3].T + T[:3, 3]
    depth = local[shot.seen, 2]
    depth = depth[depth > 0.0]
    if len(depth) < _LEAST_POINTS:
        return None
    near, far = np.percentile(depth, [1.0, 99.0])
    ahead = local[local[:, 2] > 0.0]
    u = camera.fx * ahead[:, 0] / ahead[:, 2] + camera.cx
    v = camera.fy * ahead[:, 1] / ahead[:, 2] + camera.cy
    shown = ahead[(u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height), 2]
    if len(shown) >= _LEAST_POINTS:
        near = min(near, np.percentile(shown, 1.0))
    return float(near) / _MARGIN, float(far) * _MARGIN
