"""What rays meet of a robot whose looks physics knows not of: triangles that its bodies move."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from nw_base import same_bits
from nw_scenes.mesh import TriangleMesh, rotation_matrix
from nw_scenes.rays import RayScene

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_scenes.robots import RobotSpec, Shape
    from nw_sim.physics.binding import MjData, MjModel

Array = npt.NDArray[np.float64]


class RobotRays(NamedTuple):
    """What N rays met. A miss has distance inf, geom -1 and normal 0."""

    distance: Array  # (N,) m along the ray
    geom: npt.NDArray[np.int32]  # (N,) index into `World.geom_rgba`
    normal: Array  # (N, 3) unit, world frame, out of the surface


class _Part(NamedTuple):
    """What a body looks like, in its own frame."""

    body: int
    rays: RayScene
    normals: Array  # (F, 3), or 0 of a face without an area
    shapes: npt.NDArray[np.intp]  # (F,) which shape a face is of
    middle: Array  # (3,) m
    reach: float  # m from there to the farthest point


class Looks:
    """Casts rays at a robot's `visuals`, where its bodies are now.

    Args:
        robot: pictured by its `visuals`.
        model: compiled model.

    Attributes:
        rgba: colours of the shapes, (S, 4); `RobotRays.geom` is an index into them.
    """

    def __init__(self, robot: RobotSpec, model: MjModel) -> None:
        self._weld = model.body_weldid
        own: dict[str, list[int]] = {}
        for number, shape in enumerate(robot.visuals):
            own.setdefault(shape.body, []).append(number)
        self._parts = [
            _part(int(model.body(body).id), robot.visuals, numbers) for body, numbers in own.items()
        ]
        colours = [shape.rgba or (0.5, 0.5, 0.5, 1.0) for shape in robot.visuals]
        self.rgba = np.array(colours, dtype=np.float32).reshape(-1, 4)

    def cast(
        self, data: MjData, origins: Array, directions: Array, *, exclude_body: int
    ) -> RobotRays:
        """Cast rays.

        Args:
            data: the state, with current poses of bodies.
            origins: (3,) for a common origin, or (N, 3); world frame.
            directions: (N, 3) unit vectors, world frame.
            exclude_body: this body and what is fixed to it are transparent; -1 = none.
        """
        count = len(directions)
        distance = np.full(count, np.inf)
        geom, normal = np.full(count, -1, dtype=np.int32), np.zeros((count, 3))
        starts = np.asarray(origins, dtype=np.float64)
        for part in self._parts:
            if exclude_body >= 0 and self._weld[part.body] == self._weld[exclude_body]:
                continue
            R, at = data.xmat[part.body].reshape(3, 3), data.xpos[part.body]
            ahead = R @ part.middle + at - starts
            is_fan = starts.ndim == 1
            along = directions @ ahead if is_fan else (directions * ahead).sum(axis=1)
            beside = (ahead**2).sum(axis=-1) - along**2
            near = np.flatnonzero((beside < part.reach**2) & (along > -part.reach))
            begin = np.broadcast_to(_turned(starts - at, R), (count, 3))[near]
            far, face = part.rays.cast(begin, directions[near] @ R)
            first = np.flatnonzero(far < distance[near])
            met = near[first]
            distance[met], geom[met] = far[first], part.shapes[face[first]]
            normal[met] = part.normals[face[first]] @ R.T
        # Towards the eye: not every mesh's faces turn one way.
        met = np.flatnonzero(geom >= 0)
        away = (normal[met] * directions[met]).sum(axis=1) > 0.0
        normal[met[away]] *= -1.0
        return RobotRays(distance, geom, normal)


def _part(body: int, shapes: Sequence[Shape], numbers: Sequence[int]) -> _Part:
    meshes = [mesh_of(shapes[number]) for number in numbers]
    firsts = np.cumsum([0, *(len(points) for points, _ in meshes)])
    points = np.concatenate([points for points, _ in meshes])
    faces = [faces + first for (_, faces), first in zip(meshes, firsts[:-1], strict=True)]
    counts = [len(each) for each in faces]
    joined = np.concatenate(faces).astype(np.int32)
    mesh = TriangleMesh(vertices=points, faces=joined, kinds=np.zeros(len(joined), np.uint8))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return _Part(
        body=body,
        rays=RayScene(mesh),
        normals=unit_normals(mesh.triangles),
        shapes=np.repeat(np.array(numbers, np.intp), counts),
        middle=middle,
        # And a little: rays are cast in single precision.
        reach=float(np.linalg.norm(points - middle, axis=1).max()) * 1.001 + 1e-6,
    )


def _turned(places: Array, R: Array) -> Array:
    return same_bits.product(places, R) if places.ndim == 1 else places @ R


def unit_normals(corners: Array) -> Array:
    """Return unit normals (N, 3) of triangles (N, 3, 3); of flat ones, zeros."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)


def mesh_of(shape: Shape) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return a shape as triangles in the frame of its body: vertices (V, 3) m, and faces (F, 3)."""
    if shape.triangles is not None:
        return shape.triangles.vertices.astype(np.float64), shape.triangles.faces.astype(np.int64)
    size = shape.size
    full = {
        "cylinder": (2 * size[0], 2 * size[0], 2 * size[-1]),
        "sphere": (2 * size[0],) * 3,
    }.get(shape.kind, tuple(2 * value for value in size))
    points, faces = _solid(shape.kind)
    turned = (points * np.array(full)) @ rotation_matrix(shape.quat).T
    return turned + np.array(shape.position), faces


@cache
def _solid(kind: str) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return a shape of 1 m in each direction."""
    import trimesh

    make: Any = trimesh.creation
    if kind == "box":
        solid = make.box(extents=(1.0, 1.0, 1.0))
    elif kind == "cylinder":
        solid = make.cylinder(radius=0.5, height=1.0, sections=32)
    else:
        solid = make.icosphere(subdivisions=2, radius=0.5)
    return np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64)
