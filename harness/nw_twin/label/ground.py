"""The ground of a scene: the point under a click, heights along a course, and obstacles there.

A height profile asks something of legs: hurdles, gaps, steps and ramps. Hints say what the shipped
policy can be expected to do with them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.plural import plural
from nw_scenes.mesh import TriangleMesh
from nw_scenes.rays import RayScene
from nw_twin.label.state import Point, StartPose, as_point

SPACING = 0.02
"""Between samples, m: a scan's edges are no sharper."""

_MOST = 5000  # samples of a leg

# A robot's head is lower, and what it steps over too; ceilings are higher.
_CLEARANCE = 1.0

_BEFORE = 1.0  # m from the start to the first waypoint


class Ground:
    """The mesh of a scene, as rays meet it.

    Attributes:
        mesh: world, m.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh
        self._rays = RayScene(mesh)

    def hit(self, origin: Point, direction: Point) -> Point | None:
        """Return where a ray meets the mesh first; None where it does not.

        Args:
            origin: world, m.
            direction: of any length but 0.
        """
        start = np.asarray(origin, dtype=np.float64)[None]
        along = np.asarray(direction, dtype=np.float64)[None]
        length = float(np.linalg.norm(along))
        if not np.isfinite(start).all() or not 0 < length < np.inf:
            return None
        along = along / length
        distance, face = self._rays.cast(start, along)
        if face[0] < 0:
            return None
        # Embree counts in float32; the face's own plane puts the point back on it.
        a, b, c = self.mesh.vertices[self.mesh.faces[face[0]]]
        normal = np.cross(b - a, c - a)
        slope = float(normal @ along[0])
        exact = float(normal @ (a - start[0])) / slope if slope else float(distance[0])
        near = abs(exact - distance[0]) < 1e-3 * (1 + distance[0])
        return as_point(start[0] + along[0] * (exact if near else float(distance[0])))

    def heights(self, xy: NDArray[np.float64], below: float) -> NDArray[np.float64]:
        """Return the ground's height (N,) under points xy (N, 2), m, -inf where there is none.

        Args:
            xy: world, m.
            below: height to look down from, so that ceilings and upper floors do not count.
        """
        return self._rays.height(xy, z_from=below)

    def dropped(self, x: float, y: float, near: float, *, clearance: float = 0.6) -> Point | None:
        """Return the point of the ground at x, y, seen from `clearance` above the height `near`."""
        height = float(self.heights(np.array([[x, y]]), near + clearance)[0])
        return (x, y, height) if np.isfinite(height) else None


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightProfile:
    """The ground along the straight legs from the start over all waypoints.

    Attributes:
        distance: (N,) from the start, over the ground plan, m; it never falls.
        height: (N,) of the ground, world, m; -inf where there is none.
        stops: (K,) distances of the start and of each waypoint, m.
        levels: (K,) their own heights, m.
    """

    distance: NDArray[np.float64]
    height: NDArray[np.float64]
    stops: NDArray[np.float64]
    levels: NDArray[np.float64]


def height_profile(ground: Ground, stops: Sequence[Point]) -> HeightProfile:
    """Return the profile along `stops`: the start and the waypoints; none are needed."""
    points = np.array(stops, dtype=np.float64).reshape(-1, 3)
    lengths = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    reached = np.concatenate([[0.0], np.cumsum(lengths)])[: len(points)]
    distances, heights = [np.zeros(0)], [np.zeros(0)]
    for i, length in enumerate(lengths):
        count = 1 + min(max(int(np.ceil(length / SPACING)), 1), _MOST)
        share = np.linspace(0.0, 1.0, count)
        xy = points[i, :2] + share[:, None] * (points[i + 1, :2] - points[i, :2])
        top = float(points[i : i + 2, 2].max())
        distances.append(reached[i] + share * length)
        heights.append(ground.heights(xy, top + _CLEARANCE))
    return HeightProfile(
        distance=np.concatenate(distances),
        height=np.concatenate(heights),
        stops=reached,
        levels=points[:, 2],
    )


def start_before(waypoints: Sequence[Point], ground: Ground) -> StartPose:
    """Return the start 1 m before the first waypoint, on the ground; without one, the origin."""
    if not waypoints:
        return StartPose(position=(0.0, 0.0, 0.0), yaw=0.0)
    first = np.array(waypoints[0])
    ahead = np.array(waypoints[1] if len(waypoints) > 1 else first)[:2] - first[:2]
    yaw = math.atan2(ahead[1], ahead[0])
    x, y = first[:2] - _BEFORE * np.array([math.cos(yaw), math.sin(yaw)])
    level = float(first[2])
    position = ground.dropped(float(x), float(y), level)
    return StartPose(position=position or (float(x), float(y), level), yaw=yaw)


_LIMITS: dict[ObstacleKind, tuple[float, float]] = {
    "hurdle": (0.25, 0.30),
    "gap": (0.40, 0.58),
    "step": (0.20, 0.23),
    "ramp": (math.radians(22), math.radians(30)),
}
"""What go1-parkour does well, and what it was trained up to or does sometimes: its README."""

_LOOSE: dict[ObstacleKind, float] = {"hurdle": 0.01, "gap": 0.03, "step": 0.01, "ramp": 0.02}
"""By how much a profile's sizes are uncertain."""

