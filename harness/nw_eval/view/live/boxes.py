"""Boxes that are put into a place: solid to feet, seen by rays, and painted for cameras."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.mesh import box_mesh, rotation_matrix
from nw_eval.scenes.scene import Box
from nw_eval.splat.gaussians import SH0, Gaussians
from nw_eval.splat.transform import quaternions

if TYPE_CHECKING:
    from nw_eval.scenes.mesh import TriangleMesh
    from nw_eval.scenes.rays import RayScene
    from nw_eval.sim import World

COLOUR = (0.62, 0.45, 0.28)
"""Of cardboard, red, green and blue, 0 to 1, lit from above."""
_HALF_SIZE = (0.15, 0.3, 0.1)
_AHEAD = 0.8
"""Metres from the trunk's middle to a new box's."""
_SPACING = 0.02
"""Metres between two Gaussians of a face."""
_FLAT = 0.001  # m
_OPACITY_LOGIT = 5.0
_SIDE_LIGHT = 0.7
_BELOW_LIGHT = 0.4


def box_ahead(world: World, rays: RayScene) -> Box:
    """Return a box in the way of a robot, across it, on what is under there."""
    yaw = float(world.roll_pitch_yaw[2])
    x, y, z = world.trunk_position
    x, y = x + _AHEAD * np.cos(yaw), y + _AHEAD * np.sin(yaw)
    under = float(rays.height(np.array([[x, y]]), np.array([z + 0.5]))[0])
    ground = under if np.isfinite(under) else world.scene.ground.z
    return Box(
        center=(float(x), float(y), ground + _HALF_SIZE[2]),
        half_size=_HALF_SIZE,
        quat=(float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))),
        material="cardboard",
    )


def mesh_of(box: Box) -> TriangleMesh:
    """Return what rays meet of a box."""
    return box_mesh(box.center, box.half_size, box.quat, box.kind)


def painted(boxes: Sequence[Box], harmonics: int) -> Gaussians:
    """Return boxes as Gaussians in the world, with so many harmonics, all but the first of them 0.

    Args:
        boxes: one or more.
        harmonics: 1, 4, 9 or 16.
    """
    faces = [_face(box, axis, sign) for box, axis, sign in product(boxes, range(3), (-1.0, 1.0))]
    means, scales, quats, colours = (np.concatenate(parts) for parts in zip(*faces, strict=True))
    sh = np.zeros((len(means), harmonics, 3), np.float32)
    sh[:, 0] = (colours - 0.5) / SH0
    return Gaussians(
        means=means.astype(np.float32),
        log_scales=np.log(scales).astype(np.float32),
        quats=quats.astype(np.float32),
        opacity_logits=np.full(len(means), _OPACITY_LOGIT, np.float32),
        sh=sh,
    )


def _face(box: Box, axis: int, sign: float) -> tuple[NDArray[np.float64], ...]:
    """Return centres, deviations, quaternions and colours of a face's Gaussians."""
    half = np.array(box.half_size)
    across = [other for other in range(3) if other != axis]
    counts = [max(2, round(2.0 * half[other] / _SPACING)) for other in across]
    steps = [
        (np.arange(count) + 0.5) / count * 2.0 - 1.0 for count in counts
    ]  # From edge to edge, none over it.
    grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    local = np.empty((len(grid), 3))
    local[:, axis], local[:, across] = sign * half[axis], grid * half[across]
    R = rotation_matrix(box.quat)
    spread = np.full((len(grid), 3), _FLAT)
    spread[:, across] = half[across] / np.array(counts)  # Half of a cell's width.
    up = float((R[:, axis] * sign)[2])
    light = 1.0 if up > 0.5 else _BELOW_LIGHT if up < -0.5 else _SIDE_LIGHT
    return (
        local @ R.T + np.array(box.center),
        spread,
        np.tile(quaternions(R), (len(grid), 1)),
        np.tile(light * np.array(COLOUR), (len(grid), 1)),
    )
