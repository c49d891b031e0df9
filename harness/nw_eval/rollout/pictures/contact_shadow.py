"""The soft shadow of the robot on what it stands on: ambient occlusion by its underside."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from nw_eval.scenes.rays import RayScene
    from nw_eval.sim import World

Array = NDArray[np.float64]

_REACH = 0.8  # m from the trunk's middle to the map's edges
_CELL = 0.025  # m
_EYE = (
    60.0  # m below the robot: from there rays upwards are as good as parallel, and cast as one fan
)
_LEAST_RISE = 0.02  # m; a foot that touches the ground covers what is under it, and no more
_DARKEST = 0.9  # share of the light; some always comes from the side
_FLAT = 0.04  # m: what lies this far off the ground of its cell is a wall or an edge
_GAMMA = 2.2


class ContactShadow:
    """How much of the light from above the robot keeps from the ground, as a map around it.

    Lamps and most of the sky's light are overhead: from an angle t off the zenith comes cos(t)^8 of
    what comes from there. A piece dA of the underside, h above and r beside a point of the ground,
    then takes the share 5 h^10 dA / (pi (h^2 + r^2)^6): their form factor, weighted by that.

    Args:
        world: whose robot stands there.
        static: the scene's geometry.
    """

    def __init__(self, world: World, static: RayScene) -> None:
        side = np.arange(-_REACH, _REACH + _CELL / 2, _CELL)
        x, y = np.meshgrid(*(world.trunk_position[k] + side for k in (0, 1)), indexing="ij")
        self._corner = np.array([x[0, 0], y[0, 0]])
        flat = np.stack([x.ravel(), y.ravel()], axis=1)
        # From the trunk's height, so that no ceiling is mistaken for ground.
        ground = static.height(flat, z_from=float(world.trunk_position[2]))
        underside = _underside(flat, world)
        rise = underside - ground
        over = np.flatnonzero(np.isfinite(rise))
        occlusion = np.zeros(len(flat))
        for piece in over:  # Some hundred pieces; a table of all pairs would take long.
            square = ((flat - flat[piece]) ** 2).sum(axis=1)
            h = underside[piece] - ground
            h = np.where(h > 0.0, np.maximum(h, _LEAST_RISE), np.inf)
            with np.errstate(invalid="ignore"):
                share = 5.0 * h**10 / (h**2 + square) ** 6
            occlusion += np.nan_to_num(share) * _CELL**2 / np.pi
        self._ground = ground.reshape(x.shape)
        self._occlusion = np.minimum(occlusion, _DARKEST).reshape(x.shape)

    def factors(self, points: Array) -> Array:
        """Return what display values at points (N, 3) m are multiplied by, (N,)."""
        at = (points[:, :2] - self._corner) / _CELL
        size = np.array(self._occlusion.shape)
        inside = ((at >= 0.0) & (at < size - 1)).all(axis=1)
        factors = np.ones(len(points))
        low = at[inside].astype(np.intp)
        u, v = (at[inside] - low).T
        i, j = low.T
        near = self._ground[i + (u > 0.5), j + (v > 0.5)]
        on_ground = np.abs(points[inside, 2] - near) < _FLAT
        map_ = self._occlusion
        taken = (1 - u) * ((1 - v) * map_[i, j] + v * map_[i, j + 1])
        taken += u * ((1 - v) * map_[i + 1, j] + v * map_[i + 1, j + 1])
        factors[inside] = np.where(on_ground, (1.0 - taken) ** (1.0 / _GAMMA), 1.0)
        return factors


def _underside(flat: Array, world: World) -> Array:
    """Return the height of the robot's lowest surface over points (N, 2), inf where it is not."""
    eye = world.trunk_position - [0.0, 0.0, _EYE]
    middle = np.full(len(flat), world.trunk_position[2])
    ways = np.concatenate([flat, middle[:, np.newaxis]], axis=1) - eye
    length = np.linalg.norm(ways, axis=1)
    distance = world.ray_robot(eye, ways / length[:, np.newaxis]).distance
    return eye[2] + distance * ways[:, 2] / length
