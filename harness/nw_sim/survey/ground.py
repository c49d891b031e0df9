"""The ground where feet go: what the mesh shows there, what physics has, and what is wrong with it.

Feet are dropped along the course, too: whether physics carries them where the mesh shows ground.
`footing_of` measures how rough, stepped and steep the ground is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from nw_base.words import Task
from nw_scenes.finding import Code, SceneFinding, Severity
from nw_scenes.mesh import TriangleMesh
from nw_scenes.rays import RayScene
from nw_scenes.scene import Scene, Triangles
from nw_sim.physics.batch import drop_balls, solid_heights
from nw_sim.survey.course import CourseSamples, course_samples

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

Flaw = Literal["missing", "untouched", "unseen"]
"""Of ground: there is none; it is seen and nothing is there to be touched; or the other way."""

SPACING = 0.02
"""Between samples, along the course and across it, m: as far as a foot's radius."""
WANDER = 0.1
"""How far to each side of the course a robot's feet are beside their usual place, m."""
TOLERANCE = 0.05
"""By which heights of mesh and physics may differ, m."""

_BEHIND = 0.3  # m that the hind feet are behind the start, and its jitter
_MOST = 20_000  # samples along a course
_DEEP = 1.0  # m below the course: no robot walks there
_APART = 0.2  # m between flaws that are two

FEET_SPACING = 0.1
"""Between dropped feet along the course, m."""
SUNK = 0.01
"""How far a foot may come to rest under the ground that the mesh shows round it, m."""

_MOST_FEET = 120  # places along the course; on a longer one they are farther apart
_LINES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])  # of the half width
_RADIUS = 0.02  # m, of a foot
_MASS = 3.0  # kg, what a foot carries
_FALL = 0.05  # m over the ground, from where it is thrown down
_SPEED = 3.0  # m/s at which it lands, as feet do after a jump
_STEP = 0.005  # s
_STEPS = 120  # until it lies still
_ROUND = 0.06  # m round its place, within which it may have slid off an edge

LONGEST_GAP = 1.0
"""Length of a gap from rim to rim, m, that may be what the course is about."""

INVENTED = 0.1
"""Area of ground that physics may add to what the mesh shows, m2: a small hole that is closed."""

PATCH = 0.25
"""Edge of the square of ground to whose plane roughness is measured, m."""
FOOT = 0.04
"""Length over which a step is measured, m: that of a foot."""
MOST_ROUGH = 0.07
"""Roughness that feet bear, in lengths of a leg; see docs/how-to/check-scenes.md for the trials."""
MOST_STEEP = 0.61
"""Slope that feet bear, rad: 35 degrees; the steepest ramps of the built-in scenes have 30."""

_EDGE = 0.06  # m over a foot's length: an edge, which is a step and no roughness
_LEAST_ROUGH = 0.5  # m along the course; over less, an edge may be taken for roughness
_PATCH = round(PATCH / SPACING / 2)  # samples to each side of a patch's middle
_LEAST_KNOWN = 0.5  # share of a patch that has ground

_MOST_FINDINGS = 5  # findings of one scene; the largest
_CODES: dict[Flaw, Code] = {
    "missing": "ground_missing",
    "untouched": "ground_untouched",
    "unseen": "ground_unseen",
}
_FIXES: dict[Flaw, str] = {
    "missing": "close the mesh there, photograph that ground too, or move the course elsewhere",
    "untouched": "the part there is thinner than physics can carry, or its faces point down: make "
    "it a closed solid 15 mm thick or more",
    "unseen": "close the mesh there, or open it up to the corridor's sides if that is a gap",
}


