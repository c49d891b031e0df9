"""Holes that photographs look into: what lies between two platforms is not ground.

A gap is photographed from its rims: they show well, and next to nothing shows of its walls and its
bottom. The surface has a hole there. Physics closes holes of a mesh evenly, as is right for a patch
of floor without texture; over a gap that would be a bridge. What photographs show in a hole, darker
than what is about it or farther away, lies deeper: a hole that lower ground borders on gets upright
walls, and a bottom as low as that ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_scenes.rays import RayScene
from nw_twin.building.appearance import nearest_pixels
from nw_twin.capture import Capture
from nw_twin.packages import package
from nw_twin.place import moved_mesh, moved_points
from nw_twin.reconstruct.depth import DARKER, darkness, read_depth
from nw_twin.reconstruct.surface import ColourMesh
from nw_twin.reconstruct.views import read_view

F64 = NDArray[np.float64]
Cells = NDArray[np.bool_]

_CELL = 0.02
"""Edge of a square of the plan, metres."""
_MOST = 4_000_000
"""Such squares; of larger places they are larger."""
_NEAR = 4.0
"""From a camera, seen from above, within which pits are sought, metres."""
_SIDE = 480
"""Pixels of a photograph's longer side while its colours are compared."""
_LEAST = 0.01
"""Area of a pit at least, square metres: that of a foot."""
_LARGEST = 6.0
"""At most, square metres: larger holes were not photographed."""
_WIDE = 0.4
"""From known ground, metres, within which a hole is looked at."""
_STEP = 0.05
"""Metres below the highest ground about it that a hole's level is supposed at."""
_OFF = 0.02
"""Share of its depth by which a pixel shows what lies behind a point."""
_SHARE = 0.3
"""Of the views of a point, that have to show something behind it."""
_SLIVER = 3
"""Squares of ground between two parts of a pit that nothing can stand on."""
_DEEP = 0.08
"""Metres that ground about a pit lies below its rim at least, to be its bottom."""
_LEVEL, _RIM = 0.03, 0.1
"""Metres about a rim's height, and the least share of what is about a pit that lies so: a hedge has
no level rim, and what lies between two of them is not a gap."""
_ABOUT = 0.5
"""Metres from a pit where that ground is sought."""
_DARK = (70, 70, 70)
"""Colour of what no photograph shows."""


@dataclass(frozen=True, kw_only=True)
class Pit:
    """A hole that photographs look into, metres.

    Attributes:
        centre: x and y of its middle.
        area: seen from above, square metres.
        depth: below its rim.
    """

    centre: tuple[float, float]
    area: float
    depth: float

    def __str__(self) -> str:
        """Return it in words."""
        x, y = self.centre
        return (
            f"a hole of {self.area:.2f} m2 at ({x:.1f}, {y:.1f}) that photographs show from "
            "above is "
            f"made {self.depth:.2f} m deep, as low as the ground beside it"
        )


