"""Rays against the robot, for drawing it into camera images."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nw_eval.robots.spec import VISUAL_GROUP
from nw_eval.sim.binding import MjData, MjModel, mujoco

_NO_CUTOFF = 1e10


class RobotRays(NamedTuple):
    """What N rays met. A miss has distance inf, geom -1 and normal 0."""

    distance: npt.NDArray[np.float64]  # (N,) m along the ray
    geom: npt.NDArray[np.int32]  # (N,) index into `World.geom_rgba`
    normal: npt.NDArray[np.float64]  # (N, 3) unit, world frame, out of the surface


def cast_at_visuals(
    model: MjModel,
    data: MjData,
    origins: npt.NDArray[np.float64],
    directions: npt.NDArray[np.float64],
    *,
    exclude_body: int = -1,
) -> RobotRays:
    """Cast rays at the visual primitives of the robot.

    Args:
        model: compiled model.
        data: its state, with current geom poses.
        origins: (3,) for a common origin, which is fast, or (N, 3).
        directions: (N, 3) unit vectors, world frame.
        exclude_body: body whose geoms are transparent, or -1.
    """
    count = len(directions)
    distance = np.full(count, -1.0)
    geom = np.full(count, -1, dtype=np.int32)
    normal = np.zeros((count, 3))
    groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
    groups[VISUAL_GROUP] = 1
    rays = np.ascontiguousarray(directions, dtype=np.float64)
    starts = np.asarray(origins, dtype=np.float64)
    # One fan for a common origin, else a fan of one for each ray.
    fans = [slice(0, count)] if starts.ndim == 1 else [slice(i, i + 1) for i in range(count)]
    for fan in fans:
        _cast_fan(
            model,
            data,
            starts if starts.ndim == 1 else starts[fan.start],
            rays[fan],
            groups,
            exclude_body,
            (geom[fan], distance[fan], normal[fan]),
        )
    missed = geom < 0
    distance[missed] = np.inf
    normal[missed] = 0.0
    return RobotRays(distance, geom, normal)


def _cast_fan(
    model: MjModel,
    data: MjData,
    origin: npt.NDArray[np.float64],
    directions: npt.NDArray[np.float64],
    groups: npt.NDArray[np.uint8],
    exclude_body: int,
    out: tuple[npt.NDArray[np.int32], npt.NDArray[np.float64], npt.NDArray[np.float64]],
) -> None:
    if not len(directions):
        return
    geom, distance, normal = out
    mujoco.mj_multiRay(
        m=model,
        d=data,
        pnt=origin,
        vec=directions.reshape(-1),
        geomgroup=groups,
        flg_static=False,
        bodyexclude=exclude_body,
        geomid=geom,
        dist=distance,
        normal=normal.reshape(-1),
        nray=len(directions),
        cutoff=_NO_CUTOFF,
    )
