"""A course through a scene that was photographed on a walk, proposed for a person to agree with.

It is as the shipped scenes have them: waypoints on top of things, a spawn, and a task. What the
course leads over is told from the profile of the ground: hurdles, gaps, slopes, leaning boards and
stairs, each with its size.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.words import Task
from nw_scenes.mesh import TriangleMesh
from nw_scenes.rays import RayScene
from nw_scenes.scene import Spawn, Vector
from nw_sim.survey.ground import holes_along
from nw_sim.tasks.course import REACH_RADIUS
from nw_twin.course_profile import (
    STEP,
    GroundProfile,
    Shown,
    Stretch,
    free_ways,
    ground_along,
    sound,
    stretches_of,
    way_of,
)

Values = NDArray[np.float64]

_FINISH = 1.4
"""From the last feature to the last waypoint, metres, where there is as much way."""
_APART = 0.25
"""Waypoints that are closer are one, metres."""
_APPROACH = 1.5
"""Level way before the first feature, at most, metres: as much as in the shipped scenes."""
_CLEAR = REACH_RADIUS + 0.3
"""From the spawn to the first waypoint at least, metres: beyond reach of where any trial begins.
A longer robot has its own length."""
LENGTH = 0.55
"""Of a Go1 from nose to tail, metres."""
HALF_WIDTH = 0.195
"""Of a Go1 as it stands, metres."""
_MARGIN = 0.05
"""Of ground behind the last waypoint, more than a robot's length, metres."""
_FEET = np.linspace(-0.3, 0.3, 13)
"""Lines beside the way on which feet go, metres."""
_BEHIND = 0.3
"""Of ground behind the start on which hind feet stand, metres."""
_TRIED = 6
"""Strips of level ground that are looked at for one without holes."""
_LONGEST = 8.0
"""Of a course, metres: a trial has 12 s, in which go1-parkour walks about as far."""
_BOW = 0.15
"""Distance of the way from a straight leg, metres, from which on it gets a waypoint."""
_RUN_UP = 0.5
"""Metres of level way that a robot needs before the first feature."""
FLOOR = 0.02
"""A spawn may be so far from z = 0, metres."""

_STEP_RUN, _EVEN = 4, 0.05
"""Samples within which a rise is measured, and metres up to which a way is called flat."""

_LONGEST_BAR = 0.9
"""Of a hurdle along the way, metres; what is longer is a platform."""
_WIDEST_GAP = 1.3
"""That a robot is asked to leap, metres."""
_ALIKE = 0.06
"""Two heights that differ by less are the same ground, metres."""
_STEPS = 3
"""Edges one way that make a flight of stairs."""
_LONGEST_TREAD = 1.6
"""Landings within a flight included, metres."""
_TALLEST_STEP = 0.28
_LEAN = math.tan(math.radians(6.0))
_LEAST_BOARD = 0.4
"""Of a board that leans to a side, metres along the way."""


@dataclass(frozen=True, kw_only=True)
class CourseProposal:
    """What somebody may take for a scene's course, or change.

    Attributes:
        task: that the course seems to ask for.
        reasons: for it, and what else was found.
        spawn: on the way, `_APPROACH` before the first feature or at its start, looking along it.
        trail: waypoints on top of what the robot steps on, metres.
        features: in order.
        warnings: what somebody should look at.
        whole: whether the ground has no hole as wide as a foot where feet go.
    """

    task: Task
    reasons: tuple[str, ...]
    spawn: Spawn
    trail: tuple[Vector, ...]
    features: tuple[CourseFeature, ...]
    warnings: tuple[str, ...]
    whole: bool


def propose_course(
    mesh: TriangleMesh,
    centres: Values,
    *,
    length: float = LENGTH,
    half_width: float = HALF_WIDTH,
    shown: Shown | None = None,
) -> CourseProposal:
    """Return a course along the way that the cameras went, over what lies there.

    It is as long as the robot at least, `_LONGEST` at most, and ends a robot's length before the
    ground does.

    Args:
        mesh: of the scene in metres, z up.
        centres: (V, 3) of the cameras in the order of the walk, in the same frame.
        length: of the robot from nose to tail, metres.
        half_width: of the robot as it stands, metres.
        shown: where photographs show the ground; None if unknown.

    Raises:
        SceneError: the cameras went less than a metre, the mesh has no ground below them, or too
            little for a waypoint that a robot has to walk to.
    """
    below = float(centres[:, 2].max())
    profile = ground_along(mesh, way_of(centres), below, shown)
    return _proposed(mesh, profile, below, length, half_width)


