"""Scanned scenes: two meshes and a splat, tied together by the poses in the XML.

The collision mesh was cut out of the placed visual mesh, so the two must coincide. Files of
different ages do not: some scenes were labelled anew, with another scale.

Also here: parametric scenes, of boxes, planes and round primitives instead of meshes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.files.inside import OutsideError, inside, regular, what_is
from nw_scenes.finding import SceneFinding
from nw_scenes.limits import FRICTION, LEAST_SIZE, MESH_REACH, REACH, SCALES, check_similarity
from nw_scenes.mesh import (
    FaceKind,
    TriangleMesh,
    box_mesh,
    merge,
    quad_mesh,
    rotation_matrix,
)
from nw_scenes.mesh_file import checked_mesh, read_mesh
from nw_scenes.neverwhere.files import Places
from nw_scenes.neverwhere.tree import (
    Matrix,
    PlacedGeom,
    Tree,
    inverse,
    moved,
    numbers,
    product,
)
from nw_scenes.plates import quaternion
from nw_scenes.scene import DEFAULT_FRICTION, Box, Friction, Plane, Primitive

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


VISUAL = "visual_mesh"
COLLISION = "collision_mesh"

SPLATS = ("3dgs/model.pt", "3dgs/model.ply")
"""The trainer's checkpoint, which the published evaluation reads, and its export."""

# Relative difference of the three scales of a mesh that rounding may make.
_UNEVEN = 1e-6


_BYTES = 1_000_000

Values = NDArray[np.float64]

# What the label tool cuts out, metres.
LABEL_LOW = np.array([-2.0, -3.0, -3.0])
LABEL_HIGH = np.array([7.0, 3.0, 3.0])

_PROBES = 4000
_OFF = 0.02
# Distances are looked for within this, along the surface's normal, metres.
_REACH = 1.0
_MEDIAN_LIMIT = 0.01
_SHARE_LIMIT = 0.05
# Seen from the visual mesh the box's rim is not compared: it may have been cut at another place.
_RIM = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """A scanned scene in world metres.

    Attributes:
        visual: what depth sensors and scandots meet.
        collision: what the robot touches.
        friction: of the collision geom.
        scale: metres in one unit of the visual mesh.
        T_world_splat: (4, 4) similarity.
        splats: those of `SPLATS` that there are, in that order; the first is read.
    """

    visual: TriangleMesh
    collision: TriangleMesh
    friction: Friction
    scale: float
    T_world_splat: Matrix
    splats: tuple[Path, ...]


def is_scan(tree: Tree) -> bool:
    """Return whether a tree is a scanned scene, not a parametric one."""
    return VISUAL in tree.meshes or COLLISION in tree.meshes


def read_scan(tree: Tree, places: Places) -> Scan:
    """Read the meshes of a scanned scene and place them.

    Raises:
        SceneError: a part is missing, or a scale stretches or mirrors.
    """
    visual_geom, T_mesh = _placed(tree, places, VISUAL, "mesh")
    collision_geom, _ = _placed(tree, places, COLLISION, "collision_mesh")
    scale = _scale(tree, VISUAL)
    # The splat hangs on the body, not on the geom, which MuJoCo moves to the mesh's centre.
    T_world_colmap = T_mesh.copy()
    T_world_colmap[:3, :3] *= scale
    paths = [_beside(places, name) for name in SPLATS]
    normalisation = read_normalisation(_beside(places, "3dgs/data_transforms.json"))
    return Scan(
        visual=_world(tree, places, VISUAL, visual_geom.T_world_geom, scale),
        collision=_world(
            tree, places, COLLISION, collision_geom.T_world_geom, _scale(tree, COLLISION)
        ),
        friction=checked_friction(collision_geom, DEFAULT_FRICTION),
        scale=scale,
        T_world_splat=product(T_world_colmap, inverse(normalisation)),
        splats=tuple(path for path in paths if what_is(path) == "file"),
    )