_LONGEST_LEG = 4.0  # m; the policy knows the next waypoint's direction only
_RADIUS = 0.3  # m, within which a waypoint counts as reached
_JITTER = 0.25  # m, by which a start and a waypoint may be nearer in a trial than they stand here
_OFF_GROUND = 0.1  # m
_LONGEST = 8.0  # m; a trial has 12 s, and the robot walks at 0.8 m/s
_SHARPEST = math.radians(100)

ObstacleKind = Literal["hurdle", "gap", "step", "ramp"]

_WINDOW = 5  # samples, 0.1 m: over less, a scan's edge is not all there
_SUDDEN = 0.08  # m in a window; steeper than any ramp that is walked
_SLOPE_WINDOW = 15  # samples, 0.3 m: about a robot's stance
_FLAT = math.radians(10)
_LONGEST_HURDLE, _LONGEST_GAP = 0.6, 1.2  # m; longer ones are steps up and down
_LEAST_GAP = 0.25  # m deep; into less the robot steps down
_BOTTOMLESS = 1.0  # m below all ground that there is


@dataclass(frozen=True, kw_only=True)
class Hint:
    """One line for whoever labels.

    Attributes:
        severity: a `warning` is worth a change; a `note` only good to know.
        text: a sentence.
    """

    severity: Literal["warning", "note"]
    text: str


def hints_on(stops: Sequence[Point], profile: HeightProfile) -> tuple[Hint, ...]:
    """Return hints on a course, warnings first.

    Args:
        stops: the start and the waypoints; world, m.
        profile: of the ground along them.
    """
    if len(stops) < 2:
        return (Hint(severity="warning", text="There is no waypoint yet: click on the ground."),)
    warnings = [*_on_stops(stops, profile), *_on_legs(stops)]
    notes: list[str] = []
    obstacles = obstacles_of(profile)
    for kind in _LIMITS:
        of_kind = [obstacle for obstacle in obstacles if obstacle.kind == kind]
        too_much = [each for each in of_kind if _beyond(each, 0)]
        warnings += [_warning(each) for each in too_much]
        if of_kind and not too_much:
            largest = _size(max(of_kind, key=lambda each: each.size))
            notes.append(f"{plural(len(of_kind), kind)}, {largest} at most: within reach.")
    return (
        *(Hint(severity="warning", text=text) for text in warnings),
        *(Hint(severity="note", text=text) for text in notes),
    )


def _on_stops(stops: Sequence[Point], profile: HeightProfile) -> list[str]:
    doubts: list[str] = []
    for i, (at, level) in enumerate(zip(profile.stops, profile.levels, strict=True)):
        name = f"waypoint {i}" if i else "the start"
        nearest = int(np.abs(profile.distance - at).argmin())
        height = profile.height[nearest]
        if not np.isfinite(height):
            doubts.append(f"There is no ground under {name}.")
        # On an edge the ground is at either height.
        elif np.abs(profile.height[max(nearest - 2, 0) : nearest + 3] - level).min() > _OFF_GROUND:
            doubts.append(
                f"{name.capitalize()} is {abs(level - height):.2f} m "
                f"{'above' if level > height else 'below'} the ground."
            )
    length = float(profile.stops[-1])
    if length > _LONGEST:
        doubts.append(
            f"The course is {length:.1f} m long; in the 12 s of a trial the policy walks about "
            f"{_LONGEST:g} m: set `duration` in the suite."
        )
    if len(stops) < 2 or length < _RADIUS:
        doubts.append("The robot starts at its goal.")
    elif float(np.hypot(*np.subtract(stops[1], stops[0])[:2])) < _RADIUS + _JITTER:
        doubts.append("Waypoint 1 is reached at the start: move it ahead, or the start back.")
    return doubts


