"""Puts terrain into a MuJoCo specification.

Beside `narrowphase`, the only module of this package that knows MuJoCo. `nw_sim.physics.model`
calls it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco as _mujoco
import numpy as np

from nw_scenes.narrowphase import CARRIER_BASE
from nw_scenes.narrowphase.install import use_own_collisions
from nw_scenes.scene import HeightField, Primitive, Triangles

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

# MuJoCo wants a positive elevation range, also of flat ground.
_LEAST_RANGE = 1e-3


def add_height_field(
    spec: Any, name: str, field: HeightField, *, friction: Sequence[float], priority: int
) -> None:
    """Add a height field to the world body of `spec` (an MjSpec).

    Args:
        spec: specification that is not compiled yet.
        name: of the asset and of its geom; must be new.
        field: the ground.
        friction: three coefficients, in place of the field's own.
        priority: of the geom's contacts.
    """
    use_own_collisions()
    rows, columns = field.heights.shape
    low = float(field.heights.min())
    span = max(float(field.heights.max()) - low, _LEAST_RANGE)
    spec.add_hfield(
        name=name,
        nrow=rows,
        ncol=columns,
        size=[*field.half_size, span, max(low - field.floor, _LEAST_RANGE)],
        userdata=((field.heights.astype(np.float64) - low) / span).ravel().tolist(),
    )
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=name,
        pos=[*field.center, low],
        friction=list(friction),
        priority=priority,
    )


def add_triangles(
    spec: Any, name: str, mesh: Triangles, *, friction: Sequence[float], priority: int
) -> None:
    """Add true triangles, fixed to the world. Arguments as `add_height_field`.

    A height field of two by two samples collides in their place, for the mesh that follows it.
    """
    use_own_collisions()
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    half = np.maximum((high - low) / 2, _LEAST_RANGE)
    spec.add_hfield(
        name=name,
        nrow=2,
        ncol=2,
        size=[half[0], half[1], 2 * half[2], CARRIER_BASE],
        userdata=[1.0, 0.0, 0.0, 0.0],
    )
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=name,
        pos=[*((low + high) / 2)[:2], low[2]],
        friction=list(friction),
        priority=priority,
    )
    spec.add_mesh(
        name=name,
        uservert=mesh.vertices.astype(np.float64).ravel().tolist(),
        userface=mesh.faces.ravel().tolist(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(
        name=f"{name}_triangles",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        contype=0,
        conaffinity=0,
    )


def add_primitive(
    spec: Any, name: str, solid: Primitive, *, friction: Sequence[float], priority: int
) -> None:
    """Add a round primitive to the world body. Arguments as `add_height_field`."""
    spec.worldbody.add_geom(
        name=name,
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{solid.kind.upper()}"),
        size=[*solid.size, 0.0, 0.0][:3],
        pos=list(solid.center),
        quat=list(solid.quat),
        friction=list(friction),
        priority=priority,
    )
