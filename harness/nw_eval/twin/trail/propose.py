"""A trail as the shipped scenes have them: waypoints on top of things, a spawn, and a task."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.scenes.scene import Spawn, Vector
from nw_eval.sim.trail import REACH_RADIUS
from nw_eval.twin.trail.features import TrailFeature, features_of
from nw_eval.twin.trail.ground import GroundProfile, ground_along
from nw_eval.twin.trail.stretches import stretches_of
from nw_eval.twin.trail.way import STEP, way_of
from nw_eval.words import Task

Values = NDArray[np.float64]

_FINISH = 1.4
"""From the last feature to the last waypoint, metres, where there is as much way."""
_APART = 0.25
"""Waypoints that are closer are one, metres."""
_APPROACH = 1.5
"""Level way before the first feature, at most, metres: as much as in the shipped scenes."""
_CLEAR = REACH_RADIUS + 0.3
"""From the spawn to the first waypoint at least, metres: beyond reach of where any trial begins."""
_ARRIVE = 0.6
"""Of ground behind the last waypoint, metres: a robot's length."""
_RUN_UP = 0.5
"""Metres of level way that a robot needs before the first feature."""
FLOOR = 0.02
"""A spawn may be so far from z = 0, metres."""


@dataclass(frozen=True, kw_only=True)
class TrailProposal:
    """What somebody may take for a scene's trail, or change.

    Attributes:
        task: that the trail seems to ask for.
        reasons: for it, and what else was found.
        spawn: on the way, `_APPROACH` before the first feature or at its start, looking along it.
        trail: waypoints on top of what the robot steps on, metres.
        features: in order.
        warnings: what somebody should look at.
    """

    task: Task
    reasons: tuple[str, ...]
    spawn: Spawn
    trail: tuple[Vector, ...]
    features: tuple[TrailFeature, ...]
    warnings: tuple[str, ...]


def propose_trail(mesh: TriangleMesh, centres: Values) -> TrailProposal:
    """Return a trail along the way that the cameras went, over what lies there.

    Args:
        mesh: of the place in metres, z up.
        centres: (V, 3) of the cameras in the order of the walk, in the same frame.

    Raises:
        SceneError: the cameras went less than a metre, the mesh has no ground below them, or too
            little for a waypoint that a robot has to walk to.
    """
    way = way_of(centres)
    below = float(centres[:, 2].max())
    profile = ground_along(mesh, way, below)
    features = features_of(profile, stretches_of(profile))
    if features and features[0].start > _APPROACH:
        profile = profile.after(features[0].start - _APPROACH)
        features = features_of(profile, stretches_of(profile))
    task, reasons = guess_task(features)
    return TrailProposal(
        task=task,
        reasons=reasons,
        spawn=_spawn(profile),
        trail=_waypoints(profile, features, _last(mesh, profile, below)),
        features=tuple(features),
        warnings=_warnings(profile, features),
    )


def guess_task(features: Sequence[TrailFeature]) -> tuple[Task, tuple[str, ...]]:
    """Return the task of the most features, and why; a flat trail is one of hurdles without bars.

    Of tasks with as many features the one whose features are longer along the way wins.
    """
    if not features:
        return "hurdles", ("the way is flat: a trail without obstacles",)
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


def _spawn(profile: GroundProfile) -> Spawn:
    ahead = profile.xy[min(len(profile.xy) - 1, round(_RUN_UP / STEP))] - profile.xy[0]
    x, y, z = _point(profile, 0.0)
    yaw = round(math.atan2(float(ahead[1]), float(ahead[0])), 4)
    return Spawn(position=(x, y, z), yaw=yaw)


def _last(mesh: TriangleMesh, profile: GroundProfile, below: float) -> float:
    """Return how far along the way a waypoint may stand: with `_ARRIVE` of ground behind it."""
    xy = profile.xy
    ahead = xy[-1] - xy[max(0, len(xy) - 1 - round(_RUN_UP / STEP))]
    ahead = ahead / max(float(np.hypot(*ahead)), 1e-12)
    stations = np.arange(0.0, _ARRIVE + STEP / 2, STEP)
    sides = np.array([-0.1, 0.0, 0.1])[:, None] * np.array([-ahead[1], ahead[0]])
    places = xy[-1] + stations[:, None, None] * ahead + sides
    heights = RayScene(mesh).height(places.reshape(-1, 2), z_from=below)
    there = np.isfinite(heights).reshape(places.shape[:2]).any(axis=1)
    room = _ARRIVE if there.all() else float(stations[int(np.argmin(there))])
    return float(profile.along[-1]) - (_ARRIVE - room)


def _waypoints(
    profile: GroundProfile, features: Sequence[TrailFeature], end: float
) -> tuple[Vector, ...]:
    """Return a waypoint where each feature is stood on, and one behind the last.

    None is within reach of the spawn.

    Args:
        profile: of the way.
        features: in order.
        end: how far along the way a waypoint may stand.

    Raises:
        SceneError: none is left.
    """
    stands = sorted(stand for feature in features for stand in feature.stands)
    last = max((feature.end for feature in features), default=None)
    stands.append(end if last is None else min(end, max([last, *stands]) + _FINISH))
    kept: list[float] = []
    for stand in stands:
        if stand > end or _from_start(profile, stand) < _CLEAR:
            continue
        if kept and stand - kept[-1] < _APART:
            continue
        kept.append(stand)
    if not kept:
        raise SceneError(
            f"there are {profile.along[-1]:.2f} m of ground along the way: too little for a "
            f"waypoint {_CLEAR:g} m from the start, with {_ARRIVE:g} m behind it to arrive in",
            fix="capture more ground ahead of the start, or write the trail by hand",
        )
    return tuple(_point(profile, stand) for stand in kept)


def _from_start(profile: GroundProfile, along: float) -> float:
    """Return how far a place along the way is from its start, seen from above, metres."""
    there = np.array(_point(profile, along)) - np.array(_point(profile, 0.0))
    return float(np.hypot(there[0], there[1]))


def _point(profile: GroundProfile, along: float) -> Vector:
    """Return the ground at a place along the way, to a millimetre."""
    place = min(len(profile.along) - 1, max(0, round(along / STEP)))
    x, y = profile.xy[place].tolist()
    return round(x, 3), round(y, 3), round(float(profile.height[place]), 3)


def _warnings(profile: GroundProfile, features: Sequence[TrailFeature]) -> tuple[str, ...]:
    warnings: list[str] = []
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
        warnings.append("the way ends at the last feature: no room to arrive in")
    if profile.known < 1.0 - 1e-9:
        warnings.append(f"{1.0 - profile.known:.0%} of the way is over holes of the mesh")
    return tuple(warnings)
