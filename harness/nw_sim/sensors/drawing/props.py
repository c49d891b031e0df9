"""Props where they are now: met by rays, and drawn into pictures of the scene.

A mesh is drawn by rays, nine for each pixel that it may touch. A splat is rendered by itself from
where the camera is in its own frame, and keeps the light that it was captured in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_scenes.rays import RayScene
from nw_sim.sensors.drawing.overlay import Overlay, insert, shade
from nw_splat.camera import Camera, Pixels, Rows

if TYPE_CHECKING:
    from nw_scenes.prop import Prop
    from nw_scenes.scene import Scene
    from nw_splat.image import Image
    from nw_splat.render import Renderer

Array = NDArray[np.float64]

_THIRDS = (-1.0 / 3.0, 0.0, 1.0 / 3.0)
_NINE = np.array([(x, y, 0.0) for y in _THIRDS for x in _THIRDS])
_ONE = np.zeros((1, 3))
_FAINT = 1e-3
"""Coverage below which the colour of a splat's pixel means nothing."""
_TOUCHING = 0.01
"""m that a splat's expected depth may lie behind the geometry that it stands on."""


def cast_at_prop(
    prop: Prop, T_world_prop: Array, origin: Array, directions: Array
) -> tuple[Array, NDArray[np.int32]]:
    """Return distance (N,) m, inf for a miss, and face (N,), -1 for a miss, along rays.

    Args:
        prop: met as its `solid`.
        T_world_prop: (4, 4), where it is.
        origin: (3,) of all rays, world, m.
        directions: (N, 3) unit vectors, world.
    """
    rays, middle, reach = _solid(prop)
    R, at = T_world_prop[:3, :3], T_world_prop[:3, 3]
    ahead = R @ middle + at - origin
    along = directions @ ahead
    near = np.flatnonzero((same_bits.dot(ahead, ahead) - along**2 < reach**2) & (along > -reach))
    distance, face = np.full(len(directions), np.inf), np.full(len(directions), -1, np.int32)
    begin = np.broadcast_to(same_bits.product(origin - at, R), (len(near), 3))
    distance[near], face[near] = rays.cast(begin, directions[near] @ R)
    return distance, face


def height_of_prop(prop: Prop, T_world_prop: Array, xy: Array) -> Array:
    """Return how high a prop is at points, (N,) m in the world, -inf where it is not.

    Args:
        prop: met as its `solid`, from above.
        T_world_prop: (4, 4), where it is.
        xy: (N, 2) world, m.
    """
    rays, middle, reach = _solid(prop)
    R, at = T_world_prop[:3, :3], T_world_prop[:3, 3]
    center = R @ middle + at
    near = np.flatnonzero(((xy - center[:2]) ** 2).sum(axis=1) < reach**2)
    heights = np.full(len(xy), -np.inf)
    above = np.column_stack([xy[near], np.full(len(near), center[2] + reach)])
    down = np.tile(-R[2], (len(near), 1))
    heights[near] = above[:, 2] - rays.cast((above - at) @ R, down)[0]
    return heights


@lru_cache(maxsize=64)
def _solid(prop: Prop) -> tuple[RayScene, Array, float]:
    """Return rays against a prop, and the ball round it: middle (3,) and radius, m, its frame."""
    points = prop.solid.vertices
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    # And a little: rays are cast in single precision.
    reach = float(np.linalg.norm(points - middle, axis=1).max()) * 1.001 + 1e-6
    return RayScene(prop.solid), middle, reach


@lru_cache(maxsize=64)
def _normals(prop: Prop) -> Array:
    """Return unit normals (F, 3) of a prop's faces in its frame; of flat ones, zeros."""
    corners = prop.solid.triangles
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0.0, length, 1.0)


