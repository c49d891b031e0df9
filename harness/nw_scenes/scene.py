"""What a scene is: solids for physics, a mesh for rays, a splat for cameras, a course to walk.

A scan may say from where it was photographed: near those cameras its splat shows it, far away fog.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import pi
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.memory import read_only
from nw_base.words import Task
from nw_scenes.digest import digest
from nw_scenes.mesh import FaceKind, TriangleMesh
from nw_scenes.prop import Prop

Array = NDArray[np.float64]

PER_RADIAN = 6.0 / pi
"""Metres that a turn of one radian counts as: 30 degrees are as far as one metre. A photograph
taken a step aside shows much of what one from here does, and one that looks elsewhere, little."""

Vector = tuple[float, float, float]
Friction = tuple[float, float, float]

DEFAULT_FRICTION: Friction = (1.25, 0.3, 0.3)
"""Sliding, torsional and rolling coefficients of the published scenes."""
Progress = Callable[[str, float], None]


class Nearness(NamedTuple):
    """How far a camera is from the nearest of those that a scene was photographed with."""

    distance: float  # m
    angle: float  # between the optical axes, rad, 0 to pi


@dataclass(frozen=True, kw_only=True, eq=False)
class CaptureCameras:
    """The cameras that a scene was photographed with.

    Attributes:
        positions: (N, 3) float64, metres, world; at least one.
        axes: (N, 3) float64, unit vectors along which they looked, world.
    """

    positions: Array
    axes: Array

    def __post_init__(self) -> None:
        """Check the arrays.

        Raises:
            ValueError: their shapes do not fit, or there is no camera.
        """
        shapes = self.positions.shape, self.axes.shape
        count = len(self.positions)
        if count == 0 or shapes != ((count, 3), (count, 3)):
            raise ValueError(f"positions and axes of capture cameras have the shapes {shapes}")

    @cached_property
    def _columns(self) -> tuple[Array, Array]:
        """Positions and axes as (3, N), each component in one piece."""
        return np.ascontiguousarray(self.positions.T), np.ascontiguousarray(self.axes.T)

    def nearest(self, T_world_camera: Array) -> Nearness:
        """Return how far the nearest camera is: the one with the least of metres and turn together.

        That is distance + `PER_RADIAN` * angle; distance and angle are both of that one.

        Args:
            T_world_camera: (4, 4) pose of a camera that looks along its own z.
        """
        # Component by component: it is asked for each image, and a BLAS call may round otherwise on
        # another CPU.
        (x, y, z), (a, b, c) = self._columns
        (u, v, w), (px, py, pz) = T_world_camera[:3, 2].tolist(), T_world_camera[:3, 3].tolist()
        distances = np.sqrt((x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2)
        angles = np.arccos(np.minimum(np.maximum(a * u + b * v + c * w, -1.0), 1.0))
        place = int(np.argmin(distances + PER_RADIAN * angles))
        return Nearness(float(distances[place]), float(angles[place]))


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightField:
    """Ground given by its height on a regular grid, solid down to `floor`.

    Between samples it is what MuJoCo makes of it: two triangles a cell, divided along the diagonal
    from the lower left to the upper right sample.

    Attributes:
        center: x, y of the middle of the grid, metres.
        half_size: half extents along x and y, metres; samples lie on the border.
        heights: (R, C) float32, metres, world z. Row r is at y = center - half_size + r * step,
            column c the same along x.
        floor: world z that the solid reaches down to, metres; below every height.
        friction: MuJoCo's sliding, torsional and rolling coefficients.
    """

    center: tuple[float, float]
    half_size: tuple[float, float]
    heights: NDArray[np.float32]
    floor: float
    friction: Friction = DEFAULT_FRICTION

    @property
    def spacing(self) -> tuple[float, float]:
        """Distance between samples along x and y, metres."""
        rows, columns = self.heights.shape
        return 2 * self.half_size[0] / (columns - 1), 2 * self.half_size[1] / (rows - 1)

    def height(self, xy: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the height at points (N, 2), (N,) metres; -inf outside the grid."""
        rows, columns = self.heights.shape
        low = np.subtract(self.center, self.half_size)
        u, v = ((np.asarray(xy, dtype=np.float64) - low) / self.spacing).T
        inside = (u >= 0) & (u <= columns - 1) & (v >= 0) & (v <= rows - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
        c = np.minimum(u.astype(np.int64), columns - 2)
        r = np.minimum(v.astype(np.int64), rows - 2)
        a, b = u - c, v - r
        z = self.heights.astype(np.float64)
        near, far = z[r, c], z[r + 1, c + 1]
        right, up = z[r, c + 1], z[r + 1, c]
        below = near + a * (right - near) + b * (far - right)
        above = near + b * (up - near) + a * (far - up)
        return np.where(inside, np.where(a >= b, below, above), -np.inf)


@dataclass(frozen=True, kw_only=True, eq=False)
class Triangles:
    """The triangles themselves: exact where a height field is not, and slow.

    Attributes:
        vertices: (V, 3) float64, metres, world.
        faces: (F, 3) int32.
        friction: MuJoCo's sliding, torsional and rolling coefficients.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    friction: Friction = DEFAULT_FRICTION


@dataclass(frozen=True, kw_only=True)
class Primitive:
    """A round solid of a parametric scene.

    Attributes:
        kind: which of MuJoCo's geoms.
        center: metres, world.
        size: as in MJCF, metres: sphere radius; capsule and cylinder radius and half length along
            z; ellipsoid radii.
        quat: orientation, w x y z.
        friction: MuJoCo's sliding, torsional and rolling coefficients.
    """

    kind: Literal["sphere", "capsule", "cylinder", "ellipsoid"]
    center: Vector
    size: tuple[float, ...]
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    friction: Friction = DEFAULT_FRICTION


@dataclass(frozen=True, kw_only=True)
class Box:
    """A solid box that the robot can touch.

    Attributes:
        center: metres, world.
        half_size: metres, along the box's own axes.
        quat: orientation, w x y z.
        friction: MuJoCo's sliding, torsional and rolling coefficients.
        material: what it is made of, for people and for cameras.
        kind: what it is: an `obstacle` of the course, the scene's `structure`, or `clutter`.
    """

    center: Vector
    half_size: Vector
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    friction: Vector = (1.25, 0.3, 0.3)
    material: str = ""
    kind: FaceKind = "obstacle"


Solid = Box | HeightField | Triangles | Primitive
"""What physics can touch, beside the ground plane."""


@dataclass(frozen=True, kw_only=True)
class Plane:
    """The infinite horizontal ground: its height in metres, and MuJoCo's friction coefficients."""

    z: float = 0.0
    friction: Vector = (1.25, 0.3, 0.3)


@dataclass(frozen=True, kw_only=True)
class Spawn:
    """Where the robot starts: metres and radians, world; z is the height of the ground there.

    The jitters are half widths of uniform distributions.
    """

    position: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    x_jitter: float = 0.1
    y_jitter: float = 0.1
    yaw_jitter: float = 0.1


class SplatSource(Protocol):
    """Where a scene's Gaussians come from."""

    @property
    def key(self) -> str:
        """Hex digest of everything that can change the Gaussians."""
        ...

    def store(self, progress: Progress | None = None) -> Path:
        """Return the compiled store in the cache; make it on first use."""
        ...


def _identity() -> NDArray[np.float64]:
    return np.eye(4)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """One scene. Cheap to construct: the splat is made when first asked for.

    Attributes:
        name: such as `hurdles/one_low_carpet`.
        task: what it asks for.
        title: one line for people.
        solids: what physics touches, beside the ground.
        ground: the plane that everything stands on.
        trail: (K, 3) float64 waypoints in metres, on top of obstacles, in order.
        spawn: the start.
        waypoint_noise: half widths in metres by which a trial may move waypoints along x and y.
        static_mesh: what `mesh()` returns.
        splat: the source of the Gaussians; None where a scene has no camera images.
        T_world_splat: (4, 4) similarity that maps splat points to world metres.
        licence: SPDX identifier of the scene's data.
        captures: the cameras that the scene was photographed with; None if unknown, and for
            a built-in scene, which is painted and looks the same from everywhere.
        props: what moves beside the robot. They are in neither `mesh()` nor the splat.
    """

    name: str
    task: Task
    title: str
    solids: tuple[Solid, ...]
    trail: NDArray[np.float64]
    static_mesh: TriangleMesh
    splat: SplatSource | None
    ground: Plane = Plane()
    spawn: Spawn = Spawn()
    waypoint_noise: tuple[float, float] = (0.0, 0.1)
    T_world_splat: NDArray[np.float64] = field(default_factory=_identity)
    licence: str = "MIT"
    captures: CaptureCameras | None = None
    props: tuple[Prop, ...] = ()

    def __post_init__(self) -> None:
        # All trials of a process share it, and so do the sensors of others.
        object.__setattr__(self, "trail", read_only(self.trail))

    def mesh(self) -> TriangleMesh:
        """Return what every ray against static geometry meets: ground, obstacles, walls, clutter.

        The boxes of `solids` appear in it with exactly their faces.
        """
        return self.static_mesh

    def splat_store(self, progress: Progress | None = None) -> Path:
        """Return the path of the compiled Gaussians, made in the user's cache on first use.

        Args:
            progress: called with a stage's name and the share done, 0 to 1.

        Raises:
            SceneError: the scene has no splat, or its file cannot be read.
        """
        if self.splat is None:
            raise SceneError(
                f"scene {self.name!r} has no splat",
                fix="use a policy without camera sensors, or add a splat file to the scene folder",
            )
        return self.splat.store(progress)

    def splat_stores(self, progress: Progress | None = None) -> tuple[Path, ...]:
        """Return `splat_store`, and the compiled Gaussians of props; none without a splat.

        Raises:
            SceneError: a file of a splat cannot be read.
        """
        own = () if self.splat is None else (self.splat_store(progress),)
        return (*own, *(prop.splat.store() for prop in self.props if prop.splat is not None))

    def without_collisions(self) -> Scene:
        """Return the same scene, seen and ray cast as before, with nothing but ground to touch."""
        return replace(self, solids=())

    @property
    def digest(self) -> str:
        """Hex SHA-256 of everything that can change a result; names and titles are left out."""
        return self._digest

    @cached_property
    def _digest(self) -> str:
        mesh = self.static_mesh
        return digest(
            self.task,
            self.solids,
            self.ground,
            self.trail,
            self.spawn,
            self.waypoint_noise,
            mesh.vertices,
            mesh.faces,
            mesh.kinds,
            self.T_world_splat,
            None if self.splat is None else self.splat.key,
            # A scene without them keeps the digest that it had before there were any.
            *(() if self.captures is None else (self.captures,)),
            *(("props", *(prop.facts for prop in self.props)) if self.props else ()),
        )
