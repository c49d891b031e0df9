"""A triangle mesh as terrain: height fields, boxes, and what there is to know about the mesh.

Compiled terrain is kept in the user's cache, by content.

Boxes stand behind straight, upright faces that a height field would bevel. Between two samples a
height field can only slope, so a riser becomes a ramp one cell wide. Where the mesh jumps along a
straight line and the upper side is flat behind it, a box replaces the last samples: its face is the
riser, its top is the tread, and the samples below it are lowered so that nothing of the slope
shows.
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.files.cache import cache_dir, read_sealed, sealed_path
from nw_base.plural import plural
from nw_scenes.digest import digest
from nw_scenes.finding import SceneFinding
from nw_scenes.grid import COMPILER_VERSION, Grid, TerrainOptions, shifted
from nw_scenes.mending import close_holes, raise_walls
from nw_scenes.mesh import TriangleMesh
from nw_scenes.plates import Plate, fit_plane, overhang_plates
from nw_scenes.rays import RayScene
from nw_scenes.scene import Box, HeightField, Triangles
from nw_scenes.surface import Surface

Mask = NDArray[np.bool_]

_BISECTIONS = 6
# How far an edge may stray from a straight line, and a tread from a plane, metres.
_STRAIGHT = 0.006
_FLAT = 0.006
# Slope of a tread away from its edge beyond which the face of a box would lean.
_LEAN = 0.02
_SHORTEST = 0.08
# Points on one line whose heights differ by more belong to two treads, metres.
_NEXT_TREAD = 0.02
_RUNS = 60
# Lines in a row that carry no plate, after which nothing man-made is left: rubble has no end.
_FRUITLESS = 25
_MOST_PLATES = 200
# How far a box goes into the ground in front of it, metres.
_ROOT = 0.05
# Steps that a box reaches back from its face.
_BACK = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Edges:
    """Points on jumps of the ground.

    Attributes:
        xy: (N, 2) metres.
        down: (N, 2) unit vector along a row or column of the grid, to the lower side.
        low, high: (N,) heights to either side, metres.
    """

    xy: Values
    down: Values
    low: Values
    high: Values

    def take(self, chosen: Mask | NDArray[np.int64]) -> _Edges:
        return _Edges(
            xy=self.xy[chosen],
            down=self.down[chosen],
            low=self.low[chosen],
            high=self.high[chosen],
        )


def edge_plates(
    heights: Values, grid: Grid, surface: Surface, options: TerrainOptions
) -> tuple[Plate, ...]:
    """Return a plate for every straight, upright face of the ground that is worth one.

    Args:
        heights: (R, C) metres, nan where there is no ground.
        grid: of the heights.
        surface: for looking between the samples.
        options: give the least height of a step.
    """
    edges = _find(heights, grid, surface, options.least_step)
    plates: list[Plate] = []
    random = np.random.default_rng(0)
    fruitless = 0
    while len(edges.xy) and len(plates) < _MOST_PLATES and fruitless < _FRUITLESS:
        chosen, line = _line(edges, random)
        if chosen is None:
            break
        fruitless += 1
        for part in _stretches(edges, chosen, line, 3 * grid.spacing):
            plate = _plate(part, line, grid.spacing, surface)
            if plate is not None:
                plates.append(plate)
                fruitless = 0
        rest = np.ones(len(edges.xy), dtype=np.bool_)
        rest[chosen] = False
        edges = edges.take(rest)
    return tuple(plates)


def lower_under(
    heights: Values, grid: Grid, plates: tuple[Plate, ...], least_step: float
) -> Values:
    """Lower the samples whose slope would show in front of a plate.

    A sample under a plate goes down to its lowest neighbour if all neighbours that stay up are
    under a plate as well: then the slope between is inside a box. Returns (R, C) heights.
    """
    points = grid.points()
    covered = np.zeros(grid.shape, dtype=np.bool_)
    for plate in plates:
        covered.ravel()[plate.covers(points)] = True
    around = shifted(heights, np.nan)
    below = around < heights - least_step
    under = shifted(covered.astype(np.float64), 0.0) > 0
    hidden = (below | under | np.isnan(around)).all(axis=0)
    sinks = covered & below.any(axis=0) & hidden
    lowest = np.where(below, around, np.inf).min(axis=0)
    return np.where(sinks, lowest, heights)


def _find(heights: Values, grid: Grid, surface: Surface, least: float) -> _Edges:
    """Return where neighbouring samples differ by a jump, found to a few tenths of a millimetre."""
    points = grid.points().reshape(*grid.shape, 2)
    pairs: list[tuple[Values, Values, Values, Values]] = []
    for first, second in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        a, b = heights[first], heights[second]
        jumps = np.abs(a - b) > least
        pairs.append((points[first][jumps], points[second][jumps], a[jumps], b[jumps]))
    p, q, zp, zq = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    swap = zp > zq
    low, high = np.where(swap[:, None], q, p), np.where(swap[:, None], p, q)
    z_low, z_high = np.where(swap, zq, zp), np.where(swap, zp, zq)
    step = np.linalg.norm(high - low, axis=1, keepdims=True)
    down = (low - high) / np.where(step > 0, step, 1.0)
    for _ in range(_BISECTIONS):
        if len(low) == 0:
            break
        middle = (low + high) / 2
        z = surface.ground(middle)
        up = np.abs(z - z_high) < np.abs(z - z_low)
        high, z_high = np.where(up[:, None], middle, high), np.where(up, z, z_high)
        low, z_low = np.where(up[:, None], low, middle), np.where(up, z_low, z)
    upright = z_high - z_low > least
    return _Edges(xy=(low + high) / 2, down=down, low=z_low, high=z_high).take(upright)


def _line(edges: _Edges, random: np.random.Generator) -> tuple[NDArray[np.int64] | None, Values]:
    """Return the points on the line that most points share, and its direction (2,)."""
    count = len(edges.xy)
    least = 6
    best: NDArray[np.int64] | None = None
    direction = np.array([1.0, 0.0])
    if count < least:
        return None, direction
    for _ in range(_RUNS):
        first = int(random.integers(count))
        # A partner nearby, so that it is likely on the same edge.
        offset = edges.xy - edges.xy[first]
        distance = np.abs(offset).max(axis=1)
        near = np.flatnonzero((distance > _SHORTEST / 2) & (distance < 10 * _SHORTEST))
        if len(near) == 0:
            continue
        second = int(near[random.integers(len(near))])
        along = offset[second] / np.linalg.norm(offset[second])
        normal = np.array([-along[1], along[0]])
        if edges.down[first] @ normal < 0:
            normal, along = -normal, -along
        chosen = np.flatnonzero((np.abs(offset @ normal) < _STRAIGHT) & (edges.down @ normal > 0.1))
        if len(chosen) >= least and (best is None or len(chosen) > len(best)):
            best, direction = chosen, along
    return best, direction


def _stretches(edges: _Edges, chosen: NDArray[np.int64], line: Values, gap: float) -> list[_Edges]:
    """Return the parts of a line that are long enough and without gaps, each of one tread."""
    position = edges.xy[chosen] @ line
    order = np.argsort(position, kind="stable")
    position, ordered = position[order], chosen[order]
    breaks = (np.diff(position) > gap) | (np.abs(np.diff(edges.high[ordered])) > _NEXT_TREAD)
    parts = np.split(np.arange(len(ordered)), np.flatnonzero(breaks) + 1)
    return [
        edges.take(ordered[part])
        for part in parts
        if position[part[-1]] - position[part[0]] >= _SHORTEST
    ]


def _plate(edges: _Edges, along: Values, spacing: float, surface: Surface) -> Plate | None:
    """Return the plate behind one straight stretch, or None where the upper side is not flat."""
    # A better line through the stretch than through two of its points.
    middle = edges.xy.mean(axis=0)
    s = (edges.xy - middle) @ along
    normal = np.array([-along[1], along[0]])
    d = (edges.xy - middle) @ normal
    tilt = float((s * d).sum() / (s * s).sum())
    along = (along + tilt * normal) / np.hypot(1.0, tilt)
    normal = np.array([-along[1], along[0]])
    s = (edges.xy - middle) @ along
    start, stop = float(s.min()), float(s.max())
    behind = -normal
    depth = _BACK * spacing
    inset = min(0.25 * spacing, (stop - start) / 4)
    rows = np.linspace(start + inset, stop - inset, max(int((stop - start) / spacing), 3))
    back = np.array([0.04, 0.3, 0.65, 0.98]) * depth
    local = np.stack(np.meshgrid(rows, back, indexing="ij"), axis=-1).reshape(-1, 2)
    z = surface.ground(middle + local[:, :1] * along + local[:, 1:] * behind)
    if np.isnan(z).any():
        return None
    height, (rise, lean), residual = fit_plane(local, z)
    if np.abs(residual).max() > _FLAT or abs(lean) > _LEAN:
        return None
    start, stop = _ends(start, stop, (height, rise), middle, along, behind, (spacing, surface))
    center = (start + stop) / 2
    low = float(edges.low.min())
    top = height + rise * center + lean * depth / 2
    lowest = top - abs(rise) * (stop - start) / 2
    # `across` of a plate is a quarter turn left of `along`, and `behind` must be either side.
    return Plate(
        origin=middle + center * along + depth / 2 * behind,
        along=along,
        half=((stop - start) / 2, depth / 2),
        top=top,
        slopes=(rise, 0.0),
        thickness=max(lowest - low, 0.0) + abs(rise) * (stop - start) + _ROOT,
    )


def _ends(
    start: float,
    stop: float,
    plane: tuple[float, float],
    middle: Values,
    along: Values,
    behind: Values,
    look: tuple[float, Surface],
) -> tuple[float, float]:
    """Move both ends out to where the tread ends, at most one and a half steps."""
    spacing, surface = look
    inner = np.array([start, stop])
    outer = inner + 1.5 * spacing * np.array([-1.0, 1.0])
    for _ in range(_BISECTIONS + 2):
        trial = (inner + outer) / 2
        z = surface.ground(middle + trial[:, None] * along + 0.1 * spacing * behind)
        there = np.abs(z - (plane[0] + plane[1] * trial)) < _FLAT
        inner, outer = np.where(there, trial, inner), np.where(there, outer, trial)
    return float(inner[0]), float(inner[1])


Values = NDArray[np.float64]

# How far the ground lies below the lowest surface, where there is none, metres.
_VOID = 0.5
# The coarse field hides this far below the lowest surface where the fine one is.
_SUNK = 0.25
# Boxes for what hangs over the ground.
_NEAR_SLABS = 300
_FAR_SLABS = 60
_PROBES = 4000
_PROBED_WIDTH = 0.4
# Heights are kept to this step, metres, so that the last bits of a CPU change no digest.
_STEP = 1e-5

_META = "meta"


def compiled_terrain(
    mesh: TriangleMesh,
    *,
    trail: NDArray[np.float64],
    spawn: NDArray[np.float64],
    options: TerrainOptions | None = None,
    rays: RayScene | None = None,
) -> Terrain:
    """Return the terrain of a mesh from the cache; compile it on first use.

    Arguments as `build_terrain`. A damaged file in the cache is written again.

    Raises:
        StoreError: the cache cannot be written.
    """
    chosen = TerrainOptions() if options is None else options
    key = terrain_key(mesh, trail=trail, spawn=spawn, options=chosen)
    path = cache_dir("scenes", "terrain") / f"{key[:32]}.npz"
    kept = _read_terrain(path, key, mesh, chosen)
    if kept is not None:
        return kept
    terrain = build_terrain(mesh, trail=trail, spawn=spawn, options=chosen, rays=rays)
    _write_terrain(path, key, terrain)
    return terrain


def terrain_key(
    mesh: TriangleMesh,
    *,
    trail: NDArray[np.float64],
    spawn: NDArray[np.float64],
    options: TerrainOptions,
) -> str:
    """Return the hex digest of everything that terrain is compiled from."""
    return digest(COMPILER_VERSION, mesh.vertices, mesh.faces, trail, spawn, options)


def _tuples(record: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(part) if isinstance(part, list) else part for name, part in record.items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Accuracy:
    """How far the solids' upper side is from the mesh near the course, metres."""

    median: float
    p99: float
    worst: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Terrain:
    """What physics touches.

    Attributes:
        solids: height fields first, then boxes.
        floor: z of the plane that catches what leaves the terrain, metres; lies below all of it.
        spawn_height: z of the ground under the spawn, metres; nan where there is none.
        accuracy: of the height fields and boxes against the mesh.
        findings: what the mesh lacks, and where it is more than a height field.
    """

    solids: tuple[HeightField | Box | Triangles, ...]
    floor: float
    spawn_height: float
    accuracy: Accuracy
    findings: tuple[SceneFinding, ...]


