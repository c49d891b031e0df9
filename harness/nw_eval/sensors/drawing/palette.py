"""Classes of things, and a colour for each."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from nw_eval.scenes.mesh import FACE_KINDS, FaceKind

ClassName = Literal[
    "nothing", "ground", "obstacle", "structure", "clutter", "overhead", "cone", "robot"
]
CLASSES: tuple[ClassName, ...] = get_args(ClassName)

NOTHING, CONE, ROBOT = (CLASSES.index(name) for name in ("nothing", "cone", "robot"))

_OF_KIND: dict[FaceKind, ClassName] = {
    "ground": "ground",
    "obstacle": "obstacle",
    "structure": "structure",
    "clutter": "clutter",
    "overhead": "overhead",
    "beside": "structure",
}
FACE_CLASSES = np.array([CLASSES.index(_OF_KIND[kind]) for kind in FACE_KINDS], dtype=np.uint8)
"""For each kind of a mesh's faces, its class."""

PALETTE = np.array(
    [
        (178, 205, 228),  # nothing: the sky
        (128, 116, 104),  # ground
        (214, 120, 44),  # obstacle
        (92, 112, 140),  # structure
        (146, 120, 168),  # clutter
        (88, 148, 84),  # overhead
        (230, 62, 40),  # cone
        (40, 44, 52),  # robot
    ],
    dtype=np.uint8,
)
"""(classes, 3), sRGB."""