def _placed(tree: Tree, places: Places, asset: str, body: str) -> tuple[PlacedGeom, Matrix]:
    geoms = [geom for geom in tree.geoms if geom.element.get("mesh") == asset]
    if asset not in tree.meshes or not geoms:
        raise SceneError(
            f"{places.xml}: no {'asset' if asset not in tree.meshes else 'geom'} of mesh {asset!r}",
            fix="a scanned scene needs visual_mesh and collision_mesh, each with a geom",
        )
    geom = geoms[0]
    owner = geom.bodies[-1] if geom.bodies else ""
    return geom, tree.bodies.get(body, tree.bodies.get(owner, np.eye(4)))


def _scale(tree: Tree, asset: str) -> float:
    element = tree.meshes[asset]
    scale = numbers(element, "scale", (3,)) or [1.0, 1.0, 1.0]
    text = element.get("scale")
    if min(scale) < 0:
        raise element.error(
            f"scale={text!r} mirrors the mesh", fix="give three equal positive numbers"
        )
    if min(scale) == 0:
        raise element.error(f"scale={text!r} flattens the mesh", fix="give positive numbers")
    if not SCALES[0] <= min(scale) <= max(scale) <= SCALES[1]:
        raise element.error(f"scale={text!r}", fix=f"give one from {SCALES[0]:g} to {SCALES[1]:g}")
    if max(scale) - min(scale) > _UNEVEN * max(scale):
        raise element.error(
            f"scale={text!r} is not uniform", fix="the splat follows one scale only: give s s s"
        )
    return scale[0]


def _world(
    tree: Tree, places: Places, asset: str, T_world_geom: Matrix, scale: float
) -> TriangleMesh:
    path = places.resolve(tree.meshes[asset], "file", within=tree.mesh_folder)
    local = read_mesh(path)
    vertices = moved(local.vertices * scale, T_world_geom)
    if not np.abs(vertices).max() <= MESH_REACH:
        raise tree.meshes[asset].error(
            f"placed, it reaches {np.abs(vertices).max():g} m", fix="check its pose and its scale"
        )
    return TriangleMesh(vertices=vertices, faces=local.faces, kinds=local.kinds)


def _beside(places: Places, name: str) -> Path:
    """Return the path of a file that every scene folder may have; it need not exist."""
    try:
        return inside(places.folder, name)
    except OutsideError as error:
        raise SceneError(
            f"{places.folder / name}: {error}", fix="copy the file into the scene's folder"
        ) from None


