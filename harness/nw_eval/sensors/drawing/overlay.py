"""What is not in a splat but in the picture: cones and the robot's own body, by ray casting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.drawing.cones import Cones, shade
from nw_eval.sim.body import RobotRays
from nw_eval.splat.camera import Camera, Pixels

_THIRDS = (-1.0 / 3.0, 0.0, 1.0 / 3.0)
_NINE = np.array([(x, y, 0.0) for y in _THIRDS for x in _THIRDS])
"""Where the rays of an outline's pixel go, in pixels from its centre."""


class RobotView(Protocol):
    """A robot as rays meet it."""

    @property
    def geom_rgba(self) -> NDArray[np.float32]:
        """As `World.geom_rgba`."""
        ...

    def ray_robot(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        *,
        exclude: Literal["nothing", "trunk"] = ...,
    ) -> RobotRays:
        """As `World.ray_robot`."""
        ...


@dataclass(frozen=True, kw_only=True)
class Overlay:
    """Drawn objects at the pixels of an image: the arguments of `splat.image.paste`."""

    rgb: NDArray[np.float32]
    """(H, W, 3)."""
    depth: NDArray[np.float32]
    """(H, W) m along the optical axis, inf = nothing."""
    coverage: NDArray[np.float32]
    """(H, W), share of the pixel in which something is drawn, 0 to 1."""
    lit: NDArray[np.float32] | None = None
    """(H, W), share of it on which the scene's light falls, 0 to 1; None = all of it."""


def nothing(directions: NDArray[np.float64]) -> Overlay:
    """Return the overlay of pixels (H, W, 3) in which nothing is drawn."""
    shape = directions.shape[:2]
    return Overlay(
        rgb=np.zeros((*shape, 3), np.float32),
        depth=np.full(shape, np.inf, np.float32),
        coverage=np.zeros(shape, np.float32),
    )


def stacked(parts: Sequence[Overlay]) -> Overlay:
    """Return overlays of one width, from the top down, as one; a single one is itself."""
    if len(parts) == 1:
        return parts[0]
    lit = [np.ones_like(part.coverage) if part.lit is None else part.lit for part in parts]
    return Overlay(
        rgb=np.concatenate([part.rgb for part in parts]),
        depth=np.concatenate([part.depth for part in parts]),
        coverage=np.concatenate([part.coverage for part in parts]),
        lit=np.concatenate(lit),
    )


