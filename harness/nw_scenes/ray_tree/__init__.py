"""Rays against triangles, with the same bits on every processor.

tree.py       a mesh that rays can be cast against
kernels.py    the compiled half: the tree of boxes, and what a ray meets first

`tree` imports Numba; what is named here does not.
"""

IDENTITY = "nw-eval rays 1"
"""What a distance depends on: another version may find others in their last bits."""