def read_normalisation(path: Path) -> Matrix:
    """Return T_n (4, 4), which maps the COLMAP frame to the splat's: `3dgs/data_transforms.json`.

    Its key `transform` holds three rows of four; the key `scale` is informative and not used. The
    identity if there is no such file.

    Raises:
        SceneError: the file holds something else, or no similarity.
    """
    if what_is(path) == "nothing":
        return np.eye(4)
    try:
        if regular(path).stat().st_size > _BYTES:
            raise SceneError(f"{path}: too large", fix="it holds one 3 x 4 matrix")
        content: Any = json.loads(path.read_bytes())
        rows = np.array(content["transform"], dtype=np.float64)
    except (OSError, ArithmeticError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise SceneError(
            f"{path}: no key `transform` with a 3 x 4 matrix ({type(error).__name__})",
            fix="write the file again, or remove it if the splat is in the COLMAP frame",
        ) from None
    if rows.shape not in {(3, 4), (4, 4)} or not (np.abs(rows) <= MESH_REACH).all():
        raise SceneError(
            f"{path}: `transform` has shape {rows.shape}, or numbers out of bounds",
            fix=f"give 3 x 4 numbers, up to {MESH_REACH:g}",
        )
    transform = np.eye(4)
    transform[:3] = rows[:3]
    check_similarity(transform, str(path))
    return transform


@dataclass(frozen=True, kw_only=True)
class Consistency:
    """How far two surfaces are apart along their normals, metres, capped at 1.

    Attributes:
        median: of the distances of points on the collision mesh from the visual mesh.
        p95: 95th percentile of these distances.
        share_off: of the points of both, those further than 2 cm from the other mesh.
    """

    median: float
    p95: float
    share_off: float


def compare(visual: TriangleMesh, collision: TriangleMesh, shift: Values) -> Consistency:
    """Measure how well two meshes coincide.

    Args:
        visual: placed in the world.
        collision: placed in the world.
        shift: (3,) of the collision body: the label box moves with it.
    """
    random = np.random.default_rng(0)
    on_collision, normals = _samples(collision, random)
    there = _distance(visual, on_collision, normals)
    on_visual, visual_normals = _samples(visual, random, low=LABEL_LOW, high=LABEL_HIGH)
    # Of the visual mesh only what the collision mesh spans.
    low = np.maximum(collision.vertices.min(axis=0), LABEL_LOW + np.minimum(shift, 0.0)) + _RIM
    high = np.minimum(collision.vertices.max(axis=0), LABEL_HIGH + np.maximum(shift, 0.0)) - _RIM
    inside = ((on_visual > low) & (on_visual < high)).all(axis=1)
    back = _distance(collision, on_visual[inside], visual_normals[inside])
    both = np.concatenate([there, back])
    median, p95 = np.quantile(there, [0.5, 0.95]).tolist()
    return Consistency(median=median, p95=p95, share_off=float((both > _OFF).mean()))


def consistency_findings(
    visual: TriangleMesh, collision: TriangleMesh, shift: Values
) -> tuple[SceneFinding, ...]:
    """Return the finding that the meshes disagree, with numbers, or nothing."""
    difference = compare(visual, collision, shift)
    if difference.median <= _MEDIAN_LIMIT and difference.share_off <= _SHARE_LIMIT:
        return ()
    return (
        SceneFinding(
            code="inconsistent_meshes",
            severity="error",
            message="collision mesh and placed visual mesh do not coincide: median distance "
            f"{1000 * difference.median:.1f} mm, 95 % within {1000 * difference.p95:.0f} mm, "
            f"{100 * difference.share_off:.0f} % of the surface more than {1000 * _OFF:.0f} mm off",
            fix="XML and meshes are of different ages, or scale, pos or euler are wrong: "
            "take all from one download",
            value=difference.median,
        ),
    )


def _samples(
    mesh: TriangleMesh,
    random: np.random.Generator,
    low: Values | None = None,
    high: Values | None = None,
) -> tuple[Values, Values]:
    """Return points spread evenly over a mesh (N, 3) and unit normals there."""
    corners = mesh.triangles
    if low is not None and high is not None:
        near = (corners.max(axis=1) >= low).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1)
        corners = corners[near]
    if len(corners) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    total = np.cumsum(area)
    face = np.searchsorted(total, random.uniform(0.0, total[-1], _PROBES))
    face = np.minimum(face, len(corners) - 1)
    u, v = random.uniform(size=(2, _PROBES, 1))
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    a, b, c = (corners[face, i] for i in range(3))
    return a + u * (b - a) + v * (c - a), normal[face] / area[face, None]


def _distance(mesh: TriangleMesh, points: Values, normals: Values) -> Values:
    """Return how far a mesh is from points along their normals, (N,) m, at most the reach."""
    if len(points) == 0:
        return np.zeros(0)
    from nw_scenes.rays import RayScene  # Embree loads with it.

    rays = RayScene(mesh)
    # A little beyond the surface, so that one that coincides is met.
    step = 1e-3
    distances = [
        np.abs(rays.distance(points - sign * step * normals, sign * normals) - step)
        for sign in (1.0, -1.0)
    ]
    return np.minimum(np.minimum(*distances), _REACH)