def build_terrain(
    mesh: TriangleMesh,
    *,
    trail: Values,
    spawn: Values,
    options: TerrainOptions | None = None,
    rays: RayScene | None = None,
) -> Terrain:
    """Compile a mesh; `compiled_terrain` of `store` does so once and remembers.

    Args:
        mesh: any triangles, closed or open, in world metres.
        trail: (K, 3) waypoints on top of the surface, metres.
        spawn: (3,) where the robot starts, metres.
        options: lengths.
        rays: of the same mesh, if the caller has them already.
    """
    chosen = TerrainOptions() if options is None else options
    path = np.vstack([spawn[None], trail])
    surface = Surface(mesh, path, chosen, rays)
    low, high = path[:, :2].min(axis=0), path[:, :2].max(axis=0)
    mesh_low, mesh_high = (part[:2] for part in (mesh.vertices.min(axis=0), mesh.vertices.max(0)))
    near_low, near_high = low - chosen.corridor, high + chosen.corridor
    far_low = np.minimum(np.maximum(low - chosen.reach, mesh_low), near_low)
    far_high = np.maximum(np.minimum(high + chosen.reach, mesh_high), near_high)
    near = _field(mesh, surface, Grid.over(near_low, near_high, chosen.spacing), chosen, fine=True)
    far = _field(mesh, surface, Grid.over(far_low, far_high, chosen.far_spacing), chosen)
    floor = _lowest(near, far) - _VOID
    hidden = np.array([*near.grid.center, *near.grid.half_size])
    fields = [_solid(near, floor, chosen), _solid(_sunk(far, hidden, floor), floor, chosen)]
    outside = [plate for plate in far.slabs if not _inside(plate.origin, hidden)]
    plates = [*near.edges, *near.slabs, *outside]
    boxes = [plate.box(friction=chosen.friction) for plate in plates]
    spawn_height = float(surface.ground(spawn[None, :2])[0])
    findings = [*near.findings, *_sheet_findings(surface, near.grid), *_plate_findings(near)]
    accuracy = _accuracy(surface, path, fields[0], near)
    solids: tuple[HeightField | Box | Triangles, ...] = (*fields, *boxes)
    if chosen.collision == "triangles":
        own = Triangles(vertices=mesh.vertices, faces=mesh.faces, friction=chosen.friction)
        solids = (own,)
    return Terrain(
        solids=solids,
        floor=floor,
        spawn_height=spawn_height,
        accuracy=accuracy,
        findings=tuple(findings),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Field:
    """One compiled grid: heights with nan where there is nothing, and its plates.

    `invented` marks samples that are not the mesh's own: walls and closed holes.
    """

    grid: Grid
    heights: Values
    edges: tuple[Plate, ...]
    slabs: tuple[Plate, ...]
    invented: NDArray[np.bool_]
    findings: tuple[SceneFinding, ...]


def _field(
    mesh: TriangleMesh, surface: Surface, grid: Grid, options: TerrainOptions, *, fine: bool = False
) -> _Field:
    columns = surface.columns(grid.points())
    ground = columns.ground.reshape(grid.shape)
    heights, closed, findings = close_holes(ground, grid, options.largest_hole, surface.trail)
    heights, raised = raise_walls(heights, columns, mesh, surface, grid)
    edges: tuple[Plate, ...] = ()
    if fine:
        edges = edge_plates(np.where(closed | raised, np.nan, heights), grid, surface, options)
        heights = lower_under(heights, grid, edges, options.least_step)
    if raised.any():
        x, y = grid.points()[raised.ravel()][0].tolist()
        findings = (
            *findings,
            SceneFinding(
                code="thin_wall",
                severity="note",
                message=f"{int(raised.sum())} samples stand on sheets thinner than "
                f"{1000 * grid.spacing:.1f} mm, the first at ({x:.2f}, {y:.2f}); they are as "
                "thick as that in physics",
                value=float(raised.sum()),
                place=(x, y, 0.0),
            ),
        )
    return _Field(
        grid=grid,
        heights=heights,
        edges=edges,
        slabs=overhang_plates(columns, grid, surface, most=_NEAR_SLABS if fine else _FAR_SLABS),
        invented=closed | raised,
        findings=findings,
    )


def _lowest(*fields: _Field) -> float:
    lowest = [float(np.nanmin(f.heights)) for f in fields if not np.isnan(f.heights).all()]
    return min(lowest, default=0.0)


def _sunk(far: _Field, hidden: Values, floor: float) -> _Field:
    """Return the coarse field, out of the way where the fine one is, but for its rim."""
    points = far.grid.points()
    reach = hidden[2:] - 2.0 * far.grid.spacing
    inside = (np.abs(points - hidden[:2]) < reach).all(axis=1).reshape(far.grid.shape)
    return replace(far, heights=np.where(inside, floor + _VOID - _SUNK, far.heights))


def _inside(point: Values, rectangle: Values) -> bool:
    return bool((np.abs(point - rectangle[:2]) < rectangle[2:]).all())


def _solid(field: _Field, floor: float, options: TerrainOptions) -> HeightField:
    heights = np.where(np.isnan(field.heights), floor, field.heights)
    return HeightField(
        center=field.grid.center,
        half_size=field.grid.half_size,
        heights=(np.round(heights / _STEP) * _STEP).astype(np.float32),
        floor=floor - _VOID,
        friction=options.friction,
    )


def _sheet_findings(surface: Surface, grid: Grid) -> tuple[SceneFinding, ...]:
    step = Grid.over(
        np.array([grid.x0, grid.y0]),
        np.array([grid.x0, grid.y0]) + 2 * np.array(grid.half_size),
        max(grid.spacing, 0.1),
    )
    sheets = surface.columns(step.points()).sheets
    if not sheets.any():
        return ()
    area = float(sheets.sum()) * step.spacing**2
    x, y = step.points()[sheets].mean(axis=0).tolist()
    return (
        SceneFinding(
            code="layered_sheet",
            severity="warning",
            message=f"a sheet without an underside hangs over {area:.1f} m2 round "
            f"({x:.2f}, {y:.2f}); it was taken for a roof and cannot be touched",
            fix="remove it if it is not one",
            value=area,
            place=(x, y, 0.0),
        ),
    )


def _plate_findings(near: _Field) -> tuple[SceneFinding, ...]:
    if not near.slabs:
        return ()
    x, y = near.slabs[0].origin.tolist()
    top = near.slabs[0].top
    return (
        SceneFinding(
            code="overhang",
            severity="note",
            message="what hangs over the ground is taken as "
            f"{plural(len(near.slabs), 'box', 'boxes')}, the largest at "
            f"({x:.2f}, {y:.2f}, {top:.2f}), {near.slabs[0].thickness:.3f} m thick",
            value=float(len(near.slabs)),
            place=(x, y, top),
        ),
    )


def _accuracy(surface: Surface, path: Values, solid: HeightField, near: _Field) -> Accuracy:
    """Measure between the samples, where these are the mesh's own."""
    random = np.random.default_rng(1)
    ends = path if len(path) > 1 else np.repeat(path, 2, axis=0)
    legs = random.integers(len(ends) - 1, size=_PROBES)
    share = random.uniform(size=(_PROBES, 1))
    points = ends[legs, :2] + share * (ends[legs + 1, :2] - ends[legs, :2])
    points += random.uniform(-_PROBED_WIDTH, _PROBED_WIDTH, size=points.shape)
    index, inside = near.grid.nearest(points)
    beside = near.invented | (shifted(near.invented.astype(np.float64), 0.0) > 0).any(axis=0)
    truth = surface.ground(points)
    counts = inside & ~beside.ravel()[index] & ~np.isnan(truth)
    if not counts.any():
        return Accuracy(median=np.nan, p99=np.nan, worst=np.nan)
    points, truth = points[counts], truth[counts]
    height = solid.height(points)
    for plate in near.edges:
        height = np.where(plate.covers(points), np.maximum(height, plate.plane(points)), height)
    median, p99, worst = np.quantile(np.abs(height - truth), [0.5, 0.99, 1.0]).tolist()
    return Accuracy(median=median, p99=p99, worst=worst)


def _write_terrain(path: Path, key: str, terrain: Terrain) -> None:
    fields = [solid for solid in terrain.solids if isinstance(solid, HeightField)]
    meta = {
        "key": key,
        "floor": terrain.floor,
        "spawn_height": terrain.spawn_height,
        "accuracy": asdict(terrain.accuracy),
        "findings": [asdict(finding) for finding in terrain.findings],
        "boxes": [asdict(solid) for solid in terrain.solids if isinstance(solid, Box)],
        "fields": [
            {
                "center": field.center,
                "half_size": field.half_size,
                "floor": field.floor,
                "friction": field.friction,
            }
            for field in fields
        ],
    }
    arrays: dict[str, Any] = {f"heights_{i}": field.heights for i, field in enumerate(fields)}
    text = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
    with sealed_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **{_META: text}, **arrays)


def _read_terrain(
    path: Path, key: str, mesh: TriangleMesh, options: TerrainOptions
) -> Terrain | None:
    """Return what a file holds; None if it is missing, damaged, or of another content."""
    try:
        with np.load(io.BytesIO(read_sealed(path)), allow_pickle=False) as data:
            meta = json.loads(bytes(data[_META]))
            if meta["key"] != key:
                return None
            fields = [
                HeightField(heights=data[f"heights_{index}"], **_tuples(field))
                for index, field in enumerate(meta["fields"])
            ]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None
    solids: tuple[HeightField | Box | Triangles, ...] = (
        *fields,
        *(Box(**_tuples(box)) for box in meta["boxes"]),
    )
    if options.collision == "triangles":
        own = Triangles(vertices=mesh.vertices, faces=mesh.faces, friction=options.friction)
        solids = (own,)
    return Terrain(
        solids=solids,
        floor=meta["floor"],
        spawn_height=meta["spawn_height"],
        accuracy=Accuracy(**meta["accuracy"]),
        findings=tuple(SceneFinding(**_tuples(finding)) for finding in meta["findings"]),
    )
