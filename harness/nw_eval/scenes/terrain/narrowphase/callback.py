"""The function of MuJoCo's type mjfCollision that a height field's pairs are given to."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import types

from nw_eval.machine_code.jit import c_function
from nw_eval.scenes.terrain.narrowphase.carrier import CARRIER_BASE
from nw_eval.scenes.terrain.narrowphase.collide import collide_with_field, collide_with_mesh

# Its declared types know no array whose length is read from another.
carray: Any = numba.carray  # pyright: ignore[reportPrivateImportUsage]

_MESH = 7  # mjGEOM_MESH
_MOST = 50  # mjMAXCONPAIR
_RECORD = 10  # numbers of an mjPreContact


def collision_function(model_at: dict[str, int], data_at: dict[str, int]) -> Any:
    """Compile the function; see `c_function`.

    Args:
        model_at: numbers of the words of mjModel that point at its arrays.
        data_at: likewise of mjData.
    """
    word = types.CPointer(types.voidptr)
    numbers = types.CPointer(types.float64)
    geom_type, geom_dataid, geom_size = (
        model_at["geom_type"],
        model_at["geom_dataid"],
        model_at["geom_size"],
    )
    hfield_size, hfield_nrow, hfield_ncol, hfield_adr, hfield_data = (
        model_at[f"hfield_{name}"] for name in ("size", "nrow", "ncol", "adr", "data")
    )
    mesh_vertadr, mesh_vert, mesh_faceadr, mesh_face, mesh_bvhadr = (
        model_at[f"mesh_{name}"] for name in ("vertadr", "vert", "faceadr", "face", "bvhadr")
    )
    bvh_aabb, bvh_child, bvh_nodeid = (
        model_at["bvh_aabb"],
        model_at["bvh_child"],
        model_at["bvh_nodeid"],
    )
    geom_xpos, geom_xmat = data_at["geom_xpos"], data_at["geom_xmat"]

    def collide(m: Any, d: Any, con: Any, g1: Any, g2: Any, margin: Any) -> Any:
        geoms = max(g1, g2) + 2
        types_of = carray(m[geom_type], (geoms,), np.int32)
        data_of = carray(m[geom_dataid], (geoms,), np.int32)
        sizes = carray(m[geom_size], (geoms, 3), np.float64)
        places = carray(d[geom_xpos], (geoms, 3), np.float64)
        turns = carray(d[geom_xmat], (geoms, 3, 3), np.float64)
        records = carray(con, (_MOST, _RECORD), np.float64)
        field = data_of[g1]
        rows = carray(m[hfield_nrow], (field + 1,), np.int32)[field]
        columns = carray(m[hfield_ncol], (field + 1,), np.int32)[field]
        half = carray(m[hfield_size], (field + 1, 4), np.float64)[field]
        # Every field of this process comes here: one of another model may be small, too.
        if half[3] != CARRIER_BASE or types_of[g1 + 1] != _MESH:
            start = carray(m[hfield_adr], (field + 1,), np.int32)[field]
            shares = carray(m[hfield_data], (start + rows * columns,), np.float32)[start:]
            return collide_with_field(
                shares.reshape((rows, columns)),
                half,
                places[g1],
                turns[g1],
                types_of[g2],
                sizes[g2],
                places[g2],
                turns[g2],
                margin,
                records,
            )
        mesh = data_of[g1 + 1]
        vertices = carray(m[mesh_vertadr], (mesh + 1,), np.int32)[mesh]
        faces = carray(m[mesh_faceadr], (mesh + 1,), np.int32)[mesh]
        tree = carray(m[mesh_bvhadr], (mesh + 1,), np.int32)[mesh]
        # Their lengths are not looked up: only what the tree names is read.
        far = 1 << 28
        return collide_with_mesh(
            carray(m[mesh_vert], (far, 3), np.float32)[vertices:],
            carray(m[mesh_face], (far, 3), np.int32)[faces:],
            carray(m[bvh_aabb], (far, 6), np.float64)[tree:],
            carray(m[bvh_child], (far, 2), np.int32)[tree:],
            carray(m[bvh_nodeid], (far,), np.int32)[tree:],
            places[g1 + 1],
            turns[g1 + 1],
            types_of[g2],
            sizes[g2],
            places[g2],
            turns[g2],
            margin,
            records,
        )

    arguments = (word, word, numbers, types.int32, types.int32, types.float64)
    return c_function(collide, arguments, types.int32)
