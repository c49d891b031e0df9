"""A course: points along it, how a robot stands there, and what is wrong with the course itself.

Points are evenly spaced, with the way ahead at each. A robot that stands there has its camera at a
point that follows. What is wrong: waypoints at the start, too short a way, no room to arrive.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nw_base.plural import plural
from nw_scenes.finding import SceneFinding
from nw_scenes.mesh import merge
from nw_scenes.rays import RayScene
from nw_scenes.robots import RobotSpec, get_robot
from nw_scenes.scene import HeightField, Scene
from nw_sim.physics import World
from nw_sim.tasks.course import REACH_RADIUS, start_finding

Values = NDArray[np.float64]

_LOOK_DOWN = 0.6  # m above the higher end of a leg, from where one looks down on it

CAMERA = "ego"
"""The robot's camera that policies look through unless their card names another."""

_FLAT = Scene(
    name="flat",
    task="hurdles",
    title="",
    solids=(),
    trail=np.array([[1.0, 0.0, 0.0]]),
    static_mesh=merge([]),
    splat=None,
)

# Where a foot may be put down around its place, m: over a gap a robot stands on its rim.
_FOOTHOLD = np.array([-0.1, -0.05, 0.0, 0.05, 0.1])
_SETTLING = 50  # control steps until a robot that was put down stands
_TIPS = 0.1  # rad; who leans more does not stand any more
_SIDE_BY_SIDE = 0.05  # m along x between feet, up to which none is in front of another
_STEEPEST = 0.52  # rad; the steepest ramps are of 30 degrees
_FARTHEST = 0.6  # m that ground may lie off the course and still carry the robot

_AHEAD = 0.02  # m between places that are looked at ahead of the last waypoint
_SIDES = (-0.1, 0.0, 0.1)  # m to the sides: a hole that is narrower is no end
_DEEP = 0.1  # m below the last waypoint: what only physics has there carries no arrival


@dataclass(frozen=True, kw_only=True, eq=False)
class CourseSamples:
    """Points on the line from the start through the waypoints.

    Attributes:
        along: (S,) m from the start, negative behind it.
        points: (S, 3) m, world, on that line.
        ahead: (S, 2) unit vectors along it, seen from above.
        above: (S,) z from where the ground there is looked for, m: over every obstacle of the
            course, and under ceilings.
    """

    along: Values
    points: Values
    ahead: Values
    above: Values

    @property
    def left(self) -> Values:
        """(S, 2) unit vectors to the left of the way."""
        return np.column_stack([-self.ahead[:, 1], self.ahead[:, 0]])


