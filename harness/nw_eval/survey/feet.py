"""Feet that are dropped along a trail: whether physics carries them where the mesh shows ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.rays import RayScene
from nw_eval.scenes.scene import Scene
from nw_eval.sim.binding import mujoco
from nw_eval.sim.geometry import add_geometry
from nw_eval.survey.samples import trail_samples

Values = NDArray[np.float64]

SPACING = 0.1
"""Between dropped feet along the trail, m."""
SUNK = 0.01
"""How far a foot may come to rest under the ground that the mesh shows round it, m."""

_MOST = 120  # places along the trail; on a longer one they are farther apart
_LINES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])  # of the half width
_RADIUS = 0.02  # m, of a foot
_MASS = 3.0  # kg, what a foot carries
_FALL = 0.05  # m over the ground, from where it is thrown down
_SPEED = 3.0  # m/s at which it lands, as feet do after a jump
_STEP = 0.005  # s
_STEPS = 120  # until it lies still
_ROUND = 0.06  # m round its place, within which it may have slid off an edge
_DEEP = 1.0  # m below the trail: nobody walks there


@dataclass(frozen=True, kw_only=True)
class DroppedFeet:
    """What became of them.

    Attributes:
        count: of the feet; none where there is no ground, or no room above it.
        sunk: how many came to rest under the ground.
        deepest: of those, how far under it, m; 0 without any.
        along: where the deepest is, m along the trail.
        place: where it came to rest, world, m.
    """

    count: int
    sunk: int
    deepest: float
    along: float
    place: tuple[float, float, float]


def drop_feet(scene: Scene, rays: RayScene, half_width: float) -> DroppedFeet:
    """Let spheres of a foot's size and load fall onto the corridor, and look where they end.

    Heights alone say nothing of contacts: ground can be where it should and trap what lands on it.

    Args:
        scene: where.
        rays: of its mesh.
        half_width: of the corridor, m.
    """
    samples = trail_samples(scene, SPACING, most=_MOST)
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


def _fallen(scene: Scene, starts: Values) -> Values:
    """Return where feet that fall from places (N, 3) come to rest, (N, 3) m."""
    spec = mujoco.MjSpec()
    spec.option.timestep = _STEP
    add_geometry(spec, scene, friction=None)
    for x, y, z in starts.tolist():
        body = spec.worldbody.add_body(pos=[x, y, z])
        for axis in np.eye(3).tolist():
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[_RADIUS, 0.0, 0.0],
            mass=_MASS,
            contype=2,  # Feet fall through each other.
            conaffinity=1,
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel.reshape(-1, 3)[:, 2] = -_SPEED
    for _ in range(_STEPS):
        mujoco.mj_step(model, data)
    return starts + data.qpos.reshape(-1, 3)
