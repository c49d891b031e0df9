"""Puts our collision functions into MuJoCo's table, for height fields only.

MuJoCo takes a height field apart into prisms and pushes a shape out of each by itself. A foot that
is under the surface is nearest to the walls between two prisms, so that it is pushed sideways from
both sides and stays (google-deepmind/mujoco issue 2883, seen with 4.0.0); and a trunk that lies on
small cells has used up the fifty contacts of a pair before its far end is looked at. Its
documentation offers the table `mjCOLLISIONFUNC` for such cases ("for example to implement
non-convex mesh collisions", Programming, Simulation); here its row of height fields is replaced.

A height field of two by two samples stands for the mesh that is the next geom: its triangles are
met as they are. `nw_eval.scenes.terrain.attach` makes both.

What is no sphere, capsule, cylinder or box collides as MuJoCo sees fit.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import mujoco as _mujoco

from nw_eval.errors import PrerequisiteError

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

_HFIELD = int(mujoco.mjtGeom.mjGEOM_HFIELD)
_TYPES = int(mujoco.mjtGeom.mjNGEOMTYPES)
_SHAPES = (
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_BOX,
)


@cache
def use_own_collisions() -> Any:
    """Let height fields of this process collide by this package, in every model.

    Returns:
        What must stay as long as MuJoCo points at it, which is always: the result is remembered.

    Raises:
        PrerequisiteError: this build of MuJoCo is not laid out as any that is known.
    """
    # Numba loads with it; looking at scenes needs neither.
    from nw_eval.scenes.terrain.narrowphase.callback import collision_function
    from nw_eval.scenes.terrain.narrowphase.pointers import pointers

    function = collision_function(*pointers())
    table = _table()
    for shape in _SHAPES:
        table[_HFIELD * _TYPES + int(shape)] = function.address
    return function


def _table() -> Any:
    """Return MuJoCo's table of collision functions, as words."""
    folder = Path(mujoco.__file__).parent
    library = next(iter(sorted(folder.glob("libmujoco*"))), None)
    if library is None:
        raise PrerequisiteError(
            f"MuJoCo {mujoco.__version__} has no library beside it, so that scans cannot be walked",
            fix="install the version that constraints.txt names",
        )
    words = ctypes.c_size_t * (_TYPES * _TYPES)
    return words.in_dll(ctypes.CDLL(str(library)), "mjCOLLISIONFUNC")
