"""How large the numbers of an untrusted scene may be, and what it may be called.

Each bound leaves out what no place that a robot walks in has, and what would take the machine
instead of an error; it is checked before anything is allocated. Lengths in metres. A name is no
path, but logs lie in folders that are called by it.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError

REACH = 1000.0
"""Of course, spawn, ground and solids from the origin: the longest trial (600 s) ends before, and
rays in single precision are exact to 0.1 mm there."""

MESH_REACH = 1e6
"""Of a mesh's and a splat's coordinates, which may be in COLMAP's unit: scans have stray points far
behind the scene."""

WAYPOINTS = 200
"""Of one course. Published ones have up to a dozen; every sample of a terrain is compared with all
legs."""

SOLIDS = 2000
"""Boxes and round primitives. A flight of stairs has a dozen; MuJoCo and Embree hold each twice."""

PROPS, PROP_BOXES = 50, 20
"""Bodies that move beside the robot, and boxes of each: physics solves all of them in each step."""

LEAST_SIZE = 1e-5
"""Of half an edge, or of a radius: MuJoCo and rays take thinner solids for none."""

FRICTION = 5.0
"""Largest coefficient, as of a suite's axis: rubber on dry concrete has 1."""

NOISE = 10.0
"""Half width by which a start or a waypoint may be moved."""

SCALES = (1e-6, 1e6)
"""Metres in one unit of a mesh or a splat."""

_STRETCH = 1e-3
"""Of a similarity: how far its axes may differ in scale, as a share of it."""

QUAT = 1e3
"""Largest component of a quaternion; its length need not be 1, but must be more than 1 / this."""

MESH_BYTES = 400_000_000
MESH_FACES = 4_000_000
"""Of one file, vertices too. Simplified scans have 50,000, and a robot feels no more."""

TEXTURES = 256
TEXTURE_BYTES = 128_000_000
TEXTURE_PIXELS = 16_384 * 8_192
"""Pictures that colour one mesh, and bytes and pixels of each. Scans have one to a dozen of 8192
by 8192."""

CELLS = 2_000_000
"""Of an elevation map: two triangles each."""

CAPTURES = 20_000
"""Cameras that a scene was photographed with. Frames of a long video are some thousands."""

CAPTURE_BYTES = 16 * 2**20
"""Of their file: ten times what so many take."""

_SEGMENT = r"[A-Za-z0-9_][A-Za-z0-9_.-]*"
_DEPTH, _LENGTH = 4, 120
_NAME = re.compile(rf"{_SEGMENT}(/{_SEGMENT}){{0,{_DEPTH - 1}}}")


def checked_name(name: str) -> str:
    """Return a name, such as `hurdles/one_low_carpet`.

    Raises:
        ValueError: it is not made of one to four parts between slashes, each of letters, digits,
            `_`, `-` and `.`, beginning with none of the last two; or is longer than 120 characters.
    """
    if len(name) > _LENGTH or not _NAME.fullmatch(name):
        raise ValueError(
            f"{name[:60]!r} is not a valid scene name; give up to {_DEPTH} words of letters, "
            f"digits, '_', '-' and '.' with slashes between, {_LENGTH} characters at most"
        )
    return name


def name_of(file_name: str) -> str:
    """Return the name of a file or folder as part of a scene's name."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", file_name).lstrip("-.")[: _LENGTH - 20] or "unnamed"


def check_similarity(transform: NDArray[np.float64], origin: str) -> float:
    """Return the scale of a (4, 4) similarity.

    Raises:
        SceneError: it stretches, mirrors or flattens.
    """
    linear = transform[:3, :3]
    determinant = float(np.linalg.det(linear))
    if determinant <= 0:
        raise SceneError(
            f"{origin}: the transform {'mirrors' if determinant < 0 else 'flattens'}: "
            f"determinant {determinant:g}",
            fix="give a rotation times a positive scale",
        )
    scale = determinant ** (1 / 3)
    if not SCALES[0] <= scale <= SCALES[1]:
        raise SceneError(f"{origin}: its scale is {scale:g}", fix="check the unit")
    off = float(np.abs(linear.T @ linear / scale**2 - np.eye(3)).max())
    if off > _STRETCH:
        raise SceneError(
            f"{origin}: the transform stretches axes differently, by {off:.3g} of its scale "
            f"{scale:.4g}",
            fix="give a rotation times one scale",
        )
    return scale