def course_samples(
    scene: Scene,
    spacing: float,
    *,
    behind: float = 0.0,
    beyond: float = 0.0,
    most: int = 100_000,
) -> CourseSamples:
    """Return points on a scene's course, its start and its last waypoint included.

    Args:
        scene: whose course.
        spacing: between neighbours, m; a longer course than `most` of them gets fewer a metre.
        behind: how far before the start the line begins, m.
        beyond: how far behind the last waypoint it ends, m.
        most: points at most, about.
    """
    yaw = scene.spawn.yaw
    path = np.vstack([[scene.spawn.position], scene.trail])
    legs = [(a, b) for a, b in pairwise(path) if np.linalg.norm((b - a)[:2]) > 1e-6]
    if not legs:
        start = path[0]
        legs = [(start, start + 1e-3 * np.array([np.cos(yaw), np.sin(yaw), 0.0]))]
    length = sum(float(np.linalg.norm((b - a)[:2])) for a, b in legs)
    spacing = max(spacing, length / most)
    rows: list[Values] = []
    gone = 0.0
    for index, (a, b) in enumerate(legs):
        across = float(np.linalg.norm((b - a)[:2]))
        first = -behind if index == 0 else 0.0
        stations = np.arange(first, across, spacing)
        if index == len(legs) - 1:
            further = across + np.arange(spacing, beyond + spacing / 2, spacing)
            stations = np.concatenate([stations, [across], further])
        on_leg = np.clip(stations, 0.0, across)
        points = a + on_leg[:, None] / across * (b - a)
        ahead = (b - a)[:2] / across
        points[:, :2] += (stations - on_leg)[:, None] * ahead
        above = np.full(len(stations), max(a[2], b[2]) + _LOOK_DOWN)
        ways = np.broadcast_to(ahead, (len(stations), 2))
        rows.append(np.column_stack([gone + stations, points, ways, above]))
        gone += across
    table = np.concatenate(rows)
    return CourseSamples(
        along=table[:, 0], points=table[:, 1:4], ahead=table[:, 4:6], above=table[:, 6]
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Stance:
    """A robot that stands on level ground. Metres.

    Attributes:
        T_ground_camera: (4, 4) of its camera, from the point on the ground under its trunk, x
            ahead and z up.
        fore, hind: of the feet along x, from that point.
        half_width: of the feet along y, their own radius included.
        height: of the trunk's origin over the ground.
        length: of trunk and head along x, legs left out.
    """

    T_ground_camera: Values
    fore: float
    hind: float
    half_width: float
    height: float
    length: float


def flat_world(robot: RobotSpec, steps: tuple[float, int] = (0.005, 4)) -> World:
    """Return a robot on level ground, with a physics step, s, and how many make a control step."""
    return World(robot, _FLAT, timestep=steps[0], substeps=steps[1])


def stance_of(robot: RobotSpec) -> Stance:
    """Return how a robot stands when its servos hold the default pose and have given way.

    One that tips over meanwhile, as bipeds do without a controller, stands as it was put down.
    """
    with flat_world(robot) as world:
        for _ in range(_SETTLING):
            world.step(robot.standing_targets)
        if world.uprightness < np.cos(_TIPS):
            world.reset(position=(0.0, 0.0, robot.spawn_height), yaw=0.0)
            for _ in range(_SETTLING):
                world.step(robot.standing_targets)
                if world.foot_contacts.any():
                    break
        under = np.array([*world.trunk_position[:2], 0.0])
        places, widths = world.foot_places()
        feet = places - under
        camera = world.camera_pose(CAMERA).copy()
        length = world.trunk_length()
        height = float(world.trunk_position[2])
    camera[:3, 3] -= under
    fore, hind = _fore_and_hind(feet[:, 0], widths)
    return Stance(
        T_ground_camera=camera,
        fore=fore,
        hind=hind,
        half_width=float(np.abs(feet[:, 1]).max()) + float(widths[0]),
        height=height,
        length=length,
    )


def _fore_and_hind(along: Values, widths: Values) -> tuple[float, float]:
    """Return where a robot's feet are along x, m: the middle of those in front and behind.

    Feet that stand side by side, as a biped's, carry it from their tips to their heels.
    """
    front = along > along.mean()
    if np.ptp(along) > _SIDE_BY_SIDE:
        return float(along[front].mean()), float(along[~front].mean())
    return float((along + widths).max()), float((along - widths).min())


def camera_poses(samples: CourseSamples, rays: RayScene, stance: Stance) -> Values:
    """Return where a robot's camera is as it stands at each sample and looks along the course.

    It stands on the highest ground round its fore and hind feet, and pitches with it.

    Returns:
        (S, 4, 4) T_world_camera, camera axes x right, y down, z ahead.
    """
    ends = [_ground_at(samples, rays, x, stance.half_width) for x in (stance.fore, stance.hind)]
    pitch = np.arctan2(ends[0] - ends[1], stance.fore - stance.hind)
    pitch = np.clip(pitch, -_STEEPEST, _STEEPEST)
    share = stance.fore / (stance.fore - stance.hind)
    ground = (1 - share) * ends[0] + share * ends[1]
    level = np.cos(pitch)
    ahead = np.column_stack([samples.ahead * level[:, None], np.sin(pitch)])
    left = np.column_stack([samples.left, np.zeros(len(pitch))])
    up = np.cross(ahead, left)
    under = np.broadcast_to(np.eye(4), (len(pitch), 4, 4)).copy()
    under[:, :3, :3] = np.stack([ahead, left, up], axis=2)
    under[:, :3, 3] = np.column_stack([samples.points[:, :2], ground])
    return under @ stance.T_ground_camera


def _ground_at(samples: CourseSamples, rays: RayScene, x: float, half_width: float) -> Values:
    """Return the height of what carries the feet at `x` in the trunk's frame, (S,) m."""
    sides = np.array([-half_width, 0.0, half_width])
    offsets = np.stack(np.meshgrid(x + _FOOTHOLD, sides, indexing="ij"), -1).reshape(-1, 2)
    places = (
        samples.points[:, None, :2]
        + offsets[:, :1] * samples.ahead[:, None]
        + offsets[:, 1:] * samples.left[:, None]
    )
    above = np.repeat(samples.above, len(offsets))
    heights = rays.height(places.reshape(-1, 2), z_from=above).reshape(places.shape[:2])
    trail = samples.points[:, 2:]
    carries = np.abs(heights - trail) < _FARTHEST
    highest = np.where(carries, heights, -np.inf).max(axis=1)
    return np.where(np.isfinite(highest), highest, trail[:, 0])


def course_findings(scene: Scene, robot: str) -> list[SceneFinding]:
    """Return what is wrong with a course, apart from the ground and the views along it.

    Args:
        scene: whose.
        robot: whose length counts: that of trunk and head.
    """
    length = stance_of(get_robot(robot)).length
    start = start_finding(scene)
    findings = [] if start is None else [start]
    path = np.vstack([[scene.spawn.position], scene.trail])[:, :2]
    legs = np.linalg.norm(np.diff(path, axis=0), axis=1)
    if legs.sum() < length:
        findings.append(
            SceneFinding(
                code="trail_short",
                severity="error",
                message=f"the course is {legs.sum():.2f} m long, shorter than a {robot} "
                f"({length:.2f} m from nose to tail)",
                fix="make it longer: waypoints that are reached without walking do not measure a "
                "policy",
                value=float(legs.sum()),
            )
        )
    together = [k for k in range(1, len(scene.trail)) if legs[k] < REACH_RADIUS]
    if together:
        first = together[0]
        x, y, z = scene.trail[first].tolist()
        findings.append(
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
    return findings if end is None else [*findings, end]


def _end(scene: Scene, path: Values, robot: str, length: float) -> SceneFinding | None:
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
        fix=f"move it back by {length - room:.2f} m or more, or capture more of the scene",
        value=room,
        place=(x, y, z),
    )
