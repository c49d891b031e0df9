"""What ray casting draws into pictures, hidden as the scene hides it and lit as the scene is lit.

Into pictures of a splat come cones at the waypoints, which the published evaluation paints into
camera images, and the robot's own body. Of a scene that has no splat its mesh is drawn, shaded, for
people; no policy sees that.

The light on drawn objects is told from the picture that they are put into: gray world. Nothing is
known of a scanned scene's lamps; but what is photographed there reflects 18 % of its light on
average (Buchsbaum, "A spatial processor model for object colour perception", 1980, and the grey
card of photographers). So the mean colour of the ground around an object tells how bright and of
which colour the light is there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_scenes.mesh import CONE_BASE, CONE_HEIGHT, TriangleMesh, cone_mesh, merge
from nw_scenes.rays import RayScene
from nw_sim.physics.looks import RobotRays
from nw_sim.sensors.drawing.pictures import FACE_CLASSES, NOTHING, PALETTE
from nw_splat.camera import Camera, Pixels, Rows
from nw_splat.image import Image, composite
from nw_splat.kernels import insert as insertion

# Share of the light that reaches a face from everywhere; the rest comes from above.
_AMBIENT = 0.5
_BOUND = 1.05 * math.hypot(CONE_BASE / math.sqrt(2.0), CONE_HEIGHT / 2)
"""Radius of a sphere around a cone's middle that holds all of it, m."""