def survey_ground(scene: Scene, rays: RayScene, half_width: float, length: float) -> SurveyedGround:
    """Look down on the corridor along a scene's course, and feel what carries there.

    Args:
        scene: where.
        rays: of its mesh.
        half_width: of the corridor, m: half of a standing robot, without `WANDER`.
        length: of the robot, m: the corridor goes on so far behind the last waypoint.
    """
    samples = course_samples(scene, SPACING, behind=_BEHIND, beyond=length, most=_MOST)
    end = float(course_samples(scene, 1.0).along[-1])
    xy, reach = _corridor(samples, half_width)
    flat, above = xy.reshape(-1, 2), np.repeat(samples.above, xy.shape[1])
    low = samples.points[:, 2:] - _DEEP
    seen = rays.height(flat, z_from=above).reshape(xy.shape[:2])
    seen = np.where(seen > low, seen, np.nan)
    felt = _felt(scene, flat, above).reshape(xy.shape[:2])
    felt = np.where(felt > low, felt, np.nan)
    # Under the lowest of what is seen there is but what catches what falls off a mesh.
    felt = np.where(felt < np.nanmin(seen, initial=np.inf) - TOLERANCE, np.nan, felt)
    lower = seen - felt > TOLERANCE
    flawed: dict[Flaw, Mask] = {
        "missing": np.isnan(seen) & np.isnan(felt),
        "untouched": ~np.isnan(seen) & (np.isnan(felt) | lower),
        "unseen": ~np.isnan(felt) & (np.isnan(seen) | (felt - seen > TOLERANCE)),
    }
    any_flaw = np.logical_or.reduce([flawed[kind] for kind in get_args(Flaw)])
    flaws = [
        flaw
        for kind, mask in flawed.items()
        for flaw in _stretches(kind, _foot_sized(mask), samples, xy, np.abs(seen - felt))
    ]
    return SurveyedGround(
        width=2 * reach,
        sound=float(1 - any_flaw[samples.along <= end].mean()),
        end=end,
        flaws=tuple(sorted(flaws, key=lambda flaw: (flaw.first, flaw.kind))),
        footing=footing_of(samples, seen),
    )


def _corridor(samples: CourseSamples, half_width: float) -> tuple[Values, float]:
    """Return points (S, L, 2) where feet go, and how far to each side, m."""
    reach = half_width + WANDER
    sides = np.linspace(-reach, reach, 1 + 2 * round(reach / SPACING))
    return samples.points[:, None, :2] + sides[:, None] * samples.left[:, None], reach


def room_behind(scene: Scene, rays: RayScene, half_width: float, most: float) -> float:
    """Return how far the mesh has ground behind a course's last waypoint, where feet go, m.

    Args:
        scene: whose course.
        rays: of its mesh.
        half_width: of the corridor, m, as `survey_ground` has it.
        most: how far to look, m.
    """
    samples = course_samples(scene, SPACING, beyond=most, most=_MOST)
    end = float(course_samples(scene, 1.0).along[-1])
    xy, _ = _corridor(samples, half_width)
    seen = rays.height(xy.reshape(-1, 2), z_from=np.repeat(samples.above, xy.shape[1]))
    there = (seen > np.repeat(samples.points[:, 2] - _DEEP, xy.shape[1])).reshape(xy.shape[:2])
    holes = samples.along[_foot_sized(~there).any(axis=1) & (samples.along > end)]
    return min(most, float(holes[0]) - end) if len(holes) else most


@dataclass(frozen=True, kw_only=True)
class SurveyedGround:
    """The corridor under the feet.

    Attributes:
        width: m.
        sound: share of its samples up to the last waypoint at which mesh and physics have the same
            ground.
        end: where the last waypoint is, m along the course; the corridor goes on behind it.
        flaws: in the order of the course; none is smaller than a foot.
        footing: how rough, stepped and steep it is.
    """

    width: float
    sound: float
    end: float
    flaws: tuple[GroundFlaw, ...]
    footing: Footing


@dataclass(frozen=True, kw_only=True, eq=False)
class Footing:
    """The ground of the corridor at stations along the course, from the start on.

    Attributes:
        along: (S,) m from the start, `FEET_SPACING` apart.
        places: (S, 3) on the course's line, world, m.
        roughness: (S,) root mean square distance from the plane of a square of `PATCH`, m. Where
            an edge crosses the square, of its smoothest half or quarter. nan without ground.
        step: (S,) largest change of height over `FOOT`, m, of an edge that is wider than a foot;
            nan without ground.
        slope: (S,) of that plane in the corridor's middle, rad; nan without ground.
    """

    along: Values
    places: Values
    roughness: Values
    step: Values
    slope: Values


