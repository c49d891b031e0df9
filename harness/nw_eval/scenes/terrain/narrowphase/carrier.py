"""How the height field that stands for a mesh is told from one that is ground."""

CARRIER_BASE = 0.5 + 2.0**-20
"""Its depth below the mesh, metres: half a metre, by a hair that no other field's depth has.

What has sunk deeper is no longer looked at.
"""