class Cones:
    """Cones on a course, answered by ray casting. Nothing ever touches them."""

    def __init__(self, waypoints: NDArray[np.float64]) -> None:
        """Put a cone on each waypoint, (K, 3) m."""
        cone = cone_mesh()
        self._rays = RayScene(
            merge(
                [
                    TriangleMesh(
                        vertices=cone.mesh.vertices + waypoint,
                        faces=cone.mesh.faces,
                        kinds=cone.mesh.kinds,
                    )
                    for waypoint in waypoints
                ]
            )
        )
        self._middles = waypoints + np.array([0.0, 0.0, CONE_HEIGHT / 2])
        corners = cone.mesh.triangles
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1)
        upwards = normal[:, 2] / np.where(length > 0.0, length, 1.0)  # The tip has no area.
        light = shade(upwards).astype(np.float32)
        self._colour = np.tile(cone.colors * light[:, np.newaxis], (len(waypoints), 1))

    def cast(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return distance (N,) m, inf for a miss, and colour (N, 3) along rays from one point."""
        near = self._near(origin, directions)
        distance = np.full(len(directions), np.inf)
        colour = np.zeros((len(directions), 3), dtype=np.float32)
        rays = directions[near]
        distance[near], face = self._rays.cast(origin, rays)
        colour[near] = self._colour[face]
        return distance, colour

    def distance(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return only the distances of `cast`."""
        near = self._near(origin, directions)
        distance = np.full(len(directions), np.inf)
        rays = directions[near]
        distance[near] = self._rays.distance(origin, rays)
        return distance

    def _near(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> NDArray[np.intp]:
        """Return which rays come as near to a cone as its bounding sphere: few of a picture's."""
        nearest = np.empty(len(directions), dtype=np.intp)
        point = np.array(origin)  # In one piece, which the kernel was compiled for.
        return nearest[: insertion.near_any(directions, self._middles, point, _BOUND, nearest)]


def shade(upwards: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how bright surfaces are whose unit normals have these z components, 0.5 to 1."""
    return _AMBIENT + (1.0 - _AMBIENT) * (0.5 + 0.5 * upwards)


class CourseCones:
    """The cones of a course that may be another one in the next trial."""

    def __init__(self) -> None:
        self._cones: Cones | None = None
        self._trail: NDArray[np.float64] | None = None

    def on(self, trail: NDArray[np.float64]) -> Cones:
        """Return cones on waypoints (K, 3), made once for each array of them."""
        if self._cones is None or self._trail is not trail:
            self._cones, self._trail = Cones(trail), trail
        return self._cones


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
    """Drawn objects at the pixels of an image: the arguments of `nw_splat.image.paste`."""

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
    if pitch is not None:
        # Few pixels: what is costly is done for them alone.
        nearest = np.empty(len(flat), dtype=np.intp)
        edge = nearest[: insertion.outline(inside.reshape(shape), nearest)]
        rays = np.empty((len(_NINE) * len(edge), 3))
        insertion.rays_around(flat, edge, _NINE * (*pitch, 0.0), rays)
        if len(edge):
            insertion.soften(*shoot(rays), edge, depth, colour, coverage)
    drawn = np.flatnonzero(coverage > 0.0)
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


_LIGHT = np.array([-0.35, -0.25, 0.9])
"""Towards the light, from over a shoulder of somebody who looks along a course."""
_MESH_GREY, _MESH_TINT = 0.62, 0.4
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
        self._colour = _MESH_GREY + _MESH_TINT * (classes - classes.mean(axis=1, keepdims=True))

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


Floats = NDArray[np.floating]

_LOOSE = 0.05
"""Metres: so near to a surface of the geometry, above or below, the splat shows that surface."""

_GREY = 0.46
"""Display value (sRGB) of what reflects 18 %."""
_TINT = 0.35
"""Share of the mean's tint that is the light's; the rest is of the surfaces themselves."""
_CELLS = (9, 16)
"""Rows and columns in which means are taken."""
_SAMPLES = 45
"""Rows and columns of pixels that are looked at, at least; more say nothing new about a mean."""
_LEVEL = 0.02
"""Rays that go down less steeply than this see what is far away, or sky."""
_LUMA = (0.2126, 0.7152, 0.0722)


def insert(
    image: Image,
    overlay: Overlay,
    *,
    directions: NDArray[np.float64],
    T_world_camera: NDArray[np.float64],
    static: RayScene,
) -> Image:
    """Blend drawn objects, of which geometry hides nothing more, into a picture of the splat.

    The splat hides them too, where it shows what the geometry lacks, such as grass or a pole. Its
    depth has noise, a few centimetres along a slanting ray: where it comes to lie near a surface,
    it is that surface, and about that the geometry has been asked.

    Args:
        image: rendered, depth in m.
        overlay: at the same pixels, from `overlay.draw` with `static`.
        directions: (H, W, 3) from `ray_directions`.
        T_world_camera: (4, 4), a rotation and metres; or (H, 4, 4), one for each row.
        static: the scene's geometry.
    """
    # Of booleans in a row it is found five times as fast.
    row, column = np.divmod(np.flatnonzero(overlay.coverage > 0.0), overlay.coverage.shape[1])
    if len(row) == 0:
        return image
    drawn = overlay.depth[row, column]
    depth = image.depth[row, column]
    before = np.flatnonzero(depth < drawn)
    rays = directions[row[before], column[before]]
    along = depth[before].astype(np.float64) / rays[:, 2]
    seen = rays * along[:, np.newaxis]
    if T_world_camera.ndim == 2:
        points = seen @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        down = directions @ -T_world_camera[2, :3]
    else:
        T = T_world_camera[row[before]]
        points = (T[:, :3, :3] @ seen[..., np.newaxis])[..., 0] + T[:, :3, 3]
        down = -(directions * T_world_camera[:, np.newaxis, 2, :3]).sum(axis=-1)
    surface = before[_beside_surface(points, static)]
    depth[surface] = np.nextafter(drawn[surface], np.float32(np.inf))
    light = light_around(image.rgb, down, row, column)
    if overlay.lit is not None:
        light = 1.0 + (light - 1.0) * overlay.lit[row, column, np.newaxis]
    blended = composite(
        Image(
            rgb=image.rgb[row, column][np.newaxis],
            depth=depth[np.newaxis],
            alpha=image.alpha[row, column][np.newaxis],
        ),
        (overlay.rgb[row, column] * light)[np.newaxis],
        drawn[np.newaxis],
        overlay.coverage[row, column][np.newaxis],
    )
    new = Image(rgb=image.rgb.copy(), depth=image.depth.copy(), alpha=image.alpha.copy())
    new.rgb[row, column] = blended.rgb[0]
    new.depth[row, column] = blended.depth[0]
    new.alpha[row, column] = blended.alpha[0]
    return new


def _beside_surface(points: NDArray[np.float64], static: RayScene) -> NDArray[np.bool_]:
    """Return which points (N, 3) have a surface at most `_LOOSE` above or below them."""
    down = np.zeros_like(points)
    down[:, 2] = -1.0
    return static.distance(points + np.array([0.0, 0.0, _LOOSE]), down) < 2.0 * _LOOSE


_DIMMEST, _BRIGHTEST = 0.15, 1.1
_ELSEWHERE, _AFAR = 1e-4, 1e-2
"""Weights beside that of ground around: of what is no ground, and of ground anywhere else."""


def light_around(
    rgb: Floats, down: Floats, row: NDArray[np.intp], column: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Return the factors that light puts on display values of objects at some pixels.

    Display values are about powers of light, and powers keep products: the ratio of display values
    is that factor, without decoding them.

    Args:
        rgb: (H, W, 3) picture without the objects, display values.
        down: (H, W) how far down the pixels' rays go in each metre.
        row: (N,) of the pixels.
        column: (N,) of the pixels.

    Returns:
        (N, 3), 1 where the ground is an average grey.
    """
    size = rgb.shape[:2]
    steps = tuple(max(1, side // _SAMPLES) for side in size)
    starts = tuple(
        _starts(-(-side // step), count)
        for side, step, count in zip(size, steps, _CELLS, strict=True)
    )
    cells = np.empty((*map(len, starts), 4))
    insertion.sum_cells(rgb, down, steps, _LEVEL, _ELSEWHERE, starts, cells)
    total = _around(cells) + _AFAR * cells.sum(axis=(0, 1))
    light = np.empty((len(row), 3), dtype=np.float32)
    numbers = (_LUMA, _GREY, _DIMMEST, _BRIGHTEST, _TINT)
    of_pixels = (total[..., :3] / total[..., 3:], row, column)
    means, row, column = map(np.ascontiguousarray, of_pixels)
    insertion.light_at(means, size, row, column, numbers, light)
    return light


@cache
def _starts(size: int, count: int) -> NDArray[np.intp]:
    count = min(size, count)
    return np.arange(count) * size // count


def _around(cells: Floats) -> Floats:
    """Return each cell of (R, C, K) with its neighbours: the next counts 2/3, the second 1/3."""
    rows, columns = (_weights(count) for count in cells.shape[:2])
    return (rows @ cells.transpose(2, 0, 1) @ columns).transpose(1, 2, 0)


@cache
def _weights(count: int) -> Floats:
    index = np.arange(count)
    return np.maximum(3.0 - np.abs(index - index[:, np.newaxis]), 0.0)
