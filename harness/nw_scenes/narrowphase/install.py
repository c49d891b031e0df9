"""Puts our collision functions into MuJoCo's table, for height fields only.

MuJoCo takes a height field apart into prisms and pushes a shape out of each by itself. A foot that
is under the surface is nearest to the walls between two prisms, so that it is pushed sideways from
both sides and stays (google-deepmind/mujoco issue 2883, seen with 4.0.0); and a trunk that lies on
small cells has used up the fifty contacts of a pair before its far end is looked at. Its
documentation offers the table `mjCOLLISIONFUNC` for such cases ("for example to implement
non-convex mesh collisions", Programming, Simulation); here its row of height fields is replaced.

A height field of two by two samples stands for the mesh that is the next geom: its triangles are
met as they are. `nw_scenes.attach` makes both.

What is no sphere, capsule, cylinder or box collides as MuJoCo sees fit.

This file is the only one that knows how MuJoCo is laid out in memory. `use_own_collisions` looks at
the installed version before it changes anything, and refuses one that differs:

* its library exports `mjCOLLISIONFUNC`;
* the numbers of `mjtGeom` and `mjMAXCONPAIR` are those that the kernels were written for;
* the pointers of mjModel and mjData to their arrays are found, by their values, which Python tells;
  their places are not written down from the headers of one version;
* a function of the table, called as `mjfCollision`, writes records (`mjPreContact`) of the size and
  the order that the kernels write: those of a box on a plane are compared with `mjData.contact`.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import mujoco as _mujoco
import numpy as np

from nw_base.errors import PrerequisiteError

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


TESTED = "4.0.0"
"""The version of MuJoCo that the kernels are tested with, as constraints.txt has it."""


@cache
def use_own_collisions() -> Any:
    """Let height fields of this process collide by this package, in every model.

    Returns:
        What must stay as long as MuJoCo points at it, which is always: the result is remembered.

    Raises:
        PrerequisiteError: this build of MuJoCo is laid out otherwise; nothing was changed.
    """
    # Numba loads with it; looking at scenes needs neither.
    from nw_scenes.narrowphase.collide import collision_function

    pointers, table = check_layout()
    function = collision_function(*pointers)
    for shape in _SHAPES:
        table[_HFIELD * _TYPES + int(shape)] = function.address
    return function


def check_layout() -> tuple[tuple[dict[str, int], dict[str, int]], Any]:
    """Look at the installed MuJoCo, and change nothing.

    Returns:
        What `_pointers` does, and the table of collision functions, as words.

    Raises:
        PrerequisiteError: it is laid out otherwise than the kernels know.
    """
    _check_numbers()
    table = _table()
    pointers = _pointers()
    _check_records(table)
    return pointers, table


def _refused(what: str) -> PrerequisiteError:
    return PrerequisiteError(
        f"MuJoCo {mujoco.__version__} {what}, so that its robots cannot walk on scans",
        fix=f"pip install 'mujoco=={TESTED}'",
    )


def _table() -> Any:
    """Return MuJoCo's table of collision functions, as words."""
    folder = Path(mujoco.__file__).parent
    library = next(iter(sorted(folder.glob("libmujoco*"))), None)
    if library is None:
        raise _refused("has no library beside it")
    words = ctypes.c_size_t * (_TYPES * _TYPES)
    try:
        return words.in_dll(ctypes.CDLL(str(library)), "mjCOLLISIONFUNC")
    except (OSError, ValueError) as error:
        raise _refused(f"exports no table of collision functions ({error})") from None


def _check_numbers() -> None:
    """Check the constants that are compiled into the kernels.

    Raises:
        PrerequisiteError: one is another.
    """
    from nw_scenes.narrowphase import collide, triangles

    known = {
        "mjtGeom.mjGEOM_SPHERE": (mujoco.mjtGeom.mjGEOM_SPHERE, triangles.SPHERE),
        "mjtGeom.mjGEOM_CAPSULE": (mujoco.mjtGeom.mjGEOM_CAPSULE, triangles.CAPSULE),
        "mjtGeom.mjGEOM_CYLINDER": (mujoco.mjtGeom.mjGEOM_CYLINDER, triangles.CYLINDER),
        "mjtGeom.mjGEOM_BOX": (mujoco.mjtGeom.mjGEOM_BOX, triangles.BOX),
        "mjtGeom.mjGEOM_MESH": (mujoco.mjtGeom.mjGEOM_MESH, collide.MESH),
        "mjMAXCONPAIR": (mujoco.mjMAXCONPAIR, collide.MOST_RECORDS),
    }
    for name, (actual, wanted) in known.items():
        if int(actual) != wanted:
            raise _refused(f"has {int(actual)} as {name} in place of {wanted}")


_ON_PLANE = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body pos="0 0 .09"><freejoint/><geom type="box" size=".3 .2 .1"/></body>
  </worldbody>
</mujoco>
"""
"""A box 1 cm deep in a plane, which it meets with its four lower corners."""


def _check_records(table: Any) -> None:
    """Check what a collision function of MuJoCo's writes against the contacts that MuJoCo reports.

    Raises:
        PrerequisiteError: it writes them otherwise than the kernels do.
    """
    from nw_scenes.narrowphase.collide import MOST_RECORDS, RECORD

    model = mujoco.MjModel.from_xml_string(_ON_PLANE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    plane, box = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_BOX)
    address = table[plane * _TYPES + box]
    if not address:
        raise _refused("has no collision function of a box on a plane")
    # Room for records that are longer than known: those of MuJoCo 3 have 68 numbers.
    written = np.full((MOST_RECORDS, 128), np.nan)
    collide = ctypes.CFUNCTYPE(
        ctypes.c_int,
        *(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p),
        *(ctypes.c_int, ctypes.c_int, ctypes.c_double),
    )(address)
    # The addresses of the structures are told by nothing else.
    count = collide(model._address, data._address, written.ctypes.data, 0, 1, 0.0)  # noqa: SLF001
    contacts = data.contact
    records = written.ravel()[: 4 * RECORD].reshape(4, RECORD)[:, :7]
    reported = np.column_stack([contacts.dist, contacts.pos, contacts.frame[:, :3]])
    if count != 4 or reported.shape != records.shape or not np.allclose(records, reported):
        raise _refused("writes contacts in another form")
    if not np.isnan(written.ravel()[4 * RECORD :]).all():
        raise _refused(f"writes records of more than {RECORD} numbers")


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
    words: dict[str, int] = {}
    for word in range(_WORDS):
        values = tuple(ctypes.c_size_t.from_address(start + 8 * word).value for start in starts)
        if values in wanted:
            words.setdefault(wanted[values], word)
        if len(words) == len(names):
            return words
    missing = ", ".join(sorted(set(names) - set(words)))
    raise _refused(f"keeps {missing} where it cannot be found")
