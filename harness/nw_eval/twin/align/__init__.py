"""From a capture's own frame to metres: z up, the floor at z = 0, and no person to say so.

gravity/       which way is up, and where the floor is
scale/         how long a unit is
placing.py     the metric frame's origin and heading
align.py       all of it
apply.py       points, meshes, cameras and Gaussians in metres
file.py        align.json
"""

from nw_eval.twin.align.align import align
from nw_eval.twin.align.alignment import Alignment, GravityCue, ScaleCue
from nw_eval.twin.align.file import ALIGN_FILE, read_alignment, write_alignment
from nw_eval.twin.align.options import AlignOptions, KnownLength

__all__ = [
    "ALIGN_FILE",
    "AlignOptions",
    "Alignment",
    "GravityCue",
    "KnownLength",
    "ScaleCue",
    "align",
    "read_alignment",
    "write_alignment",
]
