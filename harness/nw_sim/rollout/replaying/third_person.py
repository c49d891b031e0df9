"""The view of somebody who stands beside: the scene, with robot and cones in it.

Under the robot lies its soft shadow on what it stands on: ambient occlusion by its underside.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from nw_base import same_bits
from nw_base.lens import Intrinsics
from nw_scenes.rays import RayScene
from nw_sim.sensors.drawing.overlay import (
    Cones,
    MeshPicture,
    Overlay,
    draw,
    insert,
    ray_directions,
)
from nw_sim.sensors.drawing.props import PropPictures, joined
from nw_splat.camera import Camera, Pixels, look_at

if TYPE_CHECKING:
    from nw_scenes import Scene
    from nw_sim.physics import World
    from nw_sim.tasks import Task
    from nw_splat.image import Image
    from nw_splat.render import Renderer

Bytes = NDArray[np.uint8]

# Where the spectator stands, in the robot's heading frame, and what is looked at; m, for a trunk
# that starts so high. Of a larger robot, the spectator stands as much farther away.
_HEIGHT = 0.4
_EYE = np.array([-1.35, -1.15, 0.75])
_TARGET = np.array([0.35, 0.0, -0.05])
_FOVY = np.deg2rad(55.0)
# Rendered this many times larger and averaged down: edges of drawn objects are not antialiased.
_OVERSAMPLING = 2
# Share of the way to a wall that the eye may go.
_SHORT_OF_WALLS = 0.85
Array = NDArray[np.float64]
Ghost = tuple[Array, Array, Array]
"""Where a robot should be: position (3,) m and quaternion (4,) of its trunk, and (J,) rad."""
_GHOST, _THROUGH = (70, 190, 255), 0.5
"""Its colour, and the share of what is behind it that is seen through it."""

_REACH = 0.8  # m from the trunk's middle to the map's edges
_CELL = 0.025  # m
_BELOW = (
    60.0  # m below the robot: from there rays upwards are as good as parallel, and cast as one fan
)
_LEAST_RISE = 0.02  # m; a foot that touches the ground covers what is under it, and no more
_DARKEST = 0.9  # share of the light; some always comes from the side
_FLAT = 0.04  # m: what lies this far off the ground of its cell is a wall or an edge
_GAMMA = 2.2


class Spectator:
    """Takes third-person pictures of one scene; owns nothing that must be closed.

    Args:
        scene: what is seen.
        renderer: of its splat; None draws its mesh.
    """

    def __init__(self, scene: Scene, renderer: Renderer | None) -> None:
        self._scene = scene
        self._rays = RayScene(scene.mesh())
        self._props = PropPictures(scene)
        drawn = MeshPicture(self._rays, scene.T_world_splat)
        self._renderer = drawn if renderer is None else renderer

    def beside(
        self,
        world: World,
        trail: NDArray[np.float64],
        *,
        width: int,
        height: int,
        ghost: Ghost | None = None,
    ) -> Bytes:
        """Return the robot from behind its right shoulder, (height, width, 3).

        Args:
            world: whose robot is drawn.
            trail: (K, 3) m, where the cones stand.
            width: pixels.
            height: pixels.
            ghost: of `ghost_of`; where the robot should be, drawn through.
        """
        yaw = world.roll_pitch_yaw[2]
        cosine, sine = np.cos(yaw), np.sin(yaw)
        R = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        trunk, times = world.trunk_position, max(1.0, world.robot.spawn_height / _HEIGHT)
        eye = self._in_front_of_walls(trunk, trunk + R @ (times * _EYE))
        T_world_camera = look_at(eye, trunk + R @ (times * _TARGET))
        drawn = self.view(T_world_camera, _FOVY, world, trail, width=width, height=height)
        return drawn if ghost is None else self._with_ghost(drawn, ghost, T_world_camera, world)

    def _with_ghost(
        self, drawn: Bytes, ghost: Ghost, T_world_camera: NDArray[np.float64], world: World
    ) -> Bytes:
        """Return a view with a robot in it that one sees through, (H, W, 3)."""
        height, width = drawn.shape[:2]
        lens = Intrinsics.from_fovy(width, height, _FOVY)
        rays = ray_directions(Camera.of(lens, T_world_camera), Pixels()).reshape(-1, 3)
        rays = rays @ T_world_camera[:3, :3].T
        origin = T_world_camera[:3, 3]
        distance = world.ray_ghost(ghost, origin, rays)
        met = np.flatnonzero(np.isfinite(distance))
        before, _ = self._rays.cast(np.broadcast_to(origin, (len(met), 3)), rays[met])
        robot = world.ray_robot(origin, rays[met]).distance
        seen = met[distance[met] < np.minimum(before, robot)]
        picture = drawn.reshape(-1, 3).copy()
        mixed = (1.0 - _THROUGH) * np.array(_GHOST) + _THROUGH * picture[seen]
        picture[seen] = np.rint(mixed).astype(np.uint8)
        return picture.reshape(drawn.shape)

    def aboard(
        self, world: World, trail: NDArray[np.float64], camera: str, *, width: int, height: int
    ) -> Bytes:
        """Return the view of one of the robot's own cameras, (height, width, 3)."""
        lens = world.robot.cameras[camera].lens(width, height)
        return self._view(world.camera_pose(camera), lens, world, trail, is_aboard=True)

    def view(
        self,
        T_world_camera: NDArray[np.float64],
        fovy: float,
        world: World,
        trail: NDArray[np.float64],
        *,
        width: int,
        height: int,
    ) -> Bytes:
        """Return the view of any camera, (height, width, 3).

        Args:
            T_world_camera: (4, 4).
            fovy: vertical field of view, rad.
            world: whose robot is drawn.
            trail: (K, 3) m, where the cones stand.
            width: pixels.
            height: pixels.
        """
        lens = Intrinsics.from_fovy(width, height, fovy)
        return self._view(T_world_camera, lens, world, trail)

    def _view(
        self,
        T_world_camera: NDArray[np.float64],
        lens: Intrinsics,
        world: World,
        trail: NDArray[np.float64],
        *,
        is_aboard: bool = False,
    ) -> Bytes:
        """Return the view through a lens; `is_aboard`: the trunk carries it, and is left out."""
        width, height = lens.width, lens.height
        T = same_bits.inverse(self._scene.T_world_splat) @ T_world_camera
        lens = lens.resized(width * _OVERSAMPLING, height * _OVERSAMPLING)
        camera = Camera.of(lens, T)
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
        others: list[Overlay] = []
        if self._scene.props:
            others = self._props.overlays(
                world.prop_poses(),
                lambda T: replace(camera, T_world_camera=T),
                directions=directions,
                T_world_camera=T_world_camera,
                static=self._rays,
            )
        image = insert(
            image,
            joined([overlay, *others]),
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
        # It is soft: one ray for each pixel of the picture that is averaged.
        some = directions[::_OVERSAMPLING, ::_OVERSAMPLING]
        rays = some.reshape(-1, 3) @ T_world_camera[:3, :3].T
        origin = T_world_camera[:3, 3]
        distance, _ = self._rays.cast(np.broadcast_to(origin, rays.shape), rays)
        points = origin + np.where(np.isfinite(distance), distance, 1e6)[:, np.newaxis] * rays
        factors = ContactShadow(world, self._rays).factors(points).reshape(some.shape[:2])
        factors = factors.repeat(_OVERSAMPLING, axis=0).repeat(_OVERSAMPLING, axis=1)
        return replace(image, rgb=image.rgb * factors[..., np.newaxis].astype(np.float32))

    def _in_front_of_walls(
        self, near: NDArray[np.float64], far: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        way = far - near
        length = float(np.linalg.norm(way))
        distance, _ = self._rays.cast(near[np.newaxis], way[np.newaxis] / length)
        return near + way * min(1.0, _SHORT_OF_WALLS * float(distance[0]) / length)


def ghost_of(task: Task, step: int) -> Ghost | None:
    """Return where the motion of a task is at a control step; None where it tracks none."""
    if (placed := task.reference) is None:
        return None
    frame = placed.at(step)
    return frame.root_position, frame.root_quat, frame.joint_positions


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
        apart = (side[:, np.newaxis] - side) ** 2  # m^2 between rows of cells, and between columns.
        for piece in over:  # Some hundred pieces; a table of all pairs would take long.
            i, j = divmod(int(piece), len(side))
            square = (apart[i, :, np.newaxis] + apart[j]).ravel()
            h = underside[piece] - ground
            h2 = np.where(np.isfinite(h), np.maximum(h, _LEAST_RISE), 1.0) ** 2
            ratio = h2 / (h2 + square)
            cube = ratio * ratio * ratio  # A power takes ten times as long.
            occlusion += np.where(np.isfinite(h) & (h > 0.0), cube * cube / h2, 0.0)
        occlusion *= 5.0 * _CELL**2 / np.pi
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
    eye = world.trunk_position - [0.0, 0.0, _BELOW]
    middle = np.full(len(flat), world.trunk_position[2])
    ways = np.concatenate([flat, middle[:, np.newaxis]], axis=1) - eye
    length = np.linalg.norm(ways, axis=1)
    distance = world.ray_robot(eye, ways / length[:, np.newaxis]).distance
    return eye[2] + distance * ways[:, 2] / length