class PropPictures:
    """Draws the props of a scene. Renderers of their splats are opened when first needed.

    Args:
        scene: whose props they are.
    """

    def __init__(self, scene: Scene) -> None:
        self.props = scene.props
        self._renderers: dict[str, Renderer] = {}

    def overlays(
        self,
        poses: Sequence[Array],
        camera_at: Callable[[Array], Camera],
        *,
        directions: Array,
        T_world_camera: Array,
        static: RayScene,
        pixels: Pixels = Pixels(),  # noqa: B008 (frozen)
        rows: Rows | None = None,
        pitch: tuple[float, float] | None = None,
    ) -> list[Overlay]:
        """Return each prop at the pixels of an image, as far as the scene's geometry shows it.

        Args:
            poses: (4, 4) of each, T_world_prop.
            camera_at: from its (4, 4) pose in the world of a splat to the camera.
            directions: (H, W, 3) from `overlay.ray_directions`.
            T_world_camera: (4, 4), a rotation and metres.
            static: the scene's geometry.
            pixels: of the camera.
            rows: of the pixels, those that `directions` are of; None = all.
            pitch: 1 / fx and 1 / fy of the camera, for soft edges of meshes; None = hard ones.
        """
        overlays: list[Overlay] = []
        for prop, pose in zip(self.props, poses, strict=True):
            if prop.splat is None:
                one = _of_mesh(prop, pose, directions, T_world_camera, static, pitch)
            else:
                T = same_bits.inverse(pose @ prop.T_prop_splat) @ T_world_camera
                renderer, camera = self._renderer(prop), camera_at(T)
                image = (
                    renderer.render(camera, pixels)
                    if rows is None
                    else renderer.render(camera, pixels, rows)
                )
                one = _of_splat(image, directions, T_world_camera, static)
            if one is not None:
                overlays.append(one)
        return overlays

    def into(
        self,
        image: Image,
        poses: Sequence[Array],
        camera_at: Callable[[Array], Camera],
        *,
        directions: Array,
        T_world_camera: Array,
        static: RayScene,
    ) -> Image:
        """Return a picture of the scene with the props in it; arguments as `overlays`."""
        pinhole = camera_at(np.eye(4))
        overlays = self.overlays(
            poses,
            camera_at,
            directions=directions,
            T_world_camera=T_world_camera,
            static=static,
            pitch=(1.0 / pinhole.fx, 1.0 / pinhole.fy),
        )
        if not overlays:
            return image
        place = {"directions": directions, "T_world_camera": T_world_camera}
        return insert(image, joined(overlays), static=static, **place)

    def _renderer(self, prop: Prop) -> Renderer:
        from nw_splat.render import open_renderer
        from nw_splat.store import open_store

        if prop.name not in self._renderers:
            self._renderers[prop.name] = open_renderer(open_store(prop.splat.store()), "cpu")
        return self._renderers[prop.name]


def _of_mesh(
    prop: Prop,
    pose: Array,
    directions: Array,
    T_world_camera: Array,
    static: RayScene,
    pitch: tuple[float, float] | None,
) -> Overlay | None:
    shape = directions.shape[:2]
    flat = directions.reshape(-1, 3)
    R_world_camera, origin = T_world_camera[:3, :3], T_world_camera[:3, 3]
    near = _may_touch(prop, pose, flat, T_world_camera, pitch)
    if not len(near):
        return None
    steps = _ONE if pitch is None else _NINE * (*pitch, 0.0)
    rays = (flat[near] / flat[near, 2:])[:, np.newaxis] + steps
    rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3)
    turned = rays @ R_world_camera.T
    distance, face = cast_at_prop(prop, pose, origin, turned)
    met = np.flatnonzero(face >= 0)
    before = static.distance(np.broadcast_to(origin, (len(met), 3)), turned[met]) < distance[met]
    distance[met[before]] = np.inf
    hit = np.isfinite(distance)
    colour = np.zeros((len(rays), 3))
    normal = _normals(prop)[face[hit]] @ pose[:3, :3].T
    normal[(normal * turned[hit]).sum(axis=1) > 0.0] *= -1.0
    colour[hit] = np.array(prop.color) * shade(normal[:, 2:])
    along = np.where(hit, distance, 0.0) * rays[:, 2]
    count = hit.reshape(-1, len(steps)).sum(axis=1)
    seen, most = np.flatnonzero(count), np.maximum(count, 1)
    mean = along.reshape(-1, len(steps)).sum(axis=1) / most
    rgb = colour.reshape(-1, len(steps), 3).sum(axis=1) / most[:, np.newaxis]
    return _overlay(
        shape, near[seen], rgb[seen], mean[seen], count[seen] / len(steps), own_light=False
    )