def propose_free_course(
    mesh: TriangleMesh,
    centres: Values,
    *,
    length: float = LENGTH,
    half_width: float = HALF_WIDTH,
    shown: Shown | None = None,
) -> CourseProposal:
    """Return a course on the longest straight strip of level ground, wherever the cameras went.

    One without holes is better, however short. It leads the way that the cameras went, as far as
    they went anywhere. Arguments as `propose_course`.

    Raises:
        SceneError: no such strip is long enough.
    """
    below = float(centres[:, 2].max())
    proposals: list[CourseProposal] = []
    failed: SceneError | None = None
    for way in free_ways(mesh, centres, below, shown)[:_TRIED]:
        try:
            profile = ground_along(mesh, way, below)
            proposals.append(_proposed(mesh, profile, below, length, half_width, from_start=True))
        except SceneError as error:
            failed = failed or error
            continue
        if proposals[-1].whole:
            return proposals[-1]
    if not proposals and failed is not None:
        raise failed
    return proposals[0]


def _proposed(
    mesh: TriangleMesh,
    profile: GroundProfile,
    below: float,
    length: float,
    half_width: float,
    *,
    from_start: bool = False,
) -> CourseProposal:
    """Return the course along a way, from before its first feature or from the way's start."""
    features = features_of(profile, stretches_of(profile))
    if features and features[0].start > _APPROACH and not from_start:
        profile = profile.after(features[0].start - _APPROACH)
        features = features_of(profile, stretches_of(profile))
    along, whole = _soundness(mesh, profile, below, length + _MARGIN)
    end = _last(profile, along, whole, length + _MARGIN)
    stands, arrives = _arriving(mesh, profile, features, min(end, _LONGEST), length, half_width)
    reached = [feature for feature in features if feature.start < stands[-1]]
    is_cut = end > _LONGEST and (stands[-1] > _LONGEST - STEP or len(reached) < len(features))
    features = reached
    task, reasons = guess_task(features)
    measured, is_even = _measured(profile, stands[-1])
    if not features and not is_even:
        reasons = ("no bar, gap, slope or step stands out along the way",)
    return CourseProposal(
        task=task,
        reasons=(*reasons, measured),
        spawn=_spawn(profile),
        trail=tuple(_point(profile, stand) for stand in stands),
        features=tuple(features),
        warnings=_warnings(profile, features, end if is_cut else None),
        whole=arrives and bool(whole[along <= stands[-1] + length].all()),
    )


def guess_task(features: Sequence[CourseFeature]) -> tuple[Task, tuple[str, ...]]:
    """Return the task of the most features, and why; a flat course is one of hurdles without bars.

    Of tasks with as many features the one whose features are longer along the way wins.
    """
    if not features:
        return "hurdles", ("the way is flat: a course without obstacles",)
    counts = Counter[Task](feature.task for feature in features)
    length = {
        one: sum(feature.end - feature.start for feature in features if feature.task == one)
        for one in counts
    }
    steps = any(feature.task == "stairs" for feature in features)
    # A flight is one feature of many steps.
    task: Task = "stairs"
    if not steps:
        task = max(counts, key=lambda one: (counts[one], length[one]))
    ordered = sorted(features, key=lambda feature: feature.task != task)
    return task, tuple(f"{one.words}, {one.start:.1f} m along" for one in ordered)


def _measured(profile: GroundProfile, end: float) -> tuple[str, bool]:
    """Return what is measured of the ground up to a waypoint so far along, and if it is even."""
    last = max(_STEP_RUN + 1, round(end / STEP) + 1)
    z, lean = profile.height[:last], np.abs(profile.lean[:last])
    steps = z[_STEP_RUN:] - z[:-_STEP_RUN] if len(z) > _STEP_RUN else np.zeros(1)
    up, down = max(0.0, float(steps.max())), max(0.0, float(-steps.min()))
    text = (
        f"measured along {end:.1f} m of it: heights from {z.min():+.2f} to {z.max():+.2f} m; "
        f"within {STEP * _STEP_RUN:.2f} m it rises by {up:.2f} m and falls by {down:.2f} m at "
        f"most; it leans by {math.degrees(math.atan(float(lean.max()))):.0f} degrees at most"
    )
    return text, float(np.ptp(z)) < _EVEN and max(up, down) < _EVEN


