"""What a place is: solids for physics, a mesh for rays, a splat for cameras, a trail to walk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nw_eval.arrays import read_only
from nw_eval.errors import SceneError
from nw_eval.scenes.captures import CaptureCameras
from nw_eval.scenes.digest import digest
from nw_eval.scenes.mesh import FaceKind, TriangleMesh
from nw_eval.scenes.terrain.solids import HeightField, Primitive, Triangles
from nw_eval.words import Task

Vector = tuple[float, float, float]
Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Box:
    """A solid box that the robot can touch.

    Attributes:
        center: metres, world.
        half_size: metres, along the box's own axes.
        quat: orientation, w x y z.
        friction: MuJoCo's sliding, torsional and rolling coefficients.
        material: what it is made of, for people and for cameras.
        kind: what it is: an `obstacle` of the trail, the place's `structure`, or `clutter`.
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
    """One place. Cheap to construct: the splat is made when first asked for.

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
        captures: the cameras that the place was photographed with; None where nobody says, and for
            a built-in place, which is painted and looks the same from everywhere.
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

    def without_collisions(self) -> Scene:
        """Return the same place, seen and ray cast as before, with nothing but ground to touch."""
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
        )