def _may_touch(
    prop: Prop,
    pose: Array,
    flat: Array,
    T_world_camera: Array,
    pitch: tuple[float, float] | None,
) -> NDArray[np.intp]:
    """Return the pixels whose rays come as near to a prop as the ball round it, or half a pixel."""
    _, middle, reach = _solid(prop)
    R_world_camera, origin = T_world_camera[:3, :3], T_world_camera[:3, 3]
    ahead = same_bits.product(pose[:3, :3] @ middle + pose[:3, 3] - origin, R_world_camera)
    along = flat @ ahead
    wide = reach + (0.0 if pitch is None else max(pitch) * np.maximum(along, 0.0))
    return np.flatnonzero((same_bits.dot(ahead, ahead) - along**2 < wide**2) & (along > -reach))


def _of_splat(
    image: Image, directions: Array, T_world_camera: Array, static: RayScene
) -> Overlay | None:
    shape = directions.shape[:2]
    alpha = image.alpha.ravel()
    seen = np.flatnonzero(alpha > _FAINT)
    rays = directions.reshape(-1, 3)[seen]
    depth = image.depth.ravel()[seen].astype(np.float64)
    origin = np.broadcast_to(T_world_camera[:3, 3], rays.shape)
    place = static.distance(origin, rays @ T_world_camera[:3, :3].T) * rays[:, 2]
    shown = place > depth - _TOUCHING
    seen, depth = seen[shown], depth[shown]
    if not len(seen):
        return None
    share = alpha[seen, np.newaxis]
    # What the renderer has put behind it is white.
    rgb = (image.rgb.reshape(-1, 3)[seen] - (1.0 - share)) / share
    return _overlay(shape, seen, rgb, depth, alpha[seen], own_light=True)


def _overlay(
    shape: tuple[int, ...],
    at: NDArray[np.intp],
    rgb: NDArray[np.floating],
    depth: NDArray[np.floating],
    coverage: NDArray[np.floating],
    *,
    own_light: bool,
) -> Overlay:
    """Return an overlay of pixels `at` (N,) in an image, and of nothing elsewhere."""
    count = shape[0] * shape[1]
    colours, depths = np.zeros((count, 3), np.float32), np.full(count, np.inf, np.float32)
    shares, lit = np.zeros(count, np.float32), np.zeros(count, np.float32)
    colours[at], depths[at], shares[at], lit[at] = rgb, depth, coverage, float(not own_light)
    return Overlay(
        rgb=colours.reshape(*shape, 3),
        depth=depths.reshape(shape),
        coverage=shares.reshape(shape),
        lit=lit.reshape(shape),
    )


def joined(overlays: Sequence[Overlay]) -> Overlay:
    """Return several overlays, one or more, as one: in each pixel the nearer hides the farther."""
    return reduce(_over, overlays)


def _over(one: Overlay, two: Overlay) -> Overlay:
    is_one = one.depth <= two.depth
    near = np.where(is_one, one.coverage, two.coverage)
    far = np.where(is_one, two.coverage, one.coverage) * (1.0 - near)
    total = near + far
    share_one = np.where(is_one, near, far) / np.maximum(total, 1e-10)

    def mixed(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.float32]:
        weight = share_one[..., np.newaxis] if a.ndim > share_one.ndim else share_one
        return (weight * a + (1.0 - weight) * b).astype(np.float32)

    depths = [np.where(np.isfinite(each.depth), each.depth, 0.0) for each in (one, two)]
    lights = [np.ones_like(each.coverage) if each.lit is None else each.lit for each in (one, two)]
    return Overlay(
        rgb=mixed(one.rgb, two.rgb),
        depth=np.where(total > 0.0, mixed(*depths), np.inf).astype(np.float32),
        coverage=total.astype(np.float32),
        lit=mixed(*lights),
    )