def _spawn(profile: GroundProfile) -> Spawn:
    ahead = profile.xy[min(len(profile.xy) - 1, round(_RUN_UP / STEP))] - profile.xy[0]
    x, y, z = _point(profile, 0.0)
    yaw = round(math.atan2(float(ahead[1]), float(ahead[0])), 4)
    return Spawn(position=(x, y, z), yaw=yaw)


def _soundness(
    mesh: TriangleMesh, profile: GroundProfile, below: float, arrive: float
) -> tuple[Values, NDArray[np.bool_]]:
    """Return where along the way feet go, (S,) metres, and whether the ground there is sound.

    From a stance behind the start to so many metres, `arrive`, behind the end of the way.
    """
    xy, before, behind = profile.xy, round(_BEHIND / STEP), round(arrive / STEP)
    first, last = xy[1] - xy[0], xy[-1] - xy[max(0, len(xy) - 1 - round(_RUN_UP / STEP))]
    last = STEP * last / max(float(np.hypot(*last)), 1e-12)
    places = np.concatenate(
        [
            xy[0] - np.arange(before, 0, -1)[:, None] * first,
            xy,
            xy[-1] + np.arange(1, behind + 1)[:, None] * last,
        ]
    )
    ahead = np.gradient(places, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    points = places[:, None] + _FEET[:, None] * left[:, None]
    heights = RayScene(mesh).height(points.reshape(-1, 2), z_from=below)
    along = STEP * np.arange(-before, len(xy) + behind, dtype=np.float64)
    return along, sound(np.isfinite(heights).reshape(points.shape[:2]))


def _last(profile: GroundProfile, along: Values, whole: NDArray[np.bool_], arrive: float) -> float:
    """Return how far along the way a waypoint may stand: with so much ground behind it, metres."""
    end = float(profile.along[-1])
    broken = along[(along > end - STEP / 2) & ~whole]
    return min(end, float(broken[0]) - arrive) if len(broken) else end


def _arriving(
    mesh: TriangleMesh,
    profile: GroundProfile,
    features: Sequence[CourseFeature],
    end: float,
    length: float,
    half_width: float,
) -> tuple[list[float], bool]:
    """Return where along the way waypoints stand, as `_stands`, with room behind the last one.

    The way bends and the course is straight between waypoints, so the ground that a robot arrives
    on is looked at once more as the check of a scene looks at it. Where no end nearby has such
    ground, the course keeps its length, and the second value is false.

    Raises:
        SceneError: as `_stands`.
    """
    arrive = length + _MARGIN
    first = stands = _stands(profile, features, end, length)
    while stands[-1] > first[-1] - 2.0 * arrive:
        trail = np.array([_point(profile, stand) for stand in stands])
        holes, long = holes_along(mesh, _spawn(profile), trail, half_width, arrive)
        behind = holes[holes > long]
        if not len(behind):
            return stands, True
        room = float(behind[0]) - long
        end = stands[-1] - max(STEP, arrive - room)
        try:
            stands = _stands(profile, features, end, length)
        except SceneError:
            break
    return first, False


def _stands(
    profile: GroundProfile, features: Sequence[CourseFeature], end: float, length: float
) -> list[float]:
    """Return where along the way waypoints stand: on each feature, behind the last, in bends.

    None is within reach of the spawn, nor nearer to it than the robot is long.

    Args:
        profile: of the way.
        features: in order.
        end: how far along the way a waypoint may stand.
        length: of the robot, metres.

    Raises:
        SceneError: none is left.
    """
    clear = max(_CLEAR, length)
    stands = sorted(stand for feature in features for stand in feature.stands)
    last = max((feature.end for feature in features if feature.start < end), default=None)
    stands.append(end if last is None else min(end, max([last, *stands]) + _FINISH))
    kept: list[float] = []
    for stand in stands:
        if stand > end or _from_start(profile, stand) < clear:
            continue
        if kept and stand - kept[-1] < _APART:
            continue
        kept.append(stand)
    if not kept:
        raise SceneError(
            f"there are {profile.along[-1]:.2f} m of ground along the way: too little for a "
            f"waypoint {clear:.2f} m from the start, with {length + _MARGIN:.2f} m behind it to "
            "arrive in",
            fix="capture more ground ahead of the start, or set the waypoints on the label page",
        )
    return [stand for leg in pairwise([0.0, *kept]) for stand in _bends(profile, *leg)]


def _bends(profile: GroundProfile, first: float, last: float) -> list[float]:
    """Return the end of a leg, after places between where the way bends away from it."""
    a, b = (round(place / STEP) for place in (first, last))
    piece = profile.xy[a : b + 1]
    if _from_start(profile, last) < _CLEAR or len(piece) < 3:
        return [last]
    along = piece[-1] - piece[0]
    aside = piece - piece[0]
    off = np.abs(aside[:, 0] * along[1] - aside[:, 1] * along[0])
    off = off / max(float(np.hypot(*along)), 1e-9)
    middle = first + STEP * int(np.argmax(off))
    near = min(middle - first, last - middle) < _CLEAR or _from_start(profile, middle) < _CLEAR
    if off.max() < _BOW or near:
        return [last]
    return [*_bends(profile, first, middle), *_bends(profile, middle, last)]


def _from_start(profile: GroundProfile, along: float) -> float:
    there = np.array(_point(profile, along)) - np.array(_point(profile, 0.0))
    return float(np.hypot(there[0], there[1]))


def _point(profile: GroundProfile, along: float) -> Vector:
    place = min(len(profile.along) - 1, max(0, round(along / STEP)))
    x, y = profile.xy[place].tolist()
    return round(x, 3), round(y, 3), round(float(profile.height[place]), 3)


def _warnings(
    profile: GroundProfile, features: Sequence[CourseFeature], further: float | None
) -> tuple[str, ...]:
    """Return what somebody should look at.

    Args:
        profile: of the way.
        features: that the course leads over.
        further: how far along the way a waypoint could stand, metres, where the course does not go
            so far.
    """
    warnings: list[str] = []
    if further is not None:
        warnings.append(
            f"the way continues for {further:.1f} m: the course is {_LONGEST:g} m long at most, "
            "about "
            "as far as a robot walks in a trial; for more, add waypoints and set `duration`"
        )
    if profile.left_out > 0.0:
        warnings.append(
            f"{profile.left_out:.1f} m of the way lie beyond 1 m or more without ground or "
            "without a photograph of it: the course is on the longest piece between"
        )
    height = float(profile.height[0])
    if abs(height) > FLOOR:
        warnings.append(
            f"the ground under the spawn is at z = {height:.2f} m: robots start above z = 0, so "
            f"move the scene by {-height:+.2f} m"
        )
    if features and features[0].start < _RUN_UP:
        warnings.append(
            f"{features[0].words} begins {features[0].start:.2f} m after the spawn: start farther "
            "back"
        )
    if features and float(profile.along[-1]) - features[-1].end < _RUN_UP:
        warnings.append("the way ends at the last feature: no space to arrive in")
    if profile.known < 1.0 - 1e-9:
        warnings.append(f"{1.0 - profile.known:.0%} of the way is over holes of the mesh")
    return tuple(warnings)


@dataclass(frozen=True, kw_only=True)
class CourseFeature:
    """One thing that a course leads over. Lengths in metres along the way.

    Attributes:
        task: whose scenes have such things.
        start, end: along the way.
        stands: where along the way a robot stands on it, in order: bars' tops, treads, decks, or
            what lies behind a gap.
        size: height of a bar or a flight, width of a gap, metres; or angle of a slope, degrees.
        words: what it is, for people.
    """

    task: Task
    start: float
    end: float
    stands: tuple[float, ...]
    size: float
    words: str


def features_of(profile: GroundProfile, stretches: Sequence[Stretch]) -> list[CourseFeature]:
    """Return the features that a profile leads over, in order.

    A flight of stairs is three edges one way or more with treads between them; a hurdle goes up and
    down again within 0.9 m, a gap down and up again within 1.3 m, to about the same height. So bars
    on the ground are no gaps: of the two readings, ground is what lies at the height of the start.
    """
    flights = _flights(stretches)
    taken = [(flight.start, flight.end) for flight in flights]
    free = [s for s in stretches if not any(a <= s.middle <= b for a, b in taken)]
    boards = _boards(profile)
    # A board that leans has edges before and behind it; that makes no bar of it.
    level = [
        feature
        for feature in _bars_and_gaps(free)
        if not any(b.start < feature.stands[0] < b.end for b in boards)
        and not any(feature.start < b.stands[0] < feature.end for b in boards)
    ]
    features = [*flights, *level, *_slopes(free), *boards]
    return sorted(features, key=lambda feature: feature.start)


def _flights(stretches: Sequence[Stretch]) -> list[CourseFeature]:
    edges = [s for s in stretches if s.kind == "edge"]
    groups: list[list[Stretch]] = []
    for edge in edges:
        last = groups[-1][-1] if groups else None
        follows = (
            last is not None
            and edge.rise * last.rise > 0
            and edge.start - last.end <= _LONGEST_TREAD
            and max(abs(edge.rise), abs(last.rise)) <= _TALLEST_STEP
        )
        if follows:
            groups[-1].append(edge)
        else:
            groups.append([edge])
    return [_flight(group) for group in groups if len(group) >= _STEPS]


def _flight(edges: Sequence[Stretch]) -> CourseFeature:
    rises = [abs(edge.rise) for edge in edges]
    treads = tuple((a.end + b.start) / 2 for a, b in pairwise(edges))
    way = "up" if edges[0].rise > 0 else "down"
    return CourseFeature(
        task="stairs",
        start=edges[0].start,
        end=edges[-1].end,
        stands=treads[::2],
        size=sum(rises),
        words=f"{len(edges)} steps {way}, {sum(rises) / len(rises):.2f} m each",
    )


def _bars_and_gaps(stretches: Sequence[Stretch]) -> list[CourseFeature]:
    levels = [s for s in stretches if s.kind == "level"]
    ground = levels[0].before if levels else 0.0
    edges = [s for s in stretches if s.kind == "edge"]
    features: list[CourseFeature] = []
    for first, second in pairwise(edges):
        alike = abs(first.before - second.after) <= max(_ALIKE, 0.3 * abs(first.rise))
        apart = second.start - first.end
        at, beside = (first.start, second.end), abs(first.before - ground)
        if not alike or first.rise * second.rise >= 0:
            continue
        if first.rise > 0 and apart <= _LONGEST_BAR and beside <= _ALIKE:
            features.append(_bar(first, second))
        elif first.rise < 0 and apart <= _WIDEST_GAP and beside <= _ALIKE:
            behind = [s for s in levels if s.start >= at[1] - STEP]
            features.append(_gap(first, second, behind[0] if behind else None))
    return features


def _bar(up: Stretch, down: Stretch) -> CourseFeature:
    height = max(up.rise, -down.rise)
    return CourseFeature(
        task="hurdles",
        start=up.start,
        end=down.end,
        stands=((up.end + down.start) / 2,),
        size=height,
        words=f"a bar {height:.2f} m high and {down.start - up.end:.2f} m long",
    )


def _gap(down: Stretch, up: Stretch, behind: Stretch | None) -> CourseFeature:
    width = up.end - down.start
    # On the middle of a platform, or where a long one has been gained.
    stand = up.end + 0.5 if behind is None else min(behind.middle, behind.start + 1.2)
    return CourseFeature(
        task="gaps",
        start=down.start,
        end=up.end,
        stands=(stand,),
        size=width,
        words=f"a gap {width:.2f} m wide and {-down.rise:.2f} m deep",
    )


def _slopes(stretches: Sequence[Stretch]) -> list[CourseFeature]:
    """Return slopes along the way; one that leads up is stood on behind its crest."""
    features: list[CourseFeature] = []
    for number, stretch in enumerate(stretches):
        if stretch.kind != "slope":
            continue
        degrees = math.degrees(math.atan2(abs(stretch.rise), stretch.length))
        following = stretches[number + 1] if number + 1 < len(stretches) else None
        crest = stretch.end
        if following is not None and following.kind == "level":
            crest = min(following.middle, following.start + 0.6)
        features.append(
            CourseFeature(
                task="ramps",
                start=stretch.start,
                end=stretch.end,
                stands=(crest,) if stretch.rise > 0 else (),
                size=degrees,
                words=f"a slope {'up' if stretch.rise > 0 else 'down'} of {degrees:.0f} degrees "
                f"over {stretch.length:.2f} m",
            )
        )
    return features


def _boards(profile: GroundProfile) -> list[CourseFeature]:
    leans = np.where(np.abs(profile.lean) >= _LEAN, np.sign(profile.lean), 0.0)
    breaks = np.flatnonzero(np.diff(leans, prepend=0.0, append=0.0)).tolist()
    features: list[CourseFeature] = []
    for first, last in pairwise(breaks):
        length = STEP * (last - 1 - first)
        if leans[first] == 0 or length < _LEAST_BOARD:
            continue
        degrees = math.degrees(math.atan(abs(float(np.median(profile.lean[first:last])))))
        side = "right" if leans[first] > 0 else "left"
        features.append(
            CourseFeature(
                task="ramps",
                start=STEP * first,
                end=STEP * (last - 1),
                stands=(STEP * (first + last - 1) / 2,),
                size=degrees,
                words=f"a board that leans {degrees:.0f} degrees down to the {side}",
            )
        )
    return features
