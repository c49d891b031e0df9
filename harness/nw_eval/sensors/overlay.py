"""What is not in a splat but in the picture: cones and the robot's own body, by ray casting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.cones import Cones, shade
from nw_eval.sim import World
from nw_eval.splat.camera import Camera
from nw_eval.splat.pixels import Pixels


@dataclass(frozen=True, kw_only=True)
class Overlay:
    """Drawn objects at the pixels of an image: the arguments of `splat.composite`."""

    rgb: NDArray[np.float32]
    """(H, W, 3)."""
    depth: NDArray[np.float32]
    """(H, W) m along the optical axis, inf = nothing."""
    coverage: NDArray[np.float32]
    """(H, W), 1 where something is drawn."""


def ray_directions(camera: Camera, pixels: Pixels) -> NDArray[np.float64]:
    """Return unit directions through pixel centres in camera axes, (H, W, 3)."""
    x = (pixels.indices(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (pixels.indices(camera.height) + 0.5 - camera.cy) / camera.fy
    directions = np.ones((len(y), len(x), 3))
    directions[..., 0] = x
    directions[..., 1] = y[:, np.newaxis]
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def draw(
    directions: NDArray[np.float64],
    T_world_camera: NDArray[np.float64],
    *,
    cones: Cones | None,
    robot: World | None,
    is_aboard: bool = True,
) -> Overlay:
    """Cast one ray for each pixel and keep the nearest object.

    Args:
        directions: (H, W, 3) from `ray_directions`.
        T_world_camera: (4, 4), a rotation and metres.
        cones: drawn unless None.
        robot: the world whose robot is drawn.
        is_aboard: the robot carries the camera, so its trunk is left out.
    """
    rays = directions.reshape(-1, 3) @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
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
    shape = directions.shape[:2]
    along_axis = distance * directions[..., 2].ravel()
    return Overlay(
        rgb=colour.reshape(*shape, 3),
        depth=along_axis.reshape(shape).astype(np.float32),
        coverage=np.isfinite(distance).reshape(shape).astype(np.float32),
    )


def cone_mask(
    directions: NDArray[np.float64],
    T_world_camera: NDArray[np.float64],
    *,
    cones: Cones,
    static: RayScene,
    robot: World,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return cones as the published evaluation sees them: hidden by geometry, not by the splat.

    Args:
        directions: (H, W, 3) from `ray_directions`.
        T_world_camera: (4, 4), a rotation and metres.
        cones: what is looked for.
        static: the scene's geometry, which hides cones.
        robot: the world whose robot hides cones, but for the trunk that carries the camera.

    Returns:
        colour (H, W, 3), and (H, W) where a cone is the nearest thing.
    """
    rays = directions.reshape(-1, 3) @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    distance, colour = cones.cast(origin, rays)
    mask = np.isfinite(distance)
    hit = np.flatnonzero(mask)  # Few pixels: only they are asked about.
    hidden = static.distance(np.broadcast_to(origin, (len(hit), 3)), rays[hit]) < distance[hit]
    hidden |= robot.ray_robot(origin, rays[hit], exclude="trunk").distance < distance[hit]
    mask[hit[hidden]] = False
    shape = directions.shape[:2]
    return colour.reshape(*shape, 3), mask.reshape(shape)
