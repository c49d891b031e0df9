"""Pictures of a scene that has no splat: its mesh, shaded. For people; no policy sees them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.drawing.overlay import ray_directions
from nw_eval.sensors.drawing.palette import FACE_CLASSES, NOTHING, PALETTE
from nw_eval.splat.camera import Camera, Pixels, Rows
from nw_eval.splat.image import Image

_LIGHT = np.array([-0.35, -0.25, 0.9])
"""Towards the light, from over a shoulder of somebody who looks along a course."""
_AMBIENT = 0.5
_GREY, _TINT = 0.62, 0.4
"""Colours of the classes, mixed with grey: a sketch, not the sensor's classes."""
_TILE, _CONTRAST = 0.5, 0.06
"""Level faces are chequered, so that sizes and ways show: side in m, and how much."""


class MeshPicture:
    """A renderer of a scene's mesh, in place of that of its splat.

    Args:
        rays: the scene's geometry.
        T_world_splat: (4, 4) as the scene's, for cameras come in the splat's frame.
    """

    def __init__(self, rays: RayScene, T_world_splat: NDArray[np.float64]) -> None:
        self._rays = rays
        self._T_world_splat = T_world_splat
        corners = rays.mesh.triangles
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        self._normal = normal / np.where(length > 0.0, length, 1.0)
        classes = PALETTE[FACE_CLASSES[rays.mesh.kinds]] / 255.0
        self._colour = _GREY + _TINT * (classes - classes.mean(axis=1, keepdims=True))

    def render(
        self,
        camera: Camera,
        pixels: Pixels = Pixels(),  # noqa: B008 (frozen)
        rows: Rows | None = None,
    ) -> Image:
        """Return the image of a camera, or a pixel set of it, or rows of that; depth in m."""
        T_world_camera = self._T_world_splat @ camera.T_world_camera
        directions = ray_directions(camera, pixels)[slice(*(rows or (None,)))]
        shape = directions.shape[:2]
        rays = directions.reshape(-1, 3) @ T_world_camera[:3, :3].T
        origin = T_world_camera[:3, 3]
        distance, face = self._rays.cast(np.broadcast_to(origin, rays.shape), rays)
        met = np.flatnonzero(face >= 0)
        rgb = np.broadcast_to(PALETTE[NOTHING] / 255.0, rays.shape).copy()
        points = origin + distance[met, np.newaxis] * rays[met]
        rgb[met] = self._shaded(face[met], rays[met], points)
        depth = np.where(face >= 0, distance, 0.0) * directions.reshape(-1, 3)[:, 2]
        return Image(
            rgb=rgb.reshape(*shape, 3).astype(np.float32),
            depth=depth.reshape(shape).astype(np.float32),
            alpha=(face >= 0).reshape(shape).astype(np.float32),
        )

    def _shaded(
        self, face: NDArray[np.int32], rays: NDArray[np.float64], points: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        normal = self._normal[face]
        # A face that is seen from behind shows that side.
        normal = normal * -np.sign((normal * rays).sum(axis=1, keepdims=True))
        light = np.maximum(normal @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0)
        tile = np.floor(points[:, :2] / _TILE + 1e-6).astype(np.int64).sum(axis=1) % 2
        chequer = 1.0 + _CONTRAST * (tile - 0.5) * (normal[:, 2] > 0.9)
        shade = (_AMBIENT + (1.0 - _AMBIENT) * light) * chequer
        return self._colour[face] * shade[:, np.newaxis]
