"""How a robot stands on the ground, and where its camera is then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.robots import RobotSpec
from nw_eval.scenes.mesh import merge
from nw_eval.scenes.rays import RayScene
from nw_eval.scenes.scene import Scene
from nw_eval.sim import World
from nw_eval.survey.samples import TrailSamples

Values = NDArray[np.float64]

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
_STEEPEST = 0.52  # rad; the steepest ramps are of 30 degrees
_FARTHEST = 0.6  # m that ground may lie off the trail and still carry the robot


@dataclass(frozen=True, kw_only=True, eq=False)
class Stance:
    """A robot that stands on level ground. Metres.

    Attributes:
        T_ground_camera: (4, 4) of its camera, from the point on the ground under its trunk, x
            ahead and z up.
        fore, hind: of the feet along x, from that point.
        half_width: of the feet along y, their own radius included.
        length: of trunk and head along x, legs left out.
    """

    T_ground_camera: Values
    fore: float
    hind: float
    half_width: float
    length: float


def stance_of(robot: RobotSpec) -> Stance:
    """Return how a robot stands when its servos hold the default pose and have given way."""
    with World(robot, _FLAT) as world:
        for _ in range(_SETTLING):
            world.step(robot.default_pose)
        under = np.array([*world.trunk_position[:2], 0.0])
        feet = np.array([world.data.geom(foot).xpos for foot in robot.feet]) - under
        radius = float(world.model.geom(robot.feet[0]).size[0])
        camera = world.camera_pose(CAMERA).copy()
        length = _length(world)
    camera[:3, 3] -= under
    return Stance(
        T_ground_camera=camera,
        fore=float(feet[:2, 0].mean()),
        hind=float(feet[2:, 0].mean()),
        half_width=float(np.abs(feet[:, 1]).max()) + radius,
        length=length,
    )


def _length(world: World) -> float:
    """Return how long trunk and head are along x, m: of their shapes' boxes as they are turned."""
    model, data = world.model, world.data
    own = np.flatnonzero(model.geom_bodyid == model.body("trunk").id)
    R = data.geom_xmat[own].reshape(-1, 3, 3)
    centre, half = model.geom_aabb[own, :3], model.geom_aabb[own, 3:]
    middle = data.geom_xpos[own, 0] + (R[:, 0] * centre).sum(axis=1)
    reach = (np.abs(R[:, 0]) * half).sum(axis=1)
    return float((middle + reach).max() - (middle - reach).min())


def camera_poses(samples: TrailSamples, rays: RayScene, stance: Stance) -> Values:
    """Return where a robot's camera is as it stands at each sample and looks along the trail.

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


def _ground_at(samples: TrailSamples, rays: RayScene, x: float, half_width: float) -> Values:
    """Return the height of what carries the feet at `x` in the trunk's frame, (S,) m."""
    sides = np.array([-half_width, 0.0, half_width])
    offsets = np.stack(np.meshgrid(x + _FOOTHOLD, sides, indexing="ij"), -1).reshape(-1, 2)
    places = (
        samples.points[:, None, :2]
        + offsets[:, :1] * samples.ahead[:, None]
        + offsets[:, 1:] * samples.left[:, None]
    )
    above = np.repeat(samples.above, len(offsets))
    found = rays.height(places.reshape(-1, 2), z_from=above).reshape(places.shape[:2])
    trail = samples.points[:, 2:]
    carries = np.abs(found - trail) < _FARTHEST
    highest = np.where(carries, found, -np.inf).max(axis=1)
    return np.where(np.isfinite(highest), highest, trail[:, 0])
