"""Where the mesh of a place is not as its photographs show it, along the trail.

A mesh that lacks the platforms between its gaps is whole: it has ground everywhere, a splat that
lies on it, and a trail that looks easy. Depths that photographs agree on know better. Each of
their pixels is a ray; where it goes on far below what the pixel shows, ground is missing, and where
it is stopped on the way, ground is where there was none.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.finding import SceneFinding
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.twin.capture import Capture
from nw_eval.twin.moved import moved_points
from nw_eval.twin.reconstruct.depth import read_depth
from nw_eval.twin.reconstruct.packages import package

F64 = NDArray[np.float64]
Cells = NDArray[np.bool_]

_SURE, _STRIDE = 0.5, 2
"""Confidence of a depth that counts, and every how many-th pixel does, each way."""
_CELL = 0.1
"""Edge of a square of ground, metres."""
_ASIDE, _OVER = 0.6, 1.0
"""From the line of the trail, to each side and up and down, metres: where a robot comes."""
_DEEP = 0.12
"""Below what a pixel shows, from which on the mesh's ground is other ground, metres."""
_SHORT = 0.06
"""Of a ray that ends before what its pixel shows, at least, metres."""
_SHARE = 0.03
"""Of a ray's length, by which either may be off."""
_LEAST_VIEWS = 2
_LEAST_AREA = 0.2
"""From which on it is a fault, square metres: room for a robot's feet. Edges are uncertain by
centimetres; what is nowhere three squares broad does not count."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenDepth:
    """What a photograph shows.

    Attributes:
        origin: (3,) of its camera, world, m.
        points: (N, 3) that its pixels show with some confidence, world, m.
    """

    origin: F64
    points: F64


def seen_depths(capture: Capture, T: F64, depths: Path) -> Iterator[SeenDepth]:
    """Yield what the shots of a capture show.

    Args:
        capture: whose depths were measured.
        T: (4, 4) from its frame to metres.
        depths: folder of them, as `nw_eval.twin.reconstruct.reconstruct` writes them.

    Raises:
        SceneError: there is none of a shot, or it is damaged.
    """
    for shot in capture.shots:
        depth, confidence = read_depth(depths, shot.name)
        known = np.where(confidence >= _SURE, depth, 0.0)[::_STRIDE, ::_STRIDE]
        rows, columns = np.nonzero(known)
        z, camera = known[rows, columns].astype(np.float64), shot.camera
        x = (columns * _STRIDE + 0.5 - camera.cx) / camera.fx * z
        y = (rows * _STRIDE + 0.5 - camera.cy) / camera.fy * z
        pose = T @ camera.T_world_camera
        yield SeenDepth(origin=pose[:3, 3], points=moved_points(pose, np.column_stack([x, y, z])))


def unlike_photographs(
    mesh: TriangleMesh, line: F64, seen: Iterable[SeenDepth]
) -> list[SceneFinding]:
    """Return where along a trail the mesh is not as photographs show it.

    Args:
        mesh: of the place.
        line: (K, 3) of spawn and waypoints, world, m.
        seen: by photographs.
    """
    rays, plan = RayScene(mesh), _Plan(line)
    shown, missing, stopped, reached = (plan.counts() for _ in range(4))
    for each in seen:
        away = each.points - each.origin
        length = np.linalg.norm(away, axis=1)
        toward = away / np.maximum(length, 1e-9)[:, None]
        hit = rays.distance(np.broadcast_to(each.origin, toward.shape), toward)
        low = rays.height(each.points[:, :2], z_from=each.points[:, 2] + _CELL)
        gone = (each.points[:, 2] - low > _DEEP) & (hit > length * (1.0 + _SHARE))
        there = np.isfinite(hit)
        met = each.origin + toward * np.where(there, hit, 0.0)[:, None]
        short = there & (hit < length * (1.0 - _SHARE) - _SHORT)
        shown += plan.cells(each.points)
        missing += plan.cells(each.points[gone])
        reached += plan.cells(met[there])
        stopped += plan.cells(met[short])
    return [
        *_findings(plan, missing, shown, "photographs show ground that the mesh lacks"),
        *_findings(plan, stopped, reached, "the mesh has ground where photographs look through"),
    ]


class _Plan:
    """Squares of the ground along a line."""

    def __init__(self, line: F64) -> None:
        low, high = line.min(axis=0), line.max(axis=0)
        self.low = low[:2] - _ASIDE
        self.shape = tuple(np.ceil((high[:2] + _ASIDE - self.low) / _CELL).astype(int).tolist())
        self._bottom, self._top = low[2] - _OVER, high[2] + _OVER
        middles = self.low + (np.indices(self.shape).reshape(2, -1).T + 0.5) * _CELL
        self.near = (_off_line(middles, line[:, :2]) < _ASIDE).reshape(self.shape)

    def counts(self) -> NDArray[np.int64]:
        return np.zeros(self.shape, np.int64)

    def cells(self, points: F64) -> Cells:
        """Return which squares some points (N, 3) lie in."""
        places = np.floor((points[:, :2] - self.low) / _CELL).astype(np.int64)
        inside = ((places >= 0) & (places < self.shape)).all(axis=1)
        inside &= (points[:, 2] > self._bottom) & (points[:, 2] < self._top)
        found = np.zeros(self.shape, dtype=bool)
        found[tuple(places[inside].T)] = True
        return found


def _findings(
    plan: _Plan, against: NDArray[np.int64], of: NDArray[np.int64], words: str
) -> Iterator[SceneFinding]:
    """Yield a finding for each region whose squares at least two views and half of all dispute."""
    ndimage = package("scipy.ndimage")
    square = np.ones((3, 3), dtype=bool)
    disputed = (against >= _LEAST_VIEWS) & (2 * against >= of) & plan.near
    regions, count = ndimage.label(ndimage.binary_opening(disputed, square), square)
    for number in range(1, count + 1):
        squares = np.argwhere(regions == number)
        area = len(squares) * _CELL**2
        if area < _LEAST_AREA:
            continue
        x, y = (plan.low + (squares.mean(axis=0) + 0.5) * _CELL).tolist()
        yield SceneFinding(
            code="unlike_photographs",
            severity="error",
            message=f"{words}: {area:.1f} square metres of it about ({x:.2f}, {y:.2f})",
            fix="take more photographs of that place, of its edges and sides too, and build again",
            value=area,
            place=(x, y, 0.0),
        )


def _off_line(points: F64, line: F64) -> F64:
    """Return the distance of points (N, 2) from a polyline (K, 2)."""
    off = np.linalg.norm(points - line[0], axis=1)
    for start, end in pairwise(line):
        along = end - start
        share = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        off = np.minimum(off, np.linalg.norm(points - start - share[:, None] * along, axis=1))
    return off