def with_pits(
    mesh: ColourMesh, capture: Capture, folder: Path, depths: Path, T: F64
) -> tuple[ColourMesh, list[Pit]]:
    """Return the mesh with walls and bottoms of its pits, and those, the largest first.

    Args:
        mesh: in the capture's frame.
        capture: that it was made of.
        folder: of the capture, with its pictures.
        depths: folder of its depths.
        T: (4, 4) similarity from the capture's frame to metres, z up.

    Raises:
        SceneError: a picture or a depth cannot be read.
        PrerequisiteError: OpenCV or SciPy is not installed.
    """
    ndimage = package("scipy.ndimage")
    plan = _Plan.of(mesh, capture, T)
    known = np.isfinite(plan.heights)
    off, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    hole = plan.asked & ~known & (off * plan.cell <= _WIDE)
    if not hole.any() or not known.any():
        return mesh, []
    # As high as the highest ground about it: a rim, not what shows of the wall below it.
    side = 2 * round(_WIDE / plan.cell) + 1
    highest = ndimage.maximum_filter(np.where(known, plan.heights, -np.inf), size=side)
    row, column = nearest
    level = np.maximum(plan.heights[row, column], highest - _STEP)[hole]
    points = np.column_stack([plan.places(np.argwhere(hole)), level])
    deep = np.zeros(hole.shape, np.bool_)
    deep[hole] = _behind(points, capture, folder, depths, T)
    label, count = ndimage.label(deep)
    sizes = np.bincount(label.ravel(), minlength=count + 1) * plan.cell**2
    fits = (sizes >= _LEAST) & (sizes <= _LARGEST)
    fits[0] = False
    return _dug(mesh, plan, fits[label], T) if fits.any() else (mesh, [])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Plan:
    """Squares seen from above, metres.

    Attributes:
        origin: (2,) corner of the first.
        cell: edge of one.
        asked: (R, C) which are near enough to a camera; r counts along y, c along x.
        heights: (R, C) of the mesh, nan where it has a hole.
    """

    origin: F64
    cell: float
    asked: Cells
    heights: F64

    @classmethod
    def of(cls, mesh: ColourMesh, capture: Capture, T: F64) -> _Plan:
        centres = moved_points(T, capture.centres)
        low = centres[:, :2].min(axis=0) - _NEAR
        size = centres[:, :2].max(axis=0) + _NEAR - low
        cell = max(_CELL, float(np.sqrt(size.prod() / _MOST)))
        columns, rows = (int(np.ceil(side / cell)) for side in size)
        x = low[0] + cell * (np.arange(columns) + 0.5)
        y = low[1] + cell * (np.arange(rows) + 0.5)
        places = np.stack(np.meshgrid(x, y), axis=-1)
        tree = package("scipy.spatial").cKDTree(centres[:, :2])
        off, _ = tree.query(places.reshape(-1, 2), distance_upper_bound=_NEAR)
        asked = np.isfinite(off).reshape(rows, columns)
        heights = np.full((rows, columns), np.nan)
        below = np.full(int(asked.sum()), float(centres[:, 2].max()))
        measured = RayScene(moved_mesh(T, mesh.vertices, mesh.faces)).height(
            places[asked], z_from=below
        )
        heights[asked] = np.where(np.isfinite(measured), measured, np.nan)
        return cls(origin=low, cell=cell, asked=asked, heights=heights)

    def places(self, cells: NDArray[np.integer]) -> F64:
        """Return the middles (N, 2) of squares given by row and column (N, 2), metres."""
        return self.origin + self.cell * (cells[:, ::-1] + 0.5)


def _behind(points: F64, capture: Capture, folder: Path, depths: Path, T: F64) -> Cells:
    """Return behind which points (N, 3), metres, photographs show something.

    Each counts by how finely it shows level ground there.
    """
    looks, behind, at = (np.zeros(len(points)) for _ in range(3))
    scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
    local_points = moved_points(np.linalg.inv(T).astype(np.float64), points)
    up = T[2, :3] / scale
    for shot in capture.shots:
        view = read_view(shot, folder, _SIDE)
        depth = nearest_pixels(read_depth(depths, shot.name)[0], view.size)
        dark = darkness(view, depth > 0.0) >= DARKER
        C = view.T_camera_world
        local = local_points @ C[:3, :3].T + C[:3, 3]
        z = np.maximum(local[:, 2], 1e-9)
        u = view.K[0, 0] * local[:, 0] / z + view.K[0, 2]
        v = view.K[1, 1] * local[:, 1] / z + view.K[1, 2]
        height, width = view.size
        facing = -(local @ (C[:3, :3] @ up)) / np.linalg.norm(local, axis=1)
        rows = np.flatnonzero(
            (local[:, 2] > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height) & (facing > 0)
        )
        x, y = u[rows].astype(np.int64), v[rows].astype(np.int64)
        weight, there = facing[rows] * (view.K[0, 0] / z[rows]) ** 2, depth[y, x] / z[rows]
        hidden = (there > 0.0) & (there < 1.0 - _OFF)
        looks[rows] += weight * ~hidden
        at[rows] += weight * (np.abs(there - 1.0) <= _OFF)
        behind[rows] += weight * ((there > 1.0 + _OFF) | ((there == 0.0) & dark[y, x]))
    return (behind > at) & (behind > _SHARE * looks)


