"""Contacts of a robot's shapes with scanned ground, in place of MuJoCo's own."""

CARRIER_BASE = 0.5 + 2.0**-20
"""Depth of the mesh's height field below the mesh, metres: half a metre, by a hair that no other
field's depth has. What has sunk deeper is no longer looked at.
"""
