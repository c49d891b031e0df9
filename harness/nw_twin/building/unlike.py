"""Where the mesh of a scene is not as its photographs show it, along the course, and by how much.

A mesh that lacks the platforms between its gaps is whole: it has ground everywhere, a splat that
lies on it, and a course that looks easy. Depths that photographs agree on know better. Each of
their pixels is a ray; where it goes on far below what the pixel shows, ground is missing, and where
it is stopped on the way, ground is where there was none. `depth_differences` measures how far the
depths are from the mesh where feet go.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_scenes.finding import SceneFinding
from nw_scenes.grid import to_trail
from nw_scenes.mesh import TriangleMesh
from nw_scenes.rays import RayScene
from nw_twin.capture import Capture
from nw_twin.course_profile import Shown
from nw_twin.packages import package
from nw_twin.place import moved_points
from nw_twin.reconstruct.depth import read_depth

F64 = NDArray[np.float64]
Cells = NDArray[np.bool_]

SURE, _STRIDE = 0.5, 2
"""Confidence of a depth that speaks against the mesh, and every how many-th pixel counts, each way.
That ground is shown, depths of any confidence say: on a street that is walked down those of the
road have 0.05 in the median, and 99.9 % of them lie within 0.3 m of it."""
_CELL = 0.1
"""Edge of a square of ground, metres."""
_ASIDE, _OVER = 0.6, 1.0
"""From the line of the course, to each side and up and down, metres: where a robot comes."""
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
_FEET = 0.3
"""From the line of the course, to each side, metres: where feet go."""
_SQUARE = 0.2
"""Edge of a square of ground that is shown or not, metres."""
_ABOVE = 0.3
"""Above a point of a depth map, from where the mesh's ground is looked for, metres."""
MOST_APART = 0.05
"""By which depths and mesh may differ where feet go, metres: as heights of mesh and physics."""
_LEAST_LENGTH = 0.5
"""Of course that is worth a word, metres."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenDepth:
    """Depths that a photograph shows.

    Attributes:
        origin: (3,) of its camera, world, m.
        points: (N, 3) that its pixels show with enough confidence, world, m.
    """

    origin: F64
    points: F64


def seen_depths(capture: Capture, T: F64, depths: Path, least: float = 0.0) -> Iterator[SeenDepth]:
    """Yield what the shots of a capture show.

    Args:
        capture: whose depths were measured.
        T: (4, 4) from its frame to metres.
        depths: folder of them, as `nw_twin.reconstruct.reconstruct` writes them.
        least: confidence of the depths that count, 0 to 1; 0 = all that are known.

    Raises:
        SceneError: a shot has no depths, or they are damaged.
    """
    for shot in capture.shots:
        depth, confidence = read_depth(depths, shot.name)
        known = np.where(confidence >= least, depth, 0.0)[::_STRIDE, ::_STRIDE]
        rows, columns = np.nonzero(known)
        z, camera = known[rows, columns].astype(np.float64), shot.camera
        # Depths of a large photograph are of a smaller picture of it.
        wide, high = camera.width / depth.shape[1], camera.height / depth.shape[0]
        x = ((columns * _STRIDE + 0.5) * wide - camera.cx) / camera.fx * z
        y = ((rows * _STRIDE + 0.5) * high - camera.cy) / camera.fy * z
        pose = T @ camera.T_world_camera
        yield SeenDepth(origin=pose[:3, 3], points=moved_points(pose, np.column_stack([x, y, z])))


def shown_ground(mesh: TriangleMesh, seen: Iterable[SeenDepth]) -> Shown:
    """Return what says whether photographs show the ground of a mesh at places (N, 2), metres.

    They do in a square of 0.2 m where a depth is as high as the mesh, by 0.1 m.
    """
    rays, cells = RayScene(mesh), [np.zeros((0, 2), dtype=np.int64)]
    for each in seen:
        low = rays.height(each.points[:, :2], z_from=each.points[:, 2] + _ABOVE)
        flat = each.points[np.abs(each.points[:, 2] - low) < _CELL, :2]
        cells.append(np.unique(np.floor(flat / _SQUARE).astype(np.int64), axis=0))
    known = np.unique(np.concatenate(cells), axis=0)

    def shown(places: F64) -> Cells:
        asked = np.floor(places / _SQUARE).astype(np.int64)
        both, index = np.unique(np.concatenate([known, asked]), axis=0, return_inverse=True)
        of_known = np.zeros(len(both), dtype=np.bool_)
        of_known[index.ravel()[: len(known)]] = True
        return of_known[index.ravel()[len(known) :]]

    return shown


def unlike_photographs(
    mesh: TriangleMesh, line: F64, seen: Iterable[SeenDepth]
) -> list[SceneFinding]:
    """Return where along a course the mesh is not as photographs show it.

    Args:
        mesh: of the scene.
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
        *_findings(plan, stopped, reached, "the mesh has ground where photographs show none"),
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthDifferences:
    """How far depth maps are from the mesh where feet go, at stations along the course.

    Attributes:
        median, most: (S,) of the distances, half and 90 % of them at most so far, m; nan where no
            photograph shows anything.
        photographs: (S,) that show something there.
        overall: median and 90 % quantile of all distances, m; nan without any.
    """

    median: F64
    most: F64
    photographs: NDArray[np.int64]
    overall: tuple[float, float]

    def __str__(self) -> str:
        seen = self.photographs[self.photographs > 0]
        if not len(seen):
            return "depths: no photograph shows the ground along the course"
        blind = int((self.photographs == 0).sum())
        none = f", {blind} of {len(self.photographs)} points by none" if blind else ""
        return (
            f"depths: mesh and depth maps are {1e3 * self.overall[0]:.0f} mm apart (median), 90 % "
            f"within {1e3 * self.overall[1]:.0f} mm, as {seen.min()} to {seen.max()} photographs "
            f"show it{none}"
        )


