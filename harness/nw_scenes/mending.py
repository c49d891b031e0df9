"""What rays from above miss: surface that is missing, and upright sheets.

Small gaps of the surface are closed, large ones stay open, and all of them are said. Scanned walls
and thin panels, which rays slip past, are raised.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_scenes.finding import SceneFinding
from nw_scenes.grid import Grid, shifted, to_trail
from nw_scenes.mesh import TriangleMesh
from nw_scenes.surface import Columns, Surface

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

# |n_z| of a face that counts as upright.
_UPRIGHT = 0.35
# How far above the ground a sheet may begin and still stand on it, metres.
_FOOT = 0.15
_LEAST = 0.03

_SMOOTHING = 30
# Square metres below which a gap is not worth a word.
_UNSAID = 1e-3
_MOST_FINDINGS = 10
# A hole is on the way as near to it as this, and as far behind the last waypoint, metres.
_BESIDE = 0.3
_ARRIVAL = 0.6


def close_holes(
    heights: Values, grid: Grid, largest: float, path: Values
) -> tuple[Values, Mask, tuple[SceneFinding, ...]]:
    """Interpolate over holes.

    A hole on the way is a warning; what the robot's feet meet there, the survey of the ground says.
    One aside, behind the start or beyond the arrival is a note.

    Args:
        heights: (R, C) metres, nan where the mesh has no surface.
        grid: where they are.
        largest: square metres; larger holes, and what lies outside the mesh, stay nan.
        path: (K, 3) of the spawn and the waypoints, metres.

    Returns:
        Heights, where they were interpolated (R, C), and the holes inside the mesh, largest first.
    """
    labels, count = label_regions(np.isnan(heights))
    sizes = np.bincount(labels.ravel(), minlength=count + 1) * grid.spacing**2
    rim = np.zeros(count + 1, dtype=np.bool_)
    rim[np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])] = True
    closes = ~rim & (sizes <= largest)
    closes[0] = False
    closed = closes[labels]
    points = grid.points()
    findings: list[SceneFinding] = []
    inner = [i for i in range(1, count + 1) if not rim[i] and sizes[i] > _UNSAID]
    for index in sorted(inner, key=lambda i: -sizes[i])[:_MOST_FINDINGS]:
        hole = points[(labels == index).ravel()]
        x, y = hole.mean(axis=0).tolist()
        is_on_way, where = _from_way(hole, path)
        findings.append(
            SceneFinding(
                code="hole",
                severity="warning" if is_on_way else "note",
                message=f"the mesh has a hole of {sizes[index]:.3f} m2 at ({x:.2f}, {y:.2f}), "
                f"{where}, {'closed by interpolation' if closes[index] else 'left open'}",
                value=float(sizes[index]),
                place=(x, y, 0.0),
            )
        )
    return _interpolate(heights, closed), closed, tuple(findings)


def _from_way(hole: Values, path: Values) -> tuple[bool, str]:
    """Return whether a hole, samples (N, 2), is on the way along a path, and where it is."""
    away, along = to_trail(path, hole)
    nearest = int(np.argmin(away))
    length = float(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1).sum())
    if away[nearest] < (_BESIDE if along[nearest] < length else _ARRIVAL):
        return True, "on the way"
    if along[nearest] <= 0.0:
        return False, f"{away[nearest]:.1f} m behind the start"
    if along[nearest] >= length:
        return False, f"{away[nearest]:.1f} m beyond the last waypoint"
    return False, f"{away[nearest]:.1f} m aside of the way"


def _interpolate(heights: Values, closed: Mask) -> Values:
    filled = heights.copy()
    if not closed.any():
        return filled
    rows, columns = np.nonzero(closed)
    box = (
        slice(max(rows.min() - 1, 0), rows.max() + 2),
        slice(max(columns.min() - 1, 0), columns.max() + 2),
    )
    part, mask = filled[box], closed[box]
    # From the rim inwards, then smoothed: a soap film over the hole.
    while (missing := mask & np.isnan(part)).any():
        around = shifted(part, np.nan)
        known = ~np.isnan(around)
        number = known.sum(axis=0)
        ready = missing & (number > 0)
        total = np.where(known, around, 0.0).sum(axis=0)
        part[ready] = total[ready] / number[ready]
    for _ in range(_SMOOTHING):
        around = shifted(part, np.nan)
        known = ~np.isnan(around)
        mean = np.where(known, around, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        part[mask] = mean[mask]
    filled[box] = part
    return filled


def label_regions(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], int]:
    """Return (R, C) labels from 1, 0 outside, and their number; diagonal neighbours connect.

    Runs of each row are joined with the runs that they touch in the row before.
    """
    labels = np.zeros(mask.shape, dtype=np.int32)
    parents: list[int] = [0]
    previous: list[tuple[int, int, int]] = []
    for row in range(mask.shape[0]):
        edges = np.flatnonzero(np.diff(mask[row].astype(np.int8), prepend=0, append=0))
        runs: list[tuple[int, int, int]] = []
        first = 0
        for start, stop in edges.reshape(-1, 2).tolist():
            name = 0
            while first < len(previous) and previous[first][1] < start:
                first += 1  # It ends before this run and all that follow.
            touching = first
            while touching < len(previous) and previous[touching][0] <= stop:
                root = _root(parents, previous[touching][2])
                touching += 1
                if name == 0:
                    name = root
                elif root != name:
                    low, high = min(root, name), max(root, name)
                    parents[high] = low
                    name = low
            if name == 0:
                name = len(parents)
                parents.append(name)
            labels[row, start:stop] = name
            runs.append((start, stop, name))
        previous = runs
    roots = np.array([_root(parents, name) for name in range(len(parents))])
    names, compact = np.unique(roots, return_inverse=True)
    return compact.astype(np.int32)[labels], len(names) - 1


def _root(parents: list[int], name: int) -> int:
    while parents[name] != name:
        parents[name] = parents[parents[name]]
        name = parents[name]
    return name


def raise_walls(
    heights: Values, columns: Columns, mesh: TriangleMesh, surface: Surface, grid: Grid
) -> tuple[Values, Mask]:
    """Raise samples to the top of upright sheets that stand on the ground there.

    Args:
        heights: (R, C) metres, nan where there is nothing.
        columns: what lies above the same samples.
        mesh: whose upright faces are looked at.
        surface: of that mesh.
        grid: of the samples.

    Returns:
        Heights and which of them were raised, (R, C) each.
    """
    raised = np.zeros(grid.shape, dtype=np.bool_)
    points, foot = _edge_points(mesh, grid)
    ceiling = surface.ceiling(points[:, :2])
    index, inside = grid.nearest(points[:, :2])
    # A face that begins above the ceiling hangs there; another is cut off at it.
    inside &= foot < ceiling
    index, z = index[inside], np.minimum(points[:, 2], ceiling)[inside]
    low = np.full(grid.rows * grid.columns, np.inf)
    high = np.full(grid.rows * grid.columns, -np.inf)
    np.minimum.at(low, index, z)
    np.maximum.at(high, index, z)
    # What is there already: ground, or a slab above it.
    known = np.where(np.isnan(heights), -np.inf, heights).ravel()
    tops = known.copy()
    np.maximum.at(tops, columns.slab_of, columns.slab_top)
    floor, top = (
        np.maximum(shifted(part.reshape(grid.shape), -np.inf).max(axis=0).ravel(), part)
        for part in (known, tops)
    )
    stands = (high > top + _LEAST) & (low < floor + _FOOT) & (high > -np.inf)
    raised.ravel()[stands] = True
    lifted = heights.copy()
    lifted.ravel()[stands] = high[stands]
    return lifted, raised


def _edge_points(mesh: TriangleMesh, grid: Grid) -> tuple[Values, Values]:
    """Return points (N, 3) on the edges of upright faces over the grid, half a step apart.

    With them comes where the face of each begins, (N,) metres, world z.

    Seen from above an upright triangle is a line, and its edges cover that line and reach as high
    as the triangle does.
    """
    corners = mesh.triangles
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    x, y = grid.half_size
    low = np.array([grid.x0, grid.y0])
    high = low + np.array([2 * x, 2 * y])
    chosen = (
        (np.abs(normal[:, 2]) < _UPRIGHT * length)
        & (corners[:, :, :2].max(axis=1) >= low).all(axis=1)
        & (corners[:, :, :2].min(axis=1) <= high).all(axis=1)
    )
    faces = corners[chosen]
    starts = faces.reshape(-1, 3)
    foot = np.repeat(faces[:, :, 2].min(axis=1), 3)
    along = np.roll(faces, -1, axis=1).reshape(-1, 3) - starts
    # Only the stretch of an edge that lies over the grid.
    first, last = _overlap(starts[:, :2], along[:, :2], low, high)
    kept = last > first
    starts, along, foot = starts[kept], along[kept], foot[kept]
    first, last = first[kept], last[kept]
    reach = np.linalg.norm(along[:, :2], axis=1) * (last - first)
    counts = np.ceil(reach / (grid.spacing / 2)).astype(np.int64) + 2
    edge = np.repeat(np.arange(len(starts)), counts)
    rank = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    share = first[edge] + (last - first)[edge] * rank / (counts[edge] - 1)
    return starts[edge] + share[:, None] * along[edge], foot[edge]


def _overlap(start: Values, along: Values, low: Values, high: Values) -> tuple[Values, Values]:
    """Return the shares of segments (N, 2) between which they are inside a rectangle."""
    moving = np.abs(along) > 1e-12
    step = np.where(moving, along, 1.0)
    a, b = (low - start) / step, (high - start) / step
    inside = (start >= low) & (start <= high)
    first = np.where(moving, np.minimum(a, b), np.where(inside, 0.0, 2.0))
    last = np.where(moving, np.maximum(a, b), np.where(inside, 1.0, -1.0))
    return np.clip(first.max(axis=1), 0.0, 1.0), np.clip(last.min(axis=1), 0.0, 1.0)