def _on_legs(stops: Sequence[Point]) -> list[str]:
    doubts: list[str] = []
    plan = np.array(stops)[:, :2]
    legs = np.diff(plan, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    for i, length in enumerate(lengths):
        if length > _LONGEST_LEG:
            doubts.append(
                f"It is {length:.1f} m to waypoint {i + 1}: the policy may stray; add one every "
                f"{_LONGEST_LEG:g} m."
            )
        elif i and length < _RADIUS:
            doubts.append(
                f"Waypoint {i + 1} is {length:.2f} m from the last: both count as reached at once."
            )
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    for i, change in enumerate(np.diff(headings)):
        turned = abs((change + math.pi) % (2 * math.pi) - math.pi)
        if turned > _SHARPEST and min(lengths[i], lengths[i + 1]) > 0:
            doubts.append(f"The course turns by {math.degrees(turned):.0f} degrees at {i + 1}.")
    return doubts


def _beyond(obstacle: Obstacle, which: int) -> bool:
    return obstacle.size > _LIMITS[obstacle.kind][which] + _LOOSE[obstacle.kind]


def _warning(obstacle: Obstacle) -> str:
    well, _ = _LIMITS[obstacle.kind]
    chance = "probably fails" if _beyond(obstacle, 1) else "manages it sometimes"
    return (
        f"A {obstacle.kind} of {_size(obstacle)} at {obstacle.at:.1f} m: the default policy "
        f"{chance}; {_text(obstacle.kind, well)} it does well."
    )


def _size(obstacle: Obstacle) -> str:
    return _text(obstacle.kind, obstacle.size)


def _text(kind: ObstacleKind, size: float) -> str:
    return f"{math.degrees(size):.0f} degrees" if kind == "ramp" else f"{size:.2f} m"


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """One thing on the way.

    Attributes:
        kind: a `step` goes up or down; a `ramp` too.
        at: distance from the start to its near edge, m.
        size: height of a hurdle, width of a gap, height of a step, m; angle of a ramp, rad.
    """

    kind: ObstacleKind
    at: float
    size: float


def obstacles_of(profile: HeightProfile) -> tuple[Obstacle, ...]:
    """Return the obstacles along a profile, in order."""
    if not np.isfinite(profile.height).any() or profile.distance[-1] < 2 * SPACING:
        return ()
    at = np.arange(0.0, profile.distance[-1], SPACING)
    floor = profile.height[np.isfinite(profile.height)].min() - _BOTTOMLESS
    height = np.interp(at, profile.distance, np.maximum(profile.height, floor))
    if len(at) <= _WINDOW:
        return ()
    rise = height[_WINDOW:] - height[:-_WINDOW]
    sign = np.where(np.abs(rise) > _SUDDEN, np.sign(rise), 0.0)
    edges: list[tuple[float, float]] = []
    for first, last in _runs(sign):
        within = height[first : last + _WINDOW + 1]
        steepest = int((sign[first] * np.diff(within)).argmax())
        edges.append((float(at[first + steepest]), float(within[-1] - within[0])))
    obstacles = [*_paired(edges), *_ramps(at, height, sign != 0)]
    return tuple(sorted(obstacles, key=lambda obstacle: obstacle.at))


def _runs(sign: NDArray[np.float64]) -> list[tuple[int, int]]:
    borders = np.flatnonzero(np.diff(np.concatenate([[0.0], sign, [0.0]])))
    return [
        (int(first), int(last) - 1)
        for first, last in pairwise(borders.tolist())
        if sign[first] != 0
    ]


def _paired(edges: list[tuple[float, float]]) -> list[Obstacle]:
    """Return obstacles of edges (distance, rise): up and down is a hurdle, down and up a gap."""
    obstacles: list[Obstacle] = []
    i = 0
    while i < len(edges):
        at, rise = edges[i]
        after, back = edges[i + 1] if i + 1 < len(edges) else (math.inf, 0.0)
        width = after - at
        if rise > 0 > back and width <= _LONGEST_HURDLE and -back > rise / 2:
            obstacles.append(Obstacle(kind="hurdle", at=at, size=rise))
            i += 2
        elif rise < 0 < back and width <= _LONGEST_GAP and min(-rise, back) >= _LEAST_GAP:
            obstacles.append(Obstacle(kind="gap", at=at, size=width))
            i += 2
        else:
            obstacles.append(Obstacle(kind="step", at=at, size=abs(rise)))
            i += 1
    return obstacles


def _ramps(
    at: NDArray[np.float64], height: NDArray[np.float64], sudden: NDArray[np.bool_]
) -> list[Obstacle]:
    count = len(at) - _SLOPE_WINDOW
    if count <= 0:
        return []
    slope = (height[_SLOPE_WINDOW:] - height[:-_SLOPE_WINDOW]) / (_SLOPE_WINDOW * SPACING)
    # An edge within the window, or just beside it, is no slope.
    near = np.convolve(sudden, np.ones(_SLOPE_WINDOW + _WINDOW), "full")
    near = near[_SLOPE_WINDOW : _SLOPE_WINDOW + count] > 0
    steep = np.where(~near & (np.abs(slope) > math.tan(_FLAT)), np.sign(slope), 0.0)
    return [
        Obstacle(
            kind="ramp",
            at=float(at[first]),
            size=math.atan(float(np.abs(slope[first : last + 1]).max())),
        )
        for first, last in _runs(steep)
    ]
