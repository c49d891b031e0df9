"""Which way is up and where the floor is: cameras are held level, floors level, walls upright.

`up.py` weighs the cues. The floor is the level plane below all cameras with little below it, in the
sparse points and in the mesh.

An edge in a picture spans a plane with its camera's centre, and the edge itself lies in that plane.
Edges that are upright in space, those of houses, doors and windows, have plane normals that are all
perpendicular to up. The direction that most length of edges is so found along is up, if it stands
out (Kosecka and Zhang, Video Compass, 2002, for one picture; here for all of them together).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.plural import plural
from nw_twin.align.alignment import CARRIED, GravityCue, placed
from nw_twin.align.planes import (
    AGREES,
    LEVEL,
    UPRIGHT,
    FittedPlane,
    Horizon,
    find_planes,
    fit_plane,
    gram,
    horizon,
    level_form,
    smallest,
    upright_form,
    upwards,
)
from nw_twin.align.up import KnownUp, solve_up
from nw_twin.capture import Capture, PlacedShot, read_picture
from nw_twin.place import moved_mesh, moved_points
from nw_twin.walkable import walkable

_SHOTS = 60
"""That are looked at, evenly spread, at most."""
_SIDE = 800
"""Pixels of the longer side at which edges are looked for, at most."""
_LONG = 0.04
"""Of the longer side: shorter edges know their direction badly."""
_EACH = 120
"""Edges of a picture, the longest ones."""
_NEAR = math.sin(math.radians(0.7))
"""Of the angle between an edge and the plane of its camera and up, for it to count."""
_CONE = math.cos(math.radians(30.0))
_DRAWS = 20_000
_TRIED = 600
_ROUNDS = 6
_LEAST_EDGES, _LEAST_SHOTS = 40, 4
_LEAST_SHARE = 0.08
"""Of the length of all edges. Where edges lie anyhow, the best direction has 0.02."""
_LEAN = math.radians(0.3)
"""By how much houses lean, and lenses bend, in common."""
_HALF_RIGHT, _FEW = 0.15, math.radians(1.5)
"""Share of all edges at which it is as likely that they lie along furniture, or a view: of real
places, 0.14 were once 15 degrees off. And how far off so few are where they are upright."""


def upright_edges(
    capture: Capture, folder: Path, like: Values, rng: np.random.Generator
) -> KnownUp | None:
    """Return up by the upright edges in a capture's pictures.

    Args:
        capture: whose pictures lie in `folder`.
        folder: of the capture.
        like: (3,) unit vector, up to within 30 degrees.
        rng: of the pairs of edges that are tried.

    Returns:
        None where the pictures or OpenCV are not there, or no direction stands out.
    """
    shots = [shot for shot in capture.shots if (folder / shot.file).is_file()]
    if not shots:
        return None
    shots = [shots[i] for i in np.unique(np.linspace(0, len(shots) - 1, _SHOTS).astype(int))]
    try:
        edges = [_edges(shot, folder) for shot in shots]
    except ImportError:
        return None
    normals = np.concatenate([normal for normal, _ in edges])
    lengths = np.concatenate([length for _, length in edges])
    owner = np.repeat(np.arange(len(edges)), [len(length) for _, length in edges])
    if len(normals) < _LEAST_EDGES:
        return None
    first, second = rng.integers(len(normals), size=(2, _DRAWS))
    tried = np.cross(normals[first], normals[second])
    size = np.linalg.norm(tried, axis=1)
    tried = tried[size > 0.05] / size[size > 0.05, None]
    tried = tried * np.where(np.einsum("ni,i->n", tried, like) < 0, -1.0, 1.0)[:, None]
    tried = tried[np.einsum("ni,i->n", tried, like) > _CONE][:_TRIED]
    if not len(tried):
        return None
    support = [
        float(lengths[np.abs(np.einsum("ni,i->n", normals, u)) < _NEAR].sum()) for u in tried
    ]
    up = tried[int(np.argmax(support))]
    for spread in np.geomspace(2.0, 0.7, _ROUNDS) * _NEAR:
        off = np.einsum("ni,i->n", normals, up)
        weights = lengths * np.exp(-0.5 * (off / spread) ** 2)
        values, vectors = np.linalg.eigh(gram(normals, weights))
        up = vectors[:, 0] if vectors[:, 0] @ like >= 0 else -vectors[:, 0]
    off = np.einsum("ni,i->n", normals, up)
    upright = np.abs(off) < _NEAR
    share = float(lengths[upright].sum() / lengths.sum())
    seen_by = len(np.unique(owner[upright]))
    enough = np.count_nonzero(upright) >= _LEAST_EDGES and share >= _LEAST_SHARE
    if not enough or seen_by < max(_LEAST_SHOTS, len(shots) // 2):
        return None
    # Of the direction that is known least: residuals over what the normals extend along it.
    values = np.linalg.eigvalsh(gram(normals[upright], np.ones(np.count_nonzero(upright))))
    noise = float(np.sqrt((off[upright] ** 2).mean() / max(float(values[1]), 1e-9)))
    reason = (
        f"{plural(int(upright.sum()), 'upright edge')} in {plural(seen_by, 'photograph')}, "
        f"{share:.0%} of the length of all edges"
    )
    sigma = math.hypot(_LEAN, noise, _FEW * min(1.0, _HALF_RIGHT / share))
    right = 0.95 * share / (share + _HALF_RIGHT)
    return KnownUp(name="edges", up=up, sigma=sigma, right=right, reason=reason)


def _edges(shot: PlacedShot, folder: Path) -> tuple[Values, Values]:
    """Return normals (E, 3) of the planes of a picture's edges, and lengths of its side (E,)."""
    import cv2

    camera = shot.camera
    grey = cv2.cvtColor(read_picture(shot, folder), cv2.COLOR_RGB2GRAY)
    side = max(camera.width, camera.height)
    share = min(1.0, _SIDE / side)
    if share < 1.0:
        grey = cv2.resize(grey, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    lines: Any = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(grey)[0]
    if lines is None:
        return np.zeros((0, 3)), np.zeros(0)
    # OpenCV has the centre of the first pixel at (0, 0).
    ends = (lines.reshape(-1, 2, 2).astype(np.float64) + 0.5) / share
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / side
    order = np.argsort(-lengths, kind="stable")[:_EACH]
    order = order[lengths[order] > _LONG]
    local = (ends[order] - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    rays = np.concatenate([local, np.ones_like(local[..., :1])], axis=2)
    normals = np.cross(rays[:, 0], rays[:, 1])
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    return np.einsum("ij,nj->ni", camera.T_world_camera[:3, :3], normals), lengths[order]


Values = NDArray[np.float64]
Mesh = tuple[NDArray[np.floating], NDArray[np.integer]]
"""Vertices (V, 3) in the capture's frame, and faces (F, 3)."""

_TOLERANCE = 0.01
"""How far off a plane a point may be, of the distance from which it was photographed."""
_SAMPLES = 4000
"""Points on a mesh in which planes are looked for."""
_LEAST_POINTS = 12
_SURE = 6.0
"""Degrees: up that is known worse is worth a word."""
_STEEPEST, _SLOPE = math.radians(6.0), math.radians(15.0)
"""By which a floor may slope where up is not known better; and where upright edges say that up."""
_SAME_UP = math.cos(math.radians(1.0))
_LEAST_WALL = 0.03
"""Share of points of a plane that counts as a wall."""
_LEAST_FLOOR = 0.03
"""Share of the points, or of the mesh's area, of a plane that can be the floor: no ledge is."""
_RAMP = 0.1
"""Share of points of a slope that is worth a word."""

_ABOVE = 0.95
"""Share of the cameras that are above a floor."""
_BELOW = 0.15
"""Largest share of the points below it: reflections, and what matching got wrong."""
_LOWEST = 0.05
"""Where no plane is a floor, this share of the points below the cameras lies under it."""


@dataclass(frozen=True, kw_only=True)
class GravityAnswer:
    """Up and the floor.

    Attributes:
        up: (3,) unit vector in the capture's frame.
        floor: height of the floor along it below the first camera, in the capture's unit.
        floor_share: of the points, those on the mesh with them, which lies on it.
        has_floor: whether a level plane was found there; else it is as high as the lowest points.
        heights: (V,) of the cameras above the floor, along `up`, in the capture's unit.
        slope: of that plane, degrees; 0 without one.
        lower: share of the cameras' median height by which the lowest points lie below the floor.
        uncertain: angle within which up lies with 95 %, degrees.
        cues: what each says.
        warnings: what somebody should look at, disagreements aside.
    """

    up: Values
    floor: float
    floor_share: float
    has_floor: bool
    heights: Values
    slope: float
    lower: float
    uncertain: float
    cues: tuple[GravityCue, ...]
    warnings: tuple[str, ...]


def find_gravity(
    capture: Capture,
    mesh: Mesh | None,
    known: Sequence[KnownUp],
    rng: np.random.Generator,
    say: Callable[[str], None],
    folder: Path | None = None,
) -> GravityAnswer:
    """Return up and the floor of a capture.

    Args:
        capture: as calibrated.
        mesh: in its frame; None without.
        known: up as sources of poses have it.
        rng: of the draws.
        say: receives slopes.
        folder: of the capture, with its pictures; None = edges are not looked for.

    Raises:
        SceneError: it has no shots, or too few points to find a floor in; or a picture is damaged.
    """
    if not capture.shots or len(capture.points) < _LEAST_POINTS:
        raise SceneError(
            f"a capture with {plural(len(capture.shots), 'shot')} and "
            f"{plural(len(capture.points), 'point')} cannot be aligned",
            fix=f"calibrate it with more photographs: {_LEAST_POINTS} points at least",
        )
    poses = np.array([shot.camera.T_world_camera[:3, :3] for shot in capture.shots])
    level = horizon(poses / np.linalg.norm(poses[:, :, :1], axis=1, keepdims=True), rng)
    tolerance = _TOLERANCE * _distance(capture)
    points, centres = capture.points, capture.centres
    planes = find_planes(points, tolerance, rng)
    cloud = points
    if mesh is not None:
        # Ground without texture has few points, and depth all the same.
        sampled, _ = sample_mesh(*mesh, rng)
        planes += find_planes(sampled, tolerance, rng)
        cloud = np.concatenate([points, sampled])
    doubts = [doubt(one, cloud, centres, level.up, 3.0 * tolerance) for one in planes]
    solution = solve_up(level, planes, doubts, known)
    edges = None if folder is None else upright_edges(capture, folder, solution.up, rng)
    if edges is not None:
        known = [*known, edges]
        solution = solve_up(level, planes, doubts, known)
    up = solution.up
    steep = max(AGREES, min(1.5 * math.radians(solution.uncertain), _STEEPEST))
    if edges is not None and edges.up @ up > _SAME_UP:
        steep = _SLOPE
    near = math.cos(steep)
    flat = [upwards(plane, up) for plane in planes if abs(plane.normal @ up) > near]
    walls = [
        plane
        for plane in planes
        if abs(plane.normal @ up) < math.sin(AGREES) and plane.share > _LEAST_WALL
    ]
    floor = find_floor(cloud, centres, up, flat, tolerance, mesh)
    by_mesh = None
    if mesh is not None and floor.plane is not None:
        vertices, faces = mesh
        by_mesh = floor_of_mesh(vertices.astype(np.float64), faces, floor.plane, tolerance)
    for plane in planes:
        slope = math.degrees(math.acos(min(1.0, abs(float(plane.normal @ up)))))
        if plane.share > _RAMP and math.degrees(LEVEL) * 12 < slope < 40:
            say(f"a plane with {plane.share:.0%} of the points slopes by {slope:.1f} degrees")
    plane = by_mesh or floor.plane
    if plane is not None:
        solution = solution.by_floor(plane.normal)
        up = solution.up
    heights = np.einsum("ni,i->n", capture.centres, up) - floor.height
    lower = slope = 0.0
    if plane is not None:
        heights = plane.distances(capture.centres) / float(plane.normal @ up)
        slope = math.degrees(math.acos(min(1.0, float(plane.normal @ up))))
        deep = -float(np.quantile(plane.distances(cloud), _LOWEST)) - tolerance
        lower = max(0.0, deep) / max(float(np.median(heights)), 1e-12)
    return GravityAnswer(
        up=up,
        floor=float(centres[0] @ up - heights[0]),
        heights=heights,
        slope=slope,
        lower=lower,
        floor_share=floor.share,
        has_floor=plane is not None,
        uncertain=solution.uncertain,
        cues=(cues := _cues(up, level, walls, floor, by_mesh, known)),
        warnings=_warnings(level, floor, solution.uncertain, cues),
    )


def sample_mesh(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], rng: np.random.Generator
) -> tuple[Values, Values]:
    """Return points (N, 3) on a mesh, as dense on each face as on any other, and its normals."""
    corners = vertices.astype(np.float64)[faces]
    sides = corners[:, 1:] - corners[:, :1]
    normals = np.cross(sides[:, 0], sides[:, 1])
    area = np.linalg.norm(normals, axis=1)
    if not area.sum() > 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    chosen = np.searchsorted(np.cumsum(area), rng.random(_SAMPLES) * area.sum())
    chosen = np.minimum(chosen, len(faces) - 1)
    share = np.sort(rng.random((_SAMPLES, 2)), axis=1)
    weights = np.column_stack([share[:, 0], share[:, 1] - share[:, 0], 1.0 - share[:, 1]])
    points = np.einsum("nk,nki->ni", weights, corners[chosen])
    return points, normals[chosen] / np.maximum(area[chosen, None], 1e-300)


def _distance(capture: Capture) -> float:
    """Return the distance from which points are usually photographed."""
    centres = capture.centres
    seen = [
        float(np.median(np.linalg.norm(capture.points[shot.seen] - centre, axis=1)))
        for shot, centre in zip(capture.shots, centres, strict=True)
        if len(shot.seen)
    ]
    if not seen:
        away = np.linalg.norm(capture.points - centres.mean(axis=0), axis=1)
        return float(np.median(away))
    return float(np.median(seen))


def _cues(
    up: Values,
    level: Horizon,
    walls: Sequence[FittedPlane],
    floor: FloorLevel,
    by_mesh: FittedPlane | None,
    known: Sequence[KnownUp],
) -> tuple[GravityCue, ...]:
    lie = ", pictures on their sides" if level.sideways else ""
    reason = (
        f"the cameras' sideways axes, rolled by {level.roll:.1f} degrees{lie}; known to "
        f"{level.degrees:.1f} degrees"
    )
    cues = [_cue("horizon", level.up, up, math.radians(level.degrees), reason)]
    if floor.plane is not None:
        reason = f"a plane below the cameras with {floor.share:.0%} of the points"
        sigma = math.hypot(LEVEL, floor.plane.sigma)
        cues.append(_cue("floor", floor.plane.normal, up, sigma, reason))
    if walls:
        form = 1e-3 * level_form(level.up, UPRIGHT)
        for plane in walls:
            form = form + upright_form(plane.normal, math.hypot(UPRIGHT, plane.sigma))
        sigma = 1.0 / math.sqrt(float(np.linalg.eigvalsh(form)[1]))
        reason = f"{plural(len(walls), 'upright plane')}"
        cues.append(_cue("walls", smallest(form, up), up, sigma, reason))
    if by_mesh is not None:
        reason = f"the mesh's faces along the floor, {by_mesh.share:.0%} of its area"
        cues.append(_cue("mesh", by_mesh.normal, up, math.hypot(LEVEL, by_mesh.sigma), reason))
    cues += [_cue(one.name, one.up, up, one.sigma, one.reason) for one in known]
    return tuple(cues)


def _cue(name: str, own: Values, up: Values, sigma: float, reason: str) -> GravityCue:
    own = own / np.linalg.norm(own)
    sine = float(np.linalg.norm(np.cross(own, up)))
    x, y, z = own.tolist()
    return GravityCue(
        name=name,
        up=(x, y, z),
        degrees=math.degrees(math.atan2(sine, float(own @ up))),
        uncertain=math.degrees(sigma),
        reason=reason,
    )


def _warnings(
    level: Horizon, floor: FloorLevel, uncertain: float, cues: Sequence[GravityCue]
) -> tuple[str, ...]:
    warnings: list[str] = []
    if floor.plane is None:
        warnings.append(
            "no level plane lies below the cameras with little below it: the floor's height is "
            "that of the lowest points. Does the floor mirror, or has it no texture? Lay something "
            "matt with a pattern on it, and photograph again"
        )
    if uncertain > _SURE:
        agree = [cue.name for cue in cues if cue.degrees <= max(2.0, 2.0 * cue.uncertain)]
        which = "no two cues agree" if len(agree) < 2 else f"only {' and '.join(agree)} agree"
        warnings.append(
            f"up is known to {uncertain:.0f} degrees only: {which}. Three clicks on the floor in "
            "`nw-eval twin label` set it"
        )
    if level.sideways:
        warnings.append("the pictures seem to lie on their sides: check which way is up")
    return tuple(warnings)


@dataclass(frozen=True, kw_only=True)
class FloorLevel:
    """The floor of a capture, in its unit.

    Attributes:
        height: along up.
        plane: of its points; None where none was found, and the height is that of low points.
        share: of the points that lie on it.
    """

    height: float
    plane: FittedPlane | None
    share: float


def doubt(plane: FittedPlane, points: Values, centres: Values, up: Values, far: float) -> float:
    """Return how little a plane looks like a floor: 0 for one with all above it, 2 for a ramp.

    The share of the cameras and of the points below it; what has points of a floor below itself is
    none.

    Args:
        plane: in question.
        points: (N, 3).
        centres: (V, 3) of the cameras; V may be 0.
        up: (3,) roughly.
        far: how far below it a point has to be.
    """
    sense = 1.0 if plane.normal @ up >= 0 else -1.0
    under = float((sense * plane.distances(points) < -far).mean())
    cameras = float((sense * plane.distances(centres) < 0).mean()) if len(centres) else 0.0
    return 15.0 * under + 5.0 * cameras


def find_floor(
    points: Values,
    centres: Values,
    up: Values,
    level: Sequence[FittedPlane],
    tolerance: float,
    mesh: Mesh | None = None,
) -> FloorLevel:
    """Return the floor among level planes; a ceiling is above the cameras, a table has a floor.

    Of several it is the one on which a robot can walk farthest, or else that of most points.

    Args:
        points: (N, 3), one at least.
        centres: (V, 3) of the cameras.
        up: (3,) unit vector.
        level: planes, normals upwards.
        tolerance: how far off a point of the floor may be.
        mesh: in the frame of the points; None without.
    """
    heights = np.einsum("ni,i->n", points, up)
    cameras = np.einsum("ni,i->n", centres, up)
    floors: list[tuple[float, float, FittedPlane]] = []
    for plane in level:
        on_it = np.abs(plane.distances(points)) <= tolerance
        if not on_it.any():
            continue
        height = settled(heights[on_it])
        below = float((plane.distances(points) < -3.0 * tolerance).mean())
        above = float((plane.distances(centres) > 0.0).mean())
        if plane.share >= _LEAST_FLOOR and above >= _ABOVE and below <= _BELOW:
            floors.append((plane.share, height, plane))
    if floors:
        walked = [0.0] * len(floors)
        if mesh is not None and len(floors) > 1:
            walked = [_walked(mesh, centres, up, height) for _, height, _ in floors]
        best = max(range(len(floors)), key=lambda i: (walked[i], floors[i][0]))
        share, height, plane = floors[best]
        return FloorLevel(height=height, plane=plane, share=share)
    under = heights[heights < cameras.min()]
    lowest = float(np.quantile(under if len(under) else heights, _LOWEST))
    share = float((np.abs(heights - lowest) <= tolerance).mean())
    return FloorLevel(height=lowest, plane=None, share=share)


def _walked(mesh: Mesh, centres: Values, up: Values, height: float) -> float:
    """Return the area on which cameras walked if the floor is so high, in the capture's unit2."""
    cameras = float(np.median(np.einsum("ni,i->n", centres, up))) - height
    if cameras <= 0.0:
        return 0.0
    # As if people had carried them: what a robot steps over and fits into is in metres.
    scale = CARRIED / cameras
    T = placed(up=up, scale=scale, floor=height, centres=centres, forward=up)
    ground = walkable(moved_mesh(T, *mesh))
    region = ground.walked(moved_points(T, centres))
    if region is None or abs(ground.height(region)) > 0.1 * CARRIED:
        return 0.0
    return float(ground.areas[region]) / scale**2


def floor_of_mesh(
    vertices: Values, faces: NDArray[np.integer], floor: FittedPlane, tolerance: float
) -> FittedPlane | None:
    """Return the floor by the faces of a mesh that lie along it, each by its area.

    Args:
        vertices: (V, 3) in the capture's frame.
        faces: (F, 3).
        floor: by the points.
        tolerance: how far off a face of it may be.

    Returns:
        None where less than a hundredth of the mesh lies there.
    """
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    along = np.abs(np.einsum("ni,i->n", normals, floor.normal)) > np.cos(np.radians(15.0)) * area
    middles = corners.mean(axis=1)
    near = along & (area > 0) & (np.abs(floor.distances(middles)) <= 2.0 * tolerance)
    if area[near].sum() < 0.01 * area.sum() or np.count_nonzero(near) < 3:
        return None
    plane = fit_plane(
        np.repeat(middles[near], 3, axis=0) / 2 + corners[near].reshape(-1, 3) / 2,
        floor.normal,
        floor.offset,
        tolerance,
        np.repeat(area[near], 3),
    )
    share = float(area[near].sum() / area.sum())
    if plane.normal @ floor.normal < 0:
        return replace(plane, normal=-plane.normal, offset=-plane.offset, share=share)
    return replace(plane, share=share)


def settled(heights: Values) -> float:
    """Return the mean of heights without outliers."""
    height = float(np.median(heights))
    spread = max(1.4826 * float(np.median(np.abs(heights - height))), 1e-12)
    for _ in range(5):
        weights = np.clip(1.0 - ((heights - height) / (4.0 * spread)) ** 2, 0.0, None) ** 2
        height = float((weights * heights).sum() / max(float(weights.sum()), 1e-300))
    return height