def footing_of(samples: CourseSamples, seen: Values) -> Footing:
    """Return how rough, stepped and steep a corridor is.

    Args:
        samples: (S,) of its line, `SPACING` apart.
        seen: (S, L) heights of its ground, lines `SPACING` apart, m; nan where there is none.
    """
    every = round(FEET_SPACING / SPACING)
    rows = np.flatnonzero(samples.along > -SPACING / 2)[::every]
    padded = np.pad(seen, ((_PATCH, _PATCH), (0, 0)), constant_values=np.nan)
    windows = sliding_window_view(padded, 2 * _PATCH + 1, axis=0)[rows]  # (stations, lines, along)
    middles = np.linspace(_PATCH, seen.shape[1] - 1 - _PATCH, 3).round().astype(np.int64)
    across = middles[:, None] + np.arange(-_PATCH, _PATCH + 1)
    patches = windows[:, across].swapaxes(2, 3)  # (stations, left to right, along, across)
    rough, slope = _planes(patches)
    foot = round(FOOT / SPACING)
    near = patches[:, :, _PATCH - every : _PATCH + every + 1]
    rises = np.abs(near[:, :, foot:] - near[:, :, :-foot])
    there = np.isfinite(rises)
    step = np.median(np.where(there, rises, 0.0), axis=3).max(axis=(1, 2))
    known = np.isfinite(rough)
    squares = np.where(known, rough**2, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return Footing(
        along=samples.along[rows],
        places=samples.points[rows],
        roughness=np.where(known.any(axis=1), np.sqrt(squares), np.nan),
        step=np.where(there.any(axis=(1, 2, 3)), step, np.nan),
        slope=slope[:, 1],
    )


def _planes(patches: Values) -> tuple[Values, Values]:
    """Return the roughness, m, and the slope, rad, of squares of ground, (S, 3) each.

    Planes are fitted by least squares. A square that an edge crosses is judged by its smoothest
    half or quarter: a step from plane to plane is not rough, nor is the corner of a board.

    Args:
        patches: (S, 3, N, N) heights `SPACING` apart, m; nan where there is none.
    """
    side = SPACING * np.arange(-_PATCH, _PATCH + 1)
    u, v = (part.ravel() for part in np.meshgrid(side, side, indexing="ij"))
    design = np.column_stack([np.ones_like(u), u, v])
    outer = (design[:, :, None] * design[:, None, :]).reshape(-1, 9)
    flat = patches.reshape(-1, len(u))
    heights = np.where(np.isfinite(flat), flat, 0.0)
    foot = round(FOOT / SPACING)
    edged = np.zeros(len(flat), dtype=np.bool_)
    for moved in (patches, patches.swapaxes(2, 3)):
        rises = np.abs(moved[:, :, foot:] - moved[:, :, :-foot])
        edged |= (rises > _EDGE).any(axis=(2, 3)).ravel()
    rough, slope = np.full((2, len(flat)), np.inf)
    halves = (u <= 0.0, u >= 0.0, v <= 0.0, v >= 0.0)
    quarters = [one & other for one in halves[:2] for other in halves[2:]]
    for number, piece in enumerate((u < 1.0, *halves, *quarters)):
        weight = (np.isfinite(flat) & piece).astype(np.float64)
        count = weight.sum(axis=1)
        enough = count >= _LEAST_KNOWN * piece.sum()
        normal = (weight @ outer).reshape(-1, 3, 3) + 1e-9 * np.eye(3)
        plane = np.linalg.solve(normal, ((weight * heights) @ design)[..., None])[..., 0]
        off = weight * (heights - plane @ design.T)
        roughness = np.sqrt((off**2).sum(axis=1) / np.maximum(count, 1.0))
        better = enough & (roughness < rough) & (edged if number else ~edged)
        rough = np.where(better, roughness, rough)
        slope = np.where(better, np.arctan(np.hypot(plane[:, 1], plane[:, 2])), slope)
    rough, slope = (np.where(np.isfinite(part), part, np.nan) for part in (rough, slope))
    return rough.reshape(patches.shape[:2]), slope.reshape(patches.shape[:2])


def footing_findings(footing: Footing, robot: str, leg: float) -> list[SceneFinding]:
    """Return where the ground is rougher or steeper than feet bear, the longest stretch of each.

    Args:
        footing: measured.
        robot: its name.
        leg: length of its legs, m.
    """
    bounds = (
        (footing.roughness, MOST_ROUGH * leg, "{:.3f} m off the plane of {} m"),
        (footing.slope, MOST_STEEP, "{:.2f} rad steep over {} m"),
    )
    findings: list[SceneFinding] = []
    for values, limit, words in bounds:
        beyond = np.concatenate([[False], values > limit, [False]])
        starts, ends = np.flatnonzero(np.diff(beyond.astype(np.int8))).reshape(-1, 2).T
        if not len(starts) or (ends - starts).max() * FEET_SPACING < _LEAST_ROUGH:
            continue
        longest = int(np.argmax(ends - starts))
        first, last = int(starts[longest]), int(ends[longest]) - 1
        value = float(np.median(values[first : last + 1]))
        x, y, z = footing.places[(first + last) // 2].tolist()
        findings.append(
            SceneFinding(
                code="ground_rough",
                severity="warning",
                message=f"the ground is {words.format(value, PATCH)} (median) from "
                f"{footing.along[first]:.2f} to {footing.along[last]:.2f} m along the course, "
                "round "
                f"({x:.2f}, {y:.2f}); feet of a {robot} bear {limit:.3f}",
                fix="smooth the mesh there if the real ground is smoother, or move the course "
                "elsewhere",
                value=value,
                place=(x, y, z),
            )
        )
    return findings


@dataclass(frozen=True, kw_only=True)
class GroundFlaw:
    """A stretch of the corridor whose ground is not what it should be.

    Attributes:
        kind: what is wrong.
        first, last: where, m along the course.
        width: of the flaw where it is widest, m.
        area: m2.
        off: by how much the heights of mesh and physics differ there at most, m; None where one of
            them has none.
        across: whether it takes the whole corridor.
        place: its middle, world, m.
    """

    kind: Flaw
    first: float
    last: float
    width: float
    area: float
    off: float | None
    across: bool
    place: tuple[float, float, float]


def _felt(scene: Scene, xy: Values, above: Values) -> Values:
    """Return the height at which physics stops what comes down at points, (N,) m, nan for nothing.

    Asked of MuJoCo's own geometry, boxes and height fields as a trial has them; of a mesh that
    collides by its own triangles, these are asked.
    """
    for solid in scene.solids:
        if isinstance(solid, Triangles):
            kinds = np.zeros(len(solid.faces), dtype=np.uint8)
            mesh = TriangleMesh(vertices=solid.vertices, faces=solid.faces, kinds=kinds)
            return RayScene(mesh).height(xy, z_from=above)
    return solid_heights(scene, xy, above)


def _foot_sized(mask: Mask) -> Mask:
    """Return the parts of a mask (S, L) that hold three by three samples: wider than a foot."""
    core = mask.copy()
    for axis in (0, 1):
        core = core & _shifted(core, 1, axis) & _shifted(core, -1, axis)
    for axis in (0, 1):
        core = core | _shifted(core, 1, axis) | _shifted(core, -1, axis)
    return core


def _shifted(mask: Mask, by: int, axis: int) -> Mask:
    moved = np.zeros_like(mask)
    to, source = (slice(1, None), slice(None, -1))[::by], (slice(None, -1), slice(1, None))[::by]
    if axis == 0:
        moved[to[0]] = mask[source[0]]
    else:
        moved[:, to[0]] = mask[:, source[0]]
    return moved


def _stretches(
    kind: Flaw, mask: Mask, samples: CourseSamples, xy: Values, off: Values
) -> Iterator[GroundFlaw]:
    """Yield the stretches of a mask (S, L) along the course."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return
    along = samples.along
    breaks = np.flatnonzero(np.diff(along[rows]) > _APART) + 1
    for run in np.split(rows, breaks):
        part = np.zeros_like(mask)
        part[run] = mask[run]
        widest = int(part.sum(axis=1).max())
        x, y = xy[part].mean(axis=0).tolist()
        differences = off[part]
        differences = differences[np.isfinite(differences)]
        yield GroundFlaw(
            kind=kind,
            first=float(along[run[0]]),
            last=float(along[run[-1]]),
            width=widest * SPACING,
            area=float(part.sum()) * SPACING**2,
            off=float(differences.max()) if differences.size else None,
            across=widest == mask.shape[1],
            place=(x, y, float(samples.points[run, 2].mean())),
        )


def drop_feet(scene: Scene, rays: RayScene, half_width: float) -> DroppedFeet:
    """Let spheres of a foot's size and load fall onto the corridor, and look where they end.

    Heights alone say nothing of contacts: ground can be where it should and trap what lands on it.

    Args:
        scene: where.
        rays: of its mesh.
        half_width: of the corridor, m.
    """
    samples = course_samples(scene, FEET_SPACING, most=_MOST_FEET)
    sides = half_width * _LINES
    xy = (samples.points[:, None, :2] + sides[:, None] * samples.left[:, None]).reshape(-1, 2)
    along = np.repeat(samples.along, len(sides))
    above = np.repeat(samples.above, len(sides))
    ground = rays.height(xy, z_from=above)
    there = ground > np.repeat(samples.points[:, 2], len(sides)) - _DEEP
    up = np.tile([0.0, 0.0, 1.0], (int(there.sum()), 1))
    room = rays.distance(np.column_stack([xy, ground + 1e-3])[there], up)
    there[there] = room > _FALL + 2 * _RADIUS
    xy, ground, along, above = xy[there], ground[there], along[there], above[there]
    if not len(xy):
        return DroppedFeet(count=0, sunk=0, deepest=0.0, along=0.0, place=(0.0, 0.0, 0.0))
    ends = _fallen(scene, np.column_stack([xy, ground + _RADIUS + _FALL]))
    turns = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
    ring = _ROUND * np.column_stack([np.cos(turns), np.sin(turns)])
    disc = np.concatenate([np.zeros((1, 2)), ring, ring / 2])
    round_it = (ends[:, None, :2] + disc).reshape(-1, 2)
    lowest = rays.height(round_it, z_from=np.repeat(above, len(disc)))
    lowest = lowest.reshape(len(ends), len(disc)).min(axis=1)
    under = lowest + _RADIUS - ends[:, 2]
    worst = int(np.argmax(under))
    x, y, z = ends[worst].tolist()
    sunk = int((under > SUNK).sum())
    return DroppedFeet(
        count=len(ends),
        sunk=sunk,
        deepest=float(under[worst]) if sunk else 0.0,
        along=float(along[worst]),
        place=(x, y, z),
    )


@dataclass(frozen=True, kw_only=True)
class DroppedFeet:
    """What became of them.

    Attributes:
        count: of the feet; none where there is no ground, or no room above it.
        sunk: how many came to rest under the ground.
        deepest: of those, how far under it, m; 0 without any.
        along: where the deepest is, m along the course.
        place: where it came to rest, world, m.
    """

    count: int
    sunk: int
    deepest: float
    along: float
    place: tuple[float, float, float]


def _fallen(scene: Scene, starts: Values) -> Values:
    """Return where feet that fall from places (N, 3) come to rest, (N, 3) m."""
    return drop_balls(
        scene, starts, radius=_RADIUS, mass=_MASS, speed=_SPEED, timestep=_STEP, steps=_STEPS
    )


def ground_findings(ground: SurveyedGround, task: Task) -> list[SceneFinding]:
    """Return a finding for each of the largest flaws, in the order of the course."""
    largest = sorted(ground.flaws, key=lambda flaw: -flaw.area)[:_MOST_FINDINGS]
    return [_finding(flaw, ground, task) for flaw in ground.flaws if flaw in largest]


def feet_findings(feet: DroppedFeet) -> list[SceneFinding]:
    """Return that feet sink in, if any did."""
    if not feet.sunk:
        return []
    x, y, _ = feet.place
    return [
        SceneFinding(
            code="feet_sink",
            severity="error",
            message=f"{feet.sunk} of {feet.count} feet that were dropped on the course came to "
            "rest "
            f"under the ground, up to {feet.deepest:.3f} m at {feet.along:.2f} m along it, "
            f"({x:.2f}, {y:.2f}); {SUNK:g} m is allowed",
            fix="check for folded or doubled faces there, and faces that point down",
            value=feet.deepest,
            place=feet.place,
        )
    ]


def _finding(flaw: GroundFlaw, ground: SurveyedGround, task: Task) -> SceneFinding:
    x, y, _ = flaw.place
    where = f"from {flaw.first:.2f} to {flaw.last:.2f} m along the course, round ({x:.2f}, {y:.2f})"
    if flaw.last < 0.0:
        where += ", where hind feet stand at the start"
    elif flaw.first > ground.end:
        where += ", behind the last waypoint"
    size = f"{flaw.width:.2f} m wide in the {ground.width:.2f} m where feet go, {flaw.area:.3f} m2"
    off = "" if flaw.off is None else f", by {flaw.off:.2f} m ({TOLERANCE:g} m is allowed)"
    added = f" ({INVENTED:g} m2 of such ground is a warning)" if flaw.kind == "unseen" else ""
    messages: dict[Flaw, str] = {
        "missing": f"there is no ground {where}: {size}",
        "untouched": f"ground is seen {where}, where physics has none or lower one{off}: {size}",
        "unseen": f"physics carries feet {where}, where the mesh shows no ground or lower one{off}"
        f": {size}{added}",
    }
    severity, fix = _severity(flaw), _FIXES[flaw.kind]
    if task == "gaps" and flaw.kind == "missing" and flaw.across and _length(flaw) <= LONGEST_GAP:
        severity, fix = "note", "nothing, if that is a gap of the course"
    return SceneFinding(
        code=_CODES[flaw.kind],
        severity=severity,
        message=messages[flaw.kind],
        fix=fix,
        value=flaw.area,
        place=flaw.place,
    )


def _severity(flaw: GroundFlaw) -> Severity:
    """A small hole that physics closes changes what a policy is told; a large one, the course."""
    closed = flaw.kind == "unseen" and flaw.area <= INVENTED and not flaw.across
    return "warning" if closed else "error"


def _length(flaw: GroundFlaw) -> float:
    return flaw.last - flaw.first