def depth_differences(
    mesh: TriangleMesh, places: F64, seen: Iterable[SeenDepth]
) -> DepthDifferences:
    """Return how far depth maps are from the mesh round places of a course.

    The distance of a point from the mesh is taken straight down and along the ray that shows it;
    the smaller one counts, and `_OVER` where the mesh has nothing.

    Args:
        mesh: of the scene.
        places: (S, 3) on the ground, evenly spaced along the course, world, m.
        seen: by photographs.
    """
    rays, plan = RayScene(mesh), _Plan(places)
    lengths = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
    middles = np.cumsum(lengths) - lengths / 2
    photographs = np.zeros(len(places), dtype=np.int64)
    stations, distances = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for each in seen:
        points = each.points[plan.places(each.points)[0]]
        aside, along = to_trail(places, points[:, :2])
        points, at = points[aside < _FEET], np.searchsorted(middles, along[aside < _FEET])
        away = points - each.origin
        length = np.linalg.norm(away, axis=1)
        toward = away / np.maximum(length, 1e-9)[:, None]
        hit = rays.distance(np.broadcast_to(each.origin, toward.shape), toward)
        low = rays.height(points[:, :2], z_from=points[:, 2] + _ABOVE)
        stations.append(at)
        apart = np.minimum(np.abs(hit - length), np.abs(points[:, 2] - low))
        distances.append(np.minimum(apart, _OVER))
        photographs[np.unique(at)] += 1
    all_stations, all_distances = np.concatenate(stations), np.concatenate(distances)
    median, most = np.full((2, len(places)), np.nan)
    for number in np.unique(all_stations).tolist():
        at_station = all_distances[all_stations == number]
        median[number], most[number] = np.quantile(at_station, (0.5, 0.9), method="higher")
    overall = (np.nan, np.nan)
    if len(all_distances):
        overall = tuple(np.quantile(all_distances, (0.5, 0.9), method="higher").tolist())
    return DepthDifferences(median=median, most=most, photographs=photographs, overall=overall)


def difference_findings(
    differences: DepthDifferences, along: F64, places: F64
) -> Iterator[SceneFinding]:
    """Yield where depths and mesh are too far apart, and where no photograph shows the ground.

    Args:
        differences: of the depth maps from the mesh, as `depth_differences` returns them.
        along: (S,) of its stations, m from the start.
        places: (S, 3) of them, world, m.
    """
    apart, blind = differences.median > MOST_APART, differences.photographs == 0
    for flags, words, fix in (
        (
            apart,
            f"mesh and depth maps are more than {MOST_APART:g} m apart (median)",
            "photograph that ground again, from nearer and above",
        ),
        (
            blind,
            "no photograph shows the ground: the mesh has filled it",
            "photograph it, or move the course elsewhere",
        ),
    ):
        ends = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
        for first, last in zip(ends[::2].tolist(), (ends[1::2] - 1).tolist(), strict=True):
            length = float(along[last] - along[first])
            if length < _LEAST_LENGTH:
                continue
            x, y, z = places[(first + last) // 2].tolist()
            yield SceneFinding(
                code="unlike_photographs",
                severity="warning",
                message=f"{words} from {along[first]:.2f} to {along[last]:.2f} m along the course, "
                f"round ({x:.2f}, {y:.2f})",
                fix=fix,
                value=length,
                place=(x, y, z),
            )


class _Plan:
    """Squares of the ground along a line."""

    def __init__(self, line: F64) -> None:
        low, high = line.min(axis=0), line.max(axis=0)
        self.low = low[:2] - _ASIDE
        self.shape = tuple(np.ceil((high[:2] + _ASIDE - self.low) / _CELL).astype(int).tolist())
        self._bottom, self._top = low[2] - _OVER, high[2] + _OVER
        middles = self.low + (np.indices(self.shape).reshape(2, -1).T + 0.5) * _CELL
        self.near = (to_trail(line, middles)[0] < _ASIDE).reshape(self.shape)

    def counts(self) -> NDArray[np.int64]:
        return np.zeros(self.shape, np.int64)

    def places(self, points: F64) -> tuple[Cells, NDArray[np.int64]]:
        """Return which points (N, 3) lie over a square, and the flat index of each one's square."""
        places = np.floor((points[:, :2] - self.low) / _CELL).astype(np.int64)
        inside = ((places >= 0) & (places < self.shape)).all(axis=1)
        inside &= (points[:, 2] > self._bottom) & (points[:, 2] < self._top)
        return inside, places @ np.array([self.shape[1], 1])

    def cells(self, points: F64) -> Cells:
        """Return which squares some points (N, 3) lie in."""
        inside, places = self.places(points)
        cells = np.zeros(self.shape, dtype=bool)
        cells.flat[places[inside]] = True
        return cells


def _findings(
    plan: _Plan, against: NDArray[np.int64], of: NDArray[np.int64], text: str
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
            message=f"{text}: {area:.1f} square metres of it about ({x:.2f}, {y:.2f})",
            fix="take more photographs of that place, of its edges and sides too, and build again",
            value=area,
            place=(x, y, 0.0),
        )
