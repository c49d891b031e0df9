"""The view of somebody who stands beside: the place, with robot and cones in it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from nw_eval.rollout.pictures.contact_shadow import ContactShadow
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.drawing.cones import Cones
from nw_eval.sensors.drawing.insert import insert
from nw_eval.sensors.drawing.mesh_picture import MeshPicture
from nw_eval.sensors.drawing.overlay import draw, ray_directions
from nw_eval.splat.camera import Camera, Pixels, look_at

if TYPE_CHECKING:
    from nw_eval.scenes import Scene
    from nw_eval.sim import World
    from nw_eval.splat.image import Image
    from nw_eval.splat.render import Renderer

Bytes = NDArray[np.uint8]

# Where the spectator stands, in the robot's heading frame, and what is looked at; m.
_EYE = np.array([-1.35, -1.15, 0.75])
_TARGET = np.array([0.35, 0.0, -0.05])
_FOVY = np.deg2rad(55.0)
# Rendered this many times larger and averaged down: edges of drawn objects are not antialiased.
_OVERSAMPLING = 2
# Share of the way to a wall that the eye may go.
_SHORT_OF_WALLS = 0.85


class Spectator:
    """Takes third-person pictures of one scene; owns nothing that must be closed.

    Args:
        scene: what is seen.
        renderer: of its splat; None draws its mesh.
    """

    def __init__(self, scene: Scene, renderer: Renderer | None) -> None:
        self._scene = scene
        self._rays = RayScene(scene.mesh())
        drawn = MeshPicture(self._rays, scene.T_world_splat)
        self._renderer = drawn if renderer is None else renderer

    def beside(self, world: World, trail: NDArray[np.float64], *, width: int, height: int) -> Bytes:
        """Return the robot from behind its right shoulder, (height, width, 3)."""
        yaw = world.roll_pitch_yaw[2]
        cosine, sine = np.cos(yaw), np.sin(yaw)
        R = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        trunk = world.trunk_position
        eye = self._in_front_of_walls(trunk, trunk + R @ _EYE)
        T_world_camera = look_at(eye, trunk + R @ _TARGET)
        return self.view(T_world_camera, _FOVY, world, trail, width=width, height=height)

    def aboard(
        self, world: World, trail: NDArray[np.float64], camera: str, *, width: int, height: int
    ) -> Bytes:
        """Return the view of one of the robot's own cameras, (height, width, 3)."""
        fovy = world.robot.cameras[camera].fovy
        pose = world.camera_pose(camera)
        return self.view(pose, fovy, world, trail, width=width, height=height, is_aboard=True)

    def view(
        self,
        T_world_camera: NDArray[np.float64],
        fovy: float,
        world: World,
        trail: NDArray[np.float64],
        *,
        width: int,
        height: int,
        is_aboard: bool = False,
    ) -> Bytes:
        """Return the view of any camera, (height, width, 3).

        Args:
            T_world_camera: (4, 4).
            fovy: vertical field of view, rad.
            world: whose robot is drawn.
            trail: (K, 3) m, where the cones stand.
            width: pixels.
            height: pixels.
            is_aboard: the robot carries the camera, so its trunk is left out.
        """
        T = np.linalg.inv(self._scene.T_world_splat) @ T_world_camera
        camera = Camera.from_fovy(
            width=width * _OVERSAMPLING,
            height=height * _OVERSAMPLING,
            fovy=fovy,
            T_world_camera=T,
        )
        directions = ray_directions(camera, Pixels())
        overlay = draw(
            directions,
            T_world_camera,
            cones=Cones(trail),
            robot=world,
            static=self._rays,
            is_aboard=is_aboard,
        )
        image = self._shadowed(self._renderer.render(camera), directions, T_world_camera, world)
        image = insert(
            image,
            overlay,
            directions=directions,
            T_world_camera=T_world_camera,
            static=self._rays,
        )
        large = PillowImage.fromarray(image.bytes())
        return np.asarray(large.resize((width, height), PillowImage.Resampling.BOX))

    def _shadowed(
        self,
        image: Image,
        directions: NDArray[np.float64],
        T_world_camera: NDArray[np.float64],
        world: World,
    ) -> Image:
        """Return the picture with the robot's contact shadow on the ground."""
        rays = directions.reshape(-1, 3) @ T_world_camera[:3, :3].T
        origin = T_world_camera[:3, 3]
        distance, _ = self._rays.cast(np.broadcast_to(origin, rays.shape), rays)
        points = origin + np.where(np.isfinite(distance), distance, 1e6)[:, np.newaxis] * rays
        factors = ContactShadow(world, self._rays).factors(points).reshape(image.alpha.shape)
        return replace(image, rgb=image.rgb * factors[..., np.newaxis].astype(np.float32))

    def _in_front_of_walls(
        self, near: NDArray[np.float64], far: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        way = far - near
        length = float(np.linalg.norm(way))
        distance, _ = self._rays.cast(near[np.newaxis], way[np.newaxis] / length)
        return near + way * min(1.0, _SHORT_OF_WALLS * float(distance[0]) / length)
