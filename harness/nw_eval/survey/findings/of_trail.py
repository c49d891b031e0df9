"""What is wrong with a trail itself: waypoints at the start, too short a way, no room to arrive."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nw_eval.plural import plural
from nw_eval.robots import get_robot
from nw_eval.scenes.finding import SceneFinding
from nw_eval.scenes.rays import RayScene
from nw_eval.scenes.scene import HeightField, Scene
from nw_eval.sim.trail import REACH_RADIUS
from nw_eval.survey.stance import stance_of
from nw_eval.words import Robot

Values = NDArray[np.float64]

_AHEAD = 0.02  # m between places that are looked at ahead of the last waypoint
_SIDES = (-0.1, 0.0, 0.1)  # m to the sides: a hole that is narrower is no end
_DEEP = 0.1  # m below the last waypoint: what only physics has there carries no arrival


def waypoints_at_start(scene: Scene) -> int:
    """Return how many waypoints a robot that stays at its start can be credited with.

    They count in order, each within `REACH_RADIUS` of the trunk, seen from above. A trial may begin
    anywhere within the jitter of the spawn, and move a waypoint by its noise.
    """
    spawn = scene.spawn
    play = np.array([spawn.x_jitter, spawn.y_jitter]) + np.array(scene.waypoint_noise)
    away = np.abs(scene.trail[:, :2] - np.array(spawn.position[:2]))
    nearest = np.hypot(*np.maximum(away - play, 0.0).T)
    beyond = np.flatnonzero(~(nearest < REACH_RADIUS))
    return int(beyond[0]) if len(beyond) else len(scene.trail)


def start_finding(scene: Scene) -> SceneFinding | None:
    """Return that a robot which stays at the start reaches waypoints; None if it does not.

    Success would not be earned: `nw-eval run` refuses such a scene.
    """
    count = waypoints_at_start(scene)
    if not count:
        return None
    x, y, z = scene.trail[0].tolist()
    which = "waypoint 0 is" if count == 1 else f"waypoints 0 to {count - 1} are"
    return SceneFinding(
        code="waypoint_at_start",
        severity="error",
        message=f"{which} reached at the start: ({x:.2f}, {y:.2f}) is within {REACH_RADIUS:g} m of "
        "where a trial may begin, so a robot that stands still is credited",
        fix="remove what the robot need not walk to, or move the spawn back",
        value=float(np.hypot(x - scene.spawn.position[0], y - scene.spawn.position[1])),
        place=(x, y, z),
    )


def trail_findings(scene: Scene, robot: Robot) -> list[SceneFinding]:
    """Return what is wrong with a trail, apart from the ground and the views along it.

    Args:
        scene: whose.
        robot: whose length counts: that of trunk and head.
    """
    length = stance_of(get_robot(robot)).length
    start = start_finding(scene)
    found = [] if start is None else [start]
    path = np.vstack([[scene.spawn.position], scene.trail])[:, :2]
    legs = np.linalg.norm(np.diff(path, axis=0), axis=1)
    if legs.sum() < length:
        found.append(
            SceneFinding(
                code="trail_short",
                severity="error",
                message=f"the trail is {legs.sum():.2f} m long, shorter than a {robot} "
                f"({length:.2f} m from nose to tail)",
                fix="lead it farther: what is reached without walking says nothing of a policy",
                value=float(legs.sum()),
            )
        )
    together = [k for k in range(1, len(scene.trail)) if legs[k] < REACH_RADIUS]
    if together:
        first = together[0]
        x, y, z = scene.trail[first].tolist()
        found.append(
            SceneFinding(
                code="waypoints_together",
                severity="warning",
                message=f"{len(together)} of {plural(len(scene.trail), 'waypoint')} lie within "
                f"{REACH_RADIUS:g} m of the one before, first waypoint {first} at ({x:.2f}, "
                f"{y:.2f}): who reaches one reaches both",
                fix="keep one of them, unless each is a step of its own",
                value=float(legs[first]),
                place=(x, y, z),
            )
        )
    end = _end(scene, path, robot, length)
    return found if end is None else [*found, end]


def _end(scene: Scene, path: Values, robot: Robot, length: float) -> SceneFinding | None:
    """Return that the ground ends too near behind the last waypoint; None if it does not."""
    legs = [b - a for a, b in pairwise(path) if np.linalg.norm(b - a) > 1e-6]
    if not legs:
        return None
    ahead = legs[-1] / np.linalg.norm(legs[-1])
    stations = np.arange(0.0, length + _AHEAD / 2, _AHEAD)
    sides = np.array(_SIDES)[:, None] * np.array([-ahead[1], ahead[0]])
    places = path[-1] + stations[:, None, None] * ahead + sides
    flat = places.reshape(-1, 2)
    # Physics closes small holes of a scan. A drop to ground that is seen is a part of the course.
    seen = np.isfinite(RayScene(scene.mesh()).height(flat))
    fields = [solid.height(flat) for solid in scene.solids if isinstance(solid, HeightField)]
    felt = np.max([*fields, np.full(len(flat), scene.ground.z)], axis=0)
    x, y, z = scene.trail[-1].tolist()
    ends = ~(seen | (felt > z - _DEEP)).reshape(places.shape[:2]).any(axis=1)
    if not ends.any():
        return None
    room = float(stations[int(np.argmax(ends))])
    return SceneFinding(
        code="waypoint_at_end",
        severity="error",
        message=f"the last waypoint, at ({x:.2f}, {y:.2f}), is {room:.2f} m before the mesh ends; "
        f"a {robot} is {length:.2f} m long from nose to tail and needs as much ground to arrive",
        fix="move it back, or capture more of the place",
        value=room,
        place=(x, y, z),
    )