def ray_directions(camera: Camera, pixels: Pixels) -> NDArray[np.float64]:
    """Return unit directions through pixel centres in camera axes, (H, W, 3)."""
    x, y = pixels.indices(camera.width) + 0.5, pixels.indices(camera.height) + 0.5
    directions = np.ones((len(y), len(x), 3))
    directions[..., :2] = camera.lens.grid(x, y)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def draw(
    directions: NDArray[np.float64],
    T_world_camera: NDArray[np.float64],
    *,
    cones: Cones | None,
    robot: RobotView | None,
    static: RayScene | None = None,
    is_aboard: bool = True,
    pitch: tuple[float, float] | None = None,
) -> Overlay:
    """Cast one ray for each pixel and keep the nearest object; nine where an object ends.

    An object ends where the scene's geometry hides it, too: that is exact, as a splat's depth is
    not. Beside the ground, one is mistaken for the other otherwise.

    Args:
        directions: (H, W, 3) from `ray_directions`.
        T_world_camera: (4, 4), a rotation and metres.
        cones: drawn unless None.
        robot: drawn unless None; a world stands for its robot.
        static: the scene's geometry, which hides objects; None = nothing does.
        is_aboard: the robot carries the camera, so its trunk is left out.
        pitch: 1 / fx and 1 / fy of the camera, for soft edges; None = hard ones.
    """

    def shoot(rays: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return depth along the axis (N,), inf = nothing, and colour (N, 3)."""
        turned, origin = rays @ T_world_camera[:3, :3].T, T_world_camera[:3, 3]
        distance, colour = _nearest(turned, origin, cones, robot, is_aboard)
        if static is not None:
            distance[_hidden(static, origin, turned, distance)] = np.inf
        return distance * rays[:, 2], colour

    shape = directions.shape[:2]
    flat = directions.reshape(-1, 3)
    depth, colour = shoot(flat)
    inside = np.isfinite(depth)
    coverage = inside.astype(np.float32)
    # Few pixels: what is costly is done for them alone.
    edge = np.flatnonzero(_edges(inside.reshape(shape))) if pitch is not None else []
    if pitch is not None and len(edge):
        centre = flat[edge] / flat[edge, 2:]
        rays = centre[:, np.newaxis] + _NINE * (*pitch, 0.0)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        near, seen = shoot(rays.reshape(-1, 3))
        hit = np.isfinite(near).reshape(-1, len(_NINE))
        count = hit.sum(axis=1)
        weight = (hit / np.maximum(count, 1)[:, np.newaxis]).astype(np.float64)
        finite = np.where(np.isfinite(near), near, 0.0).reshape(hit.shape)
        coverage[edge] = count / len(_NINE)
        depth[edge] = np.where(count > 0, (finite * weight).sum(axis=1), np.inf)
        colour[edge] = (seen.reshape(*hit.shape, 3) * weight[..., np.newaxis]).sum(axis=1)
    drawn = np.flatnonzero(coverage)
    rgb = np.zeros((len(flat), 3), dtype=np.float32)
    rgb[drawn] = colour[drawn]
    return Overlay(
        rgb=rgb.reshape(*shape, 3),
        depth=depth.astype(np.float32).reshape(shape),
        coverage=coverage.reshape(shape),
    )


def _nearest(
    rays: NDArray[np.float64],
    origin: NDArray[np.float64],
    cones: Cones | None,
    robot: RobotView | None,
    is_aboard: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return distance (N,), inf = nothing, and colour (N, 3) of the nearest object on each ray."""
    distance = np.full(len(rays), np.inf)
    colour = np.zeros((len(rays), 3), dtype=np.float32)
    if cones is not None:
        distance, colour = cones.cast(origin, rays)
    if robot is not None:
        hit = robot.ray_robot(origin, rays, exclude="trunk" if is_aboard else "nothing")
        nearer = hit.distance < distance
        light = shade(hit.normal[nearer, 2:])
        colour[nearer] = robot.geom_rgba[hit.geom[nearer], :3] * light
        distance[nearer] = hit.distance[nearer]
    return distance, colour


def _hidden(
    static: RayScene,
    origin: NDArray[np.float64],
    rays: NDArray[np.float64],
    distance: NDArray[np.float64],
) -> NDArray[np.intp]:
    """Return which of the rays that met an object at `distance` (N,) meet the scene before it."""
    met = np.flatnonzero(np.isfinite(distance))  # Few pixels: only they are asked about.
    before = static.distance(origin, rays[met]) < distance[met]
    return met[before]


def _edges(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels (H, W) that lie beside a pixel on the other side of an outline."""
    edge = np.zeros_like(inside)
    below, beside = inside[1:] != inside[:-1], inside[:, 1:] != inside[:, :-1]
    edge[:-1] |= below
    edge[1:] |= below
    edge[:, :-1] |= beside
    edge[:, 1:] |= beside
    return edge


def cone_mask(
    directions: NDArray[np.float64],
    T_world_camera: NDArray[np.float64],
    *,
    cones: Cones,
    static: RayScene,
    robot: RobotView,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return cones as the published evaluation sees them: hidden by geometry, not by the splat.

    Args:
        directions: (H, W, 3) from `ray_directions`.
        T_world_camera: (4, 4), a rotation and metres.
        cones: what is looked for.
        static: the scene's geometry, which hides cones.
        robot: hides cones, but for the trunk that carries the camera.

    Returns:
        colour (H, W, 3), and (H, W) where a cone is the nearest thing.
    """
    rays = directions.reshape(-1, 3) @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    distance, colour = cones.cast(origin, rays)
    mask = np.isfinite(distance)
    mask[_hidden(static, origin, rays, distance)] = False
    hit = np.flatnonzero(mask)
    hidden = robot.ray_robot(origin, rays[hit], exclude="trunk").distance < distance[hit]
    mask[hit[hidden]] = False
    shape = directions.shape[:2]
    return colour.reshape(*shape, 3), mask.reshape(shape)
