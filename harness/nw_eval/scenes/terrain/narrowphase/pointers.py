"""Where MuJoCo's structures keep their arrays.

Found by looking for the pointers whose values Python tells, not written down from the headers of
one version.
"""

from __future__ import annotations

import ctypes
from typing import Any

import mujoco as _mujoco

from nw_eval.errors import PrerequisiteError

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

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


def pointers() -> tuple[dict[str, int], dict[str, int]]:
    """Return the numbers of the 8-byte words of mjModel and of mjData that point at arrays.

    Raises:
        PrerequisiteError: this build of MuJoCo is laid out in another way.
    """
    models = [mujoco.MjModel.from_xml_string(example) for example in _EXAMPLES]
    return _places(models, _OF_MODEL), _places(list(map(mujoco.MjData, models)), _OF_DATA)


def _places(owners: list[Any], names: tuple[str, ...]) -> dict[str, int]:
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