def _dug(mesh: ColourMesh, plan: _Plan, deep: Cells, T: F64) -> tuple[ColourMesh, list[Pit]]:
    ndimage = package("scipy.ndimage")
    ball = ndimage.iterate_structure(ndimage.generate_binary_structure(2, 1), _SLIVER)
    deep = ndimage.binary_closing(deep, ball) & plan.asked | deep
    # Between a pit and its rim neither shows: the rim is where the surface ends.
    deep |= ndimage.binary_dilation(deep, ball) & plan.asked & np.isnan(plan.heights)
    label, _ = ndimage.label(deep)
    bottom, rim = np.full(deep.shape, np.nan), np.full(deep.shape, np.nan)
    pits: list[Pit] = []
    for number, window in enumerate(ndimage.find_objects(label), 1):
        own = label[window] == number
        reach = round(_ABOUT / plan.cell)
        wide = tuple(slice(max(0, s.start - reach), s.stop + reach) for s in window)
        pit, heights = label[wide] == number, plan.heights[wide]
        edge = ndimage.binary_dilation(pit, iterations=3) & ~deep[wide] & np.isfinite(heights)
        if not edge.any():
            deep[window] &= ~own
            continue
        level = float(np.quantile(heights[edge], 0.75))
        about = heights[~deep[wide] & np.isfinite(heights)]
        low = about[about < level - _DEEP]
        lower = (heights[edge] < level - _DEEP).any() and len(low) > 0
        if not lower or (np.abs(heights[edge] - level) < _LEVEL).mean() < _RIM:
            deep[window] &= ~own  # Dark, as a shadow is: nothing says that it is open.
            continue
        floor = _usual(low)
        bottom[window][own], rim[window][own] = floor, level
        middle = plan.places(np.argwhere(pit) + [s.start for s in wide]).mean(axis=0)
        area = float(own.sum()) * plan.cell**2
        x, y = middle.tolist()
        pits.append(Pit(centre=(x, y), area=area, depth=level - floor))
    if not pits:
        return mesh, []
    vertices = moved_points(T, mesh.vertices)
    kept = ~_over(vertices[mesh.faces].mean(axis=1), plan, bottom, rim)
    corners, colours = _walls(plan, bottom, rim), np.array(_DARK, np.uint8)
    faces = np.arange(4 * len(corners), dtype=np.int32).reshape(-1, 4)
    new = moved_points(np.linalg.inv(T).astype(np.float64), corners.reshape(-1, 3))
    whole = ColourMesh(
        vertices=np.concatenate([mesh.vertices, new]),
        faces=np.concatenate(
            [
                mesh.faces[kept],
                faces[:, [0, 1, 2]] + np.int32(len(mesh.vertices)),
                faces[:, [0, 2, 3]] + np.int32(len(mesh.vertices)),
            ]
        ),
        colours=np.concatenate([mesh.colours, np.tile(colours, (len(new), 1))]),
    )
    return whole, sorted(pits, key=lambda pit: -pit.area)


def _usual(heights: F64) -> float:
    """Return the height that most squares have."""
    steps = np.round(heights / _OFF).astype(np.int64)
    kinds, counts = np.unique(steps, return_counts=True)
    return float(np.median(heights[steps == kinds[np.argmax(counts)]]))


def _over(middles: F64, plan: _Plan, bottom: F64, rim: F64) -> Cells:
    """Return which faces, by their middles (F, 3), lie in pits between bottom and rim."""
    cells = np.floor((middles[:, :2] - plan.origin) / plan.cell).astype(np.int64)
    inside = ((cells >= 0) & (cells < np.array(bottom.shape[::-1]))).all(axis=1)
    covered = np.zeros(len(middles), np.bool_)
    column, row = cells[inside].T
    z = middles[inside, 2]
    covered[inside] = (z < rim[row, column] + _DEEP) & (z > bottom[row, column] - _DEEP)
    return covered


def _walls(plan: _Plan, bottom: F64, rim: F64) -> F64:
    """Return quadrilaterals (Q, 4, 3) of bottoms and rims, seen from above, and of walls.

    Walls are seen from inside. The surface ends somewhere in a square of the rim; a square of its
    own height closes what is open between that and the wall.
    """
    quads: list[F64] = []
    deep = np.isfinite(bottom)
    rims = package("scipy.ndimage").binary_dilation(deep) & ~deep & np.isfinite(plan.heights)
    square = plan.cell * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    for row, column in np.argwhere(rims).tolist():
        corners = plan.origin + plan.cell * np.array([column, row]) + square
        quads.append(np.column_stack([corners, np.full(4, plan.heights[row, column])]))
    for row, column in np.argwhere(deep).tolist():
        x, y = plan.origin + plan.cell * np.array([column, row])
        X, Y, z = x + plan.cell, y + plan.cell, bottom[row, column]
        quads.append(np.array([[x, y, z], [X, y, z], [X, Y, z], [x, Y, z]]))
        beside: Sequence[tuple[int, int, tuple[float, float], tuple[float, float]]] = (
            (row, column + 1, (X, Y), (X, y)),
            (row, column - 1, (x, y), (x, Y)),
            (row + 1, column, (x, Y), (X, Y)),
            (row - 1, column, (X, y), (x, y)),
        )
        for i, j, a, b in beside:
            outside = not (0 <= i < deep.shape[0] and 0 <= j < deep.shape[1])
            if outside or not deep[i, j]:
                height = rim[row, column] if outside else plan.heights[i, j]
                top = height if np.isfinite(height) else rim[row, column]
                if top > z:
                    quads.append(np.array([[*a, z], [*b, z], [*b, top], [*a, top]]))
    return np.array(quads)
