"""Parametric scenes: boxes, planes and round primitives instead of meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.limits import FRICTION, LEAST_SIZE, REACH
from nw_eval.scenes.mesh import (
    FaceKind,
    TriangleMesh,
    box_mesh,
    merge,
    quad_mesh,
    rotation_matrix,
)
from nw_eval.scenes.mesh_file import checked_mesh
from nw_eval.scenes.neverwhere.tree import PlacedGeom, moved, numbers
from nw_eval.scenes.plates import quaternion
from nw_eval.scenes.scene import Box, Friction, Plane, Primitive

_GROUND_REACH = 60.0
# MuJoCo's own, where nothing else is said.
_MUJOCO_FRICTION = (1.0, 0.005, 0.0001)
# Without a ground plane, what falls is caught this far below everything, metres.
_VOID = 1.0
# The published scandots leave out geoms whose names begin so: their camera would see the tops of
# balls, cones and walls. Everything else that can be touched is ground to them.
_LEFT_OUT = ("ball", "basketball", "cone", "soccer", "wall")
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}


@dataclass(frozen=True, kw_only=True, eq=False)
class Primitives:
    """What a parametric scene is made of."""

    solids: tuple[Box | Primitive, ...]
    ground: Plane
    mesh: TriangleMesh


def read_primitives(geoms: list[PlacedGeom]) -> Primitives:
    """Return solids, ground and the mesh that rays meet.

    Args:
        geoms: those that collide and mark no waypoint.

    Raises:
        SceneError: a geom of another kind, or with sizes that make none.
    """
    solids: list[Box | Primitive] = []
    planes: list[Plane] = []
    meshes: list[TriangleMesh] = []
    for geom in geoms:
        kind = geom.element.get("type", "sphere") or "sphere"
        if kind == "plane":
            planes.append(_plane(geom))
            continue
        if kind not in _SIZES:
            raise geom.element.error(
                f"a solid of type {kind!r} is not read here",
                fix="supported are plane, " + ", ".join(_SIZES) + ", and the published scan meshes",
            )
        solid = _solid(geom, kind)
        solids.append(solid)
        left_out = (geom.element.get("name") or "").startswith(_LEFT_OUT)
        meshes.append(_mesh(solid, "beside" if left_out else "obstacle"))
    if planes:
        ground = max(planes, key=lambda plane: plane.z)
        reach = _GROUND_REACH
        quad = quad_mesh((-reach, -reach, ground.z), (2 * reach, 0, 0), (0, 2 * reach, 0), "ground")
        meshes.insert(0, quad)
    else:
        lowest = min((float(mesh.vertices[:, 2].min()) for mesh in meshes), default=0.0)
        ground = Plane(z=lowest - _VOID)
    return Primitives(solids=tuple(solids), ground=ground, mesh=merge(meshes))


def _plane(geom: PlacedGeom) -> Plane:
    normal = geom.T_world_geom[:3, 2]
    if normal[2] < 1 - 1e-9:
        raise geom.element.error("the ground plane is tilted", fix="use a box for a slope")
    z = float(geom.T_world_geom[2, 3])
    if not abs(z) <= REACH:
        raise geom.element.error(f"the ground lies at z = {z:g}", fix=f"keep it within {REACH:g} m")
    return Plane(z=z, friction=checked_friction(geom, _MUJOCO_FRICTION))


def _solid(geom: PlacedGeom, kind: str) -> Box | Primitive:
    element = geom.element
    T = geom.T_world_geom
    count = _SIZES[kind]
    ends = numbers(element, "fromto", (6,))
    # MJCF allows more sizes than a kind needs, and one less with end points.
    size = numbers(element, "size", (1, 2, 3)) or []
    rotation, center = T[:3, :3], T[:3, 3]
    if ends is not None:
        start, end = moved(np.array(ends).reshape(2, 3), T)
        axis = end - start
        length = float(np.linalg.norm(axis))
        if length <= 0:
            raise element.error("`fromto` has no length")
        center = (start + end) / 2
        rotation = _frame(axis / length)
        size = [size[0], *([size[0]] if count == 3 else []), length / 2] if size else []
    if not (np.isfinite(center).all() and np.abs(center).max() <= REACH):
        raise element.error(f"it lies at {center.tolist()}", fix=f"keep it within {REACH:g} m")
    if len(size) < count or not LEAST_SIZE <= min(size[:count]) <= max(size[:count]) <= REACH:
        raise element.error(
            f"size={element.get('size')!r} makes no {kind}",
            fix=f"give {count} positive numbers, {LEAST_SIZE:g} to {REACH:g} m",
        )
    x, y, z = center.tolist()
    quat = quaternion(rotation)
    friction = checked_friction(geom, _MUJOCO_FRICTION)
    if kind == "box":
        half = (size[0], size[1], size[2])
        return Box(center=(x, y, z), half_size=half, quat=quat, friction=friction)
    known: Any = kind
    return Primitive(
        kind=known, center=(x, y, z), size=tuple(size[:count]), quat=quat, friction=friction
    )


def checked_friction(geom: PlacedGeom, default: Friction) -> Friction:
    """Return a geom's friction, what it does not say by default.

    Raises:
        SceneError: a coefficient is negative or too large, or the sliding one is 0.
    """
    stated = numbers(geom.element, "friction", (1, 2, 3)) or []
    sliding, torsional, rolling = [*stated, *default[len(stated) :]]
    if sliding <= 0 or min(torsional, rolling) < 0 or max(sliding, torsional, rolling) > FRICTION:
        raise geom.element.error(
            f"friction={geom.element.get('friction')!r}", fix=f"give numbers up to {FRICTION:g}"
        )
    return sliding, torsional, rolling


def _frame(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotation whose z axis is `axis`."""
    other = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = np.cross(other, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def _mesh(solid: Box | Primitive, kind: FaceKind) -> TriangleMesh:
    if isinstance(solid, Box):
        return box_mesh(solid.center, solid.half_size, solid.quat, kind)
    from trimesh import creation

    radius, *rest = solid.size
    shape: Any
    match solid.kind:
        case "sphere":
            shape = creation.icosphere(subdivisions=3, radius=radius)
        case "ellipsoid":
            shape = creation.icosphere(subdivisions=3, radius=1.0)
            shape.apply_scale(solid.size)
        case "cylinder":
            shape = creation.cylinder(radius=radius, height=2 * rest[0], sections=32)
        case "capsule":
            shape = creation.capsule(radius=radius, height=2 * rest[0], count=[32, 32])
            shape.apply_translation((0.0, 0.0, -float(shape.bounds.mean(axis=0)[2])))
        case _:
            assert_never(solid.kind)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_matrix(solid.quat), solid.center
    vertices = moved(np.asarray(shape.vertices, dtype=np.float64), T)
    return checked_mesh(vertices, np.asarray(shape.faces), kind, solid.kind)
