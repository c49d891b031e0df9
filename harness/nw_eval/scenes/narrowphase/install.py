"""Puts our collision functions into MuJoCo's table, for height fields only.

MuJoCo takes a height field apart into prisms and pushes a shape out of each by itself. A foot that
is under the surface is nearest to the walls between two prisms, so that it is pushed sideways from
both sides and stays (google-deepmind/mujoco issue 2883, seen with 4.0.0); and a trunk that lies on
small cells has used up the fifty contacts of a pair before its far end is looked at. Its
documentation offers the table `mjCOLLISIONFUNC` for such cases ("for example to implement
non-convex mesh collisions", Programming, Simulation); here its row of height fields is replaced.

A height field of two by two samples stands for the mesh that is the next geom: its triangles are
met as they are. `nw_eval.scenes.attach` makes both.

What is no sphere, capsule, cylinder or box collides as MuJoCo sees fit.

Where MuJoCo's structures keep their arrays is found by looking for the pointers whose values Python
tells, not written down from the headers of one version.
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

# More words than a structure of MuJoCo has: mjData holds 4,000 statistics of its solver.
_WORDS = 1 << 16

_OF_MODEL = (
    "geom_type",
    "geom_dataid",
    "geom_size",
    "hfield_size",
    "hfield_nrow",
    "hfield_ncol",
    "hfield_adr",
    "hfield_data",
    "mesh_vertadr",
    "mesh_vert",
    "mesh_faceadr",
    "mesh_face",
    "mesh_bvhadr",
    "bvh_aabb",
    "bvh_child",
    "bvh_nodeid",
)
_OF_DATA = ("geom_xpos", "geom_xmat")

# Two models of other sizes: an empty array begins where the next one does, but not in both.
_EXAMPLES = tuple(
    f"""
    <mujoco>
      <asset>
        <hfield name="h" nrow="3" ncol="3" size="1 1 1 1"/>
        <mesh name="m" vertex="0 0 0  1 0 0  0 1 0  0 0 1  1 1 1"/>
      </asset>
      <worldbody>
        <geom type="hfield" hfield="h"/>
        <geom type="mesh" mesh="m"/>
        <geom type="sphere" size="1"/>
        {moving}
      </worldbody>
    </mujoco>
    """
    for moving in (
        "",
        '<body><freejoint/><geom size="1"/><body><joint/><geom size="1"/></body></body>',
    )
)

CARRIER_BASE = 0.5 + 2.0**-20
"""Its depth below the mesh, metres: half a metre, by a hair that no other field's depth has.

What has sunk deeper is no longer looked at.
"""


@cache
def use_own_collisions() -> Any:
    """Let height fields of this process collide by this package, in every model.

    Returns:
        What must stay as long as MuJoCo points at it, which is always: the result is remembered.

    Raises:
        PrerequisiteError: this build of MuJoCo is not laid out as any that is known.
    """
    # Numba loads with it; looking at scenes needs neither.
    from nw_eval.scenes.narrowphase.collide import collision_function

    function = collision_function(*_pointers())
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


def _pointers() -> tuple[dict[str, int], dict[str, int]]:
    """Return the numbers of the 8-byte words of mjModel and of mjData that point at arrays.

    Raises:
        PrerequisiteError: this build of MuJoCo is laid out in another way.
    """
    models = [mujoco.MjModel.from_xml_string(example) for example in _EXAMPLES]
    return _words_of(models, _OF_MODEL), _words_of(list(map(mujoco.MjData, models)), _OF_DATA)


def _words_of(owners: list[Any], names: tuple[str, ...]) -> dict[str, int]:
    """Return the number of the word that points at each array, the same in every structure."""
    wanted = {tuple(getattr(o, name).ctypes.data for o in owners): name for name in names}
    # The address of the structure itself is told by nothing else.
    starts = [owner._address for owner in owners]  # noqa: SLF001
    found: dict[str, int] = {}
    for word in range(_WORDS):
        values = tuple(ctypes.c_size_t.from_address(start + 8 * word).value for start in starts)
        if values in wanted:
            found.setdefault(wanted[values], word)
        if len(found) == len(names):
            return found
    missing = ", ".join(sorted(set(names) - set(found)))
    raise PrerequisiteError(
        f"MuJoCo {mujoco.__version__} keeps {missing} where scans cannot find it",
        fix="install the version that constraints.txt names",
    )
