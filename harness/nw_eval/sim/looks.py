"""What rays meet of a robot whose looks physics knows not of: triangles that its bodies move."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nw_eval.scenes.mesh import TriangleMesh, rotation_matrix
from nw_eval.scenes.rays import RayScene
from nw_eval.sim.body import RobotRays

if TYPE_CHECKING:
    from nw_eval.robots import RobotSpec, Shape
    from nw_eval.sim.binding import MjData, MjModel

Array = npt.NDArray[np.float64]


class Looks:
    """Casts rays at a robot's `visuals`, where its bodies are now.

    A ray caster is built for each pose that is asked about, some milliseconds for a mesh of 20,000
    faces, and serves until the robot moves.

    Args:
        robot: pictured by its `visuals`.
        model: compiled model.

    Attributes:
        rgba: colours of the shapes, (S, 4); `RobotRays.geom` is an index into them.
    """

    def __init__(self, robot: RobotSpec, model: MjModel) -> None:
        self._root = int(model.body(robot.root).id)
        meshes = [mesh_of(shape) for shape in robot.visuals]
        bodies = [int(model.body(shape.body).id) for shape in robot.visuals]
        counts = [len(points) for points, _ in meshes]
        firsts = np.cumsum([0, *counts])
        self._points = np.concatenate([np.zeros((0, 3)), *(points for points, _ in meshes)])
        self._faces = np.concatenate(
            [
                np.zeros((0, 3), np.int32),
                *(faces + first for (_, faces), first in zip(meshes, firsts[:-1], strict=True)),
            ]
        ).astype(np.int32)
        self._owner = np.repeat(np.array(bodies, np.intp), counts)
        self._shape = np.repeat(np.arange(len(meshes)), [len(faces) for _, faces in meshes])
        colours = [shape.rgba or (0.5, 0.5, 0.5, 1.0) for shape in robot.visuals]
        self.rgba = np.array(colours, dtype=np.float32).reshape(-1, 4)
        # What is fixed to the trunk moves with a camera that is.
        rigid = model.body_weldid == model.body_weldid[self._root]
        self._apart = ~rigid[self._owner[self._faces[:, 0]]]
        self._pose: bytes = b""
        self._casters: dict[bool, tuple[RayScene, Array, npt.NDArray[np.intp]]] = {}

    def cast(
        self, data: MjData, origins: Array, directions: Array, *, without_trunk: bool
    ) -> RobotRays:
        """Cast rays.

        Args:
            data: the state, with current poses of bodies.
            origins: (3,) for a common origin, or (N, 3); world frame.
            directions: (N, 3) unit vectors, world frame.
            without_trunk: the trunk and what is fixed to it are transparent.
        """
        count = len(directions)
        # About the trunk: rays are cast in single precision.
        middle = data.xpos[self._root].copy()
        rays, normals, shapes = self._caster(data, middle, without_trunk=without_trunk)
        starts = np.broadcast_to(np.asarray(origins, np.float64) - middle, (count, 3))
        distance, face = rays.cast(starts, directions)
        met = np.flatnonzero(face >= 0)
        geom, normal = np.full(count, -1, dtype=np.int32), np.zeros((count, 3))
        geom[met] = shapes[face[met]]
        own = normals[face[met]]
        # Towards the eye: not every mesh's faces turn one way.
        facing = np.where((own * directions[met]).sum(axis=1, keepdims=True) > 0.0, -1.0, 1.0)
        normal[met] = own * facing
        return RobotRays(distance, geom, normal)

    def _caster(
        self, data: MjData, middle: Array, *, without_trunk: bool
    ) -> tuple[RayScene, Array, npt.NDArray[np.intp]]:
        """Return a caster round `middle`, and of each of its faces normal and shape."""
        pose = data.xpos.tobytes() + data.xmat.tobytes()
        if pose != self._pose:
            self._pose, self._casters = pose, {}
        if without_trunk not in self._casters:
            turns = data.xmat[self._owner].reshape(-1, 3, 3)
            moved = np.einsum("nij,nj->ni", turns, self._points)
            moved += data.xpos[self._owner] - middle
            chosen = self._apart if without_trunk else np.ones(len(self._faces), np.bool_)
            mesh = TriangleMesh(
                vertices=moved,
                faces=self._faces[chosen],
                kinds=np.zeros(int(chosen.sum()), np.uint8),
            )
            self._casters[without_trunk] = (
                RayScene(mesh),
                unit_normals(mesh.triangles),
                self._shape[chosen],
            )
        return self._casters[without_trunk]


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
