"""Scanned scenes: two meshes and a splat, tied together by the poses in the XML."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nw_eval.errors import SceneError
from nw_eval.files.inside import OutsideError, inside, what_is
from nw_eval.scenes.limits import MESH_REACH, SCALES
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.neverwhere.places import Places
from nw_eval.scenes.neverwhere.pose import Matrix, inverse, moved, numbers, product
from nw_eval.scenes.neverwhere.primitives import checked_friction
from nw_eval.scenes.neverwhere.similarity import read_normalisation
from nw_eval.scenes.neverwhere.tree import PlacedGeom, Tree
from nw_eval.scenes.terrain.mesh_file import read_mesh
from nw_eval.scenes.terrain.solids import DEFAULT_FRICTION, Friction

VISUAL = "visual_mesh"
COLLISION = "collision_mesh"

SPLATS = ("3dgs/model.pt", "3dgs/model.ply")
"""The trainer's checkpoint, which the published evaluation reads, and its export."""

# Relative difference of the three scales of a mesh that rounding may make.
_UNEVEN = 1e-6


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
    found = [geom for geom in tree.geoms if geom.element.get("mesh") == asset]
    if asset not in tree.meshes or not found:
        raise SceneError(
            f"{places.xml}: no {'asset' if asset not in tree.meshes else 'geom'} of mesh {asset!r}",
            fix="a scanned scene needs visual_mesh and collision_mesh, each with a geom",
        )
    geom = found[0]
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
