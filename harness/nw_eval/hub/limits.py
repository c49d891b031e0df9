"""How much may be fetched of a stranger's repository, checked before anything is asked for."""

from __future__ import annotations

FILES = 1000
"""Of one place or policy. A scene folder has a handful, a policy's code some dozen."""

BYTES = 8 * 2**30
"""Of all files together, packed and unpacked. The largest published scene is said to have 4 GB."""

MANIFEST = 2**20
"""Of the list that is kept of what was fetched: names and digests of `FILES` files."""
