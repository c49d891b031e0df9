"""Rays against triangles, with the same bits on every processor.

tree.py       a mesh that rays can be cast against
kernels.py    the compiled half: the tree of boxes, and what a ray meets first

`tree` imports Numba; what is named here does not.
"""

_IN_USE = False  # From the change of bits on; until then Embree answers.


def in_use() -> bool:
    """Return whether `scenes.rays` casts rays with this package, and not with Embree."""
    return _IN_USE
